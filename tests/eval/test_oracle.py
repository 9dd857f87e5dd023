"""What is possible in a lot: lanes worked out by hand, and random lots."""

import itertools
import math

import jax
import numpy as np
import pytest
import shapely
from helpers.programs import rows_of
from helpers.scenes import polygons

from carpark_mj.config import EnvConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.planning.paths import make_path, rear_axle
from carpark_mj.planning.policy import Sight, sights
from carpark_mj.planning.search import Solids
from carpark_mj.registry import environment
from carpark_mj.vehicle import COMPACT
from oracle import (
    ACCELERATION,
    CRUISE,
    DT,
    OUTCOMES,
    STOP,
    Drive,
    Lot,
    describe,
    instants,
    main,
    meet,
    schedule,
)

SECONDS = 60.0
TIGHT = EnvConfig(layout="dead_end,garage_row", num_agents=3, num_parked_cars=1)


@pytest.fixture(scope="module", autouse=True)
def ompl():
    pytest.importorskip("ompl")


def lane(cars, blocks):
    """What cars, starts and goals, see in a lane 2.6 m wide, blind at x = -15 and 15.

    Beside it is solid ground from y = -6 to 6 at the given x, of one side or both.
    """
    boxes = [(-16, -7, -15, 7), (15, -7, 16, 7), *blocks]
    pose = [[(a + c) / 2, (b + d) / 2, 0.0] for a, b, c, d in boxes]
    size = [[c - a, d - b] for a, b, c, d in boxes]
    none = np.zeros((0, 2)), np.zeros(0)
    solids = Solids(np.array(pose, float), np.array(size, float), *none)
    poses = np.array([start for start, _ in cars], float)
    sizes = np.full((len(cars), 2), (COMPACT.length, COMPACT.width))
    found = []
    for k, (start, goal) in enumerate(cars):
        others = np.delete(poses, k, axis=0), np.delete(sizes, k, axis=0)
        ends, extent = np.array([start, goal], float), np.array([16.0, 7.0])
        rest = ends[1], COMPACT, solids, others, extent
        found.append(Sight(True, ends[0], 0.0, 0.0, *rest))
    return found


def check_witness(seen, answer):
    """Cars drive from their starts to their goals and touch nothing and nobody."""
    solids = seen[0].solids
    walls = shapely.union_all(polygons(solids.pose, solids.size))
    last = max(len(drive.point) for drive in answer.drives)
    for sight, drive, parks in zip(seen, answer.drives, answer.parks, strict=True):
        assert drive.pose[0] == pytest.approx(sight.pose)
        moved = np.hypot(*np.diff(drive.pose[drive.point, :2], axis=0).T)
        # The rear axle keeps to the speed; the car's middle swings out.
        curvature = math.tan(sight.car.max_steering) / sight.car.wheelbase
        swing = math.hypot(1.0, sight.car.centre_offset * curvature)
        assert moved.max(initial=0.0) <= CRUISE * DT * swing + 1e-6
        if parks:
            goal = np.atleast_2d(sight.goal)[0]
            assert drive.pose[-1, :2] == pytest.approx(goal[:2], abs=0.02)
            assert abs(math.sin(drive.pose[-1, 2] - goal[2])) < 0.01
        cars = polygons(drive.pose, drive.size - 2e-6)
        assert not shapely.intersects(cars, walls).any()
    instants = np.arange(last)
    cars = [polygons(d.pose[d.at(instants)], d.size - 2e-6) for d in answer.drives]
    for one, other in itertools.combinations(cars, 2):
        assert not shapely.intersects(one, other).any()


def test_cars_nose_to_nose_in_a_blind_lane_cannot_change_places():
    blocks = [(-15, 1.3, 15, 6), (-15, -6, 15, -1.3)]
    seen = lane([((-5, 0, 0), (8, 0, 0)), ((5, 0, math.pi), (-8, 0, 0))], blocks)
    answer = Lot(seen).solve(SECONDS)
    assert answer.alone.all()
    assert not answer.parks.any()


def test_a_car_lets_another_pass_that_pulls_into_its_bay():
    # The bay of the second lies beside the lane's end, behind it.
    blocks = [(-15, 1.3, 15, 6), (-15, -6, 5, -1.3)]
    seen = lane([((-5, 0, 0), (10, 0, 0)), ((3, 0, math.pi), (11, -4, 0))], blocks)
    answer = Lot(seen).solve(SECONDS)
    assert answer.parks.all()
    assert (answer.arrival <= SECONDS).all()
    check_witness(seen, answer)


def test_a_car_behind_walls_cannot_park():
    blocks = [(-15, 1.3, 15, 6), (-15, -6, 15, -1.3), (2, -1.3, 2.2, 1.3)]
    seen = lane([((-5, 0, 0), (8, 0, 0)), ((-11, 0, 0), (-7, 0, 0))], blocks)
    answer = Lot(seen).solve(SECONDS)
    assert answer.alone.tolist() == [False, True]
    assert not answer.parks[0]


