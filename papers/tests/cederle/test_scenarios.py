"""Scenarios and settings."""

import pytest

from carpark_mj.config import SimConfig
from carpark_papers.cederle.junction import (
    SCENARIOS,
    JunctionConfig,
    JunctionEnv,
    RasterConfig,
)
from carpark_papers.cederle.junction.config import Mission, RewardRules, Scenario
from carpark_papers.cederle.junction.roads import Route


@pytest.mark.parametrize(
    ("name", "lengths", "humans", "solved"),
    [
        ("2av", [53.8, 63.3], 0, 100),
        ("2av-hd", [68.1, 66.8], 1, 100),
        ("3av", [58.8, 59.6, 58.3], 0, 120),
        ("3av-hd", [63.8, 64.6, 63.3], 1, 120),
    ],
)
def test_missions_are_as_long_as_those_of_the_study(name, lengths, humans, solved):
    scenario = SCENARIOS[name]
    found = [mission.length for mission in scenario.missions]
    assert found == pytest.approx(lengths, abs=0.05)
    assert len(scenario.human_cars) == humans
    assert scenario.solved == solved


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"scenario": "4av"}, "unknown scenario '4av'; choose from"),
        ({"cars": "boat"}, "unknown cars 'boat'"),
        ({"observation": "lidar"}, "unknown observation 'lidar'"),
        ({"end": "never"}, "unknown end 'never'"),
        ({"max_steps": 0}, "max_steps must be at least 1, not 0"),
        ({"jitter": 14.0}, r"jitter must be at most 13.47 m.*not 14.0"),
        (
            {"scenario": "3av-hd", "jitter": 5.1},  # 10 m behind the human-driven car
            "jitter must be at most 5.00 m, or a car would start within another one",
        ),
        ({"jitter": -1.0}, "jitter must be at least 0"),
        ({"raster": None}, "raster must be of RasterConfig, not None"),
    ],
)
def test_impossible_settings_are_one_sentence(settings, message):
    with pytest.raises(ValueError, match=message):
        JunctionConfig(**settings)


@pytest.mark.parametrize("start", [-0.1, 33.5, float("nan")])
def test_a_mission_starts_on_its_lane(start):
    route = Route("east-EW", "south-NS")
    assert Mission(route, 33.47, 60.0).length == pytest.approx(10.32 + 34.27, abs=0.01)
    said = (
        rf"start of a mission must lie in \[0, 33.47\] m on lane 'east-EW', not {start}"
    )
    with pytest.raises(ValueError, match=said):
        JunctionConfig(scenario=Scenario((Mission(route, start, 30.0),), (), 0.0))


def test_impossible_parts_are_one_sentence():
    with pytest.raises(ValueError, match="pixels must be at least 1, not 0"):
        RasterConfig(pixels=0)
    with pytest.raises(ValueError, match=r"unknown events 'both'"):
        RewardRules(events="both")
    with pytest.raises(ValueError, match="unknown vehicle 'tank'"):
        JunctionEnv(JunctionConfig(cars="mjx", vehicle="tank"))
    icy = SimConfig(ctrl_dt=0.1, surface="ice")
    with pytest.raises(ValueError, match="bicycle physics has no tyres"):
        JunctionEnv(JunctionConfig(cars="bicycle", sim=icy))
