"""Movers in the world of scene physics: solids that stop, push and report cars."""

import copy
import functools
import math

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from helpers.instants import instant
from helpers.states import state_of

from carpark_mj.config import ObstacleKind, SimConfig
from carpark_mj.geometry.obstacles import Boxes, Discs, Movers
from carpark_mj.layouts import make_layout
from carpark_mj.mdp.collisions import find_hits
from carpark_mj.obstacles import trace_still
from carpark_mj.physics.mjx import MjxPhysics
from carpark_mj.physics.scene import ScenePhysics
from carpark_mj.physics.scene_model import DEEPEST, solids_within
from carpark_mj.rendering.stage import Stage
from carpark_mj.scene.parts import CRUSH_DAMPING, CRUSH_FREQUENCY
from carpark_mj.vehicle import COMPACT, make_vehicle

LAYOUT = make_layout("square")
SIM = SimConfig(trace_dt=0.01)  # every substep is traced
NOSE = COMPACT.length / 2
COAST = jnp.zeros((1, 2))
NOBODY = np.zeros((0, 3))


def movers(person=None, cart=None, car=None):
    """A lot's groups: a person (x, y, radius), boxes (x, y, yaw, length, width)."""

    def boxes(row, kind):
        *pose, length, width = row or (0.0, 0.0, 0.0, 1.0, 1.0)
        there, size = jnp.array([row is not None]), jnp.array([[length, width]])
        return Boxes(jnp.array([pose]), size, mask=there, kind=kind)

    *xy, radius = person or (0.0, 0.0, 0.3)
    there = jnp.array([person is not None])
    disc = Discs(jnp.array([xy]), jnp.array([radius]), mask=there)
    return (
        disc.replace(kind=ObstacleKind.PERSON),
        boxes(cart, ObstacleKind.MOVER),
        boxes(car, ObstacleKind.DRIVER),
    )


def batch(lots):
    return jax.tree.map(lambda *rows: jnp.stack(rows), *lots)


@functools.cache
def scene(num_parked_cars=0, sim=SIM, with_movers=True):
    groups = movers() if with_movers else ()
    return ScenePhysics(sim, LAYOUT, COMPACT, 1, num_parked_cars, groups)


def begin(physics, pose, speed=0.0, parked=NOBODY):
    """Lots (n,) of a car at a pose (n, 3) or (3,)."""
    pose = jnp.atleast_2d(jnp.array(pose, jnp.float32))[:, None]
    lead = pose.shape[:2]
    vehicle = make_vehicle(COMPACT)
    vehicle = jax.tree.map(lambda x: jnp.broadcast_to(x, (*lead, *x.shape)), vehicle)
    state = physics.set_speed(physics.init(pose, vehicle), jnp.full(lead, speed))
    parked = jnp.broadcast_to(
        jnp.asarray(parked, jnp.float32), (lead[0], *parked.shape)
    )
    return jax.vmap(physics.set_parked_poses)(state, parked)


def drive(physics, state, before, after, controls=COAST):
    """Lots (n,) through steps (k,): motions (k, n, 1); `before` (k, n, ...)."""

    def step(state, there):
        move = jax.vmap(physics.step_among, (0, None, 0, 0))
        state = move(state, controls, *there)
        return state, (physics.read(state), state)

    return jax.jit(lambda *a: jax.lax.scan(step, a[0], a[1:])[1])(state, before, after)


def still(groups, steps):
    return jax.tree.map(lambda x: jnp.broadcast_to(x, (steps, *x.shape)), groups)


FACE, SPEED = 2.0, 1.5  # m and m/s
STANDING = (
    {"person": (FACE + 0.3, 0.0, 0.3)},
    {"person": (FACE + 0.2, 0.0, 0.2)},
    {"cart": (FACE + 0.5, 0.0, 0.0, 1.0, 0.6)},
    {"cart": (FACE + 0.3, 0.0, math.pi / 2, 1.0, 0.6)},
    {"car": (FACE + 0.8, 0.0, math.pi / 2, 3.7, 1.6)},
)


