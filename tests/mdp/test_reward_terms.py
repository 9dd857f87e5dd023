"""Reward terms that other code registers, and what goals that agents choose pay."""

import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.paying import GOAL, step, terms
from helpers.scenes import cars, lot
from helpers.transitions import no_goal_events, transition

from carpark_mj.config import (
    REWARD_TERMS,
    REWARDS,
    EnvConfig,
    GivingWayConfig,
    GoalConfig,
    GoalRewards,
    RewardConfig,
    RewardTerm,
    insert,
)
from carpark_mj.layouts import Maxima, pad_layout
from carpark_mj.mdp.goals import target_bay
from carpark_mj.mdp.rewards import TERMS, dynamic_progress, reward_terms, term_weights
from carpark_mj.training.ppo.group import make_learner, program
from carpark_mj.training.ppo.parts import PRESETS
from carpark_mj.types import NO_BAY

CALLS = []


def hurry(config, transition, above=1.5, kind=0.0):
    """Speed above a limit."""
    CALLS.append(kind)
    return jnp.maximum(transition.after.motion.speed - above, 0.0)


@pytest.fixture(autouse=True)
def registered(monkeypatch):
    """Two terms that are gone after each test."""
    term = RewardTerm(hurry, sign=-1, per_step=True, fixed=("kind",))
    monkeypatch.setitem(REWARD_TERMS._parts, "hurry", term)
    bonus = RewardTerm(lambda config, step: jnp.ones_like(step.after.motion.speed))
    monkeypatch.setitem(REWARD_TERMS._parts, "bonus", bonus)
    CALLS.clear()


def paid(extra):
    before, after = (cars([(0.0, 0.0, 0.0)] * 2, speed=v) for v in ([0, 0], [1.0, 3.5]))
    return terms(RewardConfig(extra=extra), before, after, GOAL)


def test_a_term_pays_its_weight_its_sign_and_a_share_of_a_step():
    got = paid({"bonus": 0.25, "hurry": 10.0})
    assert tuple(got) == (*TERMS, "bonus", "hurry")  # in the order they are given
    np.testing.assert_allclose(got["bonus"], [0.25, 0.25])
    np.testing.assert_allclose(got["hurry"], [0.0, -10.0 / 200 * 2.0], atol=1e-7)


def test_parameters_are_those_of_the_config():
    got = paid({"hurry": 10.0, "hurry.above": 0.5, "hurry.kind": 2})
    np.testing.assert_allclose(got["hurry"], [-0.025, -0.15], atol=1e-7)
    assert CALLS == [2]


@pytest.mark.parametrize("extra", [{}, {"hurry": 0.0}])
def test_a_term_that_weighs_nothing_is_not_computed(extra):
    np.testing.assert_array_equal(paid(extra).get("hurry", 0.0), 0.0)
    assert not CALLS


def test_term_with_a_traced_weight_of_0_is_computed():
    reward = RewardConfig(extra={"hurry": 0.0, "hurry.above": 1.5})
    config = EnvConfig(num_agents=2, reward=reward)
    car = cars([(0.0, 0.0, 0.0)] * 2, speed=3.5)

    @jax.jit
    def pay(weight, above):
        values = {"reward.extra.hurry": weight, "reward.extra.hurry.above": above}
        traced = insert(config, values)
        return reward_terms(traced, step(config, car, car))["hurry"]

    for weight, above in ((0.0, 1.5), (2.0, 1.5), (2.0, 3.0)):
        expected = [-weight / 200 * (3.5 - above)] * 2
        np.testing.assert_allclose(pay(weight, above), expected, atol=1e-7)
    assert len(CALLS) == 1


def test_runs_side_by_side_differ_in_a_term_as_far_as_it_says():
    def run(**changes):
        extra = {"hurry": 1.0, "hurry.above": 2.0, "hurry.kind": 1.0} | changes
        config = PRESETS["cpu"]
        return insert(config, {"env.reward": RewardConfig(extra=extra)})

    assert program(run()) == program(run(hurry=2.0, **{"hurry.above": 1.0}))
    with pytest.raises(ValueError, match=r"the same env\.reward\.extra\.hurry\.kind"):
        make_learner([run(), run(**{"hurry.kind": 2.0})])


