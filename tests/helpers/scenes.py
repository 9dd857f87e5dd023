"""Scenes, stand-ins and shared compiled environments for the tests of the task."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import shapely
from helpers.states import array_module

from carpark_mj.config import EnvConfig, EpisodeConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.layouts import Layout, build, make_layout
from carpark_mj.observations import make_fields
from carpark_mj.types import Motion, State, TimeStep

CAR = (4.0, 2.0)  # m, a round footprint for hand-worked numbers


def cars(
    pose: Any,
    speed: Any = 0.0,
    steering: Any = 0.0,
    yaw_rate: Any = 0.0,
    sideways: Any = 0.0,
    size: Any = CAR,
    trace: Any = None,
    finite: Any = True,
) -> Motion:
    """Cars (..., ) by hand; scalars hold for all of them, the trace stands still."""
    xp = array_module(pose, speed, steering, yaw_rate, sideways, size, trace, finite)
    pose = xp.asarray(pose, np.float32)
    lead = pose.shape[:-1]

    def full(value: Any, *shape: int) -> Any:
        return xp.broadcast_to(xp.asarray(value, np.float32), (*lead, *shape))

    motion = Motion(
        pose_w=pose,
        velocity_b=xp.stack([full(speed), full(sideways)], axis=-1),
        yaw_rate=full(yaw_rate),
        steering=full(steering),
        size=full(size, 2),
        trace_w=pose[..., None, :] if trace is None else xp.asarray(trace, np.float32),
        finite=xp.broadcast_to(xp.asarray(finite), lead),
    )
    return jax.tree.map(jnp.asarray, motion)


def lot(
    bays: Any,
    walls: Any = (),
    bay_size: Any = (6.0, 3.0),
    wall_size: Any = (1.0, 1.0),
    spawn_size: Any = (10.0, 10.0),
    discs: Any = (),
) -> Layout:
    """A layout by hand with one spawn region at the origin; discs are x, y, radius."""
    rows = [np.asarray(x, np.float32).reshape(-1, 3) for x in (bays, walls, discs)]
    sizes = [np.asarray(x, np.float32) for x in (bay_size, wall_size, spawn_size)]
    return _assembled(*rows, *sizes)


@jax.jit
def _assembled(bays, walls, discs, bay_size, wall_size, spawn_size):
    return build.assemble(
        (50.0, 50.0),
        build.bays(bays, bay_size),
        build.walls(walls, wall_size),
        build.discs(discs[:, :2], discs[:, 2]),
        build.spawns(jnp.zeros((1, 3)), spawn_size, np.pi),
    )


def moved(pose: Any, motion: tuple[float, float, float]) -> jax.Array:
    """Poses (..., 3) after a rigid motion: turn about the origin, then shift."""
    pose = np.asarray(pose, np.float64)
    xy = (pose[..., 0] + 1j * pose[..., 1]) * np.exp(1j * motion[2])
    x, y = xy.real + motion[0], xy.imag + motion[1]
    return jnp.asarray(np.stack([x, y, pose[..., 2] + motion[2]], -1), jnp.float32)


def moved_cars(vehicle: Motion, motion: Any) -> Motion:
    return vehicle.replace(
        pose_w=moved(vehicle.pose_w, motion), trace_w=moved(vehicle.trace_w, motion)
    )


def moved_lot(layout: Layout, motion: Any) -> Layout:
    return layout.replace(
        bay_pose=moved(layout.bay_pose, motion),
        wall_pose=moved(layout.wall_pose, motion),
        disc_centre=moved(jnp.pad(layout.disc_centre, ((0, 0), (0, 1))), motion)[:, :2],
        lane_pose=moved(layout.lane_pose, motion),
        spawn_pose=moved(layout.spawn_pose, motion),
    )


def polygons(pose: Any, size: Any) -> np.ndarray:
    """Boxes as shapely polygons, worked out apart from `carpark_mj.geometry`."""
    pose, size = np.asarray(pose, np.float64), np.asarray(size, np.float64)
    centre = pose[..., 0] + 1j * pose[..., 1]
    along = np.exp(1j * pose[..., 2])
    ahead = along * size[..., 0] / 2
    left = 1j * along * size[..., 1] / 2
    ring = [
        centre + a * ahead + b * left for a, b in ((1, 1), (-1, 1), (-1, -1), (1, -1))
    ]
    ring = np.stack(ring, axis=-1)
    return shapely.polygons(np.stack([ring.real, ring.imag], axis=-1))


NOISE = 1e-4  # m; float32 at 50 m resolves 4e-6 m, a sum of a few such errors


def overlap_oracle(
    pose_a: Any, size_a: Any, pose_b: Any, size_b: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Shapely's answer, and where it holds with box a one `NOISE` larger or smaller."""
    b, size_a = polygons(pose_b, size_b), np.asarray(size_a, np.float64)
    shrunk = shapely.intersects(polygons(pose_a, size_a - 2 * NOISE), b)
    grown = shapely.intersects(polygons(pose_a, size_a + 2 * NOISE), b)
    return grown, grown == shrunk


