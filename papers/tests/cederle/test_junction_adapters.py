"""The junction as PettingZoo, batches, TorchRL, BenchMARL and JaxMARL see it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from carpark_mj.wrappers.batch import Batch, NumpyBatch
from carpark_papers.cederle.adapters.common import junction_env
from carpark_papers.cederle.junction import RasterConfig

SMALL = {"scenario": "2av-hd"}  # as on the page: compiled once
IMAGE = {"observation": "image", "raster": RasterConfig(pixels=12)}


@pytest.fixture
def parallel():
    pytest.importorskip("pettingzoo")
    from carpark_papers.cederle.adapters.pettingzoo import junction_parallel_env

    return junction_parallel_env


@pytest.mark.filterwarnings("ignore:The old environment creation API")  # its own
def test_pettingzoo_accepts_images(parallel):
    from pettingzoo.test import parallel_api_test

    env = parallel(**SMALL, **IMAGE)
    parallel_api_test(env, num_cycles=50)
    observations, _ = env.reset(seed=0)
    assert env.state_space.contains(env.state())
    assert env.observation_space("agent_0").contains(observations["agent_0"])


def test_pettingzoo_s_agents_leave_together_and_hear_who_crashed(parallel):
    env = parallel(**SMALL, render_mode="rgb_array")
    observations, _ = env.reset(seed=0)
    assert env.observation_space("agent_0").contains(observations["agent_0"])
    while env.agents:
        action = dict.fromkeys(env.agents, np.array([0]))
        _, rewards, terminated, truncated, infos = env.step(action)
    assert all(terminated.values())
    assert not any(truncated.values())
    assert infos["agent_0"] == {"is_success": False, "crashed": True}
    assert infos["agent_1"] == {"is_success": False, "crashed": False}
    assert rewards["agent_0"] < -8
    picture = env.render()
    assert picture.shape == (540, 960, 3)
    assert picture.std() > 5
    np.testing.assert_array_equal(env.render(), picture)
    env.close()


def test_a_batch_restarts_junctions_that_are_over():
    env = junction_env(**SMALL)
    batch = Batch(env, 3)
    first = batch.reset(seed=0)
    for k in range(75):
        step = batch.step(jnp.ones((3, 2, 1), jnp.int32))
        assert bool(step.over.all()) == (k == 74)
    np.testing.assert_allclose(step.observation, first, atol=1e-5)
    assert (step.final_observation != first).any()
    assert batch.state.step.tolist() == [0, 0, 0]


def test_a_batch_of_images_restarts_when_asked():
    batch = NumpyBatch(junction_env(**SMALL, **IMAGE), 1, restart=False)
    first = batch.reset_numpy(seed=0)
    for due in (False, True):
        step = batch.step_numpy(np.zeros((1, 2, 1), int))
        assert (step.observation != first).any()
        seen = batch.restart(np.array([due]))
        assert seen.dtype == np.uint8
        np.testing.assert_array_equal(seen, first if due else 0)
        assert batch.state.step.tolist() == [0 if due else 1]


def test_bad_input_is_refused_in_one_sentence():
    with pytest.raises(TypeError, match="keyword argument 'respawn'; choose from"):
        junction_env(respawn=True)
    with pytest.raises(ValueError, match="unknown scenario '9av'"):
        junction_env(scenario="9av")
    batch = NumpyBatch(junction_env(**SMALL), 1)
    with pytest.raises(ValueError, match=r"shape \(1, 2, 1\), not \(1, 2\)"):
        batch.step_numpy(np.zeros((1, 2), int))


@pytest.mark.parametrize("options", [{}, {"action": "scalar"}, IMAGE])
def test_torchrl_accepts_junctions(options):
    pytest.importorskip("torchrl")
    from torchrl.envs.utils import check_env_specs

    from carpark_papers.cederle.adapters.torchrl import TorchRLJunction

    env = TorchRLJunction(3, seed=0, **SMALL, **options)
    check_env_specs(env)
    rollout = env.rollout(80, break_when_any_done=False)
    over = rollout["next", "done"][..., 0]
    assert over.any(dim=1).all()
    assert rollout["next", "agents", "info", "arrived"].shape == (3, 80, 2, 1)


def test_jaxmarl_steps_junctions_and_begins_them_anew():
    pytest.importorskip("jaxmarl")
    from carpark_papers.cederle.adapters.jaxmarl import JaxMarlJunction

    env = JaxMarlJunction(**SMALL, end="all")
    keys = jax.random.split(jax.random.key(0), 3)
    observations, state = jax.vmap(env.reset)(keys)
    assert observations["agent_1"].shape == (3, 14)
    assert env.action_space("agent_0").n == 4
    actions = dict.fromkeys(env.agents, jnp.ones(3, int))

    def step(state, key):
        key = jax.random.split(key, 3)
        _, state, _, dones, infos = jax.vmap(env.step)(key, state, actions)
        return state, (dones["__all__"], infos["timed_out"])

    keys = jax.random.split(jax.random.key(1), 75)
    state, (over, late) = jax.lax.scan(step, state, keys)
    assert over[-1].all()
    assert not over[:-1].any()
    assert late[-1].all()
    assert state.step.tolist() == [0, 0, 0]


@pytest.mark.filterwarnings("ignore")  # of libraries
@pytest.mark.parametrize("name", ["qmix", "maddpg"])
def test_benchmarl_learns_by_index_and_by_scalar(name, tmp_path):
    pytest.importorskip("benchmarl")
    from benchmarl.algorithms import algorithm_config_registry
    from benchmarl.experiment import Experiment, ExperimentConfig
    from benchmarl.models.mlp import MlpConfig

    from carpark_papers.cederle.adapters.benchmarl import JunctionTask

    config = ExperimentConfig.get_from_yaml()
    config.max_n_frames, config.evaluation = 64, False
    config.off_policy_collected_frames_per_batch = 32
    config.off_policy_n_envs_per_worker, config.off_policy_n_optimizer_steps = 4, 1
    config.off_policy_train_batch_size, config.off_policy_memory_size = 16, 64
    config.create_json, config.loggers, config.save_folder = False, ["csv"], tmp_path
    experiment = Experiment(
        task=JunctionTask.JUNCTION.get_task(SMALL),
        algorithm_config=algorithm_config_registry[name].get_from_yaml(),
        model_config=MlpConfig.get_from_yaml(),
        critic_model_config=MlpConfig.get_from_yaml(),
        seed=0,
        config=config,
    )
    group = experiment.action_spec["agents", "action"]
    assert group.shape == ((2,) if name == "qmix" else (2, 1))
    experiment.run()
    assert experiment.n_iters_performed == 2


def test_cameras_follow_human_driven_cars_and_resets_have_no_options(parallel):
    parallel(scenario="2av-hd", camera="chase:2")
    with pytest.raises(ValueError, match=r"unknown camera 'chase:3'; .* 0 to 2"):
        parallel(scenario="2av-hd", camera="chase:3")
    with pytest.raises(ValueError, match=r"JunctionEnv\.reset takes no options"):
        parallel().reset(seed=0, options={"agent_0": {"speed": 1.0}})
