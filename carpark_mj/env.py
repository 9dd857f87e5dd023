"""The parking environment: reads like the definition of the MDP.

One `ParkingEnv` describes one lot with its agents; `jax.vmap` over keys and states
gives a batch, in which every lot may have another layout of the same padded shape.
The object holds constants only; everything that changes is in `State`.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj import metrics, rewards
from carpark_mj.config import EnvConfig
from carpark_mj.episode import judge
from carpark_mj.goals import Occupancy, evolve, init_occupancy, new_goal
from carpark_mj.layouts import Layout, generate, layout_config, make_layout
from carpark_mj.observations import observation_size, observe
from carpark_mj.physics.base import Physics
from carpark_mj.physics.mjx import MjxPhysics
from carpark_mj.precision import full_float32
from carpark_mj.spawn import spawn_pose
from carpark_mj.types import Events, VehicleState
from carpark_mj.vehicle import make_vehicle, preset


@struct.dataclass
class State:
    """Everything about one lot at one time.

    Attributes:
        physics: state of the back end, (num_agents,) cars.
        vehicle: the agents' motion, read from it.
        layout: the lot.
        occupancy: goals and parked cars.
        parked_size: (num_parked_cars, 2) footprints [m].
        step: (num_agents,) int32 control steps made in the running episodes.
        active: (num_agents,) bool; False once finished when nobody respawns.
        stats: per-episode sums.
        key: randomness of this lot.
    """

    physics: Any
    vehicle: VehicleState
    layout: Layout
    occupancy: Occupancy
    parked_size: jax.Array
    step: jax.Array
    active: jax.Array
    stats: metrics.EpisodeStats
    key: jax.Array


@struct.dataclass
class TimeStep:
    """What a step tells the agents; all leading dimension (num_agents,).

    Attributes:
        observation: (num_agents, observation_size); of the new episode where an agent
            has respawned.
        reward: (num_agents,).
        terminated: (num_agents,) bool, parked or crashed: the cost to go is zero.
        truncated: (num_agents,) bool, timed out or diverged: it is not.
        events: what happened.
        metrics: per-episode numbers, valid where `events.done`.
        reward_terms: the reward by term.
        vehicle: motion at the end of the step, before any respawn.
    """

    observation: jax.Array
    reward: jax.Array
    terminated: jax.Array
    truncated: jax.Array
    events: Events
    metrics: dict[str, jax.Array]
    reward_terms: dict[str, jax.Array]
    vehicle: VehicleState


class ParkingEnv:
    """N agents park in a lot; see `EnvConfig` for what can be set.

    - observation: (num_agents, observation_size) float32, `observations.fields`.
    - action: (num_agents, 2) steer and pedal in [-1, 1], `vehicle.drive`.
    - reward: (num_agents,), `rewards`.
    - episodes belong to agents: one that parks, crashes or times out respawns alone
      (or stays put, `EpisodeConfig.respawn`) while the others drive on.

    >>> env = ParkingEnv(EnvConfig(num_agents=2))
    >>> state, observation = jax.jit(env.reset)(jax.random.key(0))
    >>> state, timestep = jax.jit(env.step)(state, jnp.zeros((2, 2)))
    """

    def __init__(
        self, config: EnvConfig | None = None, physics: Physics | None = None
    ) -> None:
        """Builds the constants.

        Args:
            config: the environment; defaults to `EnvConfig()`.
            physics: back end; defaults to MJX with brush tyres.

        Raises:
            ValueError: the lot cannot hold the cars asked for.
        """
        self.config = config if config is not None else EnvConfig()
        self.physics: Any = (
            physics if physics is not None else MjxPhysics(self.config.sim)
        )
        self._vehicle = make_vehicle(preset(self.config.vehicle))
        self._lot = layout_config(self.config.layout)
        self._layout = None if self._lot.is_random else make_layout(self._lot)
        bays = self._lot.min_bays
        free = bays - self.config.num_agents
        if free < 0:
            raise ValueError(
                f"num_agents must be at most {bays} (a goal bay each), not "
                f"{self.config.num_agents}"
            )
        if self.config.num_parked_cars > free:
            raise ValueError(
                f"num_parked_cars must be at most {free} ({bays} bays less "
                f"{self.config.num_agents} agents' goals), not "
                f"{self.config.num_parked_cars}"
            )

    @property
    def num_agents(self) -> int:
        """Agents in the lot."""
        return self.config.num_agents

    @property
    def observation_size(self) -> int:
        """Length of an agent's observation."""
        return observation_size(self.config.observation)

    @property
    def action_size(self) -> int:
        """Length of an agent's action."""
        return 2

    def reset(self, key: jax.Array) -> tuple[State, jax.Array]:
        """Starts a lot: its layout if it is random, parked cars, goals and agents.

        Args:
            key: consumed.

        Returns:
            The state and the observations (num_agents, observation_size).
        """
        if self._layout is not None:
            return self.reset_to_layout(self._layout, key)
        key, layout_key = jax.random.split(key)
        return self.reset_to_layout(self.draw_layout(layout_key), key)

    @full_float32
    def draw_layout(self, key: jax.Array) -> Layout:
        """Draws a layout as `reset` does; always of the same shape."""
        return generate(self._lot, key)

    @full_float32
    def reset_to_layout(
        self, layout: Layout, key: jax.Array
    ) -> tuple[State, jax.Array]:
        """Starts a given lot, which must have bays enough for cars and goals."""
        config = self.config
        key, occupancy_key, spawn_key = jax.random.split(key, 3)
        occupancy = init_occupancy(
            layout, config.num_agents, config.num_parked_cars, occupancy_key
        )
        goal_pose = layout.bay_pose[occupancy.goal]

        def place(carry: tuple[jax.Array, jax.Array], agent: jax.Array):
            pose, placed = carry
            drawn = spawn_pose(
                config.spawn,
                layout,
                goal_pose[agent],
                pose[:, :2],
                placed,
                jax.random.fold_in(spawn_key, agent),
            )
            return (pose.at[agent].set(drawn), placed.at[agent].set(True)), None

        nowhere = jnp.zeros((config.num_agents, 3), jnp.float32)
        nobody = jnp.zeros(config.num_agents, bool)
        agents = jnp.arange(config.num_agents)
        (pose, _), _ = jax.lax.scan(place, (nowhere, nobody), agents)
        fleet = jax.tree.map(
            lambda x: jnp.broadcast_to(x, (config.num_agents, *x.shape)),
            self._vehicle,
        )
        physics = self.physics.init(pose, fleet)
        state = State(
            physics=physics,
            vehicle=self.physics.read(physics),
            layout=layout,
            occupancy=occupancy,
            parked_size=jnp.broadcast_to(
                self._vehicle.size, (config.num_parked_cars, 2)
            ),
            step=jnp.zeros(config.num_agents, jnp.int32),
            active=jnp.ones(config.num_agents, bool),
            stats=metrics.init_stats(config.num_agents),
            key=key,
        )
        return state, self._observe(state)

    @full_float32
    def step(self, state: State, action: jax.Array) -> tuple[State, TimeStep]:
        """Advances the lot by one control step.

        Args:
            state: current state.
            action: (num_agents, 2) steer and pedal in [-1, 1]; ignored for agents
                that have finished.

        Returns:
            The next state and what the agents learn.
        """
        config = self.config
        action = jnp.where(state.active[:, None], action, 0.0).astype(jnp.float32)
        physics = self.physics.step(state.physics, action)
        vehicle = self.physics.read(physics)
        if not config.episode.respawn:
            physics, vehicle = self._freeze(state, physics, vehicle)
        step = state.step + state.active
        goal_pose = state.layout.bay_pose[state.occupancy.goal]
        with jax.named_scope("episode"):
            events = judge(
                config.episode,
                state.layout,
                vehicle,
                state.occupancy.goal,
                state.occupancy.parked_bay,
                state.parked_size,
                step,
                state.active,
            )
        with jax.named_scope("rewards"):
            steering_change = self._vehicle.steering_rate * config.sim.ctrl_dt
            terms = rewards.reward_terms(
                config.reward,
                state.vehicle,
                vehicle,
                goal_pose,
                events,
                steering_change,
                config.episode.max_steps,
            )
            terms = {
                name: jnp.where(state.active, term, 0.0) for name, term in terms.items()
            }
            reward = jnp.sum(jnp.stack(list(terms.values())), axis=0)
        stats = jax.tree.map(
            lambda new, old: jnp.where(state.active, new, old),
            metrics.update_stats(state.stats, state.vehicle, vehicle, reward),
            state.stats,
        )
        named = metrics.step_metrics(stats, events, vehicle, goal_pose)
        state = dataclasses.replace(
            state, physics=physics, vehicle=vehicle, step=step, stats=stats
        )
        if config.episode.respawn:
            with jax.named_scope("respawn"):
                state = self._respawn(state, events)
        else:
            state = dataclasses.replace(state, active=state.active & ~events.done)
        with jax.named_scope("observations"):
            observation = self._observe(state)
        return state, TimeStep(
            observation=observation,
            reward=reward,
            terminated=events.parked | events.crashed,
            truncated=events.timed_out | events.diverged,
            events=events,
            metrics=named,
            reward_terms=terms,
            vehicle=vehicle,
        )

    def _freeze(
        self, state: State, physics: Any, vehicle: VehicleState
    ) -> tuple[Any, VehicleState]:
        """Keeps finished agents exactly where they stopped."""

        def keep(new: jax.Array, old: jax.Array) -> jax.Array:
            active = state.active.reshape(-1, *([1] * (new.ndim - 1)))
            return jnp.where(active, new, old)

        physics = jax.tree.map(keep, physics, state.physics)
        vehicle = jax.tree.map(keep, vehicle, state.vehicle)
        still = jnp.broadcast_to(vehicle.pose_w[:, None], vehicle.trace_w.shape)
        trace_w = keep(vehicle.trace_w, still)
        return physics, dataclasses.replace(vehicle, trace_w=trace_w)

    def _respawn(self, state: State, events: Events) -> State:
        """Starts new episodes, one agent after the other so that goals stay apart."""
        config = self.config
        key, respawn_key = jax.random.split(state.key)
        done = events.done

        def renew(carry: tuple[Occupancy, jax.Array], agent: jax.Array):
            occupancy, pose = carry
            goal_key, spawn_key = jax.random.split(
                jax.random.fold_in(respawn_key, agent)
            )
            evolved = evolve(
                state.layout, occupancy, agent, pose[:, :2], events.parked[agent]
            )
            renewed = new_goal(
                state.layout,
                evolved,
                agent,
                pose[:, :2],
                config.spawn.min_distance,
                goal_key,
            )
            start = spawn_pose(
                config.spawn,
                state.layout,
                state.layout.bay_pose[renewed.goal[agent]],
                pose[:, :2],
                jnp.arange(config.num_agents) != agent,
                spawn_key,
            )
            pose = pose.at[agent].set(jnp.where(done[agent], start, pose[agent]))
            occupancy = jax.tree.map(
                lambda new, old: jnp.where(done[agent], new, old), renewed, occupancy
            )
            return (occupancy, pose), None

        (occupancy, pose), _ = jax.lax.scan(
            renew,
            (state.occupancy, state.vehicle.pose_w),
            jnp.arange(config.num_agents),
        )
        fresh = self.physics.init(pose, state.physics.vehicle)

        def select(new: jax.Array, old: jax.Array) -> jax.Array:
            return jnp.where(done.reshape(-1, *([1] * (new.ndim - 1))), new, old)

        return dataclasses.replace(
            state,
            physics=jax.tree.map(select, fresh, state.physics),
            vehicle=jax.tree.map(select, self.physics.read(fresh), state.vehicle),
            occupancy=occupancy,
            step=jnp.where(done, 0, state.step),
            stats=jax.tree.map(
                select, metrics.init_stats(config.num_agents), state.stats
            ),
            key=key,
        )

    def _observe(self, state: State) -> jax.Array:
        fleet = state.physics.vehicle
        return observe(
            self.config.observation,
            state.layout,
            state.vehicle,
            state.occupancy.goal,
            state.occupancy.parked_bay,
            state.parked_size,
            fleet.max_speed,
            fleet.max_steering,
        )
