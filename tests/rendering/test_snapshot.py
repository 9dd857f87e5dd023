"""What there is to see at one instant."""

import numpy as np

from carpark_mj.layouts import make_layout
from carpark_mj.rendering.recording import Recording, aimed_at, snapshot
from carpark_mj.types import NO_BAY


def test_a_picture_shows_no_goal_of_an_agent_that_explores():
    layout = make_layout("square")
    flags = np.zeros((1, 2), bool)
    recording = Recording(
        layout=layout,
        ctrl_dt=0.2,
        pose_w=np.zeros((1, 1, 2, 3)),
        steering=np.zeros((1, 2)),
        speed=np.array([[1.0, 0.0]]),
        goal=np.array([[5, NO_BAY]]),
        parked_pose=np.zeros((1, 1, 0, 3)),
        active=~flags,
        parked=flags,
        crashed=flags,
        timed_out=flags,
        step=np.ones((1, 2), int),
        tracked_bays=np.array([[[5, 7], [NO_BAY, 3]]]),
    )
    seen = snapshot(recording, 0)
    assert seen.state == ("drives", "stands, explores")
    np.testing.assert_array_equal(seen.goal_pose[0], layout.bay_pose[5])
    assert np.isnan(seen.goal_pose[1]).all()
    assert np.isnan(aimed_at(layout, np.array([NO_BAY]))[1]).all()
    bays = np.asarray(layout.bay_pose)[:, :2]
    expected = [[bays[5], bays[7]], [[np.nan] * 2, bays[3]]]
    np.testing.assert_array_equal(seen.tracked_bay_xy, expected)
