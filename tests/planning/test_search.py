"""The planner's search, and paths that a car can drive."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from helpers.planned import CAR, case, drive
from helpers.scenes import polygons

from carpark_mj.config import SimConfig
from carpark_mj.geometry import box_disc_overlap, boxes_overlap
from carpark_mj.physics.bicycle import BicyclePhysics
from carpark_mj.planning import search as module
from carpark_mj.planning.paths import (
    BLEND,
    CREEP,
    SHIFT_TIME,
    SHORTEST,
    STEP,
    TURN,
    PlannedPath,
    centre,
    hold_distances,
    make_path,
    rear_axle,
)
from carpark_mj.planning.search import FreeSpace, SearchConfig, Solids, search
from carpark_mj.vehicle import COMPACT, make_vehicle, preset

CASES = [("normal", 0), ("normal", 1), ("complex", 0), ("complex", 1), ("extreme", 0)]


@pytest.fixture(scope="module", params=CASES, ids=str)
def planned(request):
    pytest.importorskip("ompl")
    task = case(*request.param)
    start, goal, solids, extent = task
    return task, search(start, goal, solids, CAR, extent, seed=1)


def check_path(found, start, goal, solids, car):
    """It begins and ends where it must, in one piece, and keeps its clearance."""
    segments = found.path.segments
    pose = np.concatenate([segment.pose for segment in segments])
    cars = polygons(centre(car, pose), (car.length, car.width))
    solid = shapely.union_all(polygons(solids.pose, solids.size))
    # Tested every 5 cm by the search, every 2 cm by its last check.
    least = max(found.clearance - 0.01, 0.8 * found.clearance)
    assert shapely.distance(cars, solid).min() >= least > 0.0
    step = np.diff(pose, axis=0)
    assert np.hypot(*step[:, :2].T).max() < SHORTEST + 2 * STEP
    assert np.abs(np.sin(step[:, 2])).max() < 2 * TURN
    np.testing.assert_allclose(centre(car, pose[0])[:2], start[:2], atol=0.05)
    np.testing.assert_allclose(centre(car, pose[-1])[:2], goal[:2], atol=0.05)
    assert abs(math.sin(pose[-1, 2] - goal[2])) < 0.02  # nose in or nose out


def test_a_planned_path_leads_into_the_bay_clear_of_everything(planned):
    (start, goal, solids, _), found = planned
    check_path(found, start, goal, solids, CAR)


def test_a_planned_path_turns_no_tighter_than_the_car(planned):
    _, found = planned
    tightest = math.tan(CAR.max_steering) / CAR.wheelbase
    window = 25
    for segment in found.path.segments:
        gap = np.hypot(*np.diff(segment.pose[:, :2], axis=0).T)
        turn = np.abs(np.diff(segment.pose[:, 2]))
        assert gap.max() < SHORTEST + STEP
        # Points miss the tips of the path, where it changes gear.
        way, turned = (np.convolve(x, np.ones(window)) for x in (gap, turn))
        assert (turned <= tightest * (way + SHORTEST + 2 * STEP)).all()
        assert np.abs(segment.steering).max() <= CAR.max_steering


def test_the_pedals_rules_follow_the_path_and_end_in_the_bay(planned):
    (_, _, solids, _), found = planned
    poses, speeds, error = drive(found.path)
    assert error < 0.05
    assert speeds[-1] == 0.0
    last = found.path.segments[-1].pose[-1]
    assert math.dist(poses[-1, :2], last[:2]) < 0.05
    assert abs(math.remainder(poses[-1, 2] - last[2], 2 * math.pi)) < 0.05
    cars = polygons(centre(CAR, poses[::5]), (CAR.length, CAR.width))
    solid = shapely.union_all(polygons(solids.pose, solids.size))
    assert not shapely.intersects(cars, solid).any()
    # It has stood still at every change of gear.
    moving = np.sign(speeds[np.abs(speeds) > 0.05])
    assert (np.diff(moving) != 0).sum() == found.path.shifts


NOTHING = Solids(np.zeros((0, 3)), np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))


@pytest.mark.parametrize("start", [math.pi, -math.pi])
@pytest.mark.parametrize("yaw", [0.0, 1e-4, math.pi, -math.pi])
def test_a_bay_is_entered_either_way_round_whatever_its_heading(start, yaw):
    """A car too long to turn in its lane drives straight into the bay ahead."""
    pytest.importorskip("ompl")
    walls = np.array([[0.0, 1.4, 0.0], [0.0, -1.4, 0.0]]), np.full((2, 2), [40.0, 0.1])
    found = search(
        np.array([6.0, 0.0, start]),
        np.array([-6.0, 0.0, yaw]),
        NOTHING.with_boxes(*walls),
        CAR,
        np.full(2, 20.0),
        config=SearchConfig(paths=2, clearances=(0.05,)),
    )
    assert found.path.shifts == 0
    assert found.path.length == pytest.approx(12.0, abs=0.01)


def test_directions_stay_within_bounds_to_the_last_bit():
    turns = math.pi * np.arange(-5.0, 6.0)
    for yaw in (turns, np.nextafter(turns, -99.0), np.nextafter(turns, 99.0)):
        found = module._wrap(yaw)
        assert ((found >= -math.pi) & (found < math.pi)).all()
        np.testing.assert_allclose(np.exp(1j * found), np.exp(1j * yaw), atol=1e-12)


@pytest.mark.parametrize("yaw", [0.0, 0.5 * math.pi, 2.5])
def test_the_quicker_way_round_is_driven_in_opposite_bays(yaw):
    """Straight ahead, where nothing stands in the way."""
    pytest.importorskip("ompl")
    goal = np.array([1.0, -2.0, yaw])
    start = goal - 8.0 * np.array([math.cos(yaw), math.sin(yaw), 0.0])
    ahead = np.linspace(rear_axle(CAR, start), rear_axle(CAR, goal), round(8.0 / STEP))
    for turn in (0.0, math.pi, -math.pi):
        bay = goal + np.array([0.0, 0.0, turn])
        found = search(start, bay, NOTHING, CAR, np.full(2, 20.0), seed=3)
        assert found.path.duration == pytest.approx(
            make_path(ahead, CAR).duration, abs=0.5
        )


@pytest.mark.parametrize(
    ("durations", "quickest", "clearance"),
    [
        ([90.0, 50.0, 60.0, 55.0], 50.0, 0.08),  # quick enough: the others can wait
        ([90.0, 80.0, 99.0, 75.0, 72.0, 69.0, None, 81.0], 69.0, 0.05),
        ([90.0, None, 80.0, 85.0] + 8 * [90.0], 80.0, 0.08),
    ],
)
def test_slow_paths_are_worth_searches_nearer_to_obstacles(
    durations, quickest, clearance, monkeypatch
):
    left = iter(durations)

    def connect(*_):
        duration = next(left)
        return None if duration is None else PlannedPath((), duration)

    monkeypatch.setattr(module, "_connect", connect)
    start, goal, solids, extent = case("normal", 0)
    found = search(start, goal, solids, CAR, extent)
    assert (found.path.duration, found.clearance) == (quickest, clearance)
    assert next(left, None) is None


@pytest.mark.parametrize("name", ["compact", "van"])
def test_a_slot_with_a_kerb_is_entered(name):
    """ISO 16787's, a quarter longer than the car and 0.2 m deeper."""
    pytest.importorskip("ompl")
    car = preset(name)
    beside = (1.25 * car.length + car.length) / 2
    pose = [[-beside, 0.1, 0.0], [beside, 0.1, 0.0], [0.0, -car.width / 2 - 0.2, 0.0]]
    size = [[car.length, car.width]] * 2 + [[30.0, 0.2]]
    solids = NOTHING.with_boxes(np.array(pose), np.array(size))
    start, goal = np.array([beside, car.width + 1.1, 0.0]), np.zeros(3)
    found = search(start, goal, solids, car, np.full(2, 20.0))
    check_path(found, start, goal, solids, car)


