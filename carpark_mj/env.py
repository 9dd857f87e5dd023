"""The parking environment: reads like the definition of the MDP.

One `ParkingEnv` describes one lot with its agents; `jax.vmap` over keys and states
gives a batch, in which every lot may have another layout of the same padded shape.
The object holds constants only; everything that changes is in `State`.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from carpark_mj import metrics, rewards
from carpark_mj.actions import ActionSpec, neutralise, neutralise_choices
from carpark_mj.config import EnvConfig, LayoutConfig
from carpark_mj.episode import judge
from carpark_mj.fleet import Fleet
from carpark_mj.lanes import has_lanes, is_wrong_way
from carpark_mj.layouts import Layout, generate_member, layout_config, make_layout
from carpark_mj.layouts.splits import Split, lot_key, lot_number
from carpark_mj.observations import observation_size, observe
from carpark_mj.observations.indices import observe_indices
from carpark_mj.observations.rings import count_rings, forget, init_history, remember
from carpark_mj.observations.tanner import observe_tanner
from carpark_mj.physics.base import Physics, where_cars
from carpark_mj.physics.bicycle import BicyclePhysics
from carpark_mj.physics.contact import ContactPhysics
from carpark_mj.physics.grid import GridPhysics
from carpark_mj.physics.mjx import MjxPhysics
from carpark_mj.physics.scene import ScenePhysics
from carpark_mj.precision import full_float32
from carpark_mj.randomisation import check, make_fleet
from carpark_mj.respawn import first_poses, renew
from carpark_mj.sensors import init_sensors, observed, update_sensors
from carpark_mj.state import State, TimeStep
from carpark_mj.types import Events, VehicleState
from carpark_mj.vehicle import VehicleParameters, drive, preset


class ParkingEnv:
    """N agents park in a lot; see `EnvConfig` for what can be set.

    - observation: (num_agents, observation_size) float32, `observations.fields`.
    - action: (num_agents, 2) steer and pedal in [-1, 1], `vehicle.drive`; or on the
      grid indices of an acceleration and a turn, `choices`.
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
        physics: Physics | None = None,
        vehicle: VehicleParameters | None = None,
    ) -> None:
        """Builds the constants.

        Args:
            config: the environment; defaults to `EnvConfig()`.
            physics: back end; defaults to the one that `config.physics` names.
            vehicle: a car of one's own instead of the preset `config.vehicle`.

        Raises:
            ValueError: the lot cannot hold the cars asked for, the randomisation
                could draw an impossible car, or there is no such preset.
        """
        self.config = config if config is not None else EnvConfig()
        self.vehicle = vehicle if vehicle is not None else preset(self.config.vehicle)
        self.fleet = Fleet(self.config, self.vehicle)
        for params in self.fleet.agents:
            check(self.config.randomisation, params)
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
        goals, free = self.config.goals, bays - self.config.num_parked_cars
        if goals.dynamic and goals.num_spaces > free:
            raise ValueError(
                f"goals.num_spaces must be at most {free} ({bays} bays less "
                f"{self.config.num_parked_cars} parked cars), not {goals.num_spaces}"
            )
        self.fleet.check(self._lot, self._layout)
        self.physics: Any = physics if physics is not None else self._make_physics()

    def _make_physics(self) -> Physics:
        contact = self.config.sim.tyres == "contact"
        if self.config.physics == "grid":
            return GridPhysics(self.config.grid, self.config.sim)
        if self.config.physics == "bicycle":
            return BicyclePhysics(self.config.sim)
        if self.config.physics == "mjx":
            return (ContactPhysics if contact else MjxPhysics)(self.config.sim)
        if contact:
            raise ValueError("scene physics has brush tyres only, not contact")
        if self._layout is None:
            raise ValueError(
                f"scene physics needs the same lot for every key, not "
                f"{self.config.layout!r}"
            )
        if self.config.fleet.is_on or self.config.jitter.scale != (1.0, 1.0):
            raise ValueError(
                "scene physics has cars of one kind and size only, no fleet and no "
                "jitter.scale: use mjx"
            )
        return ScenePhysics(
            self.config.sim,
            self._layout,
            self.vehicle,
            self.config.num_agents,
            self.config.num_parked_cars,
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
        if self.config.physics == "grid":
            return ActionSpec(0, self.config.grid.choices)
        return ActionSpec(2)

    @property
    def choices(self) -> tuple[int, ...] | None:
        """How many there are in each branch of an action; None if it is continuous."""
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
        config = self.config
        key, fleet_key, sensor_key = self._split_if_random(key)
        key, occupancy_key, spawn_key = jax.random.split(key, 3)
        start = self.fleet.start(layout, occupancy_key)
        occupancy, parked_size = start.occupancy, start.parked_size
        fleet = make_fleet(
            config.randomisation, start.cars, config.num_agents, fleet_key
        )
        offset = start.parked_offset
        blocked = self.fleet.blocked(
            layout, fleet.size, fleet.size, parked_size, offset
        )
        pose = first_poses(config.spawn, layout, occupancy, spawn_key, blocked)
        parked_pose = self.fleet.parked_pose(
            layout, occupancy.parked_bay, parked_size, offset
        )
        physics = self.physics.init(pose, fleet)
        physics = self.physics.arrange(physics, parked_pose)
        vehicle = self.physics.read(physics)
        state = State(
            physics=physics,
            vehicle=vehicle,
            layout=layout,
            occupancy=occupancy,
            spaces=None,
            ring_history=init_history(config.observation, config.num_agents),
            parked_size=parked_size,
            parked_offset=offset,
            step=jnp.zeros(config.num_agents, jnp.int32),
            active=jnp.ones(config.num_agents, bool),
            stats=metrics.init_stats(config.num_agents, has_lanes(layout)),
            sensors=init_sensors(config.sensors, vehicle, sensor_key),
            key=key,
        )
        return state, self._observe(state)

    @full_float32
    def step(self, state: State, action: jax.Array) -> tuple[State, TimeStep]:
        """Advances the lot by one control step.

        Args:
            state: current state.
            action: (num_agents, 2) steer and pedal in [-1, 1], or indices on the grid;
                agents that have finished brake instead. What is NaN or outside is
                neutralised and counted in the metric `invalid_actions`.

        Returns:
            The next state and what the agents learn.
        """
        config = self.config
        key, fleet_key, sensor_key = self._split_if_random(state.key)
        state = dataclasses.replace(state, key=key)
        if self.choices is not None:  # who has finished is frozen in any case
            action, invalid = neutralise_choices(action, self.choices)
        else:
            stop = drive.stopping_action(state.vehicle.speed)
            action = jnp.where(state.active[:, None], action, stop).astype(jnp.float32)
            action, invalid = neutralise(action)
        ring_history = self._remember_rings(state)
        physics = self.physics.step(state.physics, action)
        vehicle = self.physics.read(physics)
        if not (config.episode.respawn or self.physics.contacts):
            physics, vehicle = self._freeze(state, physics, vehicle)
        step = state.step + state.active
        goal_pose = state.layout.bay_pose[state.occupancy.goal]
        with jax.named_scope("episode"):
            events = judge(
                config.episode,
                state.layout,
                vehicle,
                state.occupancy.goal,
                self._parked_pose(state),
                state.parked_size,
                step,
                state.active,
            )
        wrong_way = None
        if has_lanes(state.layout):
            wrong_way = is_wrong_way(state.layout, vehicle)
        with jax.named_scope("rewards"):
            steering_rate = state.physics.vehicle.steering_rate
            steering_change = steering_rate * config.sim.ctrl_dt
            terms = rewards.reward_terms(
                config.reward,
                state.vehicle,
                vehicle,
                goal_pose,
                events,
                steering_change,
                config.episode.max_steps,
                wrong_way,
            )
            terms = {
                name: jnp.where(state.active, term, 0.0) for name, term in terms.items()
            }
            reward = jnp.sum(jnp.stack(list(terms.values())), axis=0)
        stats = jax.tree.map(
            lambda new, old: jnp.where(state.active, new, old),
            metrics.update_stats(
                state.stats, state.vehicle, vehicle, reward, invalid, wrong_way
            ),
            state.stats,
        )
        named = metrics.step_metrics(stats, events, vehicle, goal_pose)
        state = dataclasses.replace(
            state, physics=physics, vehicle=vehicle, step=step, stats=stats
        )
        if config.episode.respawn:
            with jax.named_scope("respawn"):
                state = self._respawn(state, events, fleet_key)
        else:
            state = dataclasses.replace(state, active=state.active & ~events.done)
        respawned = events.done & config.episode.respawn
        sensors = update_sensors(
            config.sensors, state.sensors, state.vehicle, respawned, sensor_key
        )
        ring_history = forget(ring_history, respawned)
        state = dataclasses.replace(state, sensors=sensors, ring_history=ring_history)
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

    def parked_pose(self, state: State) -> jax.Array:
        """Poses (num_parked_cars, 3) of the parked cars, pushed or in their bays.

        Cars that `EnvConfig.occupancy` leaves out stand far `fit.AWAY`.
        """
        if self.physics.contacts:
            return self.physics.parked_pose(state.physics)
        return self._parked_pose(state)

    def _parked_pose(self, state: State) -> jax.Array:
        """Where the parked cars are meant to stand, (num_parked_cars, 3)."""
        return self.fleet.parked_pose(
            state.layout,
            state.occupancy.parked_bay,
            state.parked_size,
            state.parked_offset,
        )

    def final_observation(self, state: State, timestep: TimeStep) -> jax.Array:
        """What agents saw at the end of a step, before any of them respawned.

        Args:
            state: before the step; goals and parked cars are as they were then.
            timestep: what the step returned.

        Returns:
            (num_agents, observation_size); `timestep.observation` where nobody was
            done.
        """
        ring_history = self._remember_rings(state)
        vehicle = timestep.vehicle
        return self._observe(
            dataclasses.replace(state, vehicle=vehicle, ring_history=ring_history)
        )

    def _freeze(
        self, state: State, physics: Any, vehicle: VehicleState
    ) -> tuple[Any, VehicleState]:
        """Keeps finished agents exactly where they stopped."""
        physics = where_cars(state.active, physics, state.physics)
        vehicle = where_cars(state.active, vehicle, state.vehicle)
        still = jnp.broadcast_to(vehicle.pose_w[:, None], vehicle.trace_w.shape)
        trace_w = where_cars(state.active, vehicle.trace_w, still)
        return physics, dataclasses.replace(vehicle, trace_w=trace_w)

    def _split_if_random(self, key: jax.Array) -> tuple[jax.Array, ...]:
        """The lot's next key, and one each for the cars and their sensors.

        Without randomisation the key stays as it is: lots are drawn as if there were
        no such thing.
        """
        config = self.config
        if config.randomisation.is_on or config.sensors.is_on or self.fleet.varies:
            return tuple(jax.random.split(key, 3))
        return key, key, key

    def _respawn(self, state: State, events: Events, fleet_key: jax.Array) -> State:
        """Starts new episodes: goals, cars and poses of those that are done."""
        config = self.config
        key, respawn_key = jax.random.split(state.key)
        done = events.done
        layout, old = state.layout, state.physics.vehicle
        fleet = old
        if config.randomisation.is_on or self.fleet.mixed:
            cars, fleet_key = self.fleet.draw_agents(fleet_key)
            fleet = make_fleet(config.randomisation, cars, config.num_agents, fleet_key)
        parked_size, offset = state.parked_size, state.parked_offset
        occupancy, pose = renew(
            config.spawn,
            layout,
            state.occupancy,
            state.vehicle.pose_w,
            done,
            events.parked,
            respawn_key,
            self.fleet.bays_for(layout, fleet.size, parked_size),
            self.fleet.blocked(layout, old.size, fleet.size, parked_size, offset),
        )
        if self.fleet.mixed:  # who finds no bay for his new car keeps goal and car
            fleet = where_cars(occupancy.goal != state.occupancy.goal, fleet, old)
        physics = self.physics.place(state.physics, done, pose, fleet)
        parked_pose = self.fleet.parked_pose(
            layout, occupancy.parked_bay, parked_size, offset
        )
        physics = self.physics.arrange(physics, parked_pose)
        return dataclasses.replace(
            state,
            physics=physics,
            vehicle=where_cars(done, self.physics.read(physics), state.vehicle),
            occupancy=occupancy,
            step=jnp.where(done, 0, state.step),
            stats=where_cars(
                done,
                metrics.init_stats(config.num_agents, has_lanes(state.layout)),
                state.stats,
            ),
            key=key,
        )

    def _observe(self, state: State) -> jax.Array:
        config = self.config
        present = None
        if self.fleet.varies:
            present = state.occupancy.parked_bay < state.layout.num_bays
        cars = (
            state.layout,
            observed(state.sensors, state.vehicle),
            state.occupancy.goal,
            self._parked_pose(state),
            state.parked_size,
        )
        if config.observation.encoding != "continuous":
            grid = (config.observation, config.grid, config.sim.ctrl_dt)
            if config.observation.encoding == "indices":
                return observe_indices(*grid, *cars, state.ring_history)
            return observe_tanner(
                *grid, *cars, present, state.spaces, state.ring_history
            )
        fleet = state.physics.vehicle
        return observe(
            config.observation,
            *cars,
            fleet.max_speed,
            fleet.max_steering,
            present,
            (fleet.wheelbase, fleet.centre_offset),
            state.spaces,
            state.ring_history,
        )

    def _remember_rings(self, state: State) -> jax.Array | None:
        """Past counts of the rings once those of `state` belong to them."""
        if state.ring_history is None:
            return None
        count = count_rings(
            self.config.observation,
            state.layout,
            observed(state.sensors, state.vehicle),
            self._parked_pose(state),
            state.parked_size,
        )
        return remember(state.ring_history, count)
