"""The picture of planned paths shows the part of a lot in which cars drive."""

import jax
import numpy as np
import pytest

from carpark_mj.suite.report import AROUND, ASPECT, _view
from carpark_mj.suite.tpcap import TpcapConfig


def test_start_and_goal_are_in_view_and_far_obstacles_are_not():
    layout = jax.device_get(TpcapConfig(4).generate(jax.random.key(0)))
    low, high = _view(layout, None)
    ends = np.stack([layout.spawn_pose[0, :2], layout.bay_pose[0, :2]])
    assert (low <= ends.min(axis=0)).all()
    assert (high >= ends.max(axis=0)).all()
    more = high - low - np.ptp(ends, axis=0) - 2 * AROUND
    assert more.min() == pytest.approx(0.0, abs=1e-3)  # as close as the frame allows
    assert (high - low)[0] == pytest.approx(ASPECT * (high - low)[1])
    assert (high - low < 2 * layout.extent).any()