def test_a_car_nearer_to_a_wall_than_the_least_clearance_leaves_it():
    pytest.importorskip("ompl")
    start, goal = np.zeros(3), np.array([8.0, 3.0, 0.0])
    wall = np.array([[-CAR.length / 2 - 0.11, 0.0, 0.0]]), np.array([[0.2, 3.0]])
    solids = NOTHING.with_boxes(*wall)
    found = search(start, goal, solids, CAR, np.full(2, 20.0))
    assert 0.0 < found.clearance < 0.01
    check_path(found, start, goal, solids, CAR)


@pytest.mark.parametrize(("away", "searches"), [(3.0, 0), (4.8, 2)])
def test_a_walled_in_bay_has_no_path_and_no_endless_search(away, searches, monkeypatch):
    """With no room to leave the bay at all, nothing is searched for."""
    pytest.importorskip("ompl")
    start, goal, solids, extent = case("normal", 0)
    lid = np.array([[goal[0], goal[1] + away, 0.0]])
    closed = solids.with_boxes(lid, np.array([[40.0, 0.2]]))
    tests, is_free = [], FreeSpace.is_free

    def counted(space, pose):
        tests.extend([pose] * (pose.ndim == 1))
        return is_free(space, pose)

    monkeypatch.setattr(FreeSpace, "is_free", counted)
    for most in (505, 2000):
        tests.clear()
        config = SearchConfig((0.05,), paths=2, max_tests=most)
        found = search(start, goal, closed, CAR, extent, config=config)
        assert found.path is None
        assert math.isnan(found.clearance)
        assert len(tests) == searches * most


