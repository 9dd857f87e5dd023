"""Settings of dynamic goals and giving way."""

import dataclasses

import pytest

from carpark_mj.config import (
    EnvConfig,
    GivingWayConfig,
    GoalConfig,
    GoalRewards,
    RewardConfig,
)

DYNAMIC = GoalConfig(dynamic=True)
BAD_REWARDS = [
    ({"continue_explore": 0.0}, "continue_explore must be negative .* not 0.0"),
    ({"change_goal": 0.1}, "change_goal must be at most 0 .* not 0.1"),
    ({"stop_goal": -0.06}, r"change_goal = stop_goal \+ .* -0.05 = -0.06 \+ 0.0"),
    ({"stop_explore": 0.1, "stop_goal": -0.05}, "change_goal = stop_goal"),
]


@pytest.mark.parametrize(("change", "message"), BAD_REWARDS)
def test_rewards_that_break_the_constraints_are_refused(change, message):
    reward = RewardConfig(goals=GoalRewards(**change))
    EnvConfig(reward=reward)  # nobody is paid for fixed goals
    with pytest.raises(ValueError, match=message) as caught:
        EnvConfig(goals=DYNAMIC, reward=reward)
    assert "\n" not in str(caught.value)


def test_rewards_that_obey_the_constraints_to_rounding_are_taken():
    pay = GoalRewards(stop_explore=-0.1, stop_goal=-0.2, change_goal=-0.1 - 0.2)
    assert EnvConfig(goals=DYNAMIC, reward=RewardConfig(goals=pay)).goals.dynamic
    # Changing goals may cost nothing, as in a run of the study.
    pay = GoalRewards(change_goal=0.0)
    reward = EnvConfig(goals=DYNAMIC, reward=RewardConfig(goals=pay)).reward
    assert reward.goals.stop == 0.0  # by rule (3.5)


@pytest.mark.parametrize(("scheme", "needed"), [("L,L,A", False), ("G,G,A", True)])
def test_a_scheme_says_what_must_be_observed(scheme, needed):
    seen, other = (
        dataclasses.replace(EnvConfig().observation, global_information=given)
        for given in (needed, not needed)
    )
    settings = {"goals": DYNAMIC, "giving_way": GivingWayConfig(scheme)}
    assert EnvConfig(**settings, observation=seen)
    with pytest.raises(ValueError, match=f"{scheme}.*global_information = {needed}"):
        EnvConfig(**settings, observation=other)


@pytest.mark.parametrize(
    ("scheme", "information", "context"),
    [
        ("L,L,S", False, "local_same"),
        ("L,L,A", False, "local_any"),
        ("G,L,S", True, "local_same"),
        ("G,L,A", True, "local_any"),
        ("G,G,S", True, "global_same"),
        ("G,G,A", True, "global_any"),
        (None, False, None),
    ],
)
def test_schemes_say_what_is_known_and_what_is_enforced(scheme, information, context):
    config = GivingWayConfig(scheme)
    assert config.global_information is information
    assert config.context == context
