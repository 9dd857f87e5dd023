"""The life-cycle of episodes: how a lot begins, and how agents end and begin anew.

A reset is a spawn of all agents of a lot; a step spawns those whose episodes ended.
"""

import copy
import dataclasses
import functools
import math
from typing import NamedTuple, Self

import jax
import jax.numpy as jnp

from carpark_mj.config import EnvConfig
from carpark_mj.geometry.obstacles import NO_MOVERS
from carpark_mj.layouts import Layout, layout_config
from carpark_mj.layouts.routes import make_routes
from carpark_mj.mdp import metrics
from carpark_mj.mdp.goals import init_tracked_bays
from carpark_mj.mdp.parked_cars import (
    bay_fits,
    in_bays,
    place_absent_agents,
    poses_in_bays,
    relocate_parked_cars,
)
from carpark_mj.observations import sensors
from carpark_mj.obstacles import begin_movers, lot_obstacles, make_movers, trace_still
from carpark_mj.physics.base import Physics, where_cars
from carpark_mj.spawning.checks import is_made_for
from carpark_mj.spawning.fleet import Fleet, randomize_all
from carpark_mj.spawning.goals import begin_goals, place_agent
from carpark_mj.spawning.placing import (
    MAX_TRIES,
    Placing,
    SpawnInputs,
    has_room,
    place_waiting,
    start_placing,
)
from carpark_mj.spawning.reset_options import ResetOptions, given_goals, has_pose
from carpark_mj.types import NO_BAY, Events, PhysicsState, State
from carpark_mj.vehicle import Vehicle

# Starts drawn for an agent in lots that may be full. Agents that respawn try again at
# every step; without respawn they are absent until the lot is reset.
FIRST_TRIES, STEP_TRIES = 16, 1


class SpawnKeys(NamedTuple):
    """Keys of what is drawn for agents that begin; without `goals` they explore."""

    cars: jax.Array
    starts: jax.Array
    goals: jax.Array | None
    sensors: jax.Array


class StepKeys(NamedTuple):
    """Keys of what is drawn in a step, and the key of the next state."""

    next: jax.Array
    reading: jax.Array
    relocate: jax.Array
    movers: jax.Array
    spawn: SpawnKeys


