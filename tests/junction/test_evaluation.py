"""Evaluation of policies at the junction, on a line of made-up steps."""

import types

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import struct

from carpark_mj.junction import JunctionConfig, RewardRules
from carpark_mj.junction.evaluation import (
    EXTRA_STEPS,
    Outcomes,
    evaluate,
    evaluation_env,
    summarize,
)


@struct.dataclass
class State:
    step: jax.Array
    active: jax.Array


class Script:
    """Two agents whose ends are written down; reward 1 per step and active agent.

    Attributes:
        arrives: steps in which they do, -1 = never.
        crashes: the same of crashes.
    """

    num_agents = 2

    def __init__(self, arrives, crashes, max_steps=8):
        self.arrives, self.crashes = jnp.array(arrives), jnp.array(crashes)
        self.config = types.SimpleNamespace(max_steps=max_steps)

    def reset(self, key):
        del key
        state = State(jnp.zeros((), int), jnp.ones(2, bool))
        return state, jnp.zeros((2, 1))

    def step(self, state, action):
        before, number = state.active, state.step + 1
        arrived = before & (self.arrives == number)
        crashed = before & (self.crashes == number)
        events = types.SimpleNamespace(arrived=arrived, crashed=crashed)
        timestep = types.SimpleNamespace(
            reward=before * action.astype(float),
            events=events,
            observation=jnp.zeros((2, 1)),
        )
        return State(number, before & ~arrived & ~crashed), timestep


def outcome(env, **options):
    config = JunctionConfig(max_steps=6, **options)
    keys = jax.random.split(jax.random.key(0), 3)
    found = evaluate(env, config, lambda _: jnp.ones(2, int), keys)
    assert found.returns.shape == (3,)
    return jax.tree.map(lambda x: x[0].item(), found)


@pytest.mark.parametrize(
    ("arrives", "crashes", "any_end", "all_end"),
    [
        # The first arrives in step 3: 3 + 3; the second drives on to step 5: 3 + 5.
        ((3, 5), (-1, -1), (6, 3, False, True), (8, 5, False, True)),
        # Both crash in step 2.
        ((-1, -1), (2, 2), (4, 2, True, False), (4, 2, True, False)),
        # The first arrives, the second crashes when the study has looked away.
        ((2, -1), (-1, 4), (4, 2, True, False), (6, 4, True, False)),
        # Nobody comes to an end: `max_steps` of the training.
        ((-1, -1), (-1, -1), (12, 6, False, False), (12, 6, False, False)),
        # The second arrives after those steps.
        ((3, 7), (-1, -1), (6, 3, False, True), (9, 6, False, True)),
    ],
)
def test_made_up_episodes_are_counted(arrives, crashes, any_end, all_end):
    env = Script(arrives, crashes)
    for end, (returned, length, crashed, completed) in (
        ("any", any_end),
        ("all", all_end),
    ):
        found = outcome(env, end=end)
        assert found == Outcomes(returned, length, crashed, completed)


def test_joint_rewards_are_counted_once():
    joint = RewardRules(joint=True)
    assert outcome(Script((3, 3), (-1, -1)), rewards=joint).returns == 3.0


def test_a_summary_says_whether_the_mean_solves_the_scenario():
    outcomes = Outcomes(
        returns=np.array([90.0, 110.0]),
        length=np.array([50, 60]),
        crashed=np.array([True, False]),
        completed=np.array([False, True]),
    )
    assert summarize(outcomes, solved=100.0) == {
        "episodes": 2,
        "return": 100.0,
        "return_std": 10.0,
        "length": 55.0,
        "crashed": 0.5,
        "completed": 0.5,
        "solved": 1,
    }
    assert summarize(outcomes, solved=100.1)["solved"] == 0


def test_policies_are_evaluated_until_all_are_done_from_varied_starts():
    config = evaluation_env(JunctionConfig(max_steps=50, jitter=0.0), 1.5).config
    assert (config.end, config.restart, config.jitter) == ("all", False, 1.5)
    assert config.max_steps == 50 + EXTRA_STEPS
