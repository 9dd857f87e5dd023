"""Clearance against shapely; time to collision by hand, and by moving boxes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from helpers.scenes import cars, lot, polygons, random_lots
from helpers.states import parked_at, state_of

from carpark_mj.geometry import box_contact_time, box_disc_contact_time, rotate
from carpark_mj.geometry.obstacles import is_crowded
from carpark_mj.mdp import collisions as clearance
from carpark_mj.mdp.collisions import (
    HORIZON,
    RANGE,
    agent_clearance,
    clearances,
    collision_times,
    find_hits,
)
from carpark_mj.obstacles import lot_obstacles

LOTS, AGENTS = 300, 4


def gaps_of(layout, motion, parked):
    return clearances(motion, lot_obstacles(layout, motion, parked))


def oracle(scene):
    """The same by shapely, of every pair at every instant."""
    layout, motion, parked = scene
    own = polygons(motion.trace_w, np.asarray(motion.size)[:, :, None])

    def gaps(shapes, counts, radius=0.0):  # shapes (lots, n, instants or 1)
        found = shapely.distance(own[:, :, None], shapes[:, None]) - radius
        return np.where(counts, found.min(axis=-1), np.inf).min(axis=-1)

    def still(pose, size, mask):
        return gaps(polygons(pose, size)[..., None], np.asarray(mask)[:, None])

    points = shapely.points(np.asarray(layout.disc_centre, np.float64))[..., None]
    radius = np.asarray(layout.disc_radius)[:, None, :, None]
    discs = gaps(points, np.asarray(layout.disc_mask)[:, None], radius)
    walls = still(layout.wall_pose, layout.wall_size, layout.wall_mask)
    found = {
        "agent": gaps(own, ~np.eye(AGENTS, dtype=bool)),
        "parked_car": still(parked.pose_w, parked.size, parked.present),
        "wall": np.minimum(walls, discs),
    }
    return {name: np.clip(gap, 0.0, RANGE) for name, gap in found.items()}


def test_clearance_is_shapely_s_and_0_where_cars_are_hit():
    # Dense lots and wide ones.
    scene = random_lots(LOTS, np.where(np.arange(LOTS) % 2, 12.0, 60.0))

    def find(layout, motion, parked):
        hits = find_hits(state_of(layout, motion, 0, parked_cars=parked))
        return gaps_of(layout, motion, parked), hits

    got, hits = jax.jit(jax.vmap(find))(*scene)
    expected = oracle(scene)
    for name, gap in expected.items():
        # Coordinates up to 60 m resolve 4e-6 m in float32.
        np.testing.assert_allclose(got[name], gap, atol=5e-5, err_msg=name)
        assert 0.05 < (gap == 0).mean() < 0.6  # all three kinds of answers
        assert 0.05 < (gap == RANGE).mean() < 0.9
    assert hits.keys() == got.keys()
    for kind, hit in hits.items():
        np.testing.assert_array_equal(hit, got[kind] == 0.0)


def test_an_agent_alone_in_an_empty_lot_is_far_from_everything():
    plan, alone = lot([(0, 0, 0)]), cars([(0, 0, 0)])
    gap = jax.jit(gaps_of)(plan, alone, parked_at())
    assert {*gap} == {"agent", "parked_car", "wall"}
    assert all(value.tolist() == [RANGE] for value in gap.values())
    assert agent_clearance(alone).tolist() == [np.inf]


@pytest.mark.parametrize("count", [5, 30])  # of all pairs, and of the near ones
def test_the_clearance_of_agents_as_they_stand_is_shapely_s(count):
    rng = np.random.default_rng(count)
    pose = rng.uniform((-15, -15, -3.1), (15, 15, 3.1), (count, 3))
    size = rng.uniform(0.5, 5.0, (count, 2))
    own = polygons(pose, size)
    gap = shapely.distance(own[:, None], own)
    expected = np.where(np.eye(count, dtype=bool), np.inf, gap).min(axis=1)
    assert is_crowded(count, count) == (count == 30)
    got = agent_clearance(cars(pose, size=size))
    np.testing.assert_allclose(got, expected, atol=5e-5)  # m, float32 at 15 m
    assert (expected > 0).any()


def test_in_a_crowd_gradients_are_those_of_all_pairs(monkeypatch):
    rng = np.random.default_rng(0)
    pose = np.float32(rng.uniform((-30, -30, -3), (30, 30, 3), (24, 3)))
    assert is_crowded(24, 24)

    def slope():
        return jax.grad(lambda pose: agent_clearance(cars(pose)).sum())(pose)

    crowded = slope()
    monkeypatch.setattr(clearance, "is_crowded", lambda *_: False)
    np.testing.assert_allclose(crowded, slope(), atol=1e-6)
    assert np.abs(crowded).max() > 0.5


PAIRS = 400
TIMES = np.arange(0.0, HORIZON, 0.02)


@pytest.fixture(scope="module")
def pairs():
    """Boxes, others, velocities; some are at rest, some are aligned."""
    rng = np.random.default_rng(0)

    def boxes():
        pose = rng.uniform((-8, -8, -3.1), (8, 8, 3.1), (PAIRS, 3))
        return np.float32(pose), np.float32(rng.uniform(0.5, 5.0, (PAIRS, 2)))

    pose_a, size_a = boxes()
    pose_b, size_b = boxes()
    pose_a[::4, 2] = pose_b[::4, 2] = 0.0
    velocity = np.float32(rng.uniform(-3, 3, (PAIRS, 2)))
    velocity[::8, 1] = 0.0
    velocity[5::40] = 0.0
    return pose_a, size_a, pose_b, size_b, velocity


def check(found, gap_at, moving):
    """Asserts first contacts (pairs,) [s] by the gaps at any times (pairs, times)."""
    hit = np.isfinite(found)
    assert 0.2 < hit.mean() < 0.8
    assert 0.02 < (found == 0).mean() < 0.4
    assert not (hit & ~moving & (found > 0)).any()
    at_contact = gap_at(np.where(hit, found, 0.0)[:, None])[:, 0]
    assert at_contact[hit].max() < 1e-4  # m, float32 at 30 m
    before = np.where(hit, found, np.inf)[:, None] - 1e-3 > TIMES
    early = (gap_at(np.broadcast_to(TIMES, before.shape)) == 0) & before
    assert not early.any()


def moved_boxes(pose, size, velocity, times):
    """Polygons (pairs, times) of boxes that have moved straight."""
    pose = np.repeat(np.float64(pose)[:, None], times.shape[1], axis=1)
    pose[..., :2] += np.float64(velocity)[:, None] * times[..., None]
    return polygons(pose, np.float64(size)[:, None])


def test_contact_times_of_boxes_match_small_steps(pairs):
    pose_a, size_a, pose_b, size_b, velocity = pairs
    other = polygons(pose_b, size_b)[:, None]

    def gap_at(times):
        return shapely.distance(moved_boxes(pose_a, size_a, velocity, times), other)

    found = np.asarray(box_contact_time(*pairs), np.float64)
    check(found, gap_at, velocity.any(axis=1))


def test_contact_times_of_discs_match_small_steps(pairs):
    pose, size, where, sizes, velocity = pairs
    centre, radius = where[:, :2], sizes[:, 0] / 2
    point = shapely.points(np.float64(centre))[:, None]

    def gap_at(times):
        boxes = moved_boxes(pose, size, velocity, times)
        return np.maximum(shapely.distance(boxes, point) - radius[:, None], 0.0)

    found = box_disc_contact_time(pose, size, centre, radius, velocity)
    check(np.asarray(found, np.float64), gap_at, velocity.any(axis=1))


def test_search_among_many_finds_what_all_pairs_give():
    lots = random_lots(1, 25.0, seed=1, agents=12, parked=30, walls=30, discs=20)
    layout, motion, parked = jax.tree.map(lambda x: x[0], lots)
    velocity = np.random.default_rng(1).uniform(-3, 3, (12, 2))
    motion = motion.replace(velocity_b=jnp.asarray(velocity, jnp.float32))

    @jax.jit
    def times(layout, motion, parked):
        found = collision_times(motion, lot_obstacles(layout, motion, parked))
        velocity = rotate(motion.velocity_b, motion.pose_w[:, 2])[:, None]
        own = motion.pose_w[:, None], motion.size[:, None]
        relative = velocity - jnp.swapaxes(velocity, 0, 1)
        to_agents = box_contact_time(*own, motion.pose_w, motion.size, relative)
        to_parked = box_contact_time(*own, parked.pose_w, parked.size, velocity)
        to_walls = box_contact_time(*own, layout.wall_pose, layout.wall_size, velocity)
        disc = layout.disc_centre, layout.disc_radius
        to_discs = box_disc_contact_time(*own, *disc, velocity)
        mask = jnp.concatenate([layout.wall_mask, layout.disc_mask])
        solid = jnp.concatenate([to_walls, to_discs], axis=1)
        return found, {
            "agent": jnp.where(jnp.eye(12, dtype=bool), jnp.inf, to_agents),
            "parked_car": jnp.where(parked.present, to_parked, jnp.inf),
            "wall": jnp.where(mask, solid, jnp.inf),
        }

    found, expected = times(layout, motion, parked)
    for kind, time in expected.items():
        nearest = jnp.minimum(jnp.min(time, axis=1), HORIZON)
        np.testing.assert_allclose(found[kind], nearest, rtol=1e-5, err_msg=kind)
        assert (nearest < HORIZON).mean() > 0.1
