"""Settings of the study's encoders that are refused, and where they fit."""

import math

import pytest

from carpark_mj.config import (
    ENCODERS,
    EnvConfig,
    FleetConfig,
    GivingWayConfig,
    GoalConfig,
)
from carpark_papers.tanner.indices import IndexObservation
from carpark_papers.tanner.observation import TannerObservation, TannerShare, ViewConfig

DYNAMIC = GoalConfig(dynamic=True)


@pytest.mark.parametrize(
    ("make", "settings", "message"),
    [
        (ViewConfig, {"field_of_view": 0.0}, r"must lie in \(0, 360\] deg, not 0.0"),
        (ViewConfig, {"field_of_view": math.nan}, "field_of_view must lie .* not nan"),
        (ViewConfig, {"diameter": 0.0}, "diameter must be positive.* not 0.0"),
        (ViewConfig, {"diameter": math.inf}, "diameter must be positive.* not inf"),
        (TannerShare, {"goals": False, "goal_headings": True}, "needs share.goals"),
        (TannerObservation, {"tracked_cars": -1}, "tracked_cars must be at least 0"),
        (TannerObservation, {"bay_parts": ("size",)}, "bay_parts .* one of .*'size'"),
        (TannerObservation, {"bay_parts": ("bearing",) * 2}, "must be different"),
        (TannerObservation, {"encoding": "indices"}, "encoding must be .tanner., not"),
        (IndexObservation, {"encoding": "words"}, "'indices', not 'words'"),
    ],
)
def test_impossible_settings_are_refused_in_a_sentence(make, settings, message):
    with pytest.raises(ValueError, match=message) as caught:
        make(**settings)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"observation": IndexObservation()}, "'indices' needs grid physics, not mjx"),
        (
            {"observation": IndexObservation(), "physics": "grid", "goals": DYNAMIC},
            "'indices' needs fixed goals, not dynamic ones",
        ),
        (
            {
                "observation": TannerObservation(share=TannerShare(goal_headings=True)),
                "goals": DYNAMIC,
            },
            "share.goal_headings needs fixed goals",
        ),
        (
            {
                "fleet": FleetConfig(agents=("city", "van")),
                "observation": TannerObservation(),
            },
            "fleet.agents needs observation.own_car = True",
        ),
        (
            {
                "giving_way": GivingWayConfig("L,L,S"),
                "goals": DYNAMIC,
                "observation": TannerObservation(global_information=True),
            },
            "scheme 'L,L,S' needs observation.global_information = False, not True",
        ),
        (
            {
                "giving_way": GivingWayConfig("L,L,S"),
                "goals": DYNAMIC,
                "observation": TannerObservation(tracked_cars=0),
            },
            "tracks at least 1 agent",
        ),
    ],
)
def test_an_observation_that_does_not_fit_the_task_is_refused(settings, message):
    with pytest.raises(ValueError, match=message) as caught:
        EnvConfig(**settings)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "settings",
    [
        {"observation": IndexObservation(), "physics": "grid"},
        {"observation": TannerObservation(6), "num_agents": 3, "num_parked_cars": 4},
        {"observation": TannerObservation(global_information=True), "goals": DYNAMIC},
    ],
)
def test_an_observation_that_fits_the_task_stays_what_was_set(settings):
    config = EnvConfig(**settings)
    for name, value in settings.items():
        assert getattr(config, name) == value


def test_the_encoders_are_known_by_name():
    for encoder in (TannerObservation, IndexObservation):
        assert ENCODERS[encoder().encoding] is encoder
