"""The parking environment: reads like the definition of the MDP.

One `ParkingEnv` describes one lot with its agents; `jax.vmap` over keys and states
gives a batch, in which every lot may have another layout of the same padded shape.
The object holds constants only; everything that changes is in `State`.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from carpark_mj.config import EnvConfig, LayoutConfig
from carpark_mj.fleet.draw import Fleet
from carpark_mj.fleet.randomization import check
from carpark_mj.layouts import Layout, generate_member, layout_config, make_layout
from carpark_mj.layouts.lanes import has_lanes
from carpark_mj.layouts.splits import Split, lot_key, lot_number
from carpark_mj.mdp.actions import ActionSpec, harmless
from carpark_mj.mdp.chosen_goals import goal_counts
from carpark_mj.mdp.giving_way import count
from carpark_mj.mdp.lanes import is_wrong_way
from carpark_mj.mdp.metrics import episode as metrics
from carpark_mj.mdp.metrics.tallies import measure
from carpark_mj.mdp.rewarding import goal_poses, step_rewards
from carpark_mj.mdp.searching import choose, look_round, review, set_out, stay
from carpark_mj.mdp.spawning.starts import (
    check_room,
    restart,
    split_if_random,
    start_lot,
    start_stats,
)
from carpark_mj.mdp.terminations import judge
from carpark_mj.mdp.tracked_bays import nearer_to_any
from carpark_mj.observations import observation_size
from carpark_mj.observations.observing import (
    intended_parked_pose,
    observe_lot,
    remember_rings,
    who_tracks,
)
from carpark_mj.observations.rings import forget
from carpark_mj.observations.sensors import update_sensors
from carpark_mj.observations.tracking import in_view
from carpark_mj.physics.base import Physics, where_cars
from carpark_mj.physics.make import make_physics
from carpark_mj.precision import full_float32
from carpark_mj.state import State, TimeStep
from carpark_mj.types import Motion
from carpark_mj.vehicle import VehicleParameters, drive, preset


class ParkingEnv:
    """N agents park in a lot; see `EnvConfig` for what can be set.

    - observation: (num_agents, observation_size) float32, `observations.fields`.
    - action: (num_agents, 2) steer and pedal in [-1, 1], `vehicle.drive`; or on the
      grid indices of an acceleration and a turn, `choices`. With dynamic goals one
      index more: 0 = explore, k = head for the k-th of the tracked bays.
    - reward: (num_agents,), `rewards`.
    - episodes belong to agents: one that parks, crashes or times out respawns alone
      (or stays put, `EpisodeConfig.respawn`) while the others drive on.

    >>> env = ParkingEnv(EnvConfig(num_agents=2))
    >>> state, observation = jax.jit(env.reset)(jax.random.key(0))
    >>> state, timestep = jax.jit(env.step)(state, jnp.zeros((2, 2)))
    """

    def __init__(
        self,
        config: EnvConfig | None = None,
        physics: Physics[Any] | None = None,
        vehicle: VehicleParameters | None = None,
    ) -> None:
        """Builds the constants.

        Args:
            config: the environment; defaults to `EnvConfig()`.
            physics: back end; defaults to the one that `config.physics` names.
            vehicle: a car of one's own instead of the preset `config.vehicle`.

        Raises:
            ValueError: the lot cannot hold the cars asked for, the randomization
                could draw an impossible car, or there is no such preset.
        """
        self.config = config if config is not None else EnvConfig()
        self.vehicle = vehicle if vehicle is not None else preset(self.config.vehicle)
        self.fleet = Fleet(self.config, self.vehicle)
        for params in self.fleet.agents:
            check(self.config.randomization, params)
        self._lot = layout_config(self.config.layout)
        self._layout = None if self._lot.is_random else make_layout(self._lot)
        check_room(self.config, self._lot)
        self.fleet.check(self._lot, self._layout)
        self.physics: Any = (
            physics
            if physics is not None
            else make_physics(self.config, self._layout, self.vehicle)
        )

    @property
    def num_agents(self) -> int:
        """Agents in the lot."""
        return self.config.num_agents

    @property
    def lot(self) -> LayoutConfig:
        """The lot, or the family it is drawn from."""
        return self._lot

    @property
    def observation_size(self) -> int:
        """Length of an agent's observation."""
        goals = self.config.goals
        num_spaces = goals.num_spaces if goals.dynamic else 0
        return observation_size(self.config.observation, num_spaces)

    @property
    def action_size(self) -> int:
        """Length of an agent's action."""
        return self.action_spec.size

    @property
    def action_spec(self) -> ActionSpec:
        """What an agent's action consists of."""
        goals = self.config.goals
        goal = (1 + goals.num_spaces,) if goals.dynamic else ()
        if self.config.physics == "grid":
            return ActionSpec(0, (*self.config.grid.choices, *goal))
        return ActionSpec(2, goal)

    @property
    def choices(self) -> tuple[int, ...] | None:
        """How many there are in each branch of an action; None without branches."""
        return self.action_spec.choices or None

    def reset(
        self, key: jax.Array, split: Split = "train", member: jax.Array | None = None
    ) -> tuple[State, jax.Array]:
        """Starts a lot: its layout if it is random, parked cars, goals and agents.

        Args:
            key: consumed.
            split: lots to draw a random layout from; those of `test` are held out for
                evaluation (`carpark_mj.layouts.splits`).
            member: () int32 which member of a mixture the lot is of; drawn if None.

        Returns:
            The state and the observations (num_agents, observation_size).
        """
        if self._layout is not None:
            return self.reset_to_layout(self._layout, key)
        key, layout_key = jax.random.split(key)
        return self.reset_to_layout(self.draw_layout(layout_key, split, member), key)

    @full_float32
    def draw_layout(
        self, key: jax.Array, split: Split = "train", member: jax.Array | None = None
    ) -> Layout:
        """Draws a layout as `reset` does; always of the same shape."""
        return generate_member(self._lot, member, lot_key(lot_number(split, key)))

    @full_float32
    def reset_to_layout(
        self, layout: Layout, key: jax.Array
    ) -> tuple[State, jax.Array]:
        """Starts a given lot, which must have bays enough for cars and goals."""
        state = start_lot(self.config, self.fleet, self.physics, layout, key)
        if self.config.goals.dynamic:
            state, _ = look_round(state, self._fitting(state))
        return state, self._observe(state)

    @full_float32
    def step(
        self, state: State, action: jax.Array, hitbox_scale: jax.Array | None = None
    ) -> tuple[State, TimeStep]:
        """Advances the lot by one control step.

        Args:
            state: current state.
            action: (num_agents, action_size), see `action_spec`; agents that have
                finished brake instead. What is NaN or outside is neutralised and
                counted in the metric `invalid_actions`.
            hitbox_scale: see `find_hits`; None = 1.

        Returns:
            The next state and what the agents learn.
        """
        config = self.config
        key, cars_key, sensor_key = split_if_random(config, self.fleet, state.key)
        state = dataclasses.replace(state, key=key)
        controls, choice, invalid = self._read(state, action)
        before = state
        if config.goals.dynamic:
            state = choose(state, choice[:, 0])
        goal = state.occupancy.goal

        ring_history = remember_rings(config, self.fleet, before)
        physics = self.physics.step(state.physics, controls)
        vehicle = self.physics.read(physics)
        if not (config.episode.respawn or self.physics.contacts):
            physics, vehicle = self._freeze(state, physics, vehicle)
        step = state.step + state.active
        with jax.named_scope("episode"):
            events = judge(
                config.episode,
                state.layout,
                vehicle,
                goal,
                intended_parked_pose(self.fleet, state),
                state.parked_size,
                step,
                state.active,
                config.goals.dynamic,
                hitbox_scale,
            )
        after = dataclasses.replace(state, physics=physics, vehicle=vehicle, step=step)
        starts = None
        if config.episode.respawn:
            with jax.named_scope("respawn"):
                after, taken, starts = restart(
                    config, self.fleet, self.physics, after, events, cars_key
                )
        else:
            after = dataclasses.replace(after, active=after.active & ~events.done)
            after, taken = stay(after, events)
        goals = contexts = None
        if config.goals.dynamic:
            with jax.named_scope("goals"):
                fitting = self._fitting(after)
                after, goals, contexts = review(
                    before,
                    goal,
                    after,
                    events,
                    taken,
                    fitting,
                    who_tracks(config, self.fleet, before),
                )
                after = set_out(after, events.done, starts)

        wrong_way = None
        if has_lanes(state.layout):
            wrong_way = is_wrong_way(state.layout, vehicle)
        with jax.named_scope("rewards"):
            goal_pose = goal_poses(state, vehicle)
            terms = step_rewards(
                config,
                before,
                state,
                vehicle,
                goal_pose,
                events,
                wrong_way,
                goals,
                contexts,
            )
            reward = jnp.sum(jnp.stack(list(terms.values())), axis=0)
        measured = {f"return_{name}": term for name, term in terms.items()}
        if goals is not None and contexts is not None and before.spaces is not None:
            way = before.vehicle.pose_w[:, :2], vehicle.pose_w[:, :2]
            nearer = nearer_to_any(state.layout, before.spaces, *way)
            measured |= goal_counts(goals, nearer)
            measured |= count(contexts, goals.change_goal | goals.stop_goal)
        if config.metrics.is_on:
            with jax.named_scope("metrics"):
                measured |= measure(
                    config.metrics,
                    config.sim.ctrl_dt,
                    state.layout,
                    state.stats.tallies,
                    state.vehicle,
                    vehicle,
                    goal_pose,
                    self.parked_pose(dataclasses.replace(state, physics=physics)),
                    state.parked_size,
                    state.occupancy.parked_bay < state.layout.num_bays,
                    goal < state.layout.num_bays,
                )
        old, cars = state.stats, (state.vehicle, vehicle)
        stats = metrics.update_stats(old, *cars, reward, invalid, wrong_way, measured)
        stats = where_cars(state.active, stats, old)
        named = metrics.step_metrics(stats, events, vehicle, goal_pose)

        respawned = events.done & config.episode.respawn
        if config.episode.respawn:
            stats = where_cars(respawned, start_stats(config, state.layout), stats)
        sensors = update_sensors(
            config.sensors, state.sensors, after.vehicle, respawned, sensor_key
        )
        ring_history = forget(ring_history, respawned)
        after = dataclasses.replace(
            after, stats=stats, sensors=sensors, ring_history=ring_history
        )
        with jax.named_scope("observations"):
            observation = self._observe(after)
        return after, TimeStep(
            observation=observation,
            reward=reward,
            terminated=events.parked | events.crashed,
            truncated=events.timed_out | events.diverged,
            events=events,
            metrics=named,
            reward_terms=terms,
            vehicle=vehicle,
            goal=goal,
            goal_events=goals,
        )

    def parked_pose(self, state: State) -> jax.Array:
        """Poses (num_parked_cars, 3) of the parked cars, pushed or in their bays.

        Cars that `EnvConfig.occupancy` leaves out stand far `fit.AWAY`.
        """
        if self.physics.contacts:
            return self.physics.parked_poses(
                state.physics, intended_parked_pose(self.fleet, state)
            )
        return intended_parked_pose(self.fleet, state)

    def final_observation(self, state: State, timestep: TimeStep) -> jax.Array:
        """What agents saw at the end of a step, before any of them respawned.

        Args:
            state: before the step; parked cars are as they were then.
            timestep: what the step returned.

        Returns:
            (num_agents, observation_size); `timestep.observation` where nobody was
            done.
        """
        occupancy = dataclasses.replace(state.occupancy, goal=timestep.goal)
        ring_history = remember_rings(self.config, self.fleet, state)
        state = dataclasses.replace(
            state,
            vehicle=timestep.vehicle,
            occupancy=occupancy,
            ring_history=ring_history,
        )
        if self.config.goals.dynamic:
            state, _ = look_round(state, self._fitting(state))
        return self._observe(state)

    def _read(
        self, state: State, action: jax.Array
    ) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Controls for the physics, choices of goals, and who asked for nonsense."""
        spec = self.action_spec
        if not spec.continuous:  # who has finished is frozen in any case
            _, indices, invalid = harmless(spec, action)
            return indices[:, :2], indices[:, 2:], invalid
        stop = drive.stopping_action(state.vehicle.speed)
        stop = jnp.pad(stop, ((0, 0), (0, len(spec.choices))))
        action = jnp.where(state.active[:, None], action, stop).astype(jnp.float32)
        return harmless(spec, action)

    def _freeze(
        self, state: State, physics: Any, vehicle: Motion
    ) -> tuple[Any, Motion]:
        """Keeps finished agents exactly where they stopped."""
        physics = where_cars(state.active, physics, state.physics)
        vehicle = where_cars(state.active, vehicle, state.vehicle)
        still = jnp.broadcast_to(vehicle.pose_w[:, None], vehicle.trace_w.shape)
        trace_w = where_cars(state.active, vehicle.trace_w, still)
        return physics, dataclasses.replace(vehicle, trace_w=trace_w)

    def _fitting(self, state: State) -> jax.Array | None:
        """Bays (num_agents, bays) that an agent can track as a goal; None = all."""
        layout, view = state.layout, self.config.observation
        size = state.physics.vehicle.size
        fits = self.fleet.bays_for(layout, size, state.parked_size)[0]
        if view.field_of_view == 360.0 and view.tracking_diameter is None:
            return fits
        seen = in_view(view, state.vehicle.pose_w, layout.bay_pose[:, :2])
        return seen if fits is None else seen & fits

    def _observe(self, state: State) -> jax.Array:
        return observe_lot(self.config, self.fleet, state)
