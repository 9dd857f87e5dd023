"""A car that drives through the aisle of a hard case while another one parks.

HOPE's program has no moving cars, so the numbers are ours. The car keeps to the far
side of the aisle and drives straight through at 1 m/s. It stops for a car ahead. If
that car stays, it backs off to its start and tries again: in aisles of 3.5 to 4.5 m two
cars cannot pass each other, so a car that never stopped, or stopped for ever, would
make some cases unsolvable. It is an ordinary agent: its start and its goal, the two
ends of the aisle, are a spawn region and a bay of the lot.
"""

import dataclasses
from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.geometry import (
    box_corners,
    boxes_overlap,
    move_forward,
    to_local,
    to_world,
)
from carpark_mj.layouts import Layout
from carpark_mj.layouts.standards import Level
from carpark_mj.layouts.types import BayKind, layout_maxima, pad_layout
from carpark_mj.observations import observe
from carpark_mj.precision import full_float32
from carpark_mj.suite.hope import MARGIN, HopeConfig
from carpark_mj.suite.tpcap import TPCAP_CAR
from carpark_mj.types import State
from carpark_mj.vehicle.drive import HOLD_SPEED

if TYPE_CHECKING:
    from carpark_mj.env import ParkingEnv

CAR = 1  # its number among the agents, its bay's and its start's
SPEED = 1.0  # m/s
ACCELERATION = 1.0  # m/s², to either side: `tpcap` cannot speed up faster
GAP = 0.3  # m to the far edge of the aisle, and kept free on both sides of its way
LOOK_AHEAD = 1.0  # m of its way that must be free: a step, the braking way and `GAP`
PATIENCE = 5.0  # s that it waits; the planner's cars replan after 4 s
STOPPING = 0.5  # m before the goal: from there it brakes


class Progress(NamedTuple):
    """State of the driver, carried between steps.

    Attributes:
        direction: () float32, 1 towards the goal or -1 while it backs off.
        waited: () float32, how long it has waited [s].
    """

    direction: jax.Array
    waited: jax.Array


