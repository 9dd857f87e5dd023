"""Reverse starts: free of everything, and the way back ends parked in the bay."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from helpers.rules import LIMITS
from helpers.scenes import cars, lot, polygons
from helpers.spawning import begun, many, placing_one
from helpers.states import parked_in

from carpark_mj.config import EnvConfig, SpawnConfig
from carpark_mj.layouts import layout_config, layout_maxima, pad_layout
from carpark_mj.mdp.parked_cars import fits, poses_in_bays
from carpark_mj.mdp.terminations import is_parked
from carpark_mj.spawning.fleet import shuffled_bays
from carpark_mj.spawning.goals import place_agent
from carpark_mj.spawning.placing import (
    SpawnInputs,
    place_waiting,
    start_placing,
    surroundings,
)
from carpark_mj.spawning.special_starts import (
    ARCS,
    LONGEST,
    MARGIN,
    NEAREST,
    ROOM,
    reverse_pose,
    reverse_shapes,
)
from carpark_mj.spawning.starts import draw_uniform
from carpark_mj.types import NO_BAY, ParkedCars
from carpark_mj.vehicle import COMPACT, PRESETS, make_vehicle

REVERSE = SpawnConfig(close_ratio=0.0, reverse_ratio=1.0)
FAMILIES = (
    "square",
    "square_compact",
    "street",
    "street_parallel",
    "angled",
    "lot",
    "garage_row",
    "dead_end",
)
LOTS, PARKED = 120, 20
STEP = 0.01  # m, of the oracle


def vehicles(names):
    """Cars of these presets (len(names),)."""
    kinds = sorted(set(names))
    each = jax.device_get([make_vehicle(PRESETS[name]) for name in kinds])
    number = [kinds.index(name) for name in names]
    return jax.tree.map(lambda *x: jnp.stack(x)[np.array(number)], *each)


@functools.cache
def maxima():
    key = jax.random.key(0)
    makers = (layout_config(f).generate for f in FAMILIES)
    return layout_maxima(jax.eval_shape(make, key) for make in makers)


@jax.jit
def reverse_starts(layouts, cars, keys):
    """Agent 0 in each lot, with agent 1 anywhere near its goal."""

    def one(layout, cars, key):
        bay_key, near_key, draw_key = jax.random.split(key, 3)
        order = shuffled_bays(layout, bay_key)
        goal = order[:2]
        bay = order[2 : 2 + PARKED]
        bay = jnp.where(layout.bay_mask[bay], bay, NO_BAY)
        size = jnp.broadcast_to(jnp.array([COMPACT.length, COMPACT.width]), (PARKED, 2))
        parked = ParkedCars(bay, jnp.zeros((PARKED, 3)), size)
        parked = parked.replace(pose_w=poses_in_bays(layout, parked))
        near = jax.random.uniform(near_key, (3,), minval=-6.0, maxval=6.0)
        pose = layout.bay_pose[goal[0]] + near
        inputs = SpawnInputs(layout, parked, cars=cars)
        waiting = jnp.array([True, False])
        placing = start_placing(goal, bay, jnp.stack([pose, pose]), waiting)
        draws = draw_uniform(reverse_shapes(), draw_key)
        around = surroundings(inputs, placing, jnp.array(0))
        start = reverse_pose(inputs, placing, around, jnp.array(0), draws)
        return start, draws, goal[0], pose, parked

    return jax.vmap(one)(layouts, cars, keys)


def drive(pose, distance, curvature, ahead):
    """Poses (..., k + 1, 3) of a footprint whose rear axle makes small steps (..., k).

    Each is straight, along the mean heading, unlike the closed form that is tested.
    """
    turn = distance * curvature
    yaw = pose[..., None, 2] + np.cumsum(np.insert(turn, 0, 0.0, axis=-1), axis=-1)
    course = yaw[..., :-1] + turn / 2
    rear = (pose[..., 0] + 1j * pose[..., 1]) - ahead * np.exp(1j * pose[..., 2])
    step = np.insert(distance * np.exp(1j * course), 0, 0.0, axis=-1)
    centre = (
        rear[..., None] + np.cumsum(step, axis=-1) + ahead[..., None] * np.exp(1j * yaw)
    )
    return np.stack([centre.real, centre.imag, yaw], axis=-1)


def small_steps(draws, wheelbase, max_steering):
    """What the numbers mean: signed steps and curvatures (n, ways, LONGEST / STEP)."""
    share = 1.0 - np.asarray(draws["share"], np.float64)
    ends = LONGEST * np.cumsum(share, axis=-1) / share.sum(axis=-1, keepdims=True)
    way = (np.arange(round(LONGEST / STEP)) + 0.5) * STEP
    arc = np.minimum((way >= ends[..., None]).sum(axis=-2), ARCS - 1)
    sharpest = np.tan(max_steering) / wheelbase
    curvature = (2.0 * np.asarray(draws["curvature"]) - 1.0) * sharpest[:, None, None]
    forwards = np.where(np.asarray(draws["direction"]) < 0.5, -STEP, STEP)
    return (np.take_along_axis(x, arc, axis=-1) for x in (forwards, curvature))


def retrace(start, draws, bay_pose, vehicle):
    """Ways back (n, k, 3) of starts (n, 3) to their bays, still where they end."""
    ahead, wheelbase, limit = (
        np.asarray(x, np.float64)[:, 0]
        for x in (vehicle.centre_offset, vehicle.wheelbase, vehicle.max_steering)
    )
    step, curvature = small_steps(draws, wheelbase, limit)
    first = np.repeat(np.asarray(bay_pose, np.float64)[:, None], step.shape[1], axis=1)
    first[..., 2] += np.where(np.asarray(draws["nose_out"]) < 0.5, np.pi, 0.0)
    out = drive(first, step, curvature, np.repeat(ahead[:, None], step.shape[1], 1))
    turned = np.exp(1j * out[..., 2]) - np.exp(1j * start[:, None, None, 2])
    off = np.linalg.norm(out[..., :2] - start[:, None, None, :2], axis=-1) + abs(turned)
    number = np.arange(len(start))
    way, at = np.divmod(off.reshape(len(start), -1).argmin(axis=1), off.shape[-1])
    # It is a point of one of the ways.
    assert off[number, way, at].max() < 0.02
    step, curvature = step[number, way], curvature[number, way]
    driven = np.arange(step.shape[1]) < at[:, None]
    back = np.where(driven, -step, 0.0)[:, ::-1]
    return drive(start, back, curvature[:, ::-1], ahead)


@pytest.mark.parametrize("name", FAMILIES)
def test_a_start_is_free_and_the_way_back_ends_parked_in_the_bay(name):
    config = layout_config(name)
    make = lambda key: pad_layout(config.generate(key), maxima())  # noqa: E731
    keys = jax.random.split(jax.random.key(0), LOTS)
    layouts = jax.jit(jax.vmap(make))(keys)
    presets = [sorted(PRESETS)[k % len(PRESETS)] for k in range(LOTS)]
    fleet = jax.tree.map(lambda x: jnp.repeat(x[:, None], 2, 1), vehicles(presets))
    (pose, found), draws, goal, other, parked = reverse_starts(
        layouts, fleet, jax.random.split(jax.random.key(1), LOTS)
    )
    number = np.arange(LOTS)
    bay_pose, bay_size = layouts.bay_pose[number, goal], layouts.bay_size[number, goal]
    size = fleet.size[:, 0]
    own = np.asarray(jax.vmap(fits)(bay_size[:, None], size))[:, 0]
    found = np.asarray(found) & own
    assert found.sum() > 0.4 * own.sum()  # agent 1 stands in the way of many

    start = np.asarray(pose, np.float64)
    room = shapely.distance(polygons(start, size), polygons(other, size))
    assert room[found].min() > ROOM - 1e-3
    away = np.linalg.norm(start[:, :2] - bay_pose[:, :2], axis=1)[found]
    assert NEAREST - 1e-3 < away.min() < 3.0
    assert 4.0 < away.max() < LONGEST

    back = retrace(start, draws, bay_pose, fleet)
    there = cars(back[:, -1], size=size)
    # Who is 5 m from a bay's end, where starts are, has arrived as MetaDrive has it.
    rules = [name for name, limits in LIMITS.items() if limits.from_end is None]
    parks = {rule: is_parked(rule, there, bay_pose, bay_size) for rule in rules}
    standing = cars(start, size=size)
    for rule, good in parks.items():
        assert np.asarray(good)[found].all(), rule
        begun = is_parked(rule, standing, bay_pose, bay_size)
        assert not np.asarray(begun)[found].any(), rule
    nose_in = np.cos(back[:, -1, 2] - bay_pose[:, 2])[found]
    np.testing.assert_allclose(np.abs(nose_in), 1.0, atol=1e-3)
    assert (nose_in > 0).any()
    assert (nose_in < 0).any()

    plans = jax.device_get(layouts)
    stands = jax.device_get(parked)
    for k in np.flatnonzero(found):
        plan = jax.tree.map(lambda x, k=k: x[k], plans)
        walls = polygons(plan.wall_pose[plan.wall_mask], plan.wall_size[plan.wall_mask])
        centres = shapely.points(plan.disc_centre[plan.disc_mask])
        discs = shapely.buffer(centres, plan.disc_radius[plan.disc_mask])
        parked_cars = polygons(stands.pose_w[k], stands.size[k])
        solid = shapely.union_all([*walls, *discs, *parked_cars])
        assert solid.distance(polygons(start[k], size[k])) > MARGIN - 1e-3
        assert not shapely.intersects(solid, polygons(back[k, ::10], size[k])).any()


FAR = lot([(20.0, 0.0, np.pi), (20.0, 40.0, 0.0)], spawn_size=(1.0, 1.0))


def test_the_share_of_reverse_starts_is_the_ratio():
    mixed = dataclasses.replace(REVERSE, close_ratio=0.1, reverse_ratio=0.4)
    x = begun(FAR, mixed)[:, 0]
    # Deviation 1.3 %: five of them. Others start within 1 m of the origin.
    assert (x > 5.0).mean() == pytest.approx(0.4, abs=0.064)
    assert (np.abs(x) <= 0.5).mean() == pytest.approx(0.6, abs=0.064)


def test_a_start_falls_back_to_random_where_no_way_leads_out():
    walls = [(20.0, 1.2, 0.0), (20.0, -1.2, 0.0), (17.2, 0.0, 1.57), (22.8, 0.0, 1.57)]
    closed = lot(FAR.bay_pose, walls, wall_size=(6.0, 0.2), spawn_size=(1.0, 1.0))
    assert np.abs(begun(closed, REVERSE)[:, 0]).max() <= 0.5
    agents = [(20.0 + 6.0 * x, 6.0 * y, 0.0) for x in (-1, 0, 1) for y in (-1, 0, 1)]
    agents = [(0.0, 40.0, 0.0), *agents]  # who leave no room
    assert np.abs(begun(FAR, REVERSE, agents)[:, 0]).max() <= 0.5


def test_parked_cars_count_where_they_stand_after_the_draw():
    """The new goal is bay 1, whose car makes way to bay 0, the old goal."""
    layout = lot([(10.0, 0.0, 0.0), (10.0, 3.0, 0.0)], spawn_size=(0.1, 0.1))
    parked, compact = parked_in(layout, [1]), vehicles(["compact"])
    inputs = SpawnInputs(layout, parked, cars=compact)
    config = EnvConfig(spawn=REVERSE)
    place = functools.partial(place_agent, config)
    placing = placing_one(inputs, 0, 45.0)
    after = many(lambda key: place_waiting(place, inputs, placing, key), 500, 4)
    assert (after.goal == 1).all()
    assert (after.parked_bay == 0).all()
    start = polygons(after.pose_w[:, 0], compact.size[0])
    reverse = np.abs(after.pose_w[:, 0, 0]) > 0.1
    assert reverse.mean() > 0.95
    moved = polygons(layout.bay_pose[0], (4.0, 2.0))
    left = polygons(layout.bay_pose[1], (4.0, 2.0))
    assert not shapely.intersects(start, moved).any()
    assert shapely.intersects(start, left)[reverse].mean() > 0.1
