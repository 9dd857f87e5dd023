"""Links and rings are those of the agent that a camera follows, otherwise of all."""

import numpy as np
import pytest

from carpark_mj.layouts import make_layout
from carpark_mj.observations.fields import Tracked
from carpark_mj.rendering.recording import Snapshot
from carpark_mj.rendering.renderer import LotRenderer, Show, followed_agents
from carpark_mj.rendering.stage import Stage
from carpark_mj.vehicle import COMPACT

LAYOUT = make_layout("square")
POSE = np.array([[2.0, 1.0, 0.0], [-6.0, 0.0, 0.0]])
PARKED = POSE + np.array([3.0, 5.0, 0.0])  # each agent tracks the one on its left
ON_LINK, ON_RING = np.array([1.5, 2.5]), np.array([0.0, -4.0])
SHOW = Show(Tracked(parked_cars=1), rings=(8.0,))


def draw(flag, camera, show):
    """A picture, and the pixels of some points (2,) in it."""
    goal = np.array([3, 20])
    seen = Snapshot(
        seconds=1.0,
        pose_w=POSE,
        steering=np.zeros(2),
        goal_pose=np.asarray(LAYOUT.bay_pose)[goal],
        goal_size=np.asarray(LAYOUT.bay_size)[goal],
        parked_pose=PARKED,
        active=np.ones(2, bool),
        state=("",) * 2,
        tally={},
        flashes=(),
    )
    renderer = LotRenderer(Stage(LAYOUT, COMPACT, 2, 2), flag, (960, 360), show)
    try:
        renderer.place(seen)
        frame = renderer.draw(seen, camera).astype(int)
        pixels = [
            [
                renderer.project(np.array([*xy + off, 0.04]), camera)
                for xy in POSE[:, :2]
            ]
            for off in (ON_LINK, ON_RING)
        ]
    finally:
        renderer.close()
    return frame, pixels


@pytest.mark.parametrize(
    ("flag", "camera", "expected"),
    [
        ("topdown", "topdown", [True, True]),
        ("overview", "overview", [True, True]),
        ("split:1", "topdown", [False, True]),
        ("split:1", "agent1/chase", [False, True]),
        ("chase:1", "agent1/chase", [False, True]),
        ("split:0", "topdown", [True, False]),
    ],
)
def test_whose_links_and_rings_are_drawn(flag, camera, expected):
    plain, _ = draw(flag, camera, None)
    extra, pixels = draw(flag, camera, SHOW)
    changed = np.abs(extra - plain).sum(-1) > 40

    def near(pixel):
        x, y = (round(v) for v in pixel)
        assert 2 < x < changed.shape[1] - 2
        assert 2 < y < changed.shape[0] - 2
        return bool(changed[y - 2 : y + 3, x - 2 : x + 3].any())

    for of_agents in pixels:
        assert [near(pixel) for pixel in of_agents] == expected


def test_the_whole_lot_follows_nobody():
    assert followed_agents(("overview",)) == ()
    assert followed_agents(("agent2/driver",)) == (2,)
    assert followed_agents(("topdown", "agent10/chase")) == (10,)
