"""Warm starts take the networks of another run and nothing else."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from carpark_mj.config import ContinuousObservation, EnvConfig, SimConfig
from carpark_mj.policy.checkpoints import CheckpointError
from carpark_mj.policy.networks import NetworkConfig
from learners.ppo.learner import Learner
from learners.ppo.presets import PRESETS
from learners.ppo.train import load_or_init, save
from learners.ppo.warm_start import require_run

KEY = jax.dtypes.prng_key
NETWORKS = ("normalizer", "policy", "average", "value")
TINY = dataclasses.replace(
    PRESETS["cpu"],
    num_lots=2,
    unroll_length=8,
    num_minibatches=1,
    networks=NetworkConfig((16,), (16,), own_size=8, entity_size=8),
    env=EnvConfig(num_agents=2, sim=SimConfig(sim_dt=0.02)),
)


@pytest.fixture(scope="module")
def other(tmp_path_factory):
    """Folder and state of a run whose every float was moved."""
    folder = tmp_path_factory.mktemp("other")
    state = jax.device_get(Learner(TINY).init())
    rng = np.random.default_rng(0)
    moved = {
        name: jax.tree.map(
            lambda x: (x + rng.uniform(0.5, 1.0, x.shape)).astype(x.dtype), tree
        )
        for name, tree in vars(state).items()
        if name in (*NETWORKS, "optimizer")
    }
    state = dataclasses.replace(state, **moved, update=np.int32(7))
    save(folder, TINY, state)
    return folder, state


def test_networks_and_statistics_are_taken_and_the_rest_is_new(other, tmp_path):
    folder, theirs = other
    config = dataclasses.replace(TINY, warm_start=str(folder), seed=3)
    own = Learner(config).init()
    state = load_or_init(Learner(config), [tmp_path])
    for name in vars(own):
        expected = theirs if name in NETWORKS else own
        found, wanted = (
            [
                jax.random.key_data(x) if jnp.issubdtype(x.dtype, KEY) else x
                for x in jax.tree.leaves(getattr(tree, name))
            ]
            for tree in (state, expected)
        )
        jax.tree.map(np.testing.assert_array_equal, found, wanted)
    assert state.update == 0


def test_a_resumed_run_goes_on_from_its_own_checkpoint(other, tmp_path):
    folder, _ = other
    config = dataclasses.replace(TINY, warm_start=str(folder))
    own = jax.device_get(Learner(TINY).init())
    save(tmp_path, config, own)
    state = load_or_init(Learner(config), [tmp_path])
    jax.tree.map(np.testing.assert_array_equal, state.policy, own.policy)


def refused(tmp_path, error, match, **changes):
    with pytest.raises(error, match=match):
        load_or_init(Learner(dataclasses.replace(TINY, **changes)), [tmp_path])


def test_what_cannot_be_taken_over_is_refused(other, tmp_path):
    folder = str(other[0])
    with pytest.raises(ValueError, match="of a run, not 'square'"):
        require_run(dataclasses.replace(TINY, warm_start="square"))
    require_run(dataclasses.replace(TINY, warm_start=folder))
    refused(tmp_path, CheckpointError, "no checkpoint", warm_start=str(tmp_path))
    refused(
        tmp_path,
        CheckpointError,
        r"is needed",
        warm_start=folder,
        networks=dataclasses.replace(TINY.networks, policy_layers=(8,)),
    )
    refused(
        tmp_path,
        ValueError,
        r"was trained on other observations",
        warm_start=folder,
        env=dataclasses.replace(
            TINY.env, observation=ContinuousObservation(own_car=True)
        ),
    )
