"""Scenes, stand-ins and shared compiled environments for the tests of the task."""

import functools

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import shapely
from helpers.states import array_module, parked_at

from carpark_mj.config import EnvConfig, EpisodeConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.layouts import build, make_layout
from carpark_mj.observations import make_fields
from carpark_mj.types import Motion

CAR = (4.0, 2.0)  # m, a round footprint for hand-worked numbers


def cars(
    pose,
    speed=0.0,
    steering=0.0,
    yaw_rate=0.0,
    sideways=0.0,
    size=CAR,
    trace=None,
    finite=True,
):
    """Cars (..., ) by hand; scalars hold for all of them, the trace stands still."""
    xp = array_module(pose, speed, steering, yaw_rate, sideways, size, trace, finite)
    pose = xp.asarray(pose, np.float32)
    lead = pose.shape[:-1]

    def full(value, *shape):
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
    bays,
    walls=(),
    bay_size=(6.0, 3.0),
    wall_size=(1.0, 1.0),
    spawn_size=(10.0, 10.0),
    discs=(),
):
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


def crossing(trace_between):
    """Agent 0 passes through agent 1 (standing) from one instant to the next."""
    x = [-6.0, 0.0, 6.0, 6.0] if trace_between else [6.0, 6.0, 6.0, 6.0]
    moving = [(value, 0.0, 0.0) for value in x]
    standing = [(0.0, 0.0, np.pi / 2)] * 4
    return cars([moving[-1], standing[-1]], trace=[moving, standing])


def moved(pose, motion):
    """Poses (..., 3) after a rigid motion: turn about the origin, then shift."""
    pose = np.asarray(pose, np.float64)
    xy = (pose[..., 0] + 1j * pose[..., 1]) * np.exp(1j * motion[2])
    x, y = xy.real + motion[0], xy.imag + motion[1]
    return jnp.asarray(np.stack([x, y, pose[..., 2] + motion[2]], -1), jnp.float32)


def moved_cars(vehicle, motion):
    return vehicle.replace(
        pose_w=moved(vehicle.pose_w, motion), trace_w=moved(vehicle.trace_w, motion)
    )


def moved_lot(layout, motion):
    return layout.replace(
        bay_pose=moved(layout.bay_pose, motion),
        wall_pose=moved(layout.wall_pose, motion),
        disc_centre=moved(jnp.pad(layout.disc_centre, ((0, 0), (0, 1))), motion)[:, :2],
        lane_pose=moved(layout.lane_pose, motion),
        spawn_pose=moved(layout.spawn_pose, motion),
    )


def polygons(pose, size):
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


def boxes(layout, kind):
    """The boxes of a kind (`bay`, `wall`, `lane`, `spawn`) in one lot as polygons."""
    mask = getattr(layout, f"{kind}_mask")
    return polygons(
        getattr(layout, f"{kind}_pose")[mask], getattr(layout, f"{kind}_size")[mask]
    )


def solid(layout):
    """Everything of one lot that is hit, as one shape."""
    centres = shapely.points(layout.disc_centre[layout.disc_mask])
    discs = shapely.buffer(centres, layout.disc_radius[layout.disc_mask])
    return shapely.union_all([*boxes(layout, "wall"), *discs])


