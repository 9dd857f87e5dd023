"""People in a lot: who they are, where and how they walk; cars can stop for them."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from helpers.scenes import cars, polygons
from helpers.states import parked_at, state_of

import crowds
from carpark_mj.config import SimConfig
from carpark_mj.geometry import box_disc_overlap, move_forward, norm, rotate
from carpark_mj.geometry.obstacles import Boxes, ObstacleKind
from carpark_mj.layouts import layout_config, make_layout
from carpark_mj.movers import Pedestrians
from carpark_mj.movers import bodies as model
from carpark_mj.movers.bodies import Room, go_round
from carpark_mj.movers.stopping import cars_of, keep_off, stopping_zones
from carpark_mj.obstacles import hit_kinds, make_movers, place_movers
from carpark_mj.physics.emergency_brake import override
from carpark_mj.physics.mjx import MjxPhysics
from carpark_mj.vehicle import COMPACT, make_vehicle
from carpark_mj.vehicle.drive import stopping_action

LOT = make_layout("square")
DT, STEPS, LOTS = 0.2, 300, 8
FAMILIES: Any = layout_config("mixture")
MANY = jax.jit(jax.vmap(FAMILIES.generate))(jax.random.split(jax.random.key(0), LOTS))
STARTS = jnp.array([-3.0, 3.0])  # m, of two cars along the first region
THIRD = jnp.arange(MANY.num_bays) % 3 == 0  # of the bays hold parked cars
BRAKES, DRIVES, STANDS, ASSISTED = range(4)
SIM, AWAY = SimConfig(emergency_brake=0.3), 1e3  # m
PEOPLE = Pedestrians(number=15, children=0.4, attention=0.3)


@pytest.fixture(scope="module")
def drive():
    """People and two cars that brake for them, drive on, stand, or are braked.

    One drives at random, the other at the nearest person.
    """
    physics, car = MjxPhysics(SIM), make_vehicle(COMPACT)
    vehicles = jax.tree.map(lambda x: jnp.broadcast_to(x, (2, *x.shape)), car)

    def one(layout, key, mode):
        parked = parked_at(layout.bay_pose, (4.0, 1.8), layout.bay_mask & THIRD)
        start = jax.vmap(move_forward, (None, 0))(layout.spawn_pose[0], STARTS)

        def step(carry, key):
            people, moving, wish = carry
            keys = jax.random.split(key, 3)
            motion = physics.read(moving)
            movers = place_movers((PEOPLE,), (people,))
            lot = state_of(layout, motion, 0, parked_cars=parked, movers=movers)
            lot = lot.replace(physics=moving)
            zones = stopping_zones(cars_of(lot, DT), DT)
            near = zones.hold(zones.local(people.xy), people.radius[:, None])
            stops = (mode == BRAKES) & (near & people.present[:, None]).any(axis=0)
            new = jax.random.uniform(keys[0], (2,), minval=-1.0)
            new = new * jnp.array([0.3, 1.0]) + jnp.array([0.0, 0.4])
            wish = jnp.where(jax.random.bernoulli(keys[1], 0.1), new, wish)
            to = people.xy - motion.xy[1] + AWAY * ~people.present[:, None]
            x, y = rotate(to[jnp.argmin(norm(to))], -motion.pose_w[1, 2])
            way = jnp.where(x > 0.0, 1.0, -1.0)
            steer = jnp.clip(way * 2.0 * jnp.arctan2(y, jnp.abs(x)), -1.0, 1.0)
            wanted = jnp.stack([wish, jnp.stack([steer, way])]) * (mode != STANDS)
            stopping = stopping_action(motion.speed).at[:, 0].set(wanted[:, 0])
            controls = jnp.where(stops[:, None], stopping, wanted)
            assisted = override(SIM, lot, wanted)
            controls = jnp.where(mode == ASSISTED, assisted, controls)
            moving = physics.step(moving, controls)
            walked = PEOPLE.step(keys[2], people, lot, DT)
            after = physics.read(moving)
            count = after.trace_w.shape[1]
            share = (jnp.arange(count) + 1.0) / count
            there = people.xy + share[:, None, None] * (walked.xy - people.xy)
            trace = jnp.swapaxes(after.trace_w, 0, 1)[:, :, None]
            hit = box_disc_overlap(trace, car.size, there[:, None], people.radius)
            hit = (hit & people.present).any(axis=(0, 2))
            # Cars that leave the aisles, or have hit somebody, begin anew, at rest.
            out = (jnp.abs(after.xy) > layout.extent - 2.0).any(axis=-1) | hit
            near = walked.xy, walked.radius + SIM.emergency_brake
            taken = box_disc_overlap(start[:, None], car.size, *near).any(axis=1)
            again = start + 100.0 * taken[:, None]
            moving = physics.place(moving, out, again, vehicles)
            return (walked, moving, wish), (walked, hit, jnp.abs(motion.speed))

        standing = Boxes(parked.pose_w, parked.size, mask=parked.present)
        people = PEOPLE.begin(key, layout, [standing])
        begin = people, physics.init(start + 100.0, vehicles), jnp.zeros(2)
        return jax.lax.scan(step, begin, jax.random.split(key, STEPS))[1]

    run = jax.jit(jax.vmap(one, (0, 0, None)))
    keys = jax.random.split(jax.random.key(2), LOTS)
    return [jax.device_get(run(MANY, keys, mode)) for mode in range(4)]


def test_braking_for_people_prevents_hits(drive):
    hits = [hit.sum() for _, hit, _ in drive]
    assert hits[BRAKES] == 0
    assert hits[STANDS] == 0  # nobody walks into a standing car
    assert (drive[DRIVES][1].sum(axis=(0, 1)) > 10).all()
    assert (drive[BRAKES][2] > 2.0).mean() > 0.05  # it drives for all that


def test_emergency_brake_prevents_hits(drive):
    _, hit, speed = drive[ASSISTED]
    assert not hit.any()
    assert ((speed > 1.0).mean(axis=(0, 1)) > 0.1).all()  # it drives for all that


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_nobody_steps_before_a_car_that_cannot_stop(side):
    size = COMPACT.length, COMPACT.width
    physics, car = MjxPhysics(SimConfig()), make_vehicle(COMPACT)
    motion = cars([(0.0, 0.0, 0.0)], speed=2.0, size=size)
    vehicle = jax.tree.map(lambda x: x[None], car)
    lot = state_of(LOT, motion, 0)
    lot = lot.replace(physics=physics.init(motion.pose_w, vehicle))
    radius, ahead = jnp.array([0.25]), size[0] / 2 + 0.4
    xy = jnp.array([[ahead, side * (size[1] / 2 + 0.35)]])
    zones = jax.jit(stopping_zones, static_argnums=1)(cars_of(lot, DT), DT)
    assert bool(zones.hold(zones.local(xy), radius[:, None])[0, 0])
    for across, goes in ((-0.06, False), (0.0, True), (0.06, True)):
        move = jnp.array([[0.4, side * across]])
        found = keep_off(xy, move, xy + 50 * move, radius, zones, zones)
        assert bool(jnp.abs(found[0, 1]) > 1e-3) == (goes and across > 0.0)
        assert bool(jnp.abs(found[0] - move[0]).max() < 1e-6) == goes


def test_people_walk_everywhere_but_never_through_walls(drive):
    for people, _, _ in drive:
        assert np.isfinite(people.xy).all()
        x, y = people.xy[..., 0], people.xy[..., 1]
        assert (np.abs(people.xy) < MANY.extent[:, None, None]).all()
        for k in range(LOTS):
            walls = polygons(MANY.wall_pose[k], MANY.wall_size[k])
            for wall in walls[np.asarray(MANY.wall_mask[k])]:
                assert not shapely.contains_xy(wall, x[k, ::5], y[k, ::5]).any()
        assert {*np.unique(people.phase)} == {0, 1, 2, 3}
        speed = np.linalg.norm(people.velocity, axis=-1)
        assert 0.8 < np.median(speed[people.phase == 2]) < 1.9


def test_nobody_stands_in_anybody_or_in_a_parked_car(drive):
    bays = MANY.bay_pose[:, None, :, None], jnp.array([4.0, 1.8]) - 1e-3
    taken = (MANY.bay_mask & THIRD)[:, None, :, None]
    for people, _, _ in drive:
        all_of = people.xy, people.radius, people.present
        xy, radius, there = (x[:, ::3] for x in all_of)
        gap = norm(xy[:, :, :, None] - xy[:, :, None])
        gap = np.asarray(gap - radius[..., None] - radius[:, :, None])
        pairs = there[..., None] & there[:, :, None] & ~np.eye(15, dtype=bool)
        assert gap[pairs].min() > -1e-4
        over = box_disc_overlap(*bays, xy[:, :, None], radius[:, :, None])
        assert not (over & taken & there[:, :, None]).any()


def test_nobody_stays_for_long_by_a_car_that_waits(drive):
    people, first = drive[STANDS][0], MANY.spawn_pose[:, 0]
    walks = (people.phase != 0) & people.present  # round the car
    stuck = np.linalg.norm(people.velocity, axis=-1) < 0.1
    assert stuck[walks].mean() < 0.05
    close = np.zeros(people.present.shape, bool)
    for x in STARTS:
        car = jax.vmap(move_forward, (0, None))(first, x)[:, None, None]
        size, reach = jnp.array([4.0, 1.8]), jnp.array(1.0)
        close |= np.asarray(box_disc_overlap(car, size, people.xy, reach))
    close &= people.present
    assert close.any()  # they pass by
    windows = np.lib.stride_tricks.sliding_window_view(close, int(20.0 / DT), axis=1)
    assert windows.all(axis=-1).mean() < 1e-3


def test_number_and_shares_are_those_asked_for(drive):
    name = "pedestrians:number=5..20,children=0.4,attention=0.3"
    [several] = make_movers([name])
    assert several == dataclasses.replace(PEOPLE, number=(5, 20))
    assert ObstacleKind.PERSON in hit_kinds([name])
    make = jax.jit(jax.vmap(lambda key: several.init(key, LOT)))
    people = make(jax.random.split(jax.random.key(0), 200))
    counts = people.present.sum(axis=1)
    assert counts.min() >= 5
    assert counts.max() <= 20
    assert len(np.unique(counts)) > 5
    assert float(people.child.mean()) == pytest.approx(0.4, abs=0.05)
    assert float(people.speed.mean()) == pytest.approx(1.34, abs=0.02)
    # Who leads begins in an aisle.
    box = LOT.bay_pose, LOT.bay_size, people.xy[:, :, None], jnp.array(0.35)
    alone = people.leader == jnp.arange(20)
    assert not box_disc_overlap(*box)[alone & people.present].any()
    walked = drive[0][0]
    leads = walked.leader[:, 0] == np.arange(15)
    assert not leads.all()
    lead = np.take_along_axis(walked.leader[:, 0], walked.leader[:, 0], axis=1)
    np.testing.assert_array_equal(lead, walked.leader[:, 0])


WEIDMANN = {1.0: 1.06, 2.0: 0.61}  # m/s at persons/m², of one-way flow
EAST = jnp.array([[1.0, 0.0]])


def test_lone_person_speeds_up_with_the_relaxation_time():
    velocity, nothing = jnp.zeros((1, 2)), jnp.zeros((1, 2))
    for step in range(1, 11):  # any step size gives the exact solution
        velocity = model.accelerate(velocity, 1.34 * EAST, nothing, 0.2)
        expected = 1.34 * (1 - np.exp(-0.2 * step / model.RELAXATION))
        np.testing.assert_allclose(velocity, [[expected, 0.0]], atol=1e-5)


def potential(x, y, stride):
    """V(b) of equation 3, for a step of a given length to the east."""
    far = np.hypot(x - stride, y)
    b = 0.5 * np.sqrt((np.hypot(x, y) + far) ** 2 - stride**2)
    return 2.1 * np.exp(-b / 0.3)  # published: V0 in m²/s², sigma in m


@pytest.mark.parametrize(("x", "y", "speed"), [(0.8, 0.3, 0.0), (-0.5, 0.9, 0.7)])
def test_the_force_is_the_slope_of_the_potential(x, y, speed):
    # The first person looks at the second, so that sight weakens nothing.
    away = np.array([[-x, -y], [speed, 0.0]])
    heading = away / np.maximum(np.linalg.norm(away, axis=1), 1e-9)[:, None]
    offset = jnp.array([[0.0, x], [-x, 0.0]]), jnp.array([[0.0, y], [-y, 0.0]])
    fx, fy = model.push(offset, jnp.array([0.0, speed]), jnp.array(heading))
    stride, eps = speed * model.STEP_TIME, 1e-5
    slope_x = potential(x + eps, y, stride) - potential(x - eps, y, stride)
    slope_y = potential(x, y + eps, stride) - potential(x, y - eps, stride)
    expected = -np.array([slope_x, slope_y]) / (2 * eps)
    np.testing.assert_allclose([fx[0, 1], fy[0, 1]], expected, rtol=1e-3)


def test_mirrored_crowds_stay_mirrored():
    # Farther apart than a step of 2.6 m, within which the ellipse is a line.
    offset = jnp.array([[0.0, -4.0], [4.0, 0.0]]), jnp.zeros((2, 2))
    fx, fy = model.push(offset, jnp.full(2, 1.3), jnp.array([[1.0, 0], [-1.0, 0]]))
    np.testing.assert_allclose(fx[0, 1], -fx[1, 0], rtol=1e-5)
    assert fx[0, 1] < 0.0
    np.testing.assert_allclose(fy, 0.0, atol=1e-6)
    rng = np.random.default_rng(0)
    xy, way = rng.normal(size=(2, 6, 2))
    way /= np.linalg.norm(way, axis=1)[:, None]

    def force(flip):
        there, heading = xy * [1, flip], jnp.array(way * [1, flip])
        offset = jnp.moveaxis(jnp.array(there[:, None] - there), -1, 0)
        found = model.push((offset[0], offset[1]), jnp.full(6, 1.3), heading)
        return np.stack(found, -1) * [1, flip] * ~np.eye(6, dtype=bool)[..., None]

    np.testing.assert_allclose(force(1), force(-1), rtol=1e-4, atol=1e-6)


def test_force_from_behind_is_less_and_always_finite():
    offset = jnp.array([[1.0]]), jnp.array([[0.0]])
    [[seen]], _ = model.push(offset, jnp.zeros(1), -EAST)
    [[unseen]], _ = model.push(offset, jnp.zeros(1), EAST)
    assert float(unseen / seen) == pytest.approx(model.UNSEEN)
    zero = jnp.zeros((1, 1)), jnp.zeros((1, 1))
    assert np.isfinite(model.push(zero, jnp.ones(1), EAST)).all()
    assert np.isfinite(model.border_push(zero)).all()
    assert np.linalg.norm(model.limit(9.0 * EAST, jnp.ones(1))) == pytest.approx(1.3)


@pytest.mark.parametrize("density", WEIDMANN)
def test_crowds_walk_as_fast_as_published_at_any_period(density):
    keys = jax.random.split(jax.random.key(0), 4)
    walk = jax.jit(jax.vmap(crowds.walk, (0, None)), static_argnums=1)

    def pace(dt):
        place = crowds.Corridor(8.0, 3.0, density, dt=dt, seconds=12.0)
        return float(walk(keys, place)[0][:, round(6.0 / dt) :].mean())

    slow, fast = pace(0.2), pace(0.02)
    assert slow == pytest.approx(WEIDMANN[density], rel=0.2)
    assert fast == pytest.approx(slow, rel=0.08)


def test_person_who_touches_a_body_slides_along_it():
    angle = jnp.linspace(0.0, 2 * jnp.pi, 200)
    ahead = jnp.stack([jnp.cos(angle), jnp.sin(angle)], axis=1)
    right = jnp.stack([ahead[:, 1], -ahead[:, 0]], axis=1)
    room = Room(ahead[:, :1], ahead[:, 1:], jnp.zeros((200, 1)))
    move = jax.jit(go_round)([room], 0.12 * ahead + 0.16 * right, 0.03)
    np.testing.assert_allclose((move * ahead).sum(axis=1), 0.0, atol=1e-6)
    np.testing.assert_allclose((move * right).sum(axis=1), 0.19, atol=1e-6)
