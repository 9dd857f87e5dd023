"""Things that move: they go where they can, and never where a car cannot stop."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from helpers.scenes import cars, polygons
from helpers.states import parked_at, parked_in, state_of

from carpark_mj.geometry.obstacles import Boxes, Movers, ObstacleKind
from carpark_mj.layouts import layout_config, make_layout
from carpark_mj.movers import Barrier, Cart, Door, RailCar
from carpark_mj.movers.things import DOOR, ROLLING, WIDEST
from carpark_mj.obstacles import (
    begin_movers,
    lot_obstacles,
    make_movers,
    step_movers,
    trace_still,
)
from inhabited import overlaps

DT, STEPS = 0.2, 400
STREET: Any = layout_config("street")
LOT = STREET.generate(jax.random.key(0))
LANE = LOT.lane_pose[0]
PARKED = parked_in(LOT, [0, 1, 4, 6], (4.0, 1.8))


def watch(mover, pose, speed=0.0, seed=0, **of_state):
    """Boxes (STEPS, n, ...) and states of a mover, with a car at a pose."""
    motion = cars([pose], speed=speed, size=(4.0, 1.8))
    state = state_of(LOT, motion, 0, **({"parked_cars": PARKED} | of_state))

    @jax.jit
    def run(key):
        def step(own, key):
            after = mover.step(key, own, state, DT)
            return after, (mover.obstacles(after)[0], after)

        return jax.lax.scan(step, mover.init(key, LOT), jax.random.split(key, STEPS))[1]

    boxes, states = jax.device_get(run(jax.random.key(seed)))
    assert all(np.isfinite(x).all() for x in jax.tree.leaves((boxes, states)))
    return boxes, states


def gaps(boxes, pose):
    """Gaps (STEPS,) [m] of a mover's box to a car."""
    car = polygons(pose, (4.0, 1.8))
    return shapely.distance(polygons(boxes.pose_w[:, 0], boxes.size[:, 0]), car)


AWAY = (60.0, 60.0, 0.0)


def test_a_cart_is_pushed_and_rolls_until_it_stands():
    boxes, state = watch(Cart(pause=2.0), AWAY)
    speed = state.speed
    assert 0.3 < speed.max() <= 1.5
    assert (speed == 0.0).any()
    rolls = (speed[1:] > 0) & (speed[:-1] > speed[1:])
    np.testing.assert_allclose((speed[:-1] - speed[1:])[rolls], ROLLING * DT, atol=1e-5)
    moved = np.linalg.norm(np.diff(boxes.pose_w[:, 0, :2], axis=0), axis=1)
    assert moved.sum() > 5.0
    assert moved.max() <= 1.5 * DT
    bays = polygons(LOT.bay_pose, LOT.bay_size)[np.asarray(LOT.bay_mask)]
    assert not shapely.contains_xy(bays[:, None], *boxes.pose_w[:, 0, :2].T).any()


def test_a_car_on_a_rail_drives_to_and_fro_and_stops_for_others():
    boxes, state = watch(RailCar(), AWAY)
    assert {*np.sign(state.speed)} >= {-1.0, 1.0}
    assert np.abs(state.way).max() <= float(state.half[0]) + 1e-4
    assert boxes.mask.all()
    stands = tuple(np.asarray(state.middle[0]))
    boxes, state = watch(RailCar(), stands)  # a car in the middle of the rail
    assert gaps(boxes, np.array(stands))[state.speed != 0].min() > 0.5


def test_a_barrier_opens_for_who_comes_near_and_closes_behind():
    boxes, _ = watch(Barrier(), AWAY)
    width = boxes.size[0, 0, 1]
    np.testing.assert_allclose(boxes.size[:, 0, 1], width)
    near = np.asarray(boxes.pose_w[0, 0]) - [4.0, 0.0, 0.0]
    boxes, _ = watch(Barrier(), tuple(near))
    expected = width * np.clip(1 - DT / 2.0 * np.arange(1, STEPS + 1), 0.05, 1.0)
    np.testing.assert_allclose(boxes.size[:, 0, 1], expected, rtol=1e-4)
    assert boxes.mask[:9].all()
    assert not boxes.mask[10:].any()  # nothing of it is left in the lane


def test_a_barrier_opens_for_drivers_too():
    beam, _ = watch(Barrier(), AWAY)
    near = jnp.asarray(beam.pose_w[:1, 0]) - jnp.array([4.0, 0.0, 0.0])
    size, still = jnp.array([[4.0, 1.8]]), jnp.zeros((1, 2))
    for present in (True, False):
        there = jnp.array([present])
        driver = Boxes(near, size, still, there, kind=ObstacleKind.DRIVER)
        _, states = watch(Barrier(), AWAY, movers=Movers((), ((driver,),)))
        assert states.is_open[-1] == float(present)