# Five bays in a row, 4 m apart, and as many bays' worth of padding.
ROW = pad_layout(
    lot([(x, 10.0, math.pi / 2) for x in (0, 4, 8, 12, 16)]), Maxima(8, 1, 1, 0, 1)
)


def config_of(reward, agents=1, scheme=None):
    return EnvConfig(
        num_agents=agents,
        goals=GoalConfig(dynamic=True),
        reward=reward,
        giving_way=scheme or GivingWayConfig(),
    )


def goal_step(config, goals, tracked, before, after, **more):
    """A step in which goals (before, after) are chosen among tracked bays."""
    old, new = (jnp.asarray(goal, jnp.int32) for goal in goals)
    tracked = jnp.broadcast_to(jnp.array(tracked), (config.num_agents, len(tracked)))
    more["target_pose"] = ROW.bay_pose[target_bay(ROW, new, tracked, after.xy)[0]]
    step = transition(config, ROW, before, after, {"tracked_bays": tracked}, **more)
    before, after = step.before.replace(goal=old), step.after.replace(goal=new)
    return step.replace(before=before, after=after)


def standing(config, goal_events, tracked=(0,)):
    """A step in which nobody moves and everybody has the goal 0."""
    still, goals = cars(np.zeros((config.num_agents, 3))), [0] * config.num_agents
    steps = (goals, goals), tracked, still, still
    return goal_step(config, *steps, goal_events=goal_events)


def progress(poses, goals, tracked=(0, 4)):
    """Progress of one agent over moves ((x, y, yaw) ...) with goals before each."""
    config = config_of(RewardConfig(progress=0.2, alignment=0.0))
    poses, goals = [cars([pose]) for pose in poses], [[goal] for goal in goals]
    steps = zip(itertools.pairwise(goals), itertools.pairwise(poses), strict=True)
    made = (goal_step(config, chosen, tracked, *moved) for chosen, moved in steps)
    return [float(dynamic_progress(config, step)[0]) for step in made]


def test_progress_counts_towards_the_goal_chosen_in_the_step():
    # Along y = 10, through the bays' middles: bay 0 at x = 0, bay 4 at x = 16.
    at = [(x, 10.0, 0.0) for x in (6.0, 5.0)]
    assert progress(at, [0, 0]) == pytest.approx([0.2])
    assert progress(at, [4, 4]) == pytest.approx([-0.2])
    # Taking the nearer goal pays nothing, the farther one (10 m, not 6) the way lost.
    assert progress(at, [4, 0]) == pytest.approx([0.2], abs=1e-6)
    assert progress(at, [0, 4]) == pytest.approx([-0.2 - 0.8], abs=1e-6)
    # Exploring earns nothing, but costs the way from the nearest tracked bay.
    assert progress(at, [NO_BAY, NO_BAY]) == pytest.approx([0.0])
    assert progress(at[::-1], [NO_BAY, NO_BAY]) == pytest.approx([-0.2])
    assert progress(at[::-1], [0, NO_BAY]) == pytest.approx([-0.2])
    assert progress(at, [NO_BAY, 0]) == pytest.approx([0.2])
    # With nothing tracked there is nothing to come nearer to.
    assert progress(at, [NO_BAY, NO_BAY], (NO_BAY, NO_BAY)) == [0.0]


