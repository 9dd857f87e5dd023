"""Ways along the lanes, and the narrowest aisles for a car."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from helpers.lanes import BLOCK, EAST, PLAN, with_lanes
from helpers.scenes import polygons
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from carpark_mj.layouts import build, layout_config, make_layout
from carpark_mj.layouts.routes import lane_distance, make_routes, route_to
from carpark_mj.layouts.standards import (
    AISLE_ANGLES,
    AISLE_WIDTHS,
    FOOT,
    DesignCar,
    least_aisle,
    least_parallel_aisle,
    one_way_aisle,
)
from carpark_mj.layouts.types import BayKind

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
    routes = make_routes(BLOCK)
    left = way(routes, BLOCK, jnp.float32([(-5.0, 0.0)]), jnp.zeros(1, int))
    # 17 m east, 20 m north, then straight to the bay at (-17, -4.5).
    assert float(left.length[0]) == pytest.approx(17 + 20 + np.hypot(17, 4.5), 1e-5)
    np.testing.assert_allclose(left.next_xy[0], (12.0, 0.0), atol=1e-5)
    inside = way(routes, BLOCK, jnp.float32([(-5.0, 15.0)]), jnp.zeros(1, int))
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


# The narrowest aisles, against a car that is swept along its arc with shapely


CAR = DesignCar()
STEPS = 200


def swept(car, angle, end, reverse):
    """The car's way along one arc into a bay whose axis leaves the aisle at the origin.

    The bay's axis points into the bay at `angle` from +x, and the arc ends with the
    rear axle at `end` along it. Forwards the car comes along +x and turns left; in
    reverse it turns the other way round, backs in and ends heading out.
    """
    radius = car.turning_radius
    theta = math.radians(angle)
    axis = np.array([math.cos(theta), math.sin(theta)])
    normal = np.array([-axis[1], axis[0]])
    centre = end * axis + radius * normal  # of the turning circle
    back = np.linspace(0.0, theta, STEPS)  # how far the car is from being aligned
    heading = theta - back
    rear = centre + radius * np.stack([np.sin(heading), -np.cos(heading)], axis=1)
    ahead = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    offset = car.length / 2 - car.rear_overhang
    # Backing in, the same circle is driven with the nose where the tail was.
    middle = rear + (-offset if reverse else offset) * ahead
    pose = np.concatenate([middle, heading[:, None]], axis=1)
    return shapely.union_all(polygons(pose, np.full((STEPS, 2), car.size)))


def neighbours(car, angle, width, walled):
    """What stands beside the bay: cars in the neighbouring bays, or walls."""
    theta = math.radians(angle)
    cot = 1 / math.tan(theta)
    axis = np.array([math.cos(theta), math.sin(theta)])
    normal = np.array([-axis[1], axis[0]])
    if walled:
        wall = shapely.box(width / 2, 0.0, width / 2 + 0.2, 6.0)
        return wall.union(shapely.affinity.translate(wall, -width - 0.2))
    mouth = width / 2 * cot  # along the bay's axis; its outer corner is at the aisle
    pose = []
    for side in (1.0, -1.0):
        along = mouth - side * width * cot + car.length / 2
        place = along * axis + side * width * normal
        pose.append((*place, theta))
    return shapely.union_all(polygons(pose, [car.size] * 2))


def best_single_arc(car, angle, width, walled, reverse):
    """Searches all ends of the arc for the one that needs the narrowest aisle."""
    obstacles = neighbours(car, angle, width, walled)
    needed = math.inf
    for end in np.arange(-3.0, 2.2, 0.02):
        way = swept(car, angle, end, reverse)
        if way.intersection(obstacles).area < 1e-6:
            needed = min(needed, -way.bounds[1])
    return needed


CASES = [
    (90.0, 2.4, False, True),
    (90.0, 2.5, False, True),
    (90.0, CAR.width + 0.4, True, True),
    (60.0, 2.5, False, False),
    (45.0, 2.4, False, False),
    (75.0, 2.7, False, False),
]


@pytest.mark.parametrize(("angle", "width", "walled", "reverse"), CASES)
def test_least_aisle_is_what_the_best_single_arc_sweeps(angle, width, walled, reverse):
    formula = least_aisle(CAR, angle, width, walled)
    found = max(best_single_arc(CAR, angle, width, walled, reverse), CAR.width)
    # The search steps 2 cm along the bay's axis, and the sweep 0.4 deg; measured:
    # -1.5 to +1.4 cm.
    assert formula == pytest.approx(found, abs=0.03)


def test_a_hand_worked_case_backing_into_a_perpendicular_bay():
    # R = 2.637 / tan 34.187 deg = 3.882 m; neighbours 1.601 m off the axis (2.5 m bays)
    # q^2 = 2.983^2 - 2.282^2; front corner sqrt(4.782^2 + 3.495^2) = 5.923 m.
    assert CAR.turning_radius == pytest.approx(3.882, abs=1e-3)
    assert least_aisle(CAR, 90.0, 2.5, walled=False) == pytest.approx(4.00, abs=0.01)


def test_nimbler_cars_need_narrower_aisles():
    assert least_aisle(CAR, 90.0, 1.7, walled=True) == math.inf
    nimble = DesignCar(max_steering=math.radians(40))
    assert least_parallel_aisle(nimble) > least_parallel_aisle(CAR) > CAR.width
    assert least_aisle(nimble, 90.0, 2.5, False) < least_aisle(CAR, 90.0, 2.5, False)


def test_published_aisles_in_feet():
    feet = dict(zip(AISLE_ANGLES, np.array(AISLE_WIDTHS) / 0.3048, strict=True))
    for angle in AISLE_ANGLES:  # they let our car in
        least = least_aisle(CAR, angle, 8.5 * FOOT, walled=False)
        assert least < one_way_aisle(angle)
    assert feet[45.0] == pytest.approx(13.5)
    assert feet[60.0] == pytest.approx(18.5)
    assert feet[90.0] == pytest.approx(24.0)
    assert one_way_aisle(52.5) == pytest.approx((15.5 * 0.75 + 18.5 * 0.25) * 0.3048)


@pytest.mark.parametrize("name", ["square", "street", "garage_row", "dead_end", "lot"])
def test_families_say_how_roomy_its_bays_and_aisles_get(name):
    config = layout_config(name)
    assert all(entry.least(CAR) <= entry.aisle for entry in config.entries)
    draw = jax.jit(jax.vmap(config.generate))
    lots = jax.device_get(draw(jax.random.split(jax.random.key(1), 200)))
    ordinary = lots.bay_mask & (lots.bay_kind == BayKind.STANDARD)
    widest = lots.bay_size[ordinary][:, 1].max()
    most = max(entry.bay_width for entry in config.entries)
    assert 0.97 * most < widest < most + 1e-4