def random_lots(count, reach, seed=0, agents=4, parked=5, walls=3, discs=4):
    """Layouts, cars and parked cars anywhere within `reach` [m] (count,) or ().

    A third of what stands does not count.
    """
    rng = np.random.default_rng(seed)
    reach = np.broadcast_to(reach, count)[:, None, None]

    def poses(n):
        place = rng.uniform(-1, 1, (count, n, 2)) * reach
        yaw = rng.uniform(-np.pi, np.pi, (count, n, 1))
        return np.float32(np.concatenate([place, yaw], axis=-1))

    def sizes(n):
        return np.float32(rng.uniform(0.5, 5.0, (count, n, 2)))

    def some(n):
        return rng.uniform(size=(count, n)) < 0.7

    pose = poses(agents)[:, :, None]
    way = rng.uniform(-0.7, 0.7, (count, agents, 1, 3))
    trace = pose + way * np.linspace(-1, 0, 3)[:, None]
    motion = cars(trace[..., -1, :], size=sizes(agents), trace=trace)
    plan = lot(np.zeros((1, 3)), np.zeros((walls, 3)), discs=np.zeros((discs, 3)))
    layout = jax.tree.map(lambda x: jnp.stack([x] * count), plan).replace(
        wall_pose=poses(walls),
        wall_size=sizes(walls),
        wall_mask=some(walls),
        disc_centre=poses(discs)[..., :2],
        disc_radius=np.float32(rng.uniform(0.1, 1.5, (count, discs))),
        disc_mask=some(discs),
    )
    stands = jax.vmap(parked_at)(poses(parked), sizes(parked), some(parked))
    return layout, motion, stands


NOISE = 1e-4  # m; float32 at 50 m resolves 4e-6 m, a sum of a few such errors


def overlap_oracle(pose_a, size_a, pose_b, size_b):
    """Shapely's answer, and where it holds with box a one `NOISE` larger or smaller."""
    b, size_a = polygons(pose_b, size_b), np.asarray(size_a, np.float64)
    shrunk = shapely.intersects(polygons(pose_a, size_a - 2 * NOISE), b)
    grown = shapely.intersects(polygons(pose_a, size_a + 2 * NOISE), b)
    return grown, grown == shrunk


def fields_of(observation, config):
    """An observation (..., size) cut into its named fields (..., k)."""
    observation = np.asarray(observation)
    named, start = {}, 0
    for field in make_fields(config):
        named[field.name] = observation[..., start : start + field.size]
        start += field.size
    assert start == observation.shape[-1]
    return named


def check_occupancy(goal, parked_bay, bay_mask):
    """Asserts the plan's invariants for histories (..., agents) and (..., cars)."""
    goal, parked_bay = np.asarray(goal), np.asarray(parked_bay)
    held = np.sort(np.concatenate([goal, parked_bay], axis=-1), axis=-1)
    # All different: goals from goals, cars from cars, and no car on a goal.
    assert (np.diff(held, axis=-1) > 0).all()
    assert np.take_along_axis(np.asarray(bay_mask), held, axis=-1).all()


LOTS = 4


@functools.cache
def mjx_env():
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


def mixed_lots():
    """Two `square` and two `square_compact` lots as one batch."""
    layouts = [
        make_layout(n) for n in ("square", "square_compact", "square", "square_compact")
    ]
    return jax.tree.map(lambda *rows: jnp.stack(rows), *layouts)


def mjx_start(seed=0):
    """The shared environment's lots, freshly started."""
    return mjx_reset()(mixed_lots(), jax.random.split(jax.random.key(seed), LOTS))


@functools.cache
def mjx_rollout():
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


def stacked(items):
    """A list of equal trees as one tree with a leading time axis."""
    return jax.tree.map(lambda *rows: np.stack(rows), *items)


def try_out(spec: mujoco.MjSpec, seconds: float = 1.0) -> list[str]:
    """Compiles a drivable scene and drives it, every car on half throttle in a curve.

    Returns MuJoCo's warnings by name (`BADQACC`...), a sentence each.
    """
    model = spec.compile()
    data = mujoco.MjData(model)
    for k in range(model.nu):
        is_brake = model.actuator(k).name.endswith("/brake")
        data.ctrl[k] = 0.0 if is_brake else 0.5 * model.actuator_ctrlrange[k, 1]
    mujoco.mj_step(model, data, nstep=round(seconds / model.opt.timestep))
    names = [name.removeprefix("mjWARN_") for name in mujoco.mjtWarning.__members__]
    counts = zip(names, (warning.number for warning in data.warning), strict=False)
    return [f"{name}, {number} times" for name, number in counts if number]
