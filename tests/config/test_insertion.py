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
    ("path", "close"),
    [
        ("rewards.park", "'reward'"),
        ("reward.parking", "'park'"),
        ("reward.park.x", "'x'"),
        ("reward.", "'park'"),
    ],
)
def test_misspelt_paths_are_refused(path, close):
    with pytest.raises(ValueError, match=close):
        insert(EnvConfig(), {path: 1.0})


def test_what_follows_from_settings_follows_from_the_new_ones():
    config = EnvConfig()
    assert (config.physics_config.back_end, config.varies) == ("mjx", False)
    new = insert(config, {"physics": "bicycle", "occupancy": (0.1, 0.2)})
    assert (new.physics_config.back_end, new.varies) == ("bicycle", True)
    assert (config.physics_config.back_end, config.varies) == ("mjx", False)
