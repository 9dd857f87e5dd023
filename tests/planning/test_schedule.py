"""Who is where and when: overlaps, and waiting for others."""

import numpy as np
import pytest
from shapely import affinity
from shapely.geometry import box

from carpark_mj.planning.paths import make_path, rear_axle
from carpark_mj.planning.schedule import (
    ACCELERATION,
    CRUISE,
    DT,
    STOP,
    Drive,
    instants,
    meet,
    schedule,
)
from carpark_mj.vehicle import COMPACT

SIZE = np.array([COMPACT.length, COMPACT.width])


def outline(pose, size):
    shape = box(-size[0] / 2, -size[1] / 2, size[0] / 2, size[1] / 2)
    turned = affinity.rotate(shape, pose[2], (0, 0), use_radians=True)
    return affinity.translate(turned, pose[0], pose[1])


def straight(first, last):
    """Instants of a car that drives from a pose straight on to another."""
    steps = np.linspace(first, last, round(np.hypot(*(last - first)[:2]) / 0.02) + 1)
    path = make_path(rear_axle(COMPACT, steps), COMPACT)
    return instants(path, COMPACT)


def test_rectangles_meet_as_shapely_says():
    numbers = np.random.default_rng(0)
    poses, others = numbers.uniform(-4, 4, (2, 30, 3))
    sizes = np.array([4.0, 1.8]), np.array([1.0, 3.0])
    expected = [
        [outline(a, sizes[0]).intersects(outline(b, sizes[1])) for b in others]
        for a in poses
    ]
    assert (meet(poses, sizes[0], others, sizes[1]) == expected).all()


def test_a_car_speeds_up_cruises_and_stops():
    pose = straight(np.array([0.0, 0, 0]), np.array([20.0, 0, 0]))
    speed = np.diff(pose[:, 0]) / DT
    assert speed.max() == pytest.approx(CRUISE, rel=1e-3)
    # Between points of the path 2 cm apart times are interpolated.
    assert np.abs(np.diff(speed)).max() <= ACCELERATION * DT + 0.03
    expected = 20.0 / CRUISE + CRUISE / ACCELERATION
    assert DT * (len(pose) - 1) == pytest.approx(expected, abs=2 * DT)


def test_nobody_waits_alone():
    pose = straight(np.array([0.0, 0, 0]), np.array([12.0, 0, 0]))
    assert schedule(pose, SIZE, [], 0).tolist() == list(range(len(pose)))
    late = schedule(pose, SIZE, [], 7)
    assert late.tolist() == [0] * 7 + list(range(len(pose)))


def test_a_car_waits_until_another_has_crossed_and_stops_for_no_less_than_it_takes():
    own = straight(np.array([-12.0, 0, 0]), np.array([12.0, 0, 0]))
    crossing = straight(np.array([0.0, -9, np.pi / 2]), np.array([0.0, 9, np.pi / 2]))
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


def test_a_car_does_not_drive_through_one_that_stands():
    own = straight(np.array([-12.0, 0, 0]), np.array([12.0, 0, 0]))
    stands = Drive(np.zeros((1, 3)), np.zeros(1, int), SIZE)
    assert schedule(own, SIZE, [stands], 0) is None


def test_a_car_does_not_stop_where_another_will_pass():
    own = straight(np.array([-12.0, 0, 0]), np.array([0.0, 0, 0]))
    crossing = straight(np.array([0.0, -9, np.pi / 2]), np.array([0.0, 9, np.pi / 2]))
    wait = [0] * 60
    other = Drive(crossing, np.array(wait + list(range(len(crossing)))), SIZE)
    index = schedule(own, SIZE, [other], 0)
    hits = meet(own[-1:], SIZE, crossing, SIZE)[0]
    later = np.arange(len(index) - 1, len(other.point))
    assert not hits[other.at(later)].any()
