"""Broad phase: nothing near is missed, and nothing else is visited."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import cars, lot
from helpers.states import parked_at, state_of

from carpark_mj.geometry import obstacles as near
from carpark_mj.geometry.obstacles import Boxes, Discs, touches, visit_near
from carpark_mj.mdp.collisions import agent_clearance, find_hits
from carpark_mj.types import Motion

AGENTS, PARKED, WALLS, TRACES = 12, 20, 8, 4


def visited(bound, limit, chunk):
    """Which (agents, n) were visited how often, with fixed limits."""
    rows = jnp.arange(bound.shape[0])[:, None]

    def visit(count, index, valid):
        return count.at[rows, index].add(valid)

    nothing = jnp.zeros(bound.shape, jnp.int32)
    return visit_near(jnp.asarray(bound), lambda _: limit, visit, nothing, chunk)


@pytest.mark.parametrize("chunk", [1, 3, 40])
def test_each_pair_below_the_limit_is_visited_once_and_no_other(chunk):
    rng = np.random.default_rng(0)
    bound = rng.uniform(0, 1, (6, 17)).astype(np.float32)
    bound[0] = 0.25  # all alike
    bound[1, ::2] = np.nan
    bound[2] = np.inf
    limit = jnp.array([0.5, 0.5, jnp.inf, 0.0, 1.0, 0.3])
    expected = bound < np.asarray(limit)[:, None]
    assert 20 < expected.sum() < 70
    np.testing.assert_array_equal(visited(bound, limit, chunk), expected)
    assert visited(bound[:, :0], limit, chunk).shape == (6, 0)  # nothing to visit
    batch = jax.vmap(lambda bound: visited(bound, limit, chunk))
    both = [np.stack([x, x[:, ::-1]]) for x in (bound, expected)]
    np.testing.assert_array_equal(batch(both[0]), both[1])


def test_a_limit_that_shrinks_ends_the_search_at_the_nearest():
    bound = jnp.array([[5.0, 1.0, 3.0, 2.0]])
    seen = []

    def visit(best, index, valid):
        jax.debug.callback(lambda i: seen.append(int(i)), index[0, 0])
        return jnp.minimum(best, jnp.where(valid, bound[0, index[0]] + 1.5, 9.0).min())

    best = visit_near(bound, lambda b: b[None], visit, jnp.float32(9.0), 1)
    jax.effects_barrier()
    assert (float(best), seen) == (2.5, [1, 3])  # 3 is beyond what was found at 1


def dense_lots(rng, count):
    """Crowded lots with fast, spinning agents, long walls and cars on top of others."""

    def poses(*shape, reach=9.0):
        low, high = (-reach, -reach, -3.1), (reach, reach, 3.1)
        return np.float32(rng.uniform(low, high, (*shape, 3)))

    start, way = poses(count, AGENTS), poses(count, AGENTS, reach=2.0)
    share = np.linspace(-0.75, 0.0, TRACES)[:, None]
    trace = start[..., None, :] + way[..., None, :] * np.float32(share)
    vehicle = cars(
        trace[..., -1, :], size=rng.uniform(1.0, 5.0, (count, AGENTS, 2)), trace=trace
    )
    # Half of the lots are wide, so that hits are rare there.
    wide = np.where(np.arange(count) % 2, 6.0, 1.0).astype(np.float32)
    spread = jnp.stack([wide, wide, np.ones_like(wide)], axis=-1)
    vehicle = vehicle.replace(
        pose_w=vehicle.pose_w * spread[:, None],
        trace_w=vehicle.trace_w
        + (vehicle.pose_w * (spread[:, None] - 1.0))[..., None, :],
    )
    walls = poses(count, WALLS) * spread[:, None]
    wall_size = np.float32(rng.uniform((0.1, 0.1), (40.0, 0.5), (count, WALLS, 2)))
    wall_size[::2, :, 0] *= 0.1
    return (
        vehicle,
        poses(count, PARKED) * spread[:, None],
        np.float32(rng.uniform(1.0, 5.0, (count, PARKED, 2))),
        walls,
        wall_size,
        rng.uniform(size=(count, WALLS)) < 0.8,
    )


def test_touching_groups_is_touching_any_obstacle_that_is_there():
    rng = np.random.default_rng(7)

    def some(shape, count, masked):
        pose = np.float32(rng.uniform(-9.0, 9.0, (count, 3 if shape is Boxes else 2)))
        size = (count, 2) if shape is Boxes else (count,)
        there = jnp.asarray(rng.uniform(size=count) < 0.5) if masked else None
        radii = np.float32(rng.uniform(0.2, 2.0, size))
        return shape(jnp.asarray(pose), jnp.asarray(radii), mask=there)

    kinds = [(Boxes, 3, False), (Discs, 2, True), (Boxes, 4, True)]
    kinds += [(Boxes, 0, False), (Discs, 3, False)]
    groups = [some(*kind) for kind in kinds]
    pose = jnp.asarray(np.float32(rng.uniform(-9.0, 9.0, (200, 3))))
    size = jnp.array([3.0, 1.5])
    each = [
        np.asarray(group.overlap(pose[:, None], size[None, None]))
        & (True if group.mask is None else np.asarray(group.mask))
        for group in groups
    ]
    wanted = np.concatenate(each, axis=1).any(axis=1)
    assert wanted.any()
    assert not wanted.all()
    np.testing.assert_array_equal(touches(pose, size, groups), wanted)


@functools.cache
def compiled(crowded):
    """Hits and clearances of a batch, by the broad phase or by testing every pair."""
    template = lot(np.zeros((PARKED, 3)), np.zeros((WALLS, 3)))

    @jax.jit
    @jax.vmap
    def run(motion: Motion, parked, parked_size, walls, wall_size, mask):
        layout = template.replace(
            bay_pose=parked, wall_pose=walls, wall_size=wall_size, wall_mask=mask
        )
        there = parked_at(parked, parked_size)
        hits = find_hits(state_of(layout, motion, 0, parked_cars=there))
        return jnp.stack([*hits.values()], axis=-1), agent_clearance(motion)

    def call(*scene):
        before = near.MANY_PAIRS
        near.MANY_PAIRS = 0 if crowded else 10**9
        try:
            return jax.tree.map(np.asarray, run(*scene))
        finally:
            near.MANY_PAIRS = before

    return call


def test_hits_and_clearances_are_those_of_testing_every_pair():
    scene = dense_lots(np.random.default_rng(0), 400)
    hits, gap = compiled(True)(*scene)
    all_hits, all_gap = compiled(False)(*scene)
    np.testing.assert_array_equal(hits, all_hits)
    np.testing.assert_allclose(gap, all_gap, atol=1e-5)  # fused otherwise
    for kind in range(3):  # both answers, in wide lots and in narrow ones
        assert 0.02 < all_hits[1::2, :, kind].mean() < 0.98
        assert 0.02 < all_hits[::2, :, kind].mean() < 0.99
    assert (all_gap > 0.5).mean() > 0.1


def test_a_car_that_is_nowhere_hides_nobody():
    scene = dense_lots(np.random.default_rng(1), 400)
    lost = scene[0].replace(
        pose_w=scene[0].pose_w.at[:, 3].set(jnp.nan),
        trace_w=scene[0].trace_w.at[:, 3].set(jnp.nan),
    )
    hits, _ = compiled(True)(lost, *scene[1:])
    all_hits, _ = compiled(False)(lost, *scene[1:])
    np.testing.assert_array_equal(hits, all_hits)
    assert not hits[:, 3].any()
    assert hits[:, :3].mean() > 0.1
