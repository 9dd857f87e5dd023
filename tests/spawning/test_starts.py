"""Starts at random or close to a goal: their random numbers, poses and redraws."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from helpers.scenes import lot, polygons
from helpers.spawning import surroundings_of, walled

from carpark_mj.config import WORLD_UNIT, SpawnConfig
from carpark_mj.layouts import Maxima, make_layout, pad_layout
from carpark_mj.spawning.goals import place_shapes
from carpark_mj.spawning.starts import (
    draw_kind,
    draw_uniform,
    pick_weighted,
    redraw,
    spawn_pose,
    spawn_shapes,
)

RANDOM = SpawnConfig(close_ratio=0.0)
CLOSE = SpawnConfig(close_ratio=1.0)
NOBODY = jnp.zeros((1, 2)), jnp.zeros(1, bool)
COUNT = 4000


@functools.partial(jax.jit, static_argnums=0)
def draw_all(config, layout, goal, around, keys):
    def one(key):
        draws = draw_uniform(spawn_shapes(config), key)
        return spawn_pose(config, layout, around, goal, draws)

    return jax.vmap(one)(keys)


def draw(config, layout, goal=(0.0, 0.0, 0.0), others=NOBODY, count=COUNT, size=None):
    """Many spawn poses as numpy."""
    keys = jax.random.split(jax.random.key(0), count)
    goal, around = jnp.array(goal, jnp.float32), surroundings_of(layout, *others, size)
    return np.asarray(draw_all(config, layout, goal, around, keys), np.float64)


def people(*xy):
    return jnp.array(xy, jnp.float32), jnp.ones(len(xy), bool)


def two_regions():
    """A turned square of 8 m at (-10, 0), and 2 m by 8 m at (10, 0); one padding."""
    layout = lot([(0.0, 20.0, 0.0)])
    layout = layout.replace(
        spawn_pose=jnp.array([[-10.0, 0.0, 0.7], [10.0, 0.0, 0.0]]),
        spawn_size=jnp.array([[8.0, 8.0], [2.0, 8.0]]),
        spawn_spread=jnp.full(2, jnp.pi),
        spawn_mask=jnp.ones(2, bool),
    )
    return pad_layout(layout, Maxima(1, 0, 0, 0, 3))


def test_random_spawns_are_uniform_over_the_region():
    layout = make_layout("square")
    side, pose = 42 * 0.5625, draw(RANDOM, layout)
    assert np.abs(pose[:, :2]).max() <= side / 2
    cell = np.floor((pose[:, :2] / side + 0.5) * 4).astype(int)
    count = np.bincount(cell[:, 0] * 4 + cell[:, 1], minlength=16)
    chi_square = ((count - COUNT / 16) ** 2 / (COUNT / 16)).sum()
    assert chi_square < 37.7  # the 0.1 % quantile at 15 degrees of freedom


def test_regions_are_drawn_in_proportion_to_their_area():
    layout = two_regions()
    pose = draw(RANDOM, layout)
    point = shapely.points(pose[:, :2])
    regions = polygons(layout.spawn_pose[:2], layout.spawn_size[:2])
    # 1e-5 m of float32 rounding at the edge.
    inside = shapely.distance(regions[:, None], point) < 1e-5
    assert inside.any(axis=0).all()
    # Areas 64 and 16: 80 %. Deviation 0.6 %, five of them.
    assert inside[0].mean() == pytest.approx(0.8, abs=0.032)


def test_random_spawns_keep_their_distance_if_there_is_room():
    # They take a third of the region: all 16 candidates fail once in 1e8 draws.
    xy, mask = people((-9.0, -9.0), (9.0, 9.0), (0.0, 0.0))
    pose = draw(RANDOM, make_layout("square"), others=(xy, mask.at[2].set(False)))
    gap = np.linalg.norm(pose[:, None, :2] - np.asarray(xy), axis=2)
    assert gap[:, :2].min() > RANDOM.min_distance
    # Not from who is masked: 2 m about the middle of 558 m^2, a third of them taken.
    assert (gap[:, 2] < 2.0).mean() > np.pi * 2.0**2 / 558.0


@pytest.mark.parametrize(
    ("make", "goal", "region"),
    [
        (lambda: make_layout("square"), (0.0, 18.0, 0.0), 0),
        (lambda: make_layout("square"), (18.0, -13.5, 0.0), 0),
        (lambda: make_layout("square"), (3.0, 2.0, 0.0), 0),  # in the region
        (two_regions, (-9.0, 20.0, 0.0), 0),
        (two_regions, (8.0, 20.0, 0.0), 1),
    ],
)
def test_close_spawns_are_near_in_the_region_nearest_the_goal(make, goal, region):
    layout = make()
    pose = draw(CLOSE, layout, goal=goal)
    area = polygons(layout.spawn_pose[region], layout.spawn_size[region])
    assert shapely.distance(area, shapely.points(pose[:, :2])).max() < 1e-5  # float32
    nearest = shapely.shortest_line(area, shapely.Point(goal[:2])).coords[0]
    gap = np.linalg.norm(pose[:, :2] - nearest, axis=1)
    assert gap.max() <= CLOSE.close_distance + 1e-4  # float32
    # A walk can be long and it can be short.
    assert gap.max() > 0.9 * CLOSE.close_distance
    assert gap.min() < 0.1 * CLOSE.close_distance


def test_starts_are_of_one_kind_at_most_in_their_ratios():
    config = SpawnConfig(
        close_ratio=0.2, conflict_ratio=0.4, reverse_ratio=0.25, misaligned_ratio=0.1
    )
    numbers = jax.random.uniform(jax.random.key(2), (COUNT,))
    close, crash, reverse, misaligned = kinds = draw_kind(config, numbers)
    assert sum(kind.astype(int) for kind in kinds).max() == 1
    # Deviations 0.6 %, 0.8 %, 0.7 % and 0.5 %: five of them.
    assert close.mean() == pytest.approx(0.2, abs=0.032)
    assert crash.mean() == pytest.approx(0.4, abs=0.04)
    assert reverse.mean() == pytest.approx(0.25, abs=0.035)
    assert misaligned.mean() == pytest.approx(0.1, abs=0.025)


@pytest.mark.parametrize("config", [RANDOM, CLOSE])
def test_starts_touch_nothing_where_there_is_room(config):
    # A wall fills the left half: of a car of 4 m by 2 m no corner is there.
    layout = walled(make_layout("square"), (-10.0, 0.0, 0.0), (20.0, 60.0))

    def share_touching(size):
        pose = draw(config, layout, goal=(4.0, 18.0, 0.0), size=size)
        cos, sin = np.abs(np.cos(pose[:, 2])), np.abs(np.sin(pose[:, 2]))
        return (pose[:, 0] - 2.0 * cos - sin < -1e-5).mean()

    # All 16 candidates touch it once in a thousand draws.
    assert share_touching((4.0, 2.0)) < 4e-3
    # A car that fits wherever it can spawn is not measured.
    assert share_touching(None) > 0.1


@pytest.mark.parametrize("config", [RANDOM, CLOSE])
def test_headings_are_within_the_spread_of_regions(config):
    layout = two_regions().replace(
        spawn_pose=jnp.array([[-10.0, 0.0, 3.1], [10.0, 0.0, -1.0], [0.0, 0.0, 0.0]]),
        spawn_spread=jnp.array([0.2, 0.05, 0.0]),
    )
    for goal, region in (((-10.0, 9.0, 0.0), 0), ((10.0, 9.0, 0.0), 1)):
        pose = draw(config, layout, goal=goal)
        here = (pose[:, 0] < 0) == (region == 0)
        stray = np.angle(np.exp(1j * (pose[here, 2] - (3.1, -1.0)[region])))
        spread = (0.2, 0.05)[region]
        # Uniform: the extremes are met, and the deviation is that of a uniform one.
        assert spread * 0.98 < np.abs(stray).max() <= spread + 1e-6
        assert stray.std() == pytest.approx(spread / np.sqrt(3), rel=0.05)
        assert (np.abs(pose[:, 2]) <= np.pi + 1e-6).all()


SPACED_CLOSE = SpawnConfig(close_ratio=1.0, spacing=WORLD_UNIT / 16)
FAR = (0.0, 60.0, 0.0)  # a goal far above: walks begin in the middle of the upper edge


def test_close_spawn_on_a_grid_is_a_walk_of_unit_steps():
    side = 21 * WORLD_UNIT
    pose = draw(SPACED_CLOSE, make_layout("square"), goal=FAR)[:, :2]
    steps = (pose - [0.0, side]) / WORLD_UNIT
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-3)
    assert pose[:, 1].max() <= side + 1e-5
    # Ten units at most give walks of up to nine steps; some never leave.
    assert np.abs(np.round(steps)).sum(axis=1).max() <= 9
    assert (np.abs(steps) < 0.5).all(axis=1).any()


KEYS = jax.random.split(jax.random.key(0), 4000)
LARGEST = np.float32(1 - 2**-23)  # of `jax.random.uniform`


def test_drawn_numbers_are_uniform_and_independent():
    shapes = place_shapes(SpawnConfig(conflict_ratio=0.5), num_agents=2, num_bays=3)
    draws = jax.vmap(lambda key: draw_uniform(shapes, key))(KEYS)
    assert {name: x.shape[1:] for name, x in draws.items()} == shapes
    parts = [np.reshape(x, (len(KEYS), -1)) for x in draws.values()]
    numbers = np.concatenate(parts, axis=1)
    assert 0.0 <= numbers.min() < numbers.max() < 1.0
    # Deviations 0.0046 and 0.0034 of each of 400 columns: five and a half of them.
    np.testing.assert_allclose(numbers.mean(axis=0), 0.5, atol=0.025)
    np.testing.assert_allclose(numbers.std(axis=0), 12**-0.5, atol=0.019)
    # No two columns share anything: a deviation of 0.016, six and a half of them.
    alike = np.corrcoef(numbers, rowvar=False) - np.eye(numbers.shape[1])
    assert np.abs(alike).max() < 0.1


def test_no_number_picks_what_has_no_weight():
    rng = np.random.default_rng(0)
    ends = jnp.array([0.0, LARGEST])
    for weights in rng.uniform(0.0, 300.0, (200, 7)).astype(np.float32):
        weights[[0, 3, 6]] = 0.0
        assert set(np.asarray(pick_weighted(jnp.asarray(weights), ends))) == {1, 5}


# One candidate a round, and others in three corners of the square of 23.6 m.
ONE = SpawnConfig(close_ratio=0.0, num_candidates=1, min_distance=16.0)
CORNERS = [(-11.0, -11.0), (11.0, -11.0), (-11.0, 11.0)]
LAYOUT = make_layout("square")


@functools.partial(jax.jit, static_argnums=0)
def draw_again(config, layout, around, keys):
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
        draw_again(config, layout, around, jax.random.split(jax.random.key(0), count))
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


def test_grid_has_one_walk_else_one_per_candidate():
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
