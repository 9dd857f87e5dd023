"""How episodes begin and end: those of a lot at once, or of some of its agents.

An `Episodes` holds constants only, those of a `ParkingEnv`.
"""

import dataclasses
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp

from carpark_mj.config import EnvConfig, LayoutConfig
from carpark_mj.config.obstacles import make_movers
from carpark_mj.fleet.checks import is_made_for
from carpark_mj.fleet.draw import Fleet
from carpark_mj.fleet.randomization import randomize_all
from carpark_mj.geometry.obstacles import NO_MOVERS, Movers
from carpark_mj.layouts import Layout, layout_config
from carpark_mj.layouts.routes import make_routes
from carpark_mj.mdp import metrics
from carpark_mj.mdp.bays import bay_fits
from carpark_mj.mdp.goals import Goals
from carpark_mj.mdp.parked_cars import (
    in_bays,
    place_absent_agents,
    poses_in_bays,
    relocate_parked_cars,
)
from carpark_mj.mdp.reset_options import ResetOptions, given_goals, has_pose
from carpark_mj.mdp.spawning.placing import (
    SURE,
    Patience,
    SpawnInputs,
    has_room,
    place_waiting,
    start_placing,
)
from carpark_mj.observations import sensors
from carpark_mj.obstacles import (
    begin_movers,
    lot_obstacles,
    step_movers,
    trace_still,
)
from carpark_mj.physics.base import Physics, RollingStarts, where_cars
from carpark_mj.types import NO_BAY, Events, ParkedCars, PhysicsState, State
from carpark_mj.vehicle import Vehicle, VehicleParameters

# For lots that may be full. Agents that respawn try again at every step; without
# respawn they are absent until the lot is reset.
FIRST_TRIES = Patience(16, True)
STEP_TRIES = Patience(1, True)


class StepKeys(NamedTuple):
    """Keys of what is drawn in a step, and the key of the next state."""

    next: jax.Array
    vehicles: jax.Array
    reading: jax.Array
    sensors: jax.Array
    spawn: jax.Array
    first_goals: jax.Array
    relocate: jax.Array
    movers: jax.Array