def test_a_mover_at_rest_stops_a_coasting_car_as_a_wall_does():
    physics, steps = scene(), 8
    start = [FACE - NOSE - 0.3, 0.0, 0.0]
    lots = still(batch([movers(**who) for who in STANDING]), steps)
    state = begin(physics, np.tile(start, (len(STANDING), 1)), SPEED)
    motion, _ = jax.device_get(drive(physics, state, lots, lots))
    # What is touched has its kind, and its own size in every lot.
    touched = motion.touched.any(axis=(0, 2))
    kinds = [{"person": 4, "cart": 3, "car": 5}[next(iter(who))] for who in STANDING]
    np.testing.assert_array_equal(touched, np.eye(6, dtype=bool)[kinds])
    # As deep as a damped spring that is hit at that speed, the law of hulls.
    damped = math.sqrt(1.0 - CRUSH_DAMPING**2)
    turn = math.atan2(damped, CRUSH_DAMPING) * CRUSH_DAMPING / damped
    expected = SPEED / CRUSH_FREQUENCY * math.exp(-turn)  # 3.2 cm
    depth = motion.trace_w[:, :, 0, :, 0].max(axis=(0, 2)) + NOSE - FACE
    np.testing.assert_allclose(depth, expected, rtol=0.15)
    assert np.abs(motion.speed[-1]).max() < 0.05
    # On its own the car rolls on.
    free = MjxPhysics(SIM)
    alone = free.set_speed(
        free.init(jnp.array([start]), jax.tree.map(lambda x: x[:1, 0], state.vehicle)),
        jnp.array([SPEED]),
    )
    for _ in range(steps):
        alone = free.step(alone, COAST)
    assert free.read(alone).pose_w[0, 0] + NOSE > FACE + 1.0


def test_who_is_absent_exerts_no_force():
    steps, controls = 8, jnp.array([[0.0, 0.8]])
    nobody = [group.replace(mask=jnp.array([False])) for group in movers(**AHEAD)]
    lots = still(batch([tuple(nobody)]), steps)
    physics, plain = scene(), scene(with_movers=False)
    start = [-3.0, 0.0, 0.0], 1.5
    _, among = drive(physics, begin(physics, *start), lots, lots, controls)
    step, state = jax.jit(jax.vmap(plain.step)), begin(plain, *start)
    for k in range(steps):
        state = step(state, controls[None])
        np.testing.assert_allclose(among.cars.qpos[k], state.cars.qpos, atol=1e-5)
        np.testing.assert_allclose(among.cars.qvel[k], state.cars.qvel, atol=1e-5)
    assert state.cars.trace_w[0, 0, -1, 0] + NOSE > 1.0  # where they would be
    assert not among.touched.any()
    assert plain.read(state).touched.shape == (1, 1, 3)


AHEAD = {
    "person": (0.0, 0.0, 0.3),
    "cart": (1.0, 0.0, 0.0, 1.0, 0.6),
    "car": (4.0, 0.0, 0.0, 3.7, 1.6),
}


def test_a_mover_pushes_a_standing_car_at_its_own_speed():
    physics, steps, speed = scene(), 12, 1.0
    way = speed * SIM.ctrl_dt * np.arange(steps + 1)
    rear = -NOSE - 0.5 - 0.5 * speed  # it needs half a second
    places = [batch([movers(cart=(rear + float(x), 0.0, 0.0, 1.0, 0.6))]) for x in way]
    before, after = batch(places[:-1]), batch(places[1:])
    state = begin(physics, np.zeros(3))
    motion, _ = jax.device_get(drive(physics, state, before, after))
    x = motion.trace_w[:, 0, 0, :, 0].ravel()  # at the ends of substeps
    time = SIM.sim_dt * np.arange(1, x.size + 1)
    depth = rear + speed * time + 0.5 - (x - NOSE)
    touched = motion.touched[:, 0, 0, ObstacleKind.MOVER]
    np.testing.assert_array_equal(np.flatnonzero(touched)[0], 2)
    # MuJoCo takes it to stand, so it stays as deep as the damper's force makes a
    # spring, 2 x damping x speed / frequency; in a jump of a whole step 20 cm.
    standing = 2.0 * CRUSH_DAMPING * speed / CRUSH_FREQUENCY
    assert depth[-20:] == pytest.approx(standing, rel=0.05)
    assert depth.max() < 1.5 * standing
    assert np.abs(x[time < 0.5]).max() < 1e-3
    assert np.diff(x).max() < 1.3 * speed * SIM.sim_dt
    assert motion.speed[-3:, 0, 0] == pytest.approx(speed, rel=0.02)


def test_what_appears_inside_a_car_does_not_throw_it():
    physics, steps = scene(), 5
    there = movers(car=(0.5, 0.4, 0.5, 3.7, 1.6), person=(-1.0, 0.2, 0.3))
    nobody = tuple(group.replace(mask=~group.mask) for group in there)
    before = batch([batch([nobody]), *[batch([there])] * (steps - 1)])
    after = still(batch([there]), steps)
    _, state = drive(physics, begin(physics, np.zeros(3)), before, after)
    assert np.abs(state.cars.qvel).max() < 0.1
    assert (
        np.abs(state.cars.qpos[-1, 0, 0, :3] - state.cars.qpos[0, 0, 0, :3]).max()
        < 0.01
    )


