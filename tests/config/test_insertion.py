"""Configs with other values of some settings."""

import pytest

from carpark_mj.config import EnvConfig, insert


def test_values_are_found_by_their_paths_and_the_config_stays_as_it_is():
    config = EnvConfig()
    new = insert(config, {"reward.park": 3.0, "num_agents": 5})
    assert (new.reward.park, new.num_agents) == (3.0, 5)
    assert new.reward.crash == config.reward.crash
    assert config == EnvConfig()


@pytest.mark.parametrize(
    ("path", "sentence"),
    [
        ("rewards.park", "EnvConfig has no setting 'rewards': it has layout, vehicle"),
        ("reward.park.x", "float has no setting 'x': it has none"),
        ("reward.", "RewardConfig has no setting '': it has park"),
        ("reward.parking", "RewardConfig has no setting 'parking': it has park, crash"),
    ],
)
def test_misspelt_paths_are_refused_with_what_there_is(path, sentence):
    with pytest.raises(ValueError, match=sentence):
        insert(EnvConfig(), {path: 1.0})
