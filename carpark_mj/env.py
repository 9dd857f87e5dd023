"""The parking environment: reads like the definition of the MDP.

One `ParkingEnv` describes one lot with its agents; `jax.vmap` over keys and states
gives a batch, in which every lot may have another layout of the same padded shape.
The object holds constants only; everything that changes is in `State`.
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp

from carpark_mj.config import EnvConfig, LayoutConfig
from carpark_mj.fleet.checks import check_cars, check_occupancy, check_room
from carpark_mj.fleet.draw import Fleet
from carpark_mj.fleet.randomization import check_randomization, randomize_all
from carpark_mj.layouts import Layout, generate_member, layout_config, make_layout
from carpark_mj.layouts.splits import Split, lot_key, lot_number
from carpark_mj.mdp import actions, metrics, rewards, terminations
from carpark_mj.mdp.actions import ActionSpec, action_spec
from carpark_mj.mdp.bays import bay_fits
from carpark_mj.mdp.goals import make_goals
from carpark_mj.mdp.parked_cars import in_bays, poses_in_bays, relocate_parked_cars
from carpark_mj.mdp.spawning.placing import (
    SpawnInputs,
    place_all,
    place_waiting,
    start_placing,
)
from carpark_mj.mdp.wrong_way import drives_wrong_way
from carpark_mj.observations import observation_size, observe, rings, sensors
from carpark_mj.physics.base import Physics, where_cars
from carpark_mj.physics.make import make_physics
from carpark_mj.precision import full_float32
from carpark_mj.types import (
    Events,
    Motion,
    ParkedCars,
    PhysicsState,
    State,
    TimeStep,
    Transition,
)
from carpark_mj.vehicle import Vehicle, VehicleParameters, drive, preset


class ParkingEnv:
    """N agents park in a lot; see `EnvConfig` for what can be set.

    - observation: (num_agents, observation_size) float32, `observations`.
    - action: (num_agents, 2) steer and pedal in [-1, 1], `vehicle.drive`; on the grid
      indices of an acceleration and a turn. With dynamic goals one index more: 0 =
      explore, k = head for the k-th of the tracked bays. See `action_spec`.
    - reward: (num_agents,), `mdp.rewards`.
    - episodes belong to agents: one that parks, crashes or times out respawns alone
      (or stays put, `EpisodeConfig.respawn`) while the others drive on.

    >>> env = ParkingEnv(EnvConfig(num_agents=2))
    >>> state, observation = jax.jit(env.reset)(jax.random.key(0))
    >>> state, timestep = jax.jit(env.step)(state, jnp.zeros((2, 2)))

    Attributes:
        config: what was configured.
        vehicle: parameters of the car that `config.vehicle` names, or one's own.
        fleet: what the cars are drawn from.
        layout_config: the lot, or the family it is drawn from.
        goals: who decides them.
        physics: the back end.
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
            ValueError: the lot cannot hold the cars asked for, the randomization
                could draw an impossible car, or there is no such preset.
        """
        self.config = config = config if config is not None else EnvConfig()
        self.vehicle = vehicle if vehicle is not None else preset(config.vehicle)
        self.fleet = Fleet(config, self.vehicle)
        self.layout_config: LayoutConfig = layout_config(config.layout)
        fixed = not self.layout_config.is_random
        self._layout = make_layout(self.layout_config) if fixed else None
        for params in self.fleet.agents:
            check_randomization(config.randomization, params)
        check_room(config, self.layout_config)
        check_occupancy(config, self.layout_config)
        check_cars(config, self.fleet, self.layout_config, self._layout)
        self.goals = make_goals(config)
        self.physics = physics or make_physics(config, self._layout, self.vehicle)

    @property
    def num_agents(self) -> int:
        """Agents in the lot."""
        return self.config.num_agents

    @property
    def observation_size(self) -> int:
        """Length of an agent's observation."""
        return observation_size(self.config)

    @property
    def action_spec(self) -> ActionSpec:
        """What an agent's action consists of."""
        return action_spec(self.config)

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
        key = lot_key(lot_number(split, key))
        return generate_member(self.layout_config, member, key)

    @full_float32
    def reset_to_layout(
        self, layout: Layout, key: jax.Array
    ) -> tuple[State, jax.Array]:
        """Starts a given lot, which must have bays enough for cars and goals."""
        config, everybody = self.config, jnp.ones(self.num_agents, bool)
        key, vehicle_key, sensor_key = self._split(key)
        key, start_key, spawn_key = jax.random.split(key, 3)
        start = self.fleet.start(layout, start_key)
        vehicles = randomize_all(config.randomization, start.vehicles, vehicle_key)
        inputs = self._spawn_inputs(layout, start.parked_cars, vehicles, vehicles)
        nowhere = jnp.zeros((self.num_agents, 3), jnp.float32)
        bay = start.parked_cars.bay
        placing = start_placing(start.goal, bay, nowhere, everybody)
        placing = place_all(self.goals.first_pose, inputs, placing, spawn_key)
        physics = self.physics.init(placing.pose_w, vehicles)
        physics = self.physics.set_parked_poses(physics, start.parked_cars.pose_w)
        motion = self.physics.read(physics)
        state = State(
            physics=physics,
            motion=motion,
            layout=layout,
            goal=start.goal,
            tracked_bays=self.goals.init_tracked_bays(),
            parked_cars=start.parked_cars,
            ring_history=rings.init_history(config),
            step=jnp.zeros(self.num_agents, jnp.int32),
            active=everybody,
            stats=metrics.init_stats(config, layout),
            sensors=sensors.init_sensors(config.sensors, motion, sensor_key),
            key=key,
        )
        state = self.goals.begin(state, placing, everybody, None)
        return state, observe(config, state)

    @full_float32
    def step(
        self, state: State, action: jax.Array, hitbox_scale: jax.Array | None = None
    ) -> tuple[State, TimeStep]:
        """Advances the lot by one control step.

        Args:
            state: current state.
            action: (num_agents, action_spec.size); agents that have finished brake
                instead. What is NaN or out of range is sanitized and counted in the
                metric `invalid_actions`.
            hitbox_scale: see `find_hits`; None = 1.

        Returns:
            The next state and what the agents learn.
        """
        config, before, keys = self.config, state, self._step_keys(state.key)
        act = actions.parse(config, self._stop_finished(before, action))
        chosen = self.goals.choose(before, act.goal_choice)
        after = self._move(chosen, act.controls, keys)
        with jax.named_scope("terminations"):
            events = terminations.judge(config.episode, after, hitbox_scale)
            ended = self._end_episodes(after, events, keys)
        with jax.named_scope("goals"):
            ended, goal_events = self.goals.update(before, ended, events)
            target_pose = self.goals.target_pose(after)
        wrong_way = drives_wrong_way(after.layout, after.motion)
        transition = Transition(
            before, after, target_pose, events, goal_events, wrong_way, act.invalid
        )
        with jax.named_scope("rewards"):
            terms = rewards.reward_terms(config, transition)
        with jax.named_scope("metrics"):
            stats = metrics.update_stats(config, transition, terms)
        ended = dataclasses.replace(ended, stats=stats, key=keys.next)
        with jax.named_scope("spawning"):
            state = self._begin_episodes(ended, events, keys)
        with jax.named_scope("observations"):
            observation = observe(config, state)
            final_observation = None
            if config.episode.final_observation:
                final_observation = observe(config, self.goals.track(after))
        return state, TimeStep(
            observation=observation,
            reward=jnp.sum(jnp.stack(list(terms.values())), axis=0),
            terminated=events.parked | events.crashed,
            truncated=events.timed_out | events.diverged,
            events=events,
            metrics=metrics.episode_metrics(transition, stats),
            reward_terms=terms,
            motion=after.motion,
            goal=after.goal,
            goal_events=goal_events,
            final_observation=final_observation,
        )

    def _move(self, state: State, controls: jax.Array, keys: "_StepKeys") -> State:
        """The state when the cars have moved and their motion has been measured."""
        config, ring_history = self.config, rings.update_history(self.config, state)
        physics = self.physics.step(state.physics, controls)
        motion = self.physics.read(physics)
        if not (config.episode.respawn or self.physics.contacts):
            physics, motion = _freeze(state, physics, motion)
        parked_cars = state.parked_cars
        pose_w = self.physics.parked_poses(physics, parked_cars.pose_w)
        return dataclasses.replace(
            state,
            physics=physics,
            motion=motion,
            parked_cars=dataclasses.replace(parked_cars, pose_w=pose_w),
            ring_history=ring_history,
            step=state.step + state.active,
            sensors=sensors.measure(
                config.sensors, state.sensors, motion, keys.reading
            ),
        )

    def _end_episodes(self, state: State, events: Events, keys: "_StepKeys") -> State:
        """Where agents respawn a parked car takes the place of each that has parked.

        Otherwise those that are done stay where they are and are no longer active.
        """
        if not self.config.episode.respawn:
            return dataclasses.replace(state, active=state.active & ~events.done)
        parked_cars = relocate_parked_cars(self.config, state, events, keys.relocate)
        return dataclasses.replace(state, parked_cars=parked_cars)

    def _begin_episodes(self, state: State, events: Events, keys: "_StepKeys") -> State:
        """New goals, cars and start poses of agents that are done."""
        config, begun, layout = self.config, events.done, state.layout
        if not config.episode.respawn:
            return state
        old, vehicles = state.physics.vehicle, self._draw_vehicles(state, keys.vehicles)
        inputs = self._spawn_inputs(layout, state.parked_cars, vehicles, old)
        placing = start_placing(
            state.goal, state.parked_cars.bay, state.motion.pose_w, begun
        )
        placing = place_waiting(self.goals.place, inputs, placing, keys.spawn)
        if self.fleet.mixed:  # who finds no bay for the new car keeps goal and car
            vehicles = where_cars(placing.found, vehicles, old)
        physics = self.physics.place(state.physics, begun, placing.pose_w, vehicles)
        parked_cars = in_bays(layout, state.parked_cars, placing.parked_bay)
        physics = self.physics.set_parked_poses(
            physics, poses_in_bays(layout, parked_cars)
        )
        pose_w = self.physics.parked_poses(physics, parked_cars.pose_w)
        motion = where_cars(begun, self.physics.read(physics), state.motion)
        state = dataclasses.replace(
            state,
            physics=physics,
            motion=motion,
            goal=placing.goal,
            parked_cars=dataclasses.replace(parked_cars, pose_w=pose_w),
            ring_history=rings.forget(state.ring_history, begun),
            step=jnp.where(begun, 0, state.step),
            stats=where_cars(begun, metrics.init_stats(config, layout), state.stats),
            sensors=sensors.reset(
                config.sensors, state.sensors, motion, begun, keys.sensors
            ),
        )
        return self.goals.begin(state, placing, begun, keys.first_goals)

    def _draw_vehicles(self, state: State, key: jax.Array) -> Vehicle:
        """Parameters (num_agents,) of cars for agents that begin; `key` is consumed."""
        config = self.config
        if not (config.randomization.is_on or self.fleet.mixed):
            return state.physics.vehicle
        nominal, key = self.fleet.draw_agents(key)
        return randomize_all(config.randomization, nominal, key)

    def _spawn_inputs(
        self, layout: Layout, parked_cars: ParkedCars, new: Vehicle, old: Vehicle
    ) -> SpawnInputs:
        fits = bay_fits(self.config, layout, new.size, parked_cars.size)
        # Spawn regions have room for cars of the one kind they were made for.
        sizes = (new.size, old.size) if self.fleet.mixed else (None, None)
        return SpawnInputs(layout, parked_cars, *sizes, fits)

    def _stop_finished(self, state: State, action: jax.Array) -> jax.Array:
        """Actions (num_agents, size) with those of finished agents on the brake."""
        spec = self.action_spec
        if not spec.continuous:  # on the grid who has finished is frozen in any case
            return action
        stop = drive.stopping_action(state.motion.speed)
        stop = jnp.pad(stop, ((0, 0), (0, len(spec.choices))))
        return jnp.where(state.active[:, None], action, stop).astype(jnp.float32)

    def _split(self, key: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        """The lot's next key, and one each for vehicles and sensors, if they vary."""
        config = self.config
        if config.randomization.is_on or config.sensors.is_on or config.varies:
            key, vehicle_key, sensor_key = jax.random.split(key, 3)
            return key, vehicle_key, sensor_key
        unused = jax.random.key(0)
        return key, unused, unused

    def _step_keys(self, key: jax.Array) -> "_StepKeys":
        key, vehicles, sensor_key = self._split(key)
        reading, sensors = jax.random.split(sensor_key)
        spawn = key
        if self.config.episode.respawn:
            key, spawn = jax.random.split(key)
        n = self.num_agents  # agents take the parts 0 to n - 1
        return _StepKeys(
            next=key,
            vehicles=vehicles,
            reading=reading,
            sensors=sensors,
            spawn=spawn,
            first_goals=jax.random.fold_in(spawn, n),
            relocate=jax.random.fold_in(spawn, n + 1),
        )


class _StepKeys(NamedTuple):
    """A key for each thing that is drawn in a step, and the state's next."""

    next: jax.Array
    vehicles: jax.Array
    reading: jax.Array
    sensors: jax.Array
    spawn: jax.Array
    first_goals: jax.Array
    relocate: jax.Array


def _freeze(
    state: State, physics: PhysicsState, motion: Motion
) -> tuple[PhysicsState, Motion]:
    """Keeps finished agents exactly where they stopped."""
    physics = where_cars(state.active, physics, state.physics)
    motion = where_cars(state.active, motion, state.motion)
    still = jnp.broadcast_to(motion.pose_w[:, None], motion.trace_w.shape)
    trace_w = where_cars(state.active, motion.trace_w, still)
    return physics, dataclasses.replace(motion, trace_w=trace_w)
