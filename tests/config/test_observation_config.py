"""Configs of what agents observe: defaults, and settings that are refused."""

import dataclasses
import math

import pytest

from carpark_mj.config import (
    ContinuousObservation,
    EnvConfig,
    FleetConfig,
    GivingWayConfig,
    GoalConfig,
    IndexObservation,
    RayConfig,
    RingConfig,
    ShareConfig,
    TannerObservation,
    ViewConfig,
)

DYNAMIC = GoalConfig(dynamic=True)


@pytest.mark.parametrize(
    ("make", "settings", "message"),
    [
        (
            RingConfig,
            {"diameters": (4.0, -1.0)},
            r"positive, not \(4.0, -1.0\)",
        ),
        (RingConfig, {"diameters": (math.inf,)}, r"must be positive, not \(inf,\)"),
        (RingConfig, {"diameters": (4.0, 4.0)}, r"must be different, not \(4.0, 4.0\)"),
        (RingConfig, {"cap": 0}, "cap must be at least 1, not 0"),
        (RingConfig, {"history": -1}, "history must be at least 0, not -1"),
        (RingConfig, {"history": 2}, "ring history 2 needs ring diameters"),
        (ViewConfig, {"field_of_view": 0.0}, r"must lie in \(0, 360\] deg, not 0.0"),
        (ViewConfig, {"field_of_view": 400.0}, r"field_of_view must lie .* not 400.0"),
        (ViewConfig, {"field_of_view": math.nan}, r"field_of_view must lie .* not nan"),
        (ViewConfig, {"diameter": 0.0}, "view diameter must be positive .* not 0.0"),
        (ViewConfig, {"diameter": math.inf}, "must be positive or None, not inf"),
        (ShareConfig, {"goals": False, "goal_headings": True}, "needs share.goals"),
        (
            TannerObservation,
            {"share": ShareConfig(steering=True)},
            "share.steering needs the continuous encoding",
        ),
        (RayConfig, {"count": -1}, "count must be at least 0, not -1"),
        (RayConfig, {"reach": 0.0}, "reach must be positive, not 0.0"),
        (ContinuousObservation, {"tracked_agents": -1}, "tracked_agents must be at"),
        (ContinuousObservation, {"tracked_parked_cars": -2}, "at least 0, not -2"),
        (ContinuousObservation, {"encoding": "tanner"}, "unknown encoding 'tanner'"),
        (TannerObservation, {"tracked_cars": -1}, "tracked_cars must be at least 0"),
        (TannerObservation, {"bay_parts": ("size",)}, "bay_parts .* one of .*'size'"),
        (TannerObservation, {"bay_parts": ("bearing",) * 2}, "must be different"),
        (TannerObservation, {"encoding": "indices"}, r"choose from \['tanner'\]"),
        (IndexObservation, {"encoding": "words"}, "unknown encoding 'words'"),
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
            {
                "observation": IndexObservation(),
                "physics": "grid",
                "goals": DYNAMIC,
            },
            "'indices' needs fixed goals, not dynamic ones",
        ),
        (
            {
                "observation": ContinuousObservation(
                    share=ShareConfig(goal_headings=True)
                ),
                "goals": DYNAMIC,
            },
            "share.goal_headings needs fixed goals",
        ),
        (
            {"fleet": FleetConfig(agents=("city", "van"))},
            "fleet.agents needs observation.own_car = True",
        ),
        (
            {
                "fleet": FleetConfig(agents=("city", "van")),
                "observation": TannerObservation(),
            },
            "fleet.agents needs observation.own_car = True of the encoding",
        ),
        (
            {"giving_way": GivingWayConfig("G,G,S"), "goals": DYNAMIC},
            "scheme 'G,G,S' needs observation.global_information = True, not False",
        ),
        (
            {
                "giving_way": GivingWayConfig("L,L,S"),
                "goals": DYNAMIC,
                "observation": TannerObservation(global_information=True),
            },
            "scheme 'L,L,S' needs observation.global_information = False, not True",
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
        {
            "observation": TannerObservation(6),
            "num_agents": 3,
            "num_parked_cars": 4,
        },
        {
            "fleet": FleetConfig(agents=("city", "van")),
            "observation": ContinuousObservation(own_car=True),
        },
        {
            "giving_way": GivingWayConfig("G,L,A"),
            "goals": DYNAMIC,
            "observation": ContinuousObservation(global_information=True),
        },
        # Without a scheme global information is a matter of taste.
        {"observation": TannerObservation(global_information=True), "goals": DYNAMIC},
        {"observation": ContinuousObservation(global_information=True)},
    ],
)
def test_an_observation_that_fits_the_task_stays_what_was_set(settings):
    config = EnvConfig(**settings)
    for name, value in settings.items():
        assert getattr(config, name) == value


def test_an_encoding_has_no_settings_of_another():
    names = {
        make: {field.name for field in dataclasses.fields(make)}
        for make in (ContinuousObservation, TannerObservation, IndexObservation)
    }
    assert names[IndexObservation] == {"rings", "encoding"}
    own = names[TannerObservation] - names[ContinuousObservation]
    assert own == {"tracked_cars", "bay_parts"}
    for make in names:
        assert make().encoding in {"continuous", "tanner", "indices"}
    assert len({make().encoding for make in names}) == 3