class Episodes:
    """Begins and ends the episodes of a lot."""

    def __init__(
        self,
        config: EnvConfig,
        fleet: Fleet,
        goals: Goals,
        physics: Physics[PhysicsState],
        layout: Layout | None,
    ) -> None:
        """Takes the parts of an environment; `layout` is None where it is random."""
        self._config = config
        self._fleet = fleet
        self._goals = goals
        self._physics = physics
        may_be_fewer = config.occupancy is not None and config.min_agents is not None
        lot = layout_config(config.layout)
        most = min(lot.min_bays // 2, lot.min_goals)
        self._movers = make_movers(config.movers)
        # Contacts can push parked cars into spawn regions, and movers can drive there.
        clear = not config.physics_config.contacts and all(
            _starts_are_free(lot, car) for car in fleet.agents
        )
        self._may_touch = bool(self._movers) or not clear
        self._only_movers = clear and bool(self._movers) and not fleet.mixed
        room = False
        if layout is not None and not self._may_touch:
            length = max(car.length for car in fleet.agents)
            width = max(car.width for car in fleet.agents)
            room = has_room(
                layout, (length, width), config.num_agents, config.spawn.spacing
            )
        # A single agent never waits.
        self._may_wait = (config.num_agents > 1 or bool(self._movers)) and not room
        self._limits_agents = (
            may_be_fewer and not config.goals.dynamic and config.num_agents > most
        )

    def begin_lot(
        self,
        layout: Layout,
        key: jax.Array,
        num_present: jax.Array | None = None,
        options: ResetOptions | None = None,
    ) -> State:
        """Begins a lot: parked cars, goals and agents.

        Args:
            layout: of the lot.
            key: consumed.
            num_present: () int32 how many agents it has, at least 1; drawn if None.
            options: starts that are given.
        """
        config = self._config
        num_agents = config.num_agents
        everybody = jnp.ones(num_agents, bool)
        counts, present = config.agent_counts, None
        if num_present is None and len(counts) > 1:
            key, count_key = jax.random.split(key)
            num_present = jax.random.randint(count_key, (), counts.start, counts.stop)
        if self._limits_agents:
            wanted = num_agents if num_present is None else num_present
            num_present = jnp.minimum(wanted, _most_agents(layout))
        if num_present is not None:
            present = jnp.arange(num_agents) < num_present
        key, vehicle_key, sensor_key = self._split(key)
        mover_key = key
        if self._movers:
            key, mover_key = jax.random.split(key)
        key, start_key, spawn_key = jax.random.split(key, 3)
        start = self._fleet.start(layout, start_key, present, options)
        movers = self._begin_movers(layout, start.parked_cars, mover_key)
        vehicles = randomize_all(config.randomization, start.vehicles, vehicle_key)
        inputs = self._spawn_inputs(
            layout, start.parked_cars, movers, vehicles, vehicles
        )
        bay = start.parked_cars.bay
        goal = start.goal
        if present is not None:
            goal = jnp.where(present, goal, NO_BAY)
            if not config.goals.dynamic:  # an agent without a bay for its car is absent
                present = present & (goal != NO_BAY)
        nowhere = jnp.zeros((num_agents, 3), jnp.float32)
        nowhere = place_absent_agents(nowhere, jnp.zeros(num_agents, bool))
        begun = everybody if present is None else present
        waiting = begun
        if options is not None and options.pose is not None:
            given = begun & has_pose(options)
            nowhere = jnp.where(given[:, None], options.pose, nowhere)
            waiting = begun & ~given
        placing = start_placing(goal, bay, nowhere, waiting)
        first_key = None
        if config.spawn.kinds_at_reset:
            spawn_key, first_key = jax.random.split(spawn_key)
        patience = FIRST_TRIES if self._may_wait else SURE
        placing = place_waiting(
            self._goals.place_first, inputs, placing, spawn_key, patience
        )
        goal, waited = placing.goal, None
        if config.goals.drive_out:  # given goals override those of drawn starts
            given = given_goals(options, num_agents)
            goal = jnp.where(begun & (given != NO_BAY), given, goal)
        if self._may_wait:
            present = begun & ~placing.waiting
            if config.episode.respawn:
                waited = placing.waiting.astype(jnp.int32)
            else:
                goal = jnp.where(present, goal, NO_BAY)
        pose_w = placing.pose_w
        physics = self._physics.init(pose_w, vehicles)
        if options is not None and options.speed is not None:
            physics = self._roll(physics, options.speed)
        physics = self._physics.set_parked_poses(physics, start.parked_cars.pose_w)
        motion = self._physics.read(physics)
        state = State(
            physics=physics,
            motion=motion,
            layout=layout,
            goal=goal,
            tracked_bays=self._goals.init_tracked_bays(),
            parked_cars=start.parked_cars,
            memory=config.observation.init_memory(config),
            step=jnp.zeros(num_agents, jnp.int32),
            active=everybody if present is None else present,
            stats=metrics.init_stats(config, layout),
            sensors=sensors.init_sensors(config.sensors, motion, sensor_key),
            key=key,
            present=present,
            waited=waited,
            routes=make_routes(layout) if config.follows_routes else None,
            kind=start.kind if self._fleet.mixed else None,
            movers=trace_still(movers, motion.trace_w.shape[-2]),
        )
        return self._goals.begin(state, placing, state.active, first_key)

    def _roll(self, physics: PhysicsState, speed: jax.Array) -> PhysicsState:
        """Cars that begin at speeds (num_agents,) [m/s]; at rest where NaN."""
        if not isinstance(self._physics, RollingStarts):
            name = type(self._physics).__name__
            raise ValueError(f"options.speed needs physics with set_speed, not {name}")
        return self._physics.set_speed(physics, jnp.where(jnp.isnan(speed), 0, speed))

    def end(self, state: State, events: Events, keys: StepKeys) -> State:
        """Ends the episodes of agents that are done.

        If agents respawn, a parked car takes the bay of each that has parked. Otherwise
        those that are done stay where they are and are no longer active.
        """
        if not self._config.episode.respawn:
            return dataclasses.replace(state, active=state.active & ~events.done)
        parked_cars = relocate_parked_cars(self._config, state, events, keys.relocate)
        return dataclasses.replace(state, parked_cars=parked_cars)

    def begin(self, state: State, events: Events, keys: StepKeys) -> State:
        """New goals, cars and start poses of agents that are done or waiting.

        Agents for which there is no free start are absent and wait, `State.waited`.
        """
        config, begun, layout = self._config, events.done, state.layout
        if not config.episode.respawn:
            return state
        if state.waited is not None:
            begun = begun | (state.waited > 0)
        old = state.physics.vehicle
        kind, vehicles = self._draw_vehicles(state, keys.vehicles)
        inputs = self._spawn_inputs(
            layout, state.parked_cars, state.movers, vehicles, old
        )
        bay, pose_w = state.parked_cars.bay, state.motion.pose_w
        placing = start_placing(state.goal, bay, pose_w, begun, state.waited)
        # No gradients through starts, which depend on the other cars by comparisons.
        inputs, placing = jax.lax.stop_gradient((inputs, placing))
        placing = place_waiting(
            self._goals.place,
            inputs,
            placing,
            keys.spawn,
            STEP_TRIES if self._may_wait else SURE,
        )
        if self._fleet.mixed:  # an agent without a bay for the new car keeps the old
            fitting = placing.found & ~placing.waiting
            vehicles = where_cars(fitting, vehicles, old)
            kind = where_cars(fitting & begun, kind, state.kind)
        pose_w = placing.pose_w
        if self._may_wait:
            pose_w = place_absent_agents(pose_w, ~placing.waiting)
        physics = self._physics.place(state.physics, begun, pose_w, vehicles)
        parked_cars = in_bays(layout, state.parked_cars, placing.parked_bay)
        physics = self._physics.set_parked_poses(
            physics, poses_in_bays(layout, parked_cars)
        )
        pose_w = self._physics.parked_poses(physics, parked_cars.pose_w)
        motion = where_cars(begun, self._physics.read(physics), state.motion)
        state = dataclasses.replace(
            state,
            physics=physics,
            motion=motion,
            goal=placing.goal,
            parked_cars=dataclasses.replace(parked_cars, pose_w=pose_w),
            kind=kind,
            memory=where_cars(
                begun, config.observation.init_memory(config), state.memory
            ),
            step=jnp.where(begun, 0, state.step),
            stats=where_cars(begun, metrics.init_stats(config, layout), state.stats),
            sensors=sensors.reset(
                config.sensors, state.sensors, motion, begun, keys.sensors
            ),
        )
        if state.waited is not None:
            waits, begun = placing.waiting, begun & ~placing.waiting
            active = (state.active | begun) & ~waits
            state = dataclasses.replace(
                state,
                active=active,
                present=active,  # with respawn all agents in the lot are active
                waited=jnp.where(waits, state.waited + 1, 0),
            )
        return self._goals.begin(state, placing, begun, keys.first_goals)

    def _draw_vehicles(
        self, state: State, key: jax.Array
    ) -> tuple[jax.Array | None, Vehicle]:
        """Kinds (num_agents,) of cars for agents that begin, and their parameters.

        `key` is consumed. The kinds are None where there is one.
        """
        config = self._config
        if not (config.randomization.is_on or self._fleet.mixed):
            return None, state.physics.vehicle
        kind, key = self._fleet.draw_kinds(key)
        nominal = self._fleet.of_kind(kind)
        vehicles = randomize_all(config.randomization, nominal, key)
        return kind if self._fleet.mixed else None, vehicles

    def _begin_movers(
        self, layout: Layout, parked_cars: ParkedCars, key: jax.Array
    ) -> Movers:
        """The movers of a lot; `key` is consumed if there are any."""
        if not self._movers:
            return NO_MOVERS
        others = lot_obstacles(layout, None, parked_cars)
        return begin_movers(self._movers, layout, key, others)

    def step_movers(self, state: State, keys: StepKeys) -> Movers:
        """The movers after a control step; `state` is before it."""
        if not self._movers:
            return NO_MOVERS
        return step_movers(self._movers, state, self._config.sim.ctrl_dt, keys.movers)

    def _spawn_inputs(
        self,
        layout: Layout,
        parked_cars: ParkedCars,
        movers: Movers,
        new: Vehicle,
        old: Vehicle,
    ) -> SpawnInputs:
        fits = bay_fits(self._config, layout, new.size, parked_cars.size)
        sized = self._fleet.mixed or self._may_touch
        sizes = (new.size, old.size) if sized else (None, None)
        return SpawnInputs(
            layout, parked_cars, *sizes, fits, new, movers, self._only_movers
        )

    def _split(self, key: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        """The lot's next key, and one each for vehicles and sensors, if they vary."""
        config = self._config
        if config.randomization.is_on or config.sensors.is_on or config.varies:
            key, vehicle_key, sensor_key = jax.random.split(key, 3)
            return key, vehicle_key, sensor_key
        unused = jax.random.key(0)
        return key, unused, unused

    def split_keys(self, key: jax.Array) -> StepKeys:
        """Keys of a step; `key`, that of the state before it, is consumed."""
        key, vehicles, sensor_key = self._split(key)
        reading, sensors = jax.random.split(sensor_key)
        spawn = first_goals = relocate = key
        if self._config.episode.respawn:
            key, spawn, first_goals, relocate = jax.random.split(key, 4)
        movers = key
        if self._movers:
            key, movers = jax.random.split(key)
        return StepKeys(
            next=key,
            vehicles=vehicles,
            reading=reading,
            sensors=sensors,
            spawn=spawn,
            first_goals=first_goals,
            relocate=relocate,
            movers=movers,
        )


def _starts_are_free(lot: LayoutConfig, car: VehicleParameters) -> bool:
    """Whether every start of a car in lots of a family is clear of obstacles."""
    # Spawn regions fit the car they are made for; the margin fits it at any heading.
    reach = math.hypot(car.length, car.width) / 2
    return all(
        is_made_for(part, car) or reach <= part.spawn_margin for part in lot.parts
    )


def _most_agents(layout: Layout) -> jax.Array:
    """The largest number of agents () int32 in a lot whose bays are partly taken.

    One for every two bays, and at most one for every bay that can be a goal.
    """
    goals = jnp.sum(layout.goal_mask, dtype=jnp.int32)
    half = jnp.sum(layout.bay_mask, dtype=jnp.int32) // 2
    return jnp.maximum(jnp.minimum(half, goals), 1)
