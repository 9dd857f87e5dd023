"""The picture of planned paths shows the part of a lot in which cars drive."""

import jax
import numpy as np

from carpark_mj.planning.plot import AROUND, _view
from carpark_mj.studies.tpcap.layouts import TpcapConfig


def test_start_and_goal_are_in_view_and_far_obstacles_are_not():
    layout = jax.device_get(TpcapConfig(4).generate(jax.random.key(0)))
    low, high = _view(layout, None)
    ends = np.stack([layout.spawn_pose[0, :2], layout.bay_pose[0, :2]])
    assert (low <= ends.min(axis=0)).all()
    assert (high >= ends.max(axis=0)).all()
    assert (high - low <= np.ptp(ends, axis=0) + 2 * AROUND + 1e-3).all()
    assert (high - low < 2 * layout.extent).any()
    assert (low >= -layout.extent).all()
    assert (high <= layout.extent).all()