def add_ends(
    level: Level, number: np.ndarray, parallel: np.ndarray, layouts: Layout
) -> Layout:
    """Held-out cases with the start and the goal of a moving car.

    It comes from the left in two cases, from the right in the next two, so that
    both happen with either kind of bay.

    Args:
        level: of the cases.
        number: (n,) which of the level's.
        parallel: (n,) bool; the others are perpendicular.
        layouts: (n, ...).
    """
    way = np.where(number // 2 % 2 == 0, 1.0, -1.0)
    end = layouts.extent[:, 0] - MARGIN - TPCAP_CAR.length / 2
    y, yaw = _line(level, parallel, layouts), np.where(way > 0, 0.0, np.pi)
    goal = jnp.stack([way * end, y, yaw], axis=-1)
    start = jnp.stack([-way * end, y, yaw], axis=-1)
    size = jnp.array(TPCAP_CAR.size) + 2 * MARGIN
    rows = layout_maxima([layouts])
    rows = dataclasses.replace(rows, bays=CAR + 1, spawns=CAR + 1)
    padded = jax.vmap(lambda layout: pad_layout(layout, rows))(layouts)
    return dataclasses.replace(
        padded,
        bay_pose=padded.bay_pose.at[:, CAR].set(goal),
        bay_size=padded.bay_size.at[:, CAR].set(size),
        # Nobody else's goal.
        bay_kind=padded.bay_kind.at[:, CAR].set(BayKind.RESERVED),
        bay_mask=padded.bay_mask.at[:, CAR].set(True),
        spawn_pose=padded.spawn_pose.at[:, CAR].set(start),  # no area: never drawn
        spawn_mask=padded.spawn_mask.at[:, CAR].set(True),
    )


def _line(level: Level, parallel: np.ndarray, layouts: Layout) -> jax.Array:
    """(n,) y of the car's way [m]."""
    aisle = [
        HopeConfig(level, "parallel" if along else "perpendicular").room.aisle
        for along in parallel.tolist()
    ]
    start = layouts.spawn_pose[:, 0]
    axle = move_forward(start, -TPCAP_CAR.centre_offset)[:, 1]  # is in the aisle
    corners = box_corners(layouts.wall_pose, layouts.wall_size)[..., 1]
    near = layouts.wall_mask & (corners < axle[:, None, None]).all(axis=-1)
    edge = jnp.where(near, corners.max(axis=-1), -jnp.inf).max(axis=-1) + MARGIN
    return edge + jnp.array(aisle) - GAP - TPCAP_CAR.width / 2


def reset(env: "ParkingEnv", layout: Layout, key: jax.Array) -> tuple[State, jax.Array]:
    """Starts a lot of `add_ends` with two agents; see `ParkingEnv.reset_to_layout`.

    The first is placed as if it were alone, then the moving car at its start.
    """
    state, _ = env.reset_to_layout(layout, key, jnp.int32(1))
    own = jnp.arange(env.num_agents) == CAR
    pose_w = jnp.where(own[:, None], layout.spawn_pose[CAR], state.motion.pose_w)
    physics = env.physics.place(state.physics, own, pose_w, state.physics.vehicle)
    state = dataclasses.replace(
        state,
        physics=physics,
        motion=env.physics.read(physics),
        goal=jnp.where(own, CAR, state.goal),
        active=state.active | own,
        present=jnp.ones_like(own),
    )
    return state, observe(env.config, state)


def init_progress(count: int) -> Progress:
    """Of moving cars (count,) at their starts."""
    return Progress(jnp.ones(count, jnp.float32), jnp.zeros(count, jnp.float32))


@full_float32
def drive(
    state: State, progress: Progress, ctrl_dt: float
) -> tuple[jax.Array, Progress]:
    """Drives the car of a lot for a control step.

    Args:
        state: of the lot.
        progress: after the step before.
        ctrl_dt: control period [s].

    Returns:
        Its action (2,) and the progress after the step.
    """
    motion = state.motion
    pose, speed = motion.pose_w[CAR], motion.speed[CAR]
    goal = state.layout.bay_pose[CAR]
    remaining = -to_local(goal, pose)[0]
    whole = -to_local(goal, state.layout.spawn_pose[CAR])[0]
    # Back at its start it tries again.
    direction = jnp.where(remaining >= whole - STOPPING, 1.0, progress.direction)

    blocked = _is_blocked(state, direction)
    waited = jnp.where(blocked, progress.waited + ctrl_dt, 0.0)
    gives_up = waited > PATIENCE
    after = Progress(
        direction=jnp.where(gives_up, -direction, direction),
        waited=jnp.where(gives_up, 0.0, waited),
    )
    stops = blocked | (remaining < STOPPING)
    target = jnp.where(stops, 0.0, direction * SPEED)
    pedal = _pedal(state, target, ctrl_dt)
    held = stops & (jnp.abs(speed) < HOLD_SPEED)  # a pedal would drive it on
    pedal = jnp.where(held, 0.0, pedal)
    return jnp.stack([jnp.zeros_like(pedal), pedal]), after


def _is_blocked(state: State, direction: jax.Array) -> jax.Array:
    """() whether another car is on the next `LOOK_AHEAD` of its way."""
    motion = state.motion
    length, width = motion.size[CAR]
    ahead = jnp.zeros(3).at[0].set(direction * (length + LOOK_AHEAD) / 2)
    size = jnp.stack([jnp.full_like(width, LOOK_AHEAD), width + 2 * GAP])
    pose = to_world(motion.pose_w[CAR], ahead)
    meets = boxes_overlap(pose, size, motion.pose_w, motion.size)
    return jnp.any(meets.at[CAR].set(False))


def _pedal(state: State, target: jax.Array, ctrl_dt: float) -> jax.Array:
    """() pedal that reaches a speed [m/s] in a control step, or comes nearest to it."""
    speed, vehicle = state.motion.speed[CAR], state.physics.vehicle
    change = jnp.clip((target - speed) / ctrl_dt, -ACCELERATION, ACCELERATION)
    brakes = change * speed < 0.0
    limit = jnp.where(brakes, vehicle.max_deceleration, vehicle.max_acceleration)
    return jnp.clip(change / limit[CAR], -1.0, 1.0)
