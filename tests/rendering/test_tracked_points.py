"""What is linked to an agent: the nearest cars, and the bays that it tracks."""

import dataclasses

import numpy as np

from carpark_mj.observations.fields import Tracked
from carpark_mj.rendering.recording import Snapshot, tracked_points


def seen(pose, parked):
    """An instant with agents and parked cars at some poses."""
    return Snapshot(
        seconds=0.0,
        pose_w=pose,
        steering=np.zeros(len(pose)),
        goal_pose=np.full_like(pose, np.nan),
        goal_size=np.full((len(pose), 2), np.nan),
        parked_pose=parked,
        active=np.ones(len(pose), bool),
        state=("",) * len(pose),
        tally={},
        flashes=(),
    )


def links(what, tracked):
    """What is tracked, as (agent, (x, y))."""
    return [(agent, tuple(point)) for agent, point in tracked_points(what, tracked)]


def test_tracked_points_are_the_nearest_cars_of_each_agent():
    pose = np.array([[0.0, 0, 0], [3, 0, 0], [10, 0, 0]])
    parked = np.array([[0.0, 5, 0], [9, 5, 0]])
    what = seen(pose, parked)
    assert sorted(links(what, Tracked(1, 1))) == [
        (0, (0.0, 5.0)),
        (0, (3.0, 0.0)),
        (1, (0.0, 0.0)),
        (1, (0.0, 5.0)),
        (2, (3.0, 0.0)),
        (2, (9.0, 5.0)),
    ]
    assert links(what, Tracked()) == []
    # In one list the nearest is an agent for 0 and 1 and a parked car for 2.
    together = [(0, (3.0, 0.0)), (1, (0.0, 0.0)), (2, (9.0, 5.0))]
    assert links(what, Tracked(cars=1)) == together
    empty = dataclasses.replace(what, parked_pose=np.zeros((0, 3)))
    assert len(links(empty, Tracked(5, 2))) == 6  # two others each, no parked car


def test_tracked_bays_are_linked_and_empty_slots_are_not():
    none = [np.nan, np.nan]
    bays = np.array([[[1.0, 2.0], none], [none, none], [[3.0, 4.0], [5.0, 6.0]]])
    what = seen(np.zeros((3, 3)), np.zeros((0, 3)))
    what = dataclasses.replace(what, tracked_bay_xy=bays)
    expected = [(0, (1.0, 2.0)), (2, (3.0, 4.0)), (2, (5.0, 6.0))]
    assert links(what, Tracked()) == expected
