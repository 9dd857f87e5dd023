"""Configs of what agents observe: defaults, and settings that are refused."""

import pytest

from carpark_mj.config import EnvConfig, FleetConfig, GivingWayConfig, GoalConfig
from carpark_mj.observations import ContinuousObservation

DYNAMIC = GoalConfig(dynamic=True)
GLOBAL = ContinuousObservation(global_information=True)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (
            {"fleet": FleetConfig(agents=("city", "van"))},
            "fleet.agents needs observation.own_car = True",
        ),
        (
            {"giving_way": GivingWayConfig("G,G,S"), "goals": DYNAMIC},
            "scheme 'G,G,S' needs observation.global_information = True, not False",
        ),
        (
            {
                "giving_way": GivingWayConfig("L,L,S"),
                "goals": DYNAMIC,
                "observation": GLOBAL,
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
        {
            "fleet": FleetConfig(agents=("city", "van")),
            "observation": ContinuousObservation(own_car=True),
        },
        {
            "giving_way": GivingWayConfig("G,L,A"),
            "goals": DYNAMIC,
            "observation": GLOBAL,
        },
        # Without a scheme global information is a matter of taste.
        {"observation": GLOBAL, "goals": DYNAMIC},
        {"observation": GLOBAL},
    ],
)
def test_an_observation_that_fits_the_task_stays_what_was_set(settings):
    config = EnvConfig(**settings)
    for name, value in settings.items():
        assert getattr(config, name) == value
