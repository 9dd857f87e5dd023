"""Evaluation of policies at the junction, on a line of made-up steps."""

import dataclasses
import types
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import struct

from carpark_papers.cederle.junction import JunctionConfig, RewardRules, scenario
from carpark_papers.cederle.junction.evaluation import (
    MAX_STEPS,
    NEVER,
    RETURN_STEPS,
    Outcomes,
    car_names,
    evaluate,
    evaluation_env,
    summarize,
)
from carpark_papers.cederle.junction.rules import KEEP_LANE, SLOW_DOWN

WAY = 4.0  # m, at which the junction ends; a car drives 1 m per step


@struct.dataclass
class State:
    step: jax.Array
    active: jax.Array
    present: jax.Array
    along: jax.Array
    task: Any


@jax.tree_util.register_static
@dataclasses.dataclass
class Task:
    routes: Any
    order: None = None

    def __hash__(self):
        return 0


class Script:
    """Two agents whose ends are written down; reward 1 per step and active agent.

    The second starts 1 m further along than the first.

    Attributes:
        arrives: steps in which they do, -1 = never.
        crashes: the same of crashes.
    """

    num_agents = num_cars = 2

    def __init__(self, arrives, crashes, rewards=None):
        self.arrives, self.crashes = jnp.array(arrives), jnp.array(crashes)
        self.config = JunctionConfig(
            max_steps=MAX_STEPS, rewards=rewards or RewardRules()
        )

    def reset(self, key):
        del key
        here = jnp.ones(2, bool)
        routes = types.SimpleNamespace(curve=jnp.array([[0.0, WAY], [0.0, WAY]]))
        state = State(jnp.zeros((), int), here, here, jnp.arange(2.0), Task(routes))
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
        after = dataclasses.replace(
            state,
            step=number,
            active=before & ~arrived & ~crashed,
            present=before,
            along=state.along + 1,
        )
        return after, timestep


def outcome(env):
    keys = jax.random.split(jax.random.key(0), 3)
    found = evaluate(env, lambda _: jnp.ones(2, int), keys)
    assert found.returns.shape == (3,)
    return jax.tree.map(lambda x: x[0].tolist(), found)


@pytest.mark.parametrize(
    ("arrives", "crashes", "expected"),
    [
        # The first arrives in step 5: 5 + 5; the second drives on.
        ((5, 6), (-1, -1), (10, 5, False, True, [4, 3])),
        # Both crash in step 2.
        ((-1, -1), (2, 2), (4, 2, True, False, [NEVER] * 2)),
        # The first arrives, the second crashes when the study has looked away.
        ((2, -1), (-1, 4), (4, 2, True, False, [NEVER, 3])),
        # The second does not arrive.
        ((5, -1), (-1, -1), (10, 5, False, False, [4, 3])),
        # Nobody comes to an end, or too late for the return.
        ((-1, -1), (-1, -1), (150, RETURN_STEPS, False, False, [4, 3])),
        ((80, 90), (-1, -1), (150, RETURN_STEPS, False, True, [4, 3])),
    ],
)
def test_made_up_episodes_are_counted(arrives, crashes, expected):
    assert outcome(Script(arrives, crashes)) == Outcomes(*expected)


def test_joint_rewards_are_counted_once():
    script = Script((3, 3), (-1, -1), rewards=RewardRules(joint=True))
    assert outcome(script).returns == 3.0


def test_a_summary_says_whether_the_mean_solves_it_and_who_yields():
    outcomes = Outcomes(
        returns=np.array([90.0, 110.0]),
        length=np.array([50, 60]),
        crashed=np.array([True, False]),
        completed=np.array([False, True]),
        passed=np.array([[NEVER, NEVER], [30, 40]]),
    )
    assert summarize(outcomes, scenario("2av")) == {
        "episodes": 2,
        "return": 100.0,
        "return_std": 10.0,
        "length": 55.0,
        "crashed": 0.5,
        "completed": 0.5,
        "solved": 1,
        "east_before_west": 0.5,
        "west_before_east": 0.0,
    }
    harder = dataclasses.replace(scenario("2av"), solved=100.1)
    assert summarize(outcomes, harder)["solved"] == 0


def test_cars_on_the_same_way_do_not_give_way_to_each_other():
    assert car_names(scenario("3av-hd")) == ["east", "south", "west", "human"]
    passed = np.array([[40, 20, 30, 10]])
    none = np.zeros(1)
    row = summarize(Outcomes(none, none, none, none, passed), scenario("3av-hd"))
    order = {name for name, share in row.items() if "_before_" in name and share}
    assert order == {
        "south_before_east",
        "south_before_west",
        "west_before_east",
        "human_before_east",
        "human_before_west",
    }


def test_who_gives_way_is_told_of_missions_not_of_agents():
    """The car from the east stands; it may be either agent."""
    env = evaluation_env(JunctionConfig(shuffle=True), 0.0)
    keys = jax.random.split(jax.random.key(0), 8)
    state, _ = jax.jit(jax.vmap(env.reset))(keys)
    assert {tuple(row) for row in state.task.order.tolist()} == {(0, 1), (1, 0)}

    def policy(observation):
        west = observation[:, 8] < 0.0  # cosine of the heading
        return jnp.where(west, SLOW_DOWN, KEEP_LANE)

    found = jax.jit(lambda keys: evaluate(env, policy, keys))(keys)
    row = summarize(found, scenario("2av"))
    assert (row["west_before_east"], row["east_before_west"]) == (1.0, 0.0)


def test_policies_are_evaluated_until_done_from_varied_starts():
    config = evaluation_env(JunctionConfig(max_steps=50, jitter=0.0), 1.5).config
    assert (config.end, config.respawn, config.jitter) == ("all", False, 1.5)
    assert config.max_steps == MAX_STEPS
