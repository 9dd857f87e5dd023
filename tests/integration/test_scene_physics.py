"""The factored physics and the box tests, judged by one world with every contact."""

import functools

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from helpers.coulomb import slide
from helpers.states import parked_in, state_of
from scipy.spatial.transform import Rotation

from carpark_mj.config import SimConfig
from carpark_mj.geometry import box_distance
from carpark_mj.layouts import make_layout
from carpark_mj.mdp.collisions import find_hits
from carpark_mj.physics.mjx import MjxPhysics
from carpark_mj.physics.scene import ScenePhysics
from carpark_mj.types import Motion
from carpark_mj.vehicle import COMPACT, make_vehicle
from carpark_mj.vehicle.drive import roll_freely

SIM = SimConfig()
LAYOUT = make_layout("square")
AGENTS, PARKED = 7, 16
LOTS, STEPS = 6, 40  # 8 s


@functools.cache
def scene():
    """The physics of one lot, which begins at rest, and its compiled functions."""
    physics = ScenePhysics(SIM, LAYOUT, COMPACT, AGENTS, PARKED)

    def begin(pose, parked):
        vehicle = jax.tree.map(lambda x: x[0], fleet(1))
        return physics.set_parked_poses(physics.init(pose, vehicle), parked)

    return physics, jax.jit(begin), jax.jit(physics.step)


def fleet(num_lots):
    vehicle = make_vehicle(COMPACT)
    shape = (num_lots, AGENTS)
    return jax.tree.map(lambda x: jnp.broadcast_to(x, (*shape, *x.shape)), vehicle)


def starts(rng, num_lots):
    """Seven cars well apart in the open square, in any direction."""
    grid = np.array([(x, y) for x in (-8, 0, 8) for y in (-7, 0, 7)])
    pose = np.zeros((num_lots, AGENTS, 3), np.float32)
    for lot in pose:
        lot[:, :2] = rng.permutation(grid)[:AGENTS]
        lot[:, 2] = rng.uniform(-np.pi, np.pi, AGENTS)
    return jnp.array(pose)


