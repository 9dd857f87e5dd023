"""A lot as JaxMARL sees it."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

pytest.importorskip("jaxmarl")

from jaxmarl.wrappers.baselines import CTRolloutManager, LogWrapper

from carpark_mj.config import EnvConfig, GoalConfig
from carpark_mj.types import NO_BAY
from carpark_mj.wrappers.jaxmarl import JaxMarlParking

LOTS = 8


@pytest.fixture(scope="module")
def env():
    return JaxMarlParking(agents=2, parked_cars=2, physics="bicycle")


def test_lots_end_together_and_start_again(env):
    """Agent 0 drives into something, agent 1 stands until its time is up."""
    keys = jax.random.split(jax.random.key(0), LOTS)
    log = LogWrapper(env)
    observation, state = jax.vmap(log.reset)(keys)
    for agent in env.agents:
        assert env.observation_space(agent).contains(observation[agent][0])
    drive = jnp.tile(jnp.array([0.0, 1.0]), (LOTS, 1))
    actions = {"agent_0": drive, "agent_1": 0 * drive}

    def step(carry, key):
        key = jax.random.split(key, LOTS)
        observation, state, *rest = jax.vmap(log.step)(key, carry, actions)
        return state, (observation, *rest)

    keys = jax.random.split(jax.random.key(1), 200)
    _, (observation, reward, done, info) = jax.lax.scan(step, state, keys)
    ended, over = np.asarray(done["agent_0"]), np.asarray(done["__all__"])
    alone = []
    for lot in range(LOTS):
        crash, last = ended[:, lot].argmax(), over[:, lot].argmax()
        assert info["crashed"][crash, lot, 0]
        assert ended[crash : last + 1, lot].all()  # stays done
        alone.append(crash < last)
        waits = slice(crash + 1, last)
        assert not np.asarray(observation["agent_0"])[waits, lot].any()
        assert not np.asarray(reward["agent_0"])[waits, lot].any()
        assert observation["agent_0"][last, lot].any()  # of the next lot
        np.testing.assert_allclose(
            info["returned_episode_returns"][last, lot],
            [reward[agent][: last + 1, lot].sum() for agent in env.agents],
            rtol=1e-4,
        )
    assert over.any(axis=0).all()
    assert any(alone)  # agent 1 drove on in one lot at least


def test_q_learners_have_numbered_actions():
    env = JaxMarlParking(agents=1, physics="bicycle", discrete=True)
    manager = CTRolloutManager(env, batch_size=3)
    observation, state = manager.batch_reset(jax.random.key(0))
    assert observation["__all__"].shape[0] == 3
    actions = manager.batch_sample(jax.random.key(1), "agent_0")
    assert actions.shape == (3,)
    assert actions.max() < env.action_space("agent_0").n == 77
    manager.batch_step(jax.random.key(2), state, {"agent_0": actions})


def test_q_learners_know_which_bays_they_may_choose():
    chosen = EnvConfig(goals=GoalConfig(dynamic=True, num_tracked_bays=2))
    given = {"config": chosen, "physics": "bicycle", "agents": 2, "parked_cars": 2}
    env = JaxMarlParking(discrete=True, details=True, **given)
    _, state = env.reset(jax.random.key(0))
    empty = dataclasses.replace(state, tracked_bays=jnp.array([[NO_BAY, 1], [2, 3]]))
    masks = env.get_avail_actions(empty)
    number = env.action_space("agent_0").n
    rows = np.arange(number) % 3 != 1  # choices are the last part of a row
    np.testing.assert_array_equal(masks["agent_0"], rows)
    assert masks["agent_1"].all()
    actions = dict.fromkeys(env.agents, jnp.int32(2))
    _, _, reward, _, infos = env.step(jax.random.key(1), state, actions)
    paid = sum(x for name, x in infos.items() if name[:7] == "reward_")
    np.testing.assert_allclose(paid, [reward[a] for a in env.agents], atol=1e-6)