EXTENT = np.array([12.0, 8.0])
SIZE = (4.7, 1.9)


def draw_boxes(rng, count):
    pose = rng.uniform(-1, 1, (count, 3)) * [*EXTENT, np.pi]
    return pose, rng.uniform(0.2, 3.0, (count, 2))


def test_a_pose_is_free_exactly_where_the_task_finds_no_overlap():
    rng = np.random.default_rng(0)
    pose, size = draw_boxes(rng, 6)
    centre, radius = rng.uniform(-6, 6, (2, 2)), np.array([0.3, 0.8])
    space = FreeSpace(Solids(pose, size, centre, radius), SIZE, EXTENT)
    cars, _ = draw_boxes(rng, 4000)
    free = space.is_free(cars)
    assert [space.is_free(car) for car in cars[:50]] == free[:50].tolist()

    def clear(change):
        own = jnp.array(cars)[:, None], jnp.array(SIZE) + change
        hit = boxes_overlap(*own, pose, size).any(axis=1)
        return np.asarray(~(hit | box_disc_overlap(*own, centre, radius).any(axis=1)))

    sure = clear(1e-4) == clear(-1e-4)
    assert sure.mean() > 0.99
    np.testing.assert_array_equal(free[sure], clear(0.0)[sure])
    assert 0.1 < free.mean() < 0.9


def test_nothing_is_free_outside_the_lot():
    space = FreeSpace(NOTHING, SIZE, EXTENT)
    assert space.is_free(np.array([11.9, -7.9, 1.0]))
    assert space.room(np.zeros(3)) == np.inf
    for x, y in ((12.1, 0.0), (-12.1, 0.0), (0.0, 8.1), (0.0, -8.1)):
        assert not space.is_free(np.array([x, y, 0.0]))
    wall = NOTHING.with_boxes(np.zeros((1, 3)), np.ones((1, 2)))
    assert not FreeSpace(wall, SIZE, EXTENT).is_free(np.array([0.0, 0.0, 0.3]))
    beside = np.array([0.0, SIZE[1] / 2 + 0.5 + 0.3, 0.0])
    assert FreeSpace(wall, SIZE, EXTENT).room(beside) == pytest.approx(0.3)
    ahead = FreeSpace(wall, SIZE, EXTENT, ahead=3.5)
    assert ahead.is_free(np.zeros((2, 3))).all()
    assert not ahead.is_free(np.array([-3.5, 0.0, 0.0]))


# Paths


RADIUS = 5.0


def line(length, way=1):
    s = np.arange(0.0, length + STEP / 2, STEP)
    return np.stack([way * s, 0 * s, 0 * s], axis=-1)


def arc(angle, side=1):
    """A turn of `RADIUS` from the origin, to the left for side 1."""
    turn = np.arange(0.0, angle, STEP / RADIUS)
    return np.stack(
        [RADIUS * np.sin(turn), side * RADIUS * (1 - np.cos(turn)), side * turn], -1
    )


def test_a_path_is_cut_where_the_gear_changes():
    there = line(3.0)
    back = there[-1] + line(1.0, way=-1)[1:]
    path = make_path(np.concatenate([there, back]), CAR)
    assert [segment.gear for segment in path.segments] == [1, -1]
    assert [segment.length for segment in path.segments] == pytest.approx([3.0, 1.0])
    assert path.length == pytest.approx(4.0)
    assert path.shifts == 1
    np.testing.assert_allclose(path.segments[1].pose[0], [3.0, 0.0, 0.0])
    # 1.56 m at 1.2 m/s, 1.44 m of braking by 0.5 m/s^2; 1 m of braking; the shift.
    assert path.duration == pytest.approx(1.3 + 2.4 + 2.0 + SHIFT_TIME, abs=0.1)


