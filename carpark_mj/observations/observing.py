"""What the agents of a lot see, put together from its state."""

import jax

from carpark_mj.config import EnvConfig
from carpark_mj.fleet.draw import Fleet
from carpark_mj.observations import observe
from carpark_mj.observations.indices import observe_indices
from carpark_mj.observations.rings import count_rings, remember
from carpark_mj.observations.sensors import observed
from carpark_mj.observations.tanner import observe_tanner
from carpark_mj.observations.tracking import tracks
from carpark_mj.state import State


def intended_parked_pose(fleet: Fleet, state: State) -> jax.Array:
    """Where the parked cars are meant to stand, (num_parked_cars, 3)."""
    return fleet.parked_pose(
        state.layout,
        state.occupancy.parked_bay,
        state.parked_size,
        state.parked_offset,
    )


def observe_lot(config: EnvConfig, fleet: Fleet, state: State) -> jax.Array:
    """Observations (num_agents, observation_size) float32 of all agents."""
    present = _present(fleet, state)
    cars = (
        state.layout,
        observed(state.sensors, state.vehicle),
        state.occupancy.goal,
        intended_parked_pose(fleet, state),
        state.parked_size,
    )
    if config.observation.encoding != "continuous":
        grid = (config.observation, config.grid, config.sim.ctrl_dt)
        if config.observation.encoding == "indices":
            return observe_indices(*grid, *cars, state.ring_history)
        return observe_tanner(*grid, *cars, present, state.spaces, state.ring_history)
    vehicle = state.physics.vehicle
    return observe(
        config.observation,
        *cars,
        vehicle.max_speed,
        vehicle.max_steering,
        present,
        (vehicle.wheelbase, vehicle.centre_offset),
        state.spaces,
        state.ring_history,
    )


def remember_rings(config: EnvConfig, fleet: Fleet, state: State) -> jax.Array | None:
    """Past counts of the rings once those of the state belong to them."""
    if state.ring_history is None:
        return None
    count = count_rings(
        config.observation,
        state.layout,
        observed(state.sensors, state.vehicle),
        intended_parked_pose(fleet, state),
        state.parked_size,
    )
    return remember(state.ring_history, count)


def who_tracks(config: EnvConfig, fleet: Fleet, state: State) -> jax.Array:
    """Who sees whom, (num_agents, num_agents) bool, see `tracking.tracks`."""
    pose = observed(state.sensors, state.vehicle).pose_w
    parked = intended_parked_pose(fleet, state)
    return tracks(config.observation, pose, parked[:, :2], _present(fleet, state))


def _present(fleet: Fleet, state: State) -> jax.Array | None:
    """Parked cars (num_parked_cars,) bool that this lot has; None = all."""
    if not fleet.varies:
        return None
    return state.occupancy.parked_bay < state.layout.num_bays