def test_no_closed_loop_of_motion_and_choices_pays():
    # 0.2 a metre and 0.5 a radian: every loop that an agent can drive is tried by
    # chance, 200 of 12 steps, choosing anything of what it tracks.
    rng = np.random.default_rng(0)
    loops, steps, bays = 200, 12, np.array([0, 2, 4, NO_BAY])
    pose = rng.uniform((-5, -5, -3), (20, 15, 3), (steps, loops, 3))
    goal = rng.choice(bays, (steps, loops)).astype(np.int32)
    config = config_of(REWARDS["shaped"], loops)

    @jax.jit
    def paid(old, new, before, after):
        happened = goal_step(config, (old, new), (0, 2, 4), cars(before), cars(after))
        return dynamic_progress(config, happened)

    total = np.zeros(loops)
    for k in range(steps):
        end = (k + 1) % steps
        total += paid(goal[k], goal[end], pose[k], pose[end])
    assert total.max() < 1e-4  # float32 sums of numbers up to 5
    assert np.median(total) < -1.0
    # With one goal all the time a loop costs nothing either.
    total, goal = np.zeros(loops), np.full(loops, 2, np.int32)
    for k in range(steps):
        total += paid(goal, goal, pose[k], pose[(k + 1) % steps])
    np.testing.assert_allclose(total, 0.0, atol=1e-4)


def test_what_becomes_of_goals_pays_its_weight_by_name():
    pay = GoalRewards(stop_explore=0.01, continue_goal=-0.003)
    config = config_of(RewardConfig(goals=pay, extra={"approach": 200.0}), 6)
    names = {
        "continue_explore": [0],
        "stop_explore": [1],
        "continue_goal": [2, 5],
        "change_goal": [3],
        "stop_goal": [4],
        "lost_untracked": [5],
        "lost_taken": [2],
    }
    flags = {name: np.isin(np.arange(6), who) for name, who in names.items()}
    got = reward_terms(config, standing(config, no_goal_events(6, **flags), (0, 4)))
    expected = {
        "park": [0] * 6,
        "crash": [0] * 6,
        "time": [-1 / 200] * 6,
        "closeness": got["closeness"],  # they stand in each other
        "approach": [0, -1, -1, -1, 0, -1],  # not while exploring
        "progress": [0] * 6,  # its own: nobody has moved
        "continue_explore": [-0.002, 0, 0, 0, 0, 0],
        "stop_explore": [0, 0.01, 0, 0, 0, 0],
        "continue_goal": [0, 0, -0.003, 0, 0, -0.003],
        "change_goal": [0, 0, 0, -0.05, 0, 0],
        "stop_goal": [0, 0, 0, 0, -0.06, 0],  # -0.05 - 0.01
        "lost_goal": [0, 0, 0, 0, 0, -0.06],
    }
    assert got.keys() == expected.keys()
    for name, value in expected.items():
        np.testing.assert_allclose(got[name], value, atol=1e-7, err_msg=name)


def bad_goals(scheme):
    """Terms of four agents; all but the third are in the contexts but (G,S).

    The first and the third keep their goals, the others change them.
    """
    pay = GoalRewards(continue_goal=0.01)
    config = config_of(RewardConfig(goals=pay), 4, scheme)
    met = jnp.array([True, True, False, True])
    kept = jnp.array([True, False, True, False])
    contexts = dict.fromkeys(("local_same", "local_any", "global_any"), met)
    events = no_goal_events(4, continue_goal=kept, change_goal=~kept, **contexts)
    terms = reward_terms(config, standing(config, events))
    assert sorted(terms) == sorted(term_weights(config))
    assert all(term.dtype == jnp.float32 for term in terms.values())
    changed = np.float32([0, -0.05, 0, -0.05])
    np.testing.assert_array_equal(terms["change_goal"], changed)
    return terms


def test_a_bad_goal_pays_its_own_reward_instead():
    paid = bad_goals(GivingWayConfig("L,L,A", -0.1))
    np.testing.assert_array_equal(paid["continue_goal"], np.float32([0, 0, 0.01, 0]))
    np.testing.assert_array_equal(paid["bad_goal"], np.float32([-0.1, 0, 0, 0]))
    # A reward of 0 replaces as well; in another context nobody is.
    paid = bad_goals(GivingWayConfig("L,L,S"))
    np.testing.assert_array_equal(paid["continue_goal"], np.float32([0, 0, 0.01, 0]))
    np.testing.assert_array_equal(paid["bad_goal"], np.zeros(4))
    paid = bad_goals(None)
    np.testing.assert_array_equal(paid["continue_goal"], np.float32([0.01, 0, 0.01, 0]))
    assert "bad_goal" not in paid
