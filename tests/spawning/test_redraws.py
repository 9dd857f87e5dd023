"""Starts as in the study: drawn until they keep their distance, close by one walk."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import lot
from helpers.spawning import surroundings_of

from carpark_mj.config import WORLD_UNIT, SpawnConfig
from carpark_mj.layouts import make_layout
from carpark_mj.spawning.starts import draw_uniform, redraw, spawn_pose, spawn_shapes

# One candidate a round, and others in three corners of the square of 23.6 m.
ONE = SpawnConfig(close_ratio=0.0, num_candidates=1, min_distance=16.0)
CORNERS = [(-11.0, -11.0), (11.0, -11.0), (-11.0, 11.0)]
LAYOUT = make_layout("square")


@functools.partial(jax.jit, static_argnums=0)
def draw(config, layout, around, keys):
    def one(key):
        first, again = jax.random.split(key)
        draws = draw_uniform(spawn_shapes(config), first)
        goal_pose = jnp.array([0.0, 18.0, 0.0])
        pose = spawn_pose(config, layout, around, goal_pose, draws)
        return redraw(config, layout, around, pose, again)

    return jax.vmap(one)(keys)


def starts(config, others, layout=LAYOUT, count=2000):
    """Start poses, and their distances to the nearest of the others."""
    around = surroundings_of(layout, others, True)
    pose = np.asarray(
        draw(config, layout, around, jax.random.split(jax.random.key(0), count))
    )
    gap = np.linalg.norm(pose[:, None, :2] - np.array(others), axis=2).min(axis=1)
    return pose, gap


def test_a_start_is_drawn_again_until_it_keeps_its_distance():
    _, once = starts(ONE, CORNERS)
    share = (once > ONE.min_distance).mean()
    assert 0.05 < share < 0.2  # of the region
    pose, gap = starts(dataclasses.replace(ONE, max_redraws=1000), CORNERS)
    assert gap.min() > ONE.min_distance
    # The first draw stays where it was good, and the others are uniform there: their
    # mean is that of many draws that were.
    np.testing.assert_array_equal(gap[once > 16.0], once[once > 16.0])
    many, gaps = starts(ONE, CORNERS, count=40_000)
    expected = many[gaps > ONE.min_distance, :2]
    # Deviations 2.5 m over sqrt(2000) and over sqrt(4000): five of them.
    np.testing.assert_allclose(pose[:, :2].mean(0), expected.mean(0), atol=0.5)


def test_redraws_end_where_there_is_no_room():
    small = lot([(0.0, 20.0, 0.0)], spawn_size=(4.0, 4.0))
    _, gap = starts(dataclasses.replace(ONE, max_redraws=5), [(0.0, 0.0)], small, 20)
    assert gap.max() < ONE.min_distance


def test_a_close_start_has_one_walk_on_a_grid_and_a_walk_per_candidate_elsewhere():
    # The other stands where walks begin: many end too near to it, and then a start on a
    # grid is random.
    beside, wide = (0.0, 11.8), SpawnConfig(close_ratio=1.0, min_distance=1.0)
    grid = dataclasses.replace(wide, spacing=WORLD_UNIT)

    def share_close(config):
        _, gap = starts(config, [beside])
        return (gap <= 5.7).mean()

    assert share_close(wide) > 0.99
    _, gap = starts(dataclasses.replace(grid, min_distance=0.0), [beside])
    kept = (gap > 1.0).mean()
    assert 0.1 < kept < 0.7
    # Of the random ones those between 1 m and 5.7 m about it: half a ring of 558 m^2.
    by_chance = np.pi / 2 * (5.7**2 - 1.0**2) / 558.0
    # Deviation 1.1 %: five of them.
    expected = kept + (1 - kept) * by_chance
    assert share_close(grid) == pytest.approx(expected, abs=0.056)
