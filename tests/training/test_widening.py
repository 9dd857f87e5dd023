"""Networks for agents that observe more: where the numbers of the others go."""

import dataclasses

import numpy as np

from carpark_mj.config import EnvConfig, RayConfig
from carpark_mj.observations import ContinuousObservation, make_fields
from carpark_mj.training.ppo.config import PPOConfig
from carpark_mj.training.ppo.learner import Learner
from carpark_mj.training.ppo.warm_start import widen

TINY = PPOConfig(num_lots=2, num_minibatches=1, env=EnvConfig(num_agents=2))


def test_near_rays_keep_their_bearings():
    few, many = (
        dataclasses.replace(
            TINY.env, observation=ContinuousObservation(rays=RayConfig(count, near=1.0))
        )
        for count in (24, 72)
    )

    def near(env):
        """Whether the agent's own numbers are near rays."""
        own = [field for field in make_fields(env) if not field.group]
        names = [field.name for field in own for _ in range(field.size)]
        return np.array(names) == "rays_near"

    theirs = Learner(dataclasses.replace(TINY, env=few)).init().normalizer
    numbered = np.arange(near(few).size, dtype=np.float32)
    theirs = theirs | {"own": theirs["own"].replace(mean=numbered)}
    config = dataclasses.replace(TINY, env=many)
    wide = widen(config, few, {"normalizer": theirs}, {"normalizer": {}})["normalizer"]
    found = np.asarray(wide["own"].mean)[near(many)]
    np.testing.assert_array_equal(found[::3], numbered[near(few)])
    np.testing.assert_array_equal(np.delete(found, np.s_[::3]), 0.0)
