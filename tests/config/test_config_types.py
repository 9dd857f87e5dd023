"""Fields of configs are of the types they declare, in every config there is."""

import dataclasses

import numpy as np
import pytest

from carpark_mj.config import EnvConfig, ParkedRule, RewardConfig, SimConfig
from carpark_mj.layouts.base import FAMILIES
from carpark_mj.policy.networks import NetworkConfig
from carpark_mj.training.ppo.config import CurriculumConfig, PPOConfig


def config_classes(cls, found):
    """A config's class and those of all configs in it."""
    found.add(cls)
    for field in dataclasses.fields(cls):
        value = getattr(cls(), field.name)
        if dataclasses.is_dataclass(value) and type(value) not in found:
            config_classes(type(value), found)
    return found


CLASSES = config_classes(EnvConfig, {ParkedRule})
CLASSES |= {family for name, family in FAMILIES.items() if name != "from_file"}
CLASSES |= {NetworkConfig, CurriculumConfig, PPOConfig}
JUNK = (object(), b"x", 1j, [1], {"a": 1}, (object(),), np.zeros(2), range(3), 10**400)


@pytest.mark.parametrize("cls", sorted(CLASSES, key=lambda cls: cls.__name__))
def test_no_field_takes_a_value_of_another_type(cls):
    for field in dataclasses.fields(cls):
        for junk in JUNK:
            if isinstance(junk, dict) and (cls, field.name) == (RewardConfig, "extra"):
                continue  # unknown terms
            with pytest.raises(ValueError, match=rf"\b{field.name}\b.* not "):
                cls(**{field.name: junk})


def test_numbers_may_be_numpys():
    config = SimConfig(ctrl_dt=np.float32(0.25), sim_dt=np.float64(0.05))
    assert config.num_substeps == 5
    assert EnvConfig(num_agents=np.int32(3)).num_agents == 3
