"""Cameras: names of flags, and what is no camera."""

import pytest

from carpark_mj.cli.play import PlayConfig
from carpark_mj.cli.render import RenderConfig
from carpark_mj.rendering.renderer import camera_names
from carpark_mj.wrappers.gymnasium_env import ParkEnv


def test_cameras_are_refused_by_name():
    assert camera_names("chase:1", 2) == ("agent1/chase",)
    assert camera_names("driver:0", 2) == ("agent0/driver",)
    assert camera_names("split", 2) == ("topdown", "agent0/chase")
    assert camera_names("split:1", 2) == ("topdown", "agent1/chase")
    for name in (
        "chase:2",
        "driver:2",
        "chase:",
        "chase:-1",
        "top",
        "",
        "split:",
        "split:2",
        3,
    ):
        with pytest.raises(ValueError, match=f"unknown camera {name!r}; choose topd"):
            camera_names(name, 2)
    assert camera_names("chase:9") == ("agent9/chase",)  # of any number of agents
    for make in (
        lambda: RenderConfig("zero", camera="top"),
        lambda: PlayConfig(view="window", camera="top"),
        lambda: ParkEnv(camera="top"),
    ):
        with pytest.raises(ValueError, match=r"'top'; choose .* with K from 0"):
            make()
