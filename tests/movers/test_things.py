"""Things that move and recorded drives: where they go, and files that are none."""

import dataclasses
import itertools
import json
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from helpers.scenes import cars, polygons
from helpers.states import parked_at, parked_in, state_of

from carpark_mj.geometry.obstacles import Boxes, Discs, Movers, ObstacleKind
from carpark_mj.layouts import layout_config, make_layout
from carpark_mj.movers import Barrier, Cart, Door, Replay
from carpark_mj.movers.things import DOOR, ROLLING, WIDEST
from carpark_mj.obstacles import (
    begin_movers,
    lot_obstacles,
    make_movers,
    step_movers,
    trace_still,
)
from carpark_mj.vehicle.presets import COMPACT

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
    bare = Barrier().init(jax.random.key(0), make_layout("square"))  # without lanes
    assert not Barrier().obstacles(bare)[0].mask.any()


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


@pytest.mark.parametrize("mover", [Cart(pause=1.0), Door(pause=1.0)])
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
        *("cart:pause=2", "barrier", "door:pause=2", "drivers:number=3"),
    )
)


SLACK = np.full((1, 200, 1), 2e-3)  # m, of overlaps, by step
SLACK[:, 0] = 1e-3


def overlapping(one, other):
    """How many obstacles (lots, steps, n) overlap others by more than `SLACK`."""
    shapes, radii, reaches, centres, there = [], [], [], [], []
    for group, inset in ((one, SLACK), (other, 0 * SLACK)):
        pose, size = np.float64(group.pose_w), np.float64(group.size)
        if isinstance(group, Discs):
            shapes.append(shapely.points(pose))
            radii.append(size - inset)
            reaches.append(size)
        else:
            shapes.append(polygons(pose, size - 2 * inset[..., None]))
            radii.append(0 * size[..., 0])
            reaches.append(np.linalg.norm(size, axis=-1) / 2)
        centres.append(pose[..., 0] + 1j * pose[..., 1])
        there.append(True | (radii[-1] > 0) if group.mask is None else group.mask)

    def pairs(parts):
        return np.broadcast_arrays(parts[0][..., None], parts[1][..., None, :])

    near = np.abs(np.subtract(*pairs(centres))) < np.add(*pairs(reaches))
    near = near & np.logical_and(*pairs(there))
    if one is other:
        near = near & ~np.eye(near.shape[-1], dtype=bool)
    first, second = (shape[near] for shape in pairs(shapes))
    return (shapely.distance(first, second) <= np.add(*pairs(radii))[near]).sum()


def test_nothing_begins_or_moves_into_anything_else():
    lots = jax.jit(jax.vmap(STREET.generate))(jax.random.split(jax.random.key(3), 6))
    motion = cars([AWAY], size=(4.0, 1.8))

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
            after = state.replace(movers=step_movers(KINDS, state, DT, key))
            return after, state.movers.groups

        return jax.lax.scan(step, state, keys[1:])[1], others

    moving, others = jax.device_get(run(lots, jax.random.split(jax.random.key(4), 6)))
    others = [jax.tree.map(lambda x: x[:, None], group) for group in others]
    things = ObstacleKind.MOVER, ObstacleKind.PERSON
    for one, other in itertools.product(moving, (*moving, *others)):
        if one.kind != ObstacleKind.MOVER or other.kind in things:  # doors are in walls
            assert overlapping(one, other) == 0, (one.kind, other.kind)
    walked = np.linalg.norm(np.diff(moving[0].pose_w, axis=1), axis=-1).sum(axis=1)
    assert np.median(walked) > 5.0  # m, for all that, in 40 s


HEAD = "id,time,x,y,yaw,length,width\n"
GOOD = HEAD + "a,1,0,0,3.0,4,2\na,3,4,2,-3.0,4,2\nb,2,9,9,0,5,2\nb,7,9,19,1,5,2\n"


def write(folder, text, name="drives.csv"):
    path = folder / name
    path.write_text(text)
    return str(path)


def test_it_interpolates_and_cars_are_there_while_they_drove(tmp_path):
    mover = Replay(write(tmp_path, GOOD), offset=(0.0, 0.0))
    state = mover.init(jax.random.key(0), None)
    assert float(state) == 0.0  # the time of the first sample
    [boxes] = mover.obstacles(mover.step(None, state, None, 0.5))
    np.testing.assert_array_equal(boxes.mask, [True, False])
    np.testing.assert_allclose(boxes.pose_w[0, :2], [1.0, 0.5], atol=1e-6)
    turned = 3.0 + 0.25 * (2 * np.pi - 6.0)  # the short way
    assert float(boxes.pose_w[0, 2]) == pytest.approx(turned, abs=1e-5)
    np.testing.assert_allclose(boxes.velocity_w[0], [2.0, 1.0], atol=1e-4)
    [boxes] = mover.obstacles(jnp.float32(3.0))
    np.testing.assert_array_equal(boxes.mask, [False, True])
    np.testing.assert_allclose(boxes.pose_w[1, :2], [9.0, 13.0], atol=1e-5)
    np.testing.assert_allclose(boxes.size, [[4, 2], [5, 2]])
    again = mover.step(None, jnp.float32(7.9), None, 0.2)  # 6 s and a pause of 2 s
    assert float(again) == pytest.approx(0.1, abs=1e-5)


def test_offsets_are_drawn_from_the_whole_recording(tmp_path):
    mover = Replay(write(tmp_path, GOOD))
    keys = jax.random.split(jax.random.key(0), 300)
    start = np.asarray(jax.vmap(lambda key: mover.init(key, None))(keys))
    assert start.min() < 0.5
    assert 7.5 < start.max() < 8.0


def archive(folder, poses, ended=(), **header):
    config = {"sim": {"ctrl_dt": 0.2}, "vehicle": "compact"}
    steps, agents = poses.shape[:2]
    terminated = np.zeros((steps, agents), bool)
    for row in ended:
        terminated[row] = True
    np.savez(
        folder / "drive.npz",
        header=json.dumps({"config": config} | header),
        poses=poses.astype(np.float32),
        terminated=terminated,
        truncated=np.zeros_like(terminated),
    )
    return str(folder / "drive.npz")


def test_what_play_saves_moves_a_car_for_each_episode(tmp_path):
    poses = np.zeros((6, 1, 3))
    poses[:3, 0, 0], poses[3:, 0, 0] = [0, 1, 2], [50, 51, 52]
    mover = Replay(archive(tmp_path, poses, ended=[(2, 0)]), offset=(0, 0))
    [boxes] = mover.obstacles(jnp.float32(0.3))
    np.testing.assert_array_equal(boxes.mask, [True, False])
    assert float(boxes.pose_w[0, 0]) == pytest.approx(1.5)
    assert float(boxes.size[0, 0]) == pytest.approx(COMPACT.length)


def test_no_such_files(tmp_path):
    for name in ("drives.txt", "none.csv", "drives.npz"):
        if name != "none.csv":
            write(tmp_path, GOOD, name)
        with pytest.raises(ValueError, match=name):
            Replay(str(tmp_path / name))
    with pytest.raises(ValueError, match="'config' of dict"):
        Replay(archive(tmp_path, np.zeros((3, 1, 3)), config=1))
    with pytest.raises(ValueError, match="not finite"):
        Replay(archive(tmp_path, np.full((3, 1, 3), np.nan)))
    with pytest.raises(ValueError, match="needs a path"):
        Replay().init(jax.random.key(0), None)