class Spawner:
    """Begins the episodes of a lot; holds constants only."""

    def __init__(
        self,
        config: EnvConfig,
        fleet: Fleet,
        physics: Physics[PhysicsState],
        layout: Layout | None,
    ) -> None:
        """Takes the parts of an environment; `layout` is None where it is random."""
        self._config, self._fleet, self._physics = config, fleet, physics
        self.movers = make_movers(config.movers)
        lot = layout_config(config.layout)
        # Contacts can push parked cars into spawn regions, and movers can drive there.
        # Regions fit the car they are made for; the margin fits it at any heading.
        clear = not config.physics_config.contacts and all(
            is_made_for(part, car)
            or math.hypot(car.length, car.width) / 2 <= part.spawn_margin
            for car in fleet.agents
            for part in lot.parts
        )
        self._may_touch = bool(self.movers) or not clear
        self._only_movers = clear and bool(self.movers) and not fleet.mixed
        room = False
        if layout is not None and not self._may_touch:
            length = max(car.length for car in fleet.agents)
            width = max(car.width for car in fleet.agents)
            cars = (length, width), config.num_agents
            room = has_room(layout, *cars, config.spawn.spacing)
        # A single agent never waits, unless it may get a car that has no room to start.
        others = config.num_agents > 1 or bool(self.movers)
        varies = fleet.mixed and config.episode.respawn
        self._may_wait = (others or varies) and not room
        may_be_fewer = config.occupancy is not None and config.min_agents is not None
        fewer = config.num_agents > min(lot.min_bays // 2, lot.min_goals)
        self._limits_agents = may_be_fewer and not config.goals.dynamic and fewer

    def with_config(self, config: EnvConfig) -> Self:
        """The spawner with other numbers, see `ParkingEnv.with_values`."""
        other = copy.copy(self)
        other._config = config
        return other

    def begin_lot(
        self,
        layout: Layout,
        key: jax.Array,
        num_present: jax.Array | None = None,
        options: ResetOptions | None = None,
    ) -> State:
        """Begins a lot: parked cars, movers, goals and agents; `key` is consumed.

        `num_present` () int32 is how many agents it has, at least 1; drawn if None.
        """
        config, num_agents = self._config, self._config.num_agents
        key, present = self._draw_present(layout, key, num_present)
        key, car_key, sensor_key = self._split(key)
        mover_key = key
        if self.movers:
            key, mover_key = jax.random.split(key)
        key, lot_key, start_key = jax.random.split(key, 3)
        goal_key = None
        if config.spawn.kinds_at_reset:
            start_key, goal_key = jax.random.split(start_key)
        drawn = self._fleet.start(layout, lot_key, present, options)
        movers = NO_MOVERS
        if self.movers:
            others = lot_obstacles(layout, None, drawn.parked_cars)
            movers = begin_movers(self.movers, layout, mover_key, others)
        goal, absent = drawn.goal, jnp.zeros(num_agents, bool)
        if present is not None:
            goal = jnp.where(present, goal, NO_BAY)
            if not config.goals.dynamic:  # an agent without a bay for its car is absent
                present = present & (goal != NO_BAY)
        begun = ~absent if present is None else present
        away_w = place_absent_agents(jnp.zeros((num_agents, 3), jnp.float32), absent)
        vehicles = randomize_all(config.randomization, drawn.vehicles, car_key)
        physics = self._physics.init(away_w, vehicles)
        motion = self._physics.read(physics)
        waits = self._may_wait and config.episode.respawn
        empty = State(
            physics=physics,
            motion=motion,
            layout=layout,
            goal=goal,
            tracked_bays=init_tracked_bays(config),
            parked_cars=drawn.parked_cars,
            memory=config.observation.init_memory(config),
            step=jnp.zeros(num_agents, jnp.int32),
            active=absent,
            stats=metrics.init_stats(config, layout),
            sensors=sensors.init_sensors(config.sensors, motion, sensor_key),
            key=key,
            present=present,
            waited=jnp.zeros(num_agents, jnp.int32) if waits else None,
            routes=make_routes(layout) if config.follows_routes else None,
            kind=drawn.kind if self._fleet.mixed else None,
            movers=trace_still(movers, motion.trace_w.shape[-2]),
        )
        keys = SpawnKeys(car_key, start_key, goal_key, sensor_key)
        return self.spawn(empty, begun, keys, options, first=True)

    def spawn(
        self,
        state: State,
        mask: jax.Array,
        keys: SpawnKeys,
        options: ResetOptions | None = None,
        first: bool = False,
    ) -> State:
        """New goals, cars and start poses of the agents in a mask, or that wait.

        Agents for which there is no free start are absent and wait, `State.waited`. The
        state is at the end of a step or, `first`, of a lot in which no agent has begun
        and cars and fixed goals are drawn already. `keys` are consumed.
        """
        config, layout, old = self._config, state.layout, state.physics.vehicle
        begun = mask if state.waited is None else mask | (state.waited > 0)
        kind, vehicles = state.kind, old
        if not first and (config.randomization.is_on or self._fleet.mixed):
            kind, key = self._fleet.draw_kinds(layout, keys.cars)
            nominal = self._fleet.of_kind(kind)
            vehicles = randomize_all(config.randomization, nominal, key)
        waiting, pose_w = begun, state.motion.pose_w
        if options is not None and options.pose is not None:
            given = begun & has_pose(options)
            waiting = begun & ~given
            pose_w = jnp.where(given[:, None], options.pose, pose_w)
        placing = self._place(state, pose_w, waiting, vehicles, keys.starts, first)
        goal, pose_w = placing.goal, placing.pose_w
        if options is not None and config.goals.drive_out:  # drawn after the starts
            given = given_goals(options, config.num_agents)
            goal = jnp.where(begun & (given != NO_BAY), given, goal)
        if self._fleet.mixed:  # an agent without a bay for the new car keeps the old
            fitting = placing.found & ~placing.waiting
            vehicles = where_cars(fitting, vehicles, old)
            kind = where_cars(fitting & begun, kind, state.kind)
        if self._may_wait:
            pose_w = place_absent_agents(pose_w, ~placing.waiting)
        parked_cars = in_bays(layout, state.parked_cars, placing.parked_bay)
        parked_pose_w = poses_in_bays(layout, parked_cars)
        physics = self._physics.place(state.physics, begun, pose_w, vehicles)
        if options is not None and options.speed is not None:
            speed = jnp.where(jnp.isnan(options.speed), 0, options.speed)
            physics = self._physics.set_speed(physics, speed)
        physics = self._physics.set_parked_poses(physics, parked_pose_w)
        parked_pose_w = self._physics.parked_poses(physics, parked_cars.pose_w)
        motion = where_cars(begun, self._physics.read(physics), state.motion)
        active, present, waited = state.active, state.present, state.waited
        if first or self._may_wait:
            active = (active | begun) & ~placing.waiting
        if self._may_wait:  # agents in the lot are active, also after a respawn
            present = active
        if waited is not None:
            waited = jnp.where(placing.waiting, waited + 1, 0)
        elif self._may_wait:  # absent until the lot is reset
            goal = jnp.where(active, goal, NO_BAY)
        state = dataclasses.replace(
            state,
            physics=physics,
            motion=motion,
            goal=goal,
            parked_cars=dataclasses.replace(parked_cars, pose_w=parked_pose_w),
            kind=kind if self._fleet.mixed else None,
            memory=where_cars(
                begun, config.observation.init_memory(config), state.memory
            ),
            step=jnp.where(begun, 0, state.step),
            stats=where_cars(begun, metrics.init_stats(config, layout), state.stats),
            sensors=sensors.reset(
                config.sensors, state.sensors, motion, begun, keys.sensors
            ),
            active=active,
            present=present,
            waited=waited,
        )
        if state.tracked_bays is None:
            return state
        begins = begun & ~placing.waiting
        return begin_goals(config, state, placing, begins, keys.goals)

    def _place(
        self,
        state: State,
        pose_w: jax.Array,
        waiting: jax.Array,
        vehicles: Vehicle,
        key: jax.Array,
        first: bool,
    ) -> Placing:
        """Places the waiting agents, whose new cars are `vehicles`."""
        config, layout, old = self._config, state.layout, state.physics.vehicle
        sized = self._fleet.mixed or self._may_touch
        inputs = SpawnInputs(
            layout=layout,
            parked_cars=state.parked_cars,
            size=vehicles.size if sized else None,
            old_size=old.size if sized else None,
            fits=bay_fits(config, layout, vehicles.size, state.parked_cars.size),
            cars=vehicles,
            movers=state.movers,
            clear=self._only_movers,
            first=first,
        )
        bay = state.parked_cars.bay
        placing = start_placing(state.goal, bay, pose_w, waiting, state.waited)
        # No gradients through starts, which depend on the other cars by comparisons.
        inputs, placing = jax.lax.stop_gradient((inputs, placing))
        tries = MAX_TRIES
        if self._may_wait:
            tries = FIRST_TRIES if first else STEP_TRIES
        place = functools.partial(place_agent, config)
        return place_waiting(place, inputs, placing, key, tries, not self._may_wait)

    def end(self, state: State, events: Events, key: jax.Array) -> State:
        """Ends the episodes of agents that are done; `key` is consumed.

        If agents respawn, a parked car takes the bay of each that has parked. Otherwise
        those that are done stay where they are and are no longer active.
        """
        if not self._config.episode.respawn:
            return dataclasses.replace(state, active=state.active & ~events.done)
        parked_cars = relocate_parked_cars(self._config, state, events, key)
        return dataclasses.replace(state, parked_cars=parked_cars)

    def _draw_present(
        self, layout: Layout, key: jax.Array, num_present: jax.Array | None
    ) -> tuple[jax.Array, jax.Array | None]:
        """The next key, and agents (num_agents,) bool of a lot; None = always all."""
        config, counts = self._config, self._config.agent_counts
        if num_present is None and len(counts) > 1:
            key, count_key = jax.random.split(key)
            num_present = jax.random.randint(count_key, (), counts.start, counts.stop)
        if self._limits_agents:
            # One for every two bays, and at most one for every bay that can be a goal.
            goals = jnp.sum(layout.goal_mask, dtype=jnp.int32)
            half = jnp.sum(layout.bay_mask, dtype=jnp.int32) // 2
            most = jnp.maximum(jnp.minimum(half, goals), 1)
            wanted = config.num_agents if num_present is None else num_present
            num_present = jnp.minimum(wanted, most)
        if num_present is None:
            return key, None
        return key, jnp.arange(config.num_agents) < num_present

    def _split(self, key: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        """The lot's next key, and one each for vehicles and sensors, if they vary."""
        config = self._config
        if config.randomization.is_on or config.sensors.is_on or config.varies:
            key, car_key, sensor_key = jax.random.split(key, 3)
            return key, car_key, sensor_key
        unused = jax.random.key(0)
        return key, unused, unused

    def split_keys(self, key: jax.Array) -> StepKeys:
        """Keys of a step; `key`, that of the state before it, is consumed."""
        key, cars, sensor_key = self._split(key)
        reading, sensors = jax.random.split(sensor_key)
        starts = goals = relocate = key
        if self._config.episode.respawn:
            key, starts, goals, relocate = jax.random.split(key, 4)
        movers = key
        if self.movers:
            key, movers = jax.random.split(key)
        spawn = SpawnKeys(cars, starts, goals, sensors)
        return StepKeys(key, reading, relocate, movers, spawn)
