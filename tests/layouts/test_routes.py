"""Ways along the lanes: against a search on a grid, and downhill."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from helpers.lanes import EAST, PLAN, with_lanes
from helpers.scenes import polygons
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from carpark_mj.layouts import build, layout_config, make_layout
from carpark_mj.layouts.routes import lane_distance, make_routes, route_to

STEP = 0.25  # m
TURNS = np.arange(16) * np.pi / 8
COMPASS = np.stack([np.cos(TURNS), np.sin(TURNS)], axis=-1)


@pytest.fixture(scope="module", params=["lot", "angled", "street", "dead_end"])
def lot(request):
    make = jax.jit(layout_config(request.param).generate)
    layout = make(jax.random.key(7))
    return layout, jax.jit(make_routes)(layout)


way, lane_gaps = jax.jit(route_to), jax.jit(lane_distance)


def test_downhill_from_anywhere_in_the_lanes_leads_into_the_bay(lot):
    """No local minimum: of small steps in 16 directions the best one is shorter."""
    layout, routes = lot
    rng = np.random.default_rng(0)
    points = rng.uniform(-1, 1, (2560, 2)) * np.asarray(layout.extent)
    inside = lane_distance(layout, jnp.float32(points)).min(axis=1) == 0.0
    xy = jnp.float32(points[np.asarray(inside)][:64])
    bay = jnp.asarray(np.resize(np.flatnonzero(layout.bay_mask), len(xy)), jnp.int32)

    @jax.jit
    def descend(xy):
        def step(xy, _):
            tried = xy[:, None] + STEP * jnp.float32(COMPASS)
            ways = jax.vmap(lambda xy: route_to(routes, layout, xy, bay), 1, 1)(tried)
            best = jnp.argmin(ways.length, axis=1)
            moved = jnp.take_along_axis(tried, best[:, None, None], axis=1)[:, 0]
            return moved, ways.length.min(axis=1)

        return jax.lax.scan(step, xy, length=800)

    start = way(routes, layout, xy, bay).length
    end, length = descend(xy)
    gap = jnp.linalg.norm(end - layout.bay_pose[bay, :2], axis=-1)
    assert (gap < 2 * STEP).all()
    steps = (np.asarray(length) > 2 * STEP).sum(axis=0) * STEP
    np.testing.assert_array_less(steps, 1.15 * np.asarray(start) + 3.0)


def _cells(layout, size=1.0):
    """Centres of square cells that lie in a lane, as a graph of 16 neighbours."""
    half = np.asarray(layout.extent)
    axes = [np.arange(-h + size / 2, h, size) for h in half]
    xy = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    gap = np.asarray(lane_distance(layout, jnp.float32(xy)).min(axis=1))
    xy = xy[gap < 0.3]
    pairs = cKDTree(xy).query_pairs(2.3 * size, output_type="ndarray")
    length = np.linalg.norm(xy[pairs[:, 0]] - xy[pairs[:, 1]], axis=1)
    graph = coo_matrix((length, pairs.T), shape=(len(xy), len(xy)))
    return xy, graph


@pytest.mark.parametrize("family", ["lot", "angled"])
def test_ways_are_as_long_as_a_search_on_a_grid_finds_them(family):
    """Dijkstra on cells within the lanes; ways turn on centre lines, cells need not."""
    layout = jax.jit(layout_config(family).generate)(jax.random.key(3))
    routes = jax.jit(make_routes)(layout)
    xy, graph = _cells(layout)
    rng = np.random.default_rng(0)
    for bay in rng.choice(np.flatnonzero(layout.bay_mask), 6, replace=False):
        x, y, yaw = np.asarray(layout.bay_pose[bay])
        out = float(layout.bay_size[bay, 0]) / 2 + 1.0
        mouth = x + out * np.cos(yaw), y + out * np.sin(yaw)
        start = int(np.linalg.norm(xy - np.array(mouth), axis=1).argmin())
        found = dijkstra(graph, directed=False, indices=start) + out
        left = way(routes, layout, jnp.float32(xy), jnp.full(len(xy), bay))
        # The straight end is shorter than one by the mouth; two turns on centre lines
        # of 3 m lanes are longer than two around the inner corners.
        more = np.asarray(left.length) - found
        assert np.isfinite(found).all()
        assert more.min() > -6.0
        assert more.max() < 8.0
        assert abs(np.median(more)) < out


def test_a_lot_without_lanes_is_open_ground():
    layout = make_layout(layout_config("square"))
    routes = make_routes(layout)
    xy = jnp.float32(np.random.default_rng(0).uniform(-15, 15, (36, 2)))
    left = way(routes, layout, xy, jnp.arange(36))
    straight = np.linalg.norm(xy - layout.bay_pose[:, :2], axis=1)
    np.testing.assert_allclose(left.length, straight, rtol=1e-6)
    np.testing.assert_array_equal(left.next_xy, layout.bay_pose[:, :2])


def test_around_the_block_by_hand():
    """An H of two aisles and a lane between their ends; the bay faces the far aisle."""
    east = build.lanes(
        [(0.0, 0.0, 0.0), (0.0, 20.0, 0.0), (12.0, 10.0, np.pi / 2)],
        [(20.0, 4.0), (20.0, 4.0), (24.0, 4.0)],
    )
    bay = build.bays([(-5.0, 15.5, np.pi / 2)], (5.0, 2.5))
    layout = build.assemble((20.0, 30.0), east, bay)
    routes = make_routes(layout)
    left = way(routes, layout, jnp.float32([(-5.0, 0.0)]), jnp.zeros(1, int))
    # 17 m east, 20 m north, then straight to the bay at (-17, -4.5).
    assert float(left.length[0]) == pytest.approx(17 + 20 + np.hypot(17, 4.5), 1e-5)
    np.testing.assert_allclose(left.next_xy[0], (12.0, 0.0), atol=1e-5)
    inside = way(routes, layout, jnp.float32([(-5.0, 15.0)]), jnp.zeros(1, int))
    assert float(inside.length[0]) == pytest.approx(0.5, 1e-5)


def test_crossings_are_on_both_centre_lines(lot):
    layout, routes = lot
    turns, crossing = np.asarray(routes.turns), np.asarray(routes.crossing)
    np.testing.assert_array_equal(turns, turns.T)
    np.testing.assert_allclose(crossing, crossing.swapaxes(0, 1), atol=1e-4)
    first, second = np.nonzero(turns)
    for lane in (first, second):
        pose = np.asarray(layout.lane_pose)[lane]
        delta = crossing[first, second] - pose[:, :2]
        aside = delta[:, 1] * np.cos(pose[:, 2]) - delta[:, 0] * np.sin(pose[:, 2])
        np.testing.assert_allclose(aside, 0.0, atol=1e-4)


def test_an_aisle_has_a_lane_each_way_on_the_right():
    pose, size = build.two_lanes([1.0, 2.0, np.pi / 2], [10.0, 6.0])
    there, back = [2.5, 2.0, np.pi / 2], [-0.5, 2.0, 1.5 * np.pi]
    np.testing.assert_allclose(pose, [there, back], atol=1e-6)
    np.testing.assert_allclose(size, [[10.0, 3.0]] * 2)


def test_padding_is_no_lane():
    padded = with_lanes(
        build.lanes([(0.0, 0.0, EAST)] * 2, (4.0, 4.0)), mask=[True, False]
    )
    [gaps] = lane_gaps(padded, jnp.array([(0.0, 0.0, 1.0)]))
    assert gaps.tolist() == [0.0, np.inf]


def test_distances_to_lanes_are_shapely_s():
    rng = np.random.default_rng(0)
    pose = np.float32(rng.uniform((-30, -20, -3.1), (30, 20, 3.1), (2000, 3)))
    gap = shapely.distance(
        polygons(PLAN.lane_pose, PLAN.lane_size), shapely.points(pose[:, None, :2])
    )
    assert ((gap == 0.0).sum(axis=1) > 1).sum() > 5  # on crossings
    found = lane_gaps(PLAN, jnp.asarray(pose))
    np.testing.assert_allclose(found, gap, atol=1e-5)  # float32 at 30 m