@functools.cache
def driven():
    """The same random driving in both: poses (2, steps, lots, agents, 3), touched."""
    rng = np.random.default_rng(5)
    pose, vehicle = starts(rng, LOTS), fleet(LOTS)
    # Bays 0 to 15 hold the parked cars.
    parked = jnp.broadcast_to(LAYOUT.bay_pose[:PARKED], (LOTS, PARKED, 3))
    style = rng.uniform(-1, 1, (STEPS // 8, LOTS, AGENTS, 2)) * (1.0, 1.4)
    noise = rng.normal(0, 0.2, (STEPS, LOTS, AGENTS, 2))
    controls = np.clip(np.repeat(style, 8, axis=0) + noise, -1, 1).astype(np.float32)

    @functools.partial(jax.jit, static_argnums=0)
    def run(physics, pose, controls):
        advance = jax.vmap(physics.step) if physics.config.contacts else physics.step

        def step(state, control):
            state = advance(state, control)
            return state, physics.read(state)

        state = physics.init(pose, vehicle)
        state = jax.vmap(physics.set_parked_poses)(state, parked)
        return jax.lax.scan(step, state, controls)[1]

    both = MjxPhysics(SIM), scene()[0]
    factored, judged = (run(each, pose, controls) for each in both)
    return jax.device_get((factored, judged))


def test_factored_and_scene_cars_agree_until_a_contact():
    factored, judged = driven()
    apart = ~np.cumsum(judged.touched.any(-1), axis=0).astype(bool)
    seconds = apart.sum(0) * SIM.ctrl_dt
    # Enough of it: most cars drive for more than five seconds before anything.
    assert (seconds >= 5.0).sum() >= LOTS * AGENTS // 2
    path = np.linalg.norm(np.diff(factored.pose_w[..., :2], axis=0), axis=-1).sum(0)
    assert np.median(path) > 5.0
    difference = np.abs(factored.pose_w - judged.pose_w)
    difference[..., 2] = np.abs((difference[..., 2] + np.pi) % (2 * np.pi) - np.pi)
    # Float32 against float64 engine over 8 s of driving; measured 2.0e-5 m, rad
    # in 265 s of cars driving.
    assert difference[apart].max() < 1e-4
    speed = np.abs(factored.velocity_b - judged.velocity_b)
    assert speed[apart].max() < 1e-4
    # And something did happen, so that "until" means something.
    assert judged.touched.any()


def test_a_lot_without_parked_cars_drives_like_factored():
    lots = 3
    pose = starts(np.random.default_rng(2), lots)[:, :1]
    vehicle = jax.tree.map(lambda x: x[:, :1], fleet(lots))
    controls, nobody = np.full((lots, 1, 2), 0.8, np.float32), jnp.zeros((lots, 0, 3))
    factored, empty = MjxPhysics(SIM), ScenePhysics(SIM, LAYOUT, COMPACT, 1, 0)
    alone, step = factored.init(pose, vehicle), jax.jit(factored.step)
    state = jax.vmap(empty.set_parked_poses)(empty.init(pose, vehicle), nobody)
    step_empty = jax.jit(jax.vmap(empty.step))
    for _ in range(3):
        alone, state = step(alone, controls), step_empty(state, controls)
    expected = factored.read(alone).pose_w
    assert np.linalg.norm((expected - pose)[..., :2], axis=-1).min() > 0.1
    assert empty.parked_poses(state, nobody).shape == (lots, 0, 3)
    # As in the lot with parked cars: float32 against a float64 engine.
    np.testing.assert_allclose(empty.read(state).pose_w, expected, atol=1e-4)


@functools.cache
def configurations():
    """Random cars, tilted a little: boxes and contacts, (10,000 lots x 3 kinds)."""
    rng = np.random.default_rng(11)
    count = 10_000
    physics, half = scene()[0], 19.0
    pose = rng.uniform((-half, -half, -np.pi), (half, half, np.pi), (count, AGENTS, 3))
    tilt = rng.uniform(-0.02, 0.02, (count, AGENTS, 2))  # pitch and roll [rad]
    bays = np.argsort(rng.random((count, LAYOUT.num_bays)))[:, :PARKED]
    data = mujoco.MjData(physics.scene.model)
    touched = np.zeros((count, AGENTS, 3), bool)
    bay_pose = np.asarray(LAYOUT.bay_pose, float)
    offset = COMPACT.centre_offset

    def rear(p):
        return p[:, :2] - offset * np.stack([np.cos(p[:, 2]), np.sin(p[:, 2])], -1)

    angles = np.concatenate([pose[..., 2:], tilt], axis=-1).reshape(-1, 3)
    turned = Rotation.from_euler("ZYX", angles).as_quat(scalar_first=True)
    turned = turned.reshape(count, AGENTS, 4)
    for k in range(count):
        axles = rear(pose[k])
        for agent in range(AGENTS):
            q = data.joint(f"agent{agent}/root").qpos
            q[:2], q[2], q[3:] = axles[agent], 0.0, turned[k, agent]
        parked = bay_pose[bays[k]]
        data.qpos[physics.scene.qpos_address[AGENTS * 13 :]] = np.column_stack(
            [rear(parked), parked[:, 2]]
        ).ravel()
        mujoco.mj_kinematics(physics.scene.model, data)
        mujoco.mj_comPos(physics.scene.model, data)
        mujoco.mj_collision(physics.scene.model, data)
        physics.scene.find_touches(data, touched[k])
    return pose.astype(np.float32), bays, touched


def test_box_tests_and_contacts_agree():
    pose, bays, touched = configurations()
    size = jnp.array([COMPACT.length, COMPACT.width], jnp.float32)
    sizes = jnp.broadcast_to(size, (AGENTS, 2))

    @jax.jit
    @jax.vmap
    def boxes(pose, bays):
        zero = jnp.zeros(AGENTS)
        motion = Motion(
            pose_w=pose,
            velocity_b=jnp.zeros((AGENTS, 2)),
            yaw_rate=zero,
            steering=zero,
            size=sizes,
            trace_w=pose[:, None],
            finite=zero == 0,
        )
        parked = parked_in(LAYOUT, bays, size)
        state = state_of(LAYOUT, motion, 0, parked_cars=parked)
        hits = jnp.stack([*find_hits(state).values()], axis=-1)
        # How near each kind is to being hit, and how deep, by growing and shrinking.
        gaps = []
        for grown in (size + 0.1, size - 0.1):
            agents = box_distance(pose[:, None], grown, pose[None], grown)
            agents = jnp.where(jnp.eye(AGENTS, dtype=bool), jnp.inf, agents)
            cars = box_distance(pose[:, None], grown, LAYOUT.bay_pose[bays], grown)
            walls = box_distance(
                pose[:, None], grown, LAYOUT.wall_pose, LAYOUT.wall_size
            )
            gaps.append(jnp.stack([g.min(-1) for g in (agents, cars, walls)], axis=-1))
        near = (gaps[0] == 0) & (gaps[1] > 0)  # within 5 cm of touching, either way
        return hits, near

    hits, near = map(np.asarray, boxes(pose, bays))
    assert near.mean() < 0.1  # a margin, not an excuse; measured 0.02
    disagree = (hits != touched) & ~near
    assert not disagree.any(), np.argwhere(disagree)[:5]
    # All kinds of both answers occur thousands of times.
    for kind in range(3):
        clear = ~near[..., kind]
        assert (hits[..., kind] & clear).sum() > 2000
        assert (~hits[..., kind] & clear).sum() > 2000


def test_a_crash_is_physical():
    """Agent 0 drives into the side of agent 1, which stands; others are far."""
    pose = np.array(
        [[-6, 0, 0], [2, 0, np.pi / 2]] + [[8, -9 + 4 * k, 0] for k in range(5)],
        np.float32,
    )
    _, begin, step = scene()
    state = begin(pose, LAYOUT.bay_pose[:PARKED])
    controls = np.zeros((AGENTS, 2), np.float32)
    controls[0, 1] = 1.0
    states = [state]
    for _ in range(30):
        states.append(step(states[-1], controls.copy()))
        if bool(states[-1].touched[0, 0]):
            controls[0, 1] = 0.0
    states = jax.device_get(states)
    poses = np.array([s.cars.trace_w[:, -1] for s in states])
    touched = np.array([s.touched for s in states])
    first = int(np.argmax(touched[:, 0, 0]))
    assert first > 3
    assert touched[first, 1, 0]  # both say so
    assert not touched[:, 2:].any()
    # The standing car is pushed sideways and neither goes through the other.
    assert poses[-1, 1, 0] - poses[0, 1, 0] > 0.05
    # Nose to side at right angles: half a length and half a width between the centres.
    gap = poses[first:, 1, 0] - poses[first:, 0, 0]
    assert gap.min() > (COMPACT.length + COMPACT.width) / 2 - 0.1
    # Nobody gains momentum, and both come to rest.
    speed = np.array([np.linalg.norm(s.cars.qvel[:2, :2], axis=-1) for s in states])
    before = speed[first - 1].sum()
    assert (speed[first:].sum(axis=1) < 1.02 * before).all()
    assert speed[-1].max() < 0.05
    # The bystanders stood still.
    assert np.abs(poses[-1, 2:] - poses[0, 2:]).max() < 1e-3


def test_a_hit_parked_car_turns_as_on_four_wheels():
    """A hit of 3 m/s, and from its end on the slide of Coulomb's friction."""
    reach = COMPACT.width / 2 + COMPACT.length / 2
    pose = np.array([[8, -9 + 3 * k, 0] for k in range(AGENTS)], np.float32)
    parked = np.array(LAYOUT.bay_pose[:PARKED])
    parked[0] = COMPACT.centre_offset, 0.0, 0.0  # its rear axle at the origin
    pose[0] = 0.0, -reach - 0.05, np.pi / 2
    _, begin, step = scene()
    state = begin(pose, parked)
    rolling = state.cars.qvel.at[0, 1].set(3.0)
    for dof in MjxPhysics(SIM).index.spin_dof:
        rolling = rolling.at[0, dof].set(3.0 / COMPACT.wheel_radius)
    speed = jnp.zeros(AGENTS).at[0].set(3.0)
    actuators = roll_freely(state.cars.actuators, speed)
    cars = state.cars.replace(qvel=rolling, actuators=actuators)
    state = state.replace(cars=cars)
    coast, brake = np.zeros((2, AGENTS, 2), np.float32)
    brake[0, 1] = -1.0
    state = step(state, coast)
    assert bool(state.touched[0, 1])
    while bool(state.touched[0, 1]):
        state = step(state, brake)
    apart = jax.device_get(state)
    (expected,) = slide(COMPACT, apart.parked_qpos[:1], apart.parked_qvel[:1], 1.0)
    for _ in range(5):
        state = step(state, brake)
    assert not state.touched[0].any()
    found = np.asarray(state.parked_qpos[0])
    np.testing.assert_allclose(found[:2], expected[:2], atol=0.03)
    assert found[2] == pytest.approx(expected[2], abs=np.radians(1.0))
    assert np.degrees(found[2]) < -4.0  # 0.4 on joints with dry friction
    assert np.abs(state.parked_qpos[1:] - apart.parked_qpos[1:]).max() < 1e-5


def test_parked_cars_are_moved_and_stay_pushed():
    (physics, begin, _), intended = scene(), LAYOUT.bay_pose[:PARKED]
    state = begin(starts(np.random.default_rng(0), 1)[0], intended)
    np.testing.assert_allclose(
        physics.parked_poses(state, intended), intended, atol=1e-5
    )
    pushed = state.replace(parked_qpos=state.parked_qpos.at[2, 0].add(0.3))
    again = physics.set_parked_poses(pushed, intended)
    pose = physics.parked_poses(again, intended)
    assert float(pose[2, 0] - intended[2, 0]) == pytest.approx(0.3, abs=1e-5)
    told = intended.at[2].set(LAYOUT.bay_pose[30])
    moved = physics.set_parked_poses(again, told)
    np.testing.assert_allclose(physics.parked_poses(moved, told), told, atol=1e-5)


def test_a_non_finite_car_is_contained_and_flagged():
    physics, begin, step = scene()
    state = begin(starts(np.random.default_rng(0), 1)[0], LAYOUT.bay_pose[:PARKED])
    cars = state.cars.replace(qvel=state.cars.qvel.at[3, 0].set(jnp.nan))
    halt = np.zeros((AGENTS, 2), np.float32)
    after = step(state.replace(cars=cars), halt)
    read = physics.read(after)
    assert list(np.asarray(read.finite)) == [k != 3 for k in range(AGENTS)]
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(read))