def test_door_opens_only_where_there_is_room(monkeypatch):
    free = np.array([2, 5])  # bays with a wall instead of a car
    pose, size = LOT.bay_pose[free], jnp.array([[5.0, 2.6]] * 2)
    kind, mask = jnp.zeros(2, jnp.int32), jnp.ones(2, bool)
    lot = dataclasses.replace(
        LOT, wall_pose=pose, wall_size=size, wall_kind=kind, wall_mask=mask
    )
    walls = polygons(pose, size)
    monkeypatch.setattr(f"{__name__}.LOT", lot)
    boxes, state = watch(Door(pause=1.0), AWAY)
    there = boxes.mask[:, 0]
    assert 0.1 < there.mean() < 0.95
    assert state.angle.max() == pytest.approx(WIDEST, abs=1e-4)
    assert len(np.unique(state.car[there])) > 2
    door = polygons(boxes.pose_w[there, 0], np.full((there.sum(), 2), DOOR))
    for number, pose in enumerate(np.asarray(PARKED.pose_w)):
        others = state.car[there] != number
        assert not shapely.intersects(door[others], polygons(pose, (4.0, 1.8))).any()
    assert not shapely.intersects(door[:, None], walls).any()


@pytest.mark.parametrize("mover", [Cart(pause=1.0), RailCar(), Door(pause=1.0)])
def test_nothing_moves_to_where_a_car_cannot_stop(mover):
    boxes, _ = watch(mover, AWAY)
    mask = np.ones(STEPS, bool) if boxes.mask is None else boxes.mask[:, 0]
    mean = boxes.pose_w[mask, 0].mean(axis=0)
    pose = np.array([*mean[:2], float(LANE[2])])  # in the middle of where it goes
    boxes, _ = watch(mover, tuple(pose), speed=2.0)
    mask = np.ones(STEPS, bool) if boxes.mask is None else boxes.mask[:, 0]
    moved = np.abs(np.diff(boxes.pose_w[:, 0], axis=0)).max(axis=1) > 1e-4
    moved = moved & mask[1:] & mask[:-1]
    assert (gaps(boxes, pose)[1:][moved] > 0.0).all()


KINDS = make_movers(
    (
        "pedestrians:number=20,children=0.3",
        *("cart:pause=2", "rail_car", "barrier", "door:pause=2", "drivers:number=3"),
    )
)


def test_nothing_begins_or_moves_into_anything_else():
    lots = jax.jit(jax.vmap(STREET.generate))(jax.random.split(jax.random.key(3), 6))
    motion = cars([AWAY], size=(4.0, 1.8))

    def deepest(state):
        found = overlaps(state)
        names = "person in", "driver in", "mover in mover", "mover in person"
        chosen = [found[name] for name in found if name.startswith(names)]
        return jnp.stack([jnp.where(there, x, -1).max() for x, there in chosen]).max()

    @jax.jit
    @jax.vmap
    def run(layout, key):
        keys = jax.random.split(key, 201)
        bays = layout.bay_mask & (jnp.arange(layout.num_bays) % 2 == 0)
        parked = parked_at(layout.bay_pose, (4.0, 1.8), bays)
        others = lot_obstacles(layout, None, parked)
        movers = begin_movers(KINDS, layout, keys[0], others)
        movers = trace_still(movers, motion.trace_w.shape[-2])
        state = state_of(layout, motion, 0, parked_cars=parked, movers=movers)

        def step(state, key):
            state = state.replace(movers=step_movers(KINDS, state, DT, key))
            return state, (deepest(state), state.movers.groups[0].pose_w)

        deep, xy = jax.lax.scan(step, state, keys[1:])[1]
        return deepest(state), deep, xy

    first, deep, xy = jax.device_get(run(lots, jax.random.split(jax.random.key(4), 6)))
    assert first.max() < 1e-3
    assert deep.max() < 2e-3
    walked = np.linalg.norm(np.diff(xy, axis=1), axis=-1).sum(axis=1)
    assert np.median(walked) > 5.0  # m, for all that, in 40 s


def test_lots_without_lanes_have_no_barrier_and_no_car_on_a_rail():
    square = make_layout("square")
    movers: tuple[Any, ...] = (Barrier(), RailCar())
    for mover in movers:
        [boxes] = mover.obstacles(mover.init(jax.random.key(0), square))
        assert not boxes.mask.any()
    assert dataclasses.asdict(Cart())["mover"] == "cart"
