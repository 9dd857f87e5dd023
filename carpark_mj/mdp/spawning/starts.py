"""How episodes begin: those of a whole lot at once, or some agents' while others drive.

The functions take the constants of an environment: configuration, fleet, back end.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from carpark_mj.config import EnvConfig, LayoutConfig
from carpark_mj.fleet.draw import Fleet
from carpark_mj.fleet.randomization import make_fleet
from carpark_mj.layouts import Layout
from carpark_mj.layouts.lanes import has_lanes
from carpark_mj.mdp import goal_rewards
from carpark_mj.mdp.chosen_goals import GOAL_COUNTS
from carpark_mj.mdp.giving_way import COUNTS
from carpark_mj.mdp.metrics.episode import EpisodeStats, init_stats
from carpark_mj.mdp.metrics.tallies import first_tallies
from carpark_mj.mdp.rewards import term_names
from carpark_mj.mdp.spawning.exploring import ExploringStart
from carpark_mj.mdp.spawning.renew_exploring import renew_exploring
from carpark_mj.mdp.spawning.respawn import first_poses, renew
from carpark_mj.mdp.tracked_bays import no_spaces
from carpark_mj.observations.rings import init_history
from carpark_mj.observations.sensors import init_sensors
from carpark_mj.physics.base import where_cars
from carpark_mj.state import State
from carpark_mj.types import Events


def check_room(config: EnvConfig, lot: LayoutConfig) -> None:
    """Refuses more cars or tracked bays than the lot has bays for.

    Raises:
        ValueError: naming the number and the most there can be.
    """
    bays, agents = lot.min_bays, config.num_agents
    if config.goals.dynamic:
        free = bays - config.num_parked_cars
        if free < config.goals.num_spaces:
            raise ValueError(
                f"goals.num_spaces must be at most {max(free, 0)} ({bays} bays less "
                f"{config.num_parked_cars} parked cars), not {config.goals.num_spaces}"
            )
        return
    free = bays - agents
    if free < 0:
        raise ValueError(
            f"num_agents must be at most {bays} (a goal bay each), not {agents}"
        )
    if config.num_parked_cars > free:
        raise ValueError(
            f"num_parked_cars must be at most {free} ({bays} bays less {agents} "
            f"agents' goals), not {config.num_parked_cars}"
        )


def split_if_random(
    config: EnvConfig, fleet: Fleet, key: jax.Array
) -> tuple[jax.Array, ...]:
    """The lot's next key, and one each for the cars and their sensors.

    Without randomization the key stays as it is: lots are drawn as if there were no
    such thing.
    """
    if config.randomization.is_on or config.sensors.is_on or fleet.varies:
        return tuple(jax.random.split(key, 3))
    return key, key, key


def start_stats(config: EnvConfig, layout: Layout) -> EpisodeStats:
    """Statistics of all agents of a lot at the start of their episodes."""
    lanes, dynamic = has_lanes(layout), config.goals.dynamic
    terms = term_names(lanes)
    if dynamic:
        terms += goal_rewards.TERMS
    if config.giving_way.context is not None:
        terms += ("bad_goal",)
    names = tuple(f"return_{name}" for name in terms)
    if dynamic:
        names += (*GOAL_COUNTS, *COUNTS)
    zero = jnp.zeros(config.num_agents, jnp.float32)
    tallies = dict.fromkeys(names, zero)
    tallies |= first_tallies(config.metrics, config.num_agents)
    return init_stats(config.num_agents, lanes, tallies)


def start_lot(
    config: EnvConfig, fleet: Fleet, physics: Any, layout: Layout, key: jax.Array
) -> State:
    """Starts a lot: parked cars, goals, agents and their cars.

    With dynamic goals nobody has looked for bays yet.
    """
    key, cars_key, sensor_key = split_if_random(config, fleet, key)
    key, occupancy_key, spawn_key = jax.random.split(key, 3)
    start = fleet.start(layout, occupancy_key)
    occupancy, parked_size = start.occupancy, start.parked_size
    cars = make_fleet(config.randomization, start.cars, config.num_agents, cars_key)
    offset = start.parked_offset
    blocked = fleet.blocked(layout, cars.size, cars.size, parked_size, offset)
    dynamic = config.goals.dynamic
    spawn = config.spawn
    if dynamic:  # there is no goal to start close to, or on the way to
        spawn = dataclasses.replace(spawn, close_ratio=0.0, crash_ratio=0.0)
    pose = first_poses(spawn, layout, occupancy, spawn_key, blocked)
    parked_pose = fleet.parked_pose(layout, occupancy.parked_bay, parked_size, offset)
    state = physics.set_parked_poses(physics.init(pose, cars), parked_pose)
    vehicle = physics.read(state)
    spaces = None
    if dynamic:
        spaces = no_spaces(config.num_agents, config.goals.num_spaces, layout.num_bays)
    return State(
        physics=state,
        vehicle=vehicle,
        layout=layout,
        occupancy=occupancy,
        spaces=spaces,
        ring_history=init_history(config.observation, config.num_agents),
        parked_size=parked_size,
        parked_offset=offset,
        step=jnp.zeros(config.num_agents, jnp.int32),
        active=jnp.ones(config.num_agents, bool),
        stats=start_stats(config, layout),
        sensors=init_sensors(config.sensors, vehicle, sensor_key),
        key=key,
    )


def restart(
    config: EnvConfig,
    fleet: Fleet,
    physics: Any,
    state: State,
    events: Events,
    cars_key: jax.Array,
) -> tuple[State, jax.Array, tuple[ExploringStart, jax.Array] | None]:
    """Starts new episodes: goals, cars and poses of those that are done.

    Statistics and sensors are not touched; with dynamic goals the new ones explore and
    have not looked for bays yet.

    Returns:
        The state; (num_agents,) bool, whose goal, though the own episode goes on,
        another has parked in; and with dynamic goals how the new ones start, with a
        key for their first goals.
    """
    key, respawn_key = jax.random.split(state.key)
    done = events.done
    layout, old = state.layout, state.physics.vehicle
    cars = old
    if config.randomization.is_on or fleet.mixed:
        drawn, cars_key = fleet.draw_agents(cars_key)
        cars = make_fleet(config.randomization, drawn, config.num_agents, cars_key)
    parked_size, offset = state.parked_size, state.parked_offset
    blocked = fleet.blocked(layout, old.size, cars.size, parked_size, offset)
    bays = fleet.bays_for(layout, cars.size, parked_size)
    spaces, taken = state.spaces, jnp.zeros_like(done)
    pose = state.vehicle.pose_w
    who = (done, events.parked, respawn_key)
    tracked, starts = config.observation.tracked_parked_cars, None
    if spaces is not None:
        occupancy, begun, taken = renew_exploring(
            config.spawn, layout, state.occupancy, pose, *who, bays[1], blocked, tracked
        )
        pose = begun.pose
        starts = begun, jax.random.fold_in(respawn_key, config.num_agents)
        spaces = jnp.where(done[:, None], layout.num_bays, spaces)
    else:
        occupancy, pose = renew(
            config.spawn, layout, state.occupancy, pose, *who, bays, blocked, tracked
        )
        if fleet.mixed:  # who finds no bay for his new car keeps goal and car
            cars = where_cars(occupancy.goal != state.occupancy.goal, cars, old)
    placed = physics.place(state.physics, done, pose, cars)
    parked_pose = fleet.parked_pose(layout, occupancy.parked_bay, parked_size, offset)
    placed = physics.set_parked_poses(placed, parked_pose)
    state = dataclasses.replace(
        state,
        physics=placed,
        vehicle=where_cars(done, physics.read(placed), state.vehicle),
        occupancy=occupancy,
        spaces=spaces,
        step=jnp.where(done, 0, state.step),
        key=key,
    )
    return state, taken, starts
