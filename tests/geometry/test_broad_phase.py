"""Broad phase: nothing near is missed, and nothing else is visited."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.compiling import both_phases
from helpers.scenes import random_lots
from helpers.states import state_of

from carpark_mj.geometry.obstacles import Boxes, Discs, touches, visit_near
from carpark_mj.mdp.collisions import find_hits

LOTS, AGENTS, PARKED, WALLS = 400, 12, 20, 8


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


def dense_lots(seed):
    """Crowded lots, and every second one wide, so that hits are rare there."""
    reach = np.where(np.arange(LOTS) % 2, 40.0, 8.0)
    return random_lots(LOTS, reach, seed, AGENTS, PARKED, WALLS, discs=4)


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


def find(layout, motion, parked):
    hits = find_hits(state_of(layout, motion, 0, parked_cars=parked))
    return jnp.stack([*hits.values()], axis=-1)


BOTH = both_phases(find)


def test_hits_are_those_of_testing_every_pair():
    all_hits, hits = (hits_of(*dense_lots(0)) for hits_of in BOTH)
    np.testing.assert_array_equal(hits, all_hits)
    for kind in range(3):  # both answers, in wide lots and in narrow ones
        assert 0.02 < all_hits[1::2, :, kind].mean() < 0.98
        assert 0.02 < all_hits[::2, :, kind].mean() < 0.99


def test_a_car_that_is_nowhere_hides_nobody():
    layout, motion, parked = dense_lots(1)
    lost = motion.replace(
        pose_w=motion.pose_w.at[:, 3].set(jnp.nan),
        trace_w=motion.trace_w.at[:, 3].set(jnp.nan),
    )
    all_hits, hits = (hits_of(layout, lost, parked) for hits_of in BOTH)
    np.testing.assert_array_equal(hits, all_hits)
    assert not hits[:, 3].any()
    assert hits[:, :3].mean() > 0.1