def test_parked_cars_are_not_pushed():
    """Doors are part of their cars, and people squeeze through gaps."""
    parked = np.array([[0.0, 5.0, 0.0]])
    physics, steps = scene(1), 3
    within = {"person": (1.0, 5.0, 0.3), "cart": (0.0, 5.9, 0.3, 1.0, 0.1)}
    lots = still(batch([movers(**within)]), steps)
    state = begin(physics, [0.0, -5.0, 0.0], parked=parked)
    motion, after = drive(physics, state, lots, lots)
    assert not motion.touched.any()
    np.testing.assert_allclose(after.parked_qpos[-1], state.parked_qpos, atol=1e-6)


def test_contacts_are_where_the_box_tests_find_overlaps():
    """Random lots, shapes and sizes; not at the edge, where hulls sway, nor deep."""
    rng, count = np.random.default_rng(0), 2500
    sim = SimConfig(ctrl_dt=0.01, trace_dt=0.01)
    physics = scene(0, sim)

    def drawn(low, high):
        return jnp.array(rng.uniform(low, high, (count, 1, len(low))), jnp.float32)

    def boxes():
        pose = drawn((-4.0, -4.0, -math.pi), (4.0, 4.0, math.pi))
        return Boxes(pose, drawn((0.1, 0.1), (5.0, 5.0)))

    centre, radius = drawn((-4.0, -4.0), (4.0, 4.0)), drawn((0.1,), (1.0,))[..., 0]
    groups = tuple(
        group.replace(kind=ObstacleKind[name])
        for name, group in (
            ("PERSON", Discs(centre, radius)),
            ("MOVER", boxes()),
            ("DRIVER", boxes()),
        )
    )
    pose = rng.uniform((-1.0, -1.0, -math.pi), (1.0, 1.0, math.pi), (count, 3))
    lots = still(groups, 1)
    motion, _ = drive(physics, begin(physics, pose), lots, lots)
    motion = jax.tree.map(lambda x: x[0], motion)

    @jax.vmap
    def overlaps(groups, pose):
        placed = motion_at(pose)
        there = trace_still(Movers((), (groups,)), 1)
        found = []
        for grown in (0.0, 0.05, -0.05, 0.1 - 2.0 * DEEPEST):
            car = placed.replace(size=placed.size + grown)
            hits = find_hits(state_of(LAYOUT, car, 0, movers=there))
            labels = ("person", "mover", "driver")
            found.append(jnp.stack([hits[label] for label in labels], axis=-1))
        return found

    def motion_at(pose):
        one = jax.tree.map(lambda x: x[0], motion)
        pose = pose[None]
        return one.replace(pose_w=pose, trace_w=pose[:, None], touched=None)

    hits, grown, shrunk, deep = map(np.asarray, overlaps(groups, jnp.array(pose)))
    touched = np.asarray(motion.touched)[..., [4, 3, 5]]
    clear = grown == shrunk
    assert clear.mean() > 0.9
    clear = clear & ~deep
    np.testing.assert_array_equal(touched[clear], hits[clear])
    for kind in range(3):
        assert (hits & clear)[..., kind].sum() > 100
        assert (~hits & clear)[..., kind].sum() > 500


def test_bodies_are_where_pictures_show_them():
    there = movers((1.0, 2.0, 0.3), (-3.0, 1.0, 0.4, 1.2, 0.7))
    world, stage = scene().scene, Stage(LAYOUT, COMPACT, 1, 0, movers=there)
    stage.place(instant(np.zeros(3), movers=there))
    data = mujoco.MjData(world.model)
    car = jnp.array([[0.0, -9.0, 0.0]]), jnp.array([[4.0, 2.0]])
    solids = solids_within(there, there, jnp.float32(0.0), *car)
    world.place_movers(copy.copy(world.model), data, solids)
    mujoco.mj_kinematics(world.model, data)
    for number, here in enumerate((True, True, False)):
        own, seen = (d.geom(f"mover{number}") for d in (data, stage.data))
        np.testing.assert_allclose(own.xpos, seen.xpos, atol=1e-6)
        np.testing.assert_allclose(own.xmat, seen.xmat, atol=1e-6)
        assert (own.xpos[2] > 0.0) == here
        shown = stage.model.geom(f"mover{number}")
        np.testing.assert_allclose(solids.size[number], shown.size, atol=1e-6)