def test_turning_the_wheels_takes_time():
    turn = arc(1.0)
    straight = line(len(turn) * STEP - STEP)
    more = make_path(turn, CAR).duration - make_path(straight, CAR).duration
    wheels = math.atan(CAR.wheelbase / RADIUS) / CAR.steering_rate
    assert more == pytest.approx(wheels, rel=0.05)


def test_a_tiny_move_to_and_fro_is_left_out():
    there = line(2.0)
    jolt = there[-1] + line(0.02, way=-1)[1:]
    path = make_path(np.concatenate([there, jolt, jolt[-1] + line(2.0)[1:]]), CAR)
    assert [segment.gear for segment in path.segments] == [1]
    assert path.length == pytest.approx(4.0, abs=0.05)
    assert make_path(np.zeros((5, 3)), CAR) is None  # a path of one place


def test_tiny_moves_that_turn_the_car_in_its_place_are_driven():
    turned = 0.004 * np.arange(41)  # by 2 cm to and fro on circles of `RADIUS`
    way = np.where(np.arange(40) % 2, -0.02, 0.02)
    moves = way[:, None] * np.stack([np.cos(turned[:-1]), np.sin(turned[:-1])], 1)
    places = np.concatenate([np.zeros((1, 2)), moves.cumsum(axis=0)])
    path = make_path(np.column_stack([places, turned]), CAR)
    joints = [s.pose[[0, -1], 2] for s in path.segments]
    ends = [0.0, *np.concatenate(joints), 40 * 0.004]
    assert np.abs(np.diff(ends)[::2]).max() < TURN + 0.005


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("way", [1, -1])
def test_on_an_arc_the_wheels_follow_from_radius_and_wheelbase(way, side):
    pose = arc(1.0, side)
    path = make_path(pose if way == 1 else pose[::-1], CAR)
    [segment] = path.segments
    assert segment.gear == way
    expected = side * math.atan(CAR.wheelbase / RADIUS)
    np.testing.assert_allclose(segment.steering, expected, atol=1e-3)


def test_the_wheels_can_follow_and_the_car_can_stop():
    left = arc(1.0)
    right = arc(1.0, side=-1)
    cos, sin = math.cos(left[-1, 2]), math.sin(left[-1, 2])
    turned = right[:, :2] @ np.array([[cos, sin], [-sin, cos]])
    right = np.column_stack([turned, right[:, 2]]) + left[-1]
    [segment] = make_path(np.concatenate([left, right[1:]]), CAR).segments
    rate = np.abs(np.gradient(segment.steering, segment.distance))
    fast = segment.speed > CREEP + 1e-6
    assert (rate * segment.speed)[fast].max() <= CAR.steering_rate * 1.01
    # Lock to lock over BLEND, not at once.
    jump = 2 * math.atan(CAR.wheelbase / RADIUS)
    assert rate.max() == pytest.approx(jump / BLEND, rel=0.1)
    slowing = np.diff(segment.speed**2) / (2 * np.diff(segment.distance))
    assert slowing.min() >= -0.5 * 1.01
    assert segment.speed[-1] == 0.0


def test_a_car_whose_pedal_is_released_rolls_as_far_as_is_planned():
    speed = np.array([0.05, 0.1, 0.2, 0.25, 0.295, 0.2999])  # below `CREEP`
    assert speed.max() < CREEP
    physics = BicyclePhysics(SimConfig())
    cars = jax.tree.map(
        lambda x: jnp.broadcast_to(x, (len(speed), *x.shape)), make_vehicle(COMPACT)
    )
    state = physics.init(jnp.zeros((len(speed), 3)), cars)
    state = physics.set_speed(state, jnp.array(speed, jnp.float32))
    step = jax.jit(physics.step)
    for _ in range(5):
        state = step(state, jnp.zeros((len(speed), 2)))
    motion = physics.read(state)
    assert np.abs(motion.velocity_b).max() == 0.0
    planned = np.interp(speed, *hold_distances())
    np.testing.assert_allclose(motion.pose_w[:, 0], planned, atol=2e-3)