@pytest.fixture(scope="module")
def tight():
    env = ParkingEnv(TIGHT)
    state, _ = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(0), 12))
    return sights(state)


def test_starts_in_tight_lots_are_possible_and_drives_touch_nothing(tight):
    assert {len(seen) for seen in tight} == {3}
    answers = [Lot(seen).solve(SECONDS) for seen in tight[:3]]
    for seen, answer in zip(tight, answers, strict=False):
        check_witness(seen, answer)
    parks = np.concatenate([answer.parks for answer in answers])
    assert parks.mean() > 0.8


def row(lot, agents, outcome, family="street"):
    which = {"lot": lot, "family": family, "agents_present": agents}
    return which | {"outcome": outcome}


def test_the_table_counts_agents_and_lots_by_family():
    rows = [row(0, 2, "in time"), row(0, 2, "late")]
    rows += [row(1, 2, "in time"), row(1, 2, "in time")]
    rows += [row(2, 1, "none found", "dead_end")]
    lines = [line.split(" | ") for line in describe(rows).splitlines()[2:]]
    assert [line[:6] for line in lines] == [
        ["| dead_end", "1", "1", "0.0", "0.0", "100.0"],
        ["| street", "2", "2", "75.0", "25.0", "0.0"],
    ]
    assert [line[6].split()[0] for line in lines] == ["0.0", "50.0"]


def test_the_command_writes_a_row_for_each_agent(tmp_path, capsys):
    flags = "--environment square --layout square_compact --num-agents 2 --lots 1"
    assert main([*flags.split(), "--out", str(tmp_path / "new")]) == 0
    rows = rows_of(tmp_path / "new" / "oracle.csv")
    assert [(r["lot"], r["agent"]) for r in rows] == [("0", "0"), ("0", "1")]
    task = environment("square")
    seconds = task.episode.max_steps * task.sim.ctrl_dt
    for r in rows:
        assert r["outcome"] in OUTCOMES
        assert (r["outcome"] == "in time") == (float(r["arrival"]) <= seconds)
    assert "| square_compact | 2 | 1 |" in capsys.readouterr().out
    assert main(["--environment", "dynamic"]) == 2
    assert "the planner needs fixed goals" in capsys.readouterr().err


SIZE = np.array([COMPACT.length, COMPACT.width])


def straight(*ends):
    """Instants of a car that drives from a pose straight on to another."""
    first, last = map(np.array, ends)
    steps = np.linspace(first, last, round(np.hypot(*(last - first)[:2]) / 0.02) + 1)
    path = make_path(rear_axle(COMPACT, steps), COMPACT)
    return instants(path, COMPACT)


def test_a_car_speeds_up_cruises_and_stops():
    pose = straight((0.0, 0, 0), (20.0, 0, 0))
    speed = np.diff(pose[:, 0]) / DT
    assert speed.max() == pytest.approx(CRUISE, rel=1e-3)
    # Between points of the path 2 cm apart times are interpolated.
    assert np.abs(np.diff(speed)).max() <= ACCELERATION * DT + 0.03
    expected = 20.0 / CRUISE + CRUISE / ACCELERATION
    assert DT * (len(pose) - 1) == pytest.approx(expected, abs=2 * DT)


def test_nobody_waits_alone_or_drives_through_who_stands():
    pose = straight((0.0, 0, 0), (12.0, 0, 0))
    assert schedule(pose, SIZE, [], 0).tolist() == list(range(len(pose)))
    late = schedule(pose, SIZE, [], 7)
    assert late.tolist() == [0] * 7 + list(range(len(pose)))
    stands = Drive(np.array([[6.0, 0.0, 0.0]]), np.zeros(1, int), SIZE)
    assert schedule(pose, SIZE, [stands], 0) is None  # nobody drives through it


def test_a_car_waits_until_another_has_crossed():
    own = straight((-12.0, 0, 0), (12.0, 0, 0))
    crossing = straight((0.0, -9, np.pi / 2), (0.0, 9, np.pi / 2))
    other = Drive(crossing, np.arange(len(crossing)), SIZE)
    index = schedule(own, SIZE, [other], 0)
    assert index[-1] == len(own) - 1
    assert len(index) > len(own)
    passed = np.arange(len(index))
    hits = meet(own, SIZE, crossing, SIZE)
    assert not hits[index, other.at(passed)].any()
    assert set(np.diff(index)) == {0, 1}
    stood = [int((index == point).sum()) - 1 for point in range(1, len(own) - 1)]
    assert all(count == 0 or count >= round(STOP / DT) - 1 for count in stood)


def test_a_car_does_not_stop_where_another_will_pass():
    own = straight((-12.0, 0, 0), (0.0, 0, 0))
    crossing = straight((0.0, -9, np.pi / 2), (0.0, 9, np.pi / 2))
    wait = [0] * 60
    other = Drive(crossing, np.array(wait + list(range(len(crossing)))), SIZE)
    index = schedule(own, SIZE, [other], 0)
    hits = meet(own[-1:], SIZE, crossing, SIZE)[0]
    later = np.arange(len(index) - 1, len(other.point))
    assert not hits[other.at(later)].any()