def fields_of(observation: Any, config: EnvConfig) -> dict[str, np.ndarray]:
    """An observation (..., size) cut into its named fields (..., k)."""
    observation = np.asarray(observation)
    named, start = {}, 0
    for field in make_fields(config):
        named[field.name] = observation[..., start : start + field.size]
        start += field.size
    assert start == observation.shape[-1]
    return named


def check_occupancy(goal: Any, parked_bay: Any, bay_mask: Any) -> None:
    """Asserts the plan's invariants for histories (..., agents) and (..., cars)."""
    goal, parked_bay = np.asarray(goal), np.asarray(parked_bay)
    held = np.sort(np.concatenate([goal, parked_bay], axis=-1), axis=-1)
    # All different: goals from goals, cars from cars, and no car on a goal.
    assert (np.diff(held, axis=-1) > 0).all()
    assert np.take_along_axis(np.asarray(bay_mask), held, axis=-1).all()


LOTS = 4


@functools.cache
def mjx_env() -> ParkingEnv:
    """The environment whose compiled step the slow tests share."""
    return ParkingEnv(
        EnvConfig(num_agents=3, num_parked_cars=8, episode=EpisodeConfig(max_steps=60))
    )


@functools.cache
def mjx_reset():
    return jax.jit(jax.vmap(mjx_env().reset_to_layout))


@functools.cache
def mjx_step():
    return jax.jit(jax.vmap(mjx_env().step))


def mixed_lots() -> Layout:
    """Two `square` and two `square_compact` lots as one batch."""
    layouts = [
        make_layout(n) for n in ("square", "square_compact", "square", "square_compact")
    ]
    return jax.tree.map(lambda *rows: jnp.stack(rows), *layouts)


def mjx_start(seed: int = 0) -> tuple[State, jax.Array]:
    """The shared environment's lots, freshly started."""
    return mjx_reset()(mixed_lots(), jax.random.split(jax.random.key(seed), LOTS))


@functools.cache
def mjx_rollout() -> tuple[State, jax.Array, list[State], list[TimeStep]]:
    """Random driving: start, first observation, then states and time steps (numpy)."""
    state, observation = mjx_start()
    rng = np.random.default_rng(0)
    states, timesteps = [], []
    for k in range(300):
        # A driving style per agent for a while, so that the cars get somewhere.
        if k % 20 == 0:
            style = rng.uniform(-1, 1, (LOTS, 3, 2)) * (1.0, 1.5)
        action = np.clip(style + rng.normal(0, 0.3, (LOTS, 3, 2)), -1, 1)
        state, timestep = mjx_step()(state, jnp.asarray(action, jnp.float32))
        kept = state.replace(key=jax.random.key_data(state.key))
        states.append(jax.device_get(kept))
        timesteps.append(jax.device_get(timestep))
    return mjx_start()[0], observation, states, timesteps


def stacked(items: list[Any]) -> Any:
    """A list of equal trees as one tree with a leading time axis."""
    return jax.tree.map(lambda *rows: np.stack(rows), *items)
