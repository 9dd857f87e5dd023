"""Counts of what becomes of dynamic goals, and of giving way."""

import jax.numpy as jnp
import numpy as np
from helpers.scenes import cars, lot
from helpers.transitions import no_goal_events, no_terms, transition

from carpark_mj.config import EnvConfig, GoalConfig
from carpark_mj.mdp.metrics import (
    CHANGES,
    CONTEXTS,
    COUNTS,
    count_goals,
    init_stats,
    update_stats,
)

PLAN = lot([(10.0, 0.0, 0.0), (-10.0, 0.0, 0.0), (0.0, 10.0, 0.0)])
CHOICES = (
    "continue_explore",
    "stop_explore",
    "continue_goal",
    "change_goal",
    "stop_goal",
)


def config(num_agents):
    return EnvConfig(num_agents=num_agents, goals=GoalConfig(dynamic=True))


def step(xy, tracked_bays, goal_events=None, **of_state):
    """A step of agents from the origin to the given places."""
    after = cars([(x, y, 0.0) for x, y in xy])
    before = cars(np.zeros((len(xy), 3)))
    if tracked_bays is not None:
        of_state["tracked_bays"] = jnp.array(tracked_bays, jnp.int32)
    return transition(
        config(len(xy)), PLAN, before, after, of_state, goal_events=goal_events
    )


def test_counts_of_an_episode_conserve_its_steps():
    agents, steps = 200, 4
    rng = np.random.default_rng(0)
    tracked = rng.integers(0, 3, (agents, 1))
    settings = config(agents)
    stats, nothing = init_stats(settings, PLAN), no_terms(settings)
    sums = {name: np.zeros(agents) for name in (*CHOICES, "lost_taken")}
    towards = np.zeros(agents)
    for _ in range(steps):
        choice = rng.integers(0, len(CHOICES), agents)
        flags = {name: choice == k for k, name in enumerate(CHOICES)}
        flags["lost_taken"] = rng.random(agents) < 0.3
        xy = rng.uniform(-1, 1, (agents, 2))
        happened = step(
            xy, tracked, goal_events=no_goal_events(agents, **flags), stats=stats
        )
        stats = update_stats(settings, happened, nothing)
        sums = {name: sums[name] + flag for name, flag in flags.items()}
        gap = np.linalg.norm(np.asarray(PLAN.bay_pose)[tracked[:, 0], :2] - xy, axis=1)
        # With a goal it does not count.
        towards += (gap < 10) & (flags["continue_explore"] | flags["stop_goal"])
    explored = sums["continue_explore"] + sums["stop_goal"]
    np.testing.assert_array_equal(stats.tallies["explored_steps"], explored)
    np.testing.assert_array_equal(stats.tallies["towards_bay_steps"], towards)
    for name in CHANGES:
        expected = sums.get(name, np.zeros(agents))
        np.testing.assert_array_equal(stats.tallies[name], expected)
    assert (towards > 0).any()
    assert (towards < explored).any()


def test_an_agent_gives_way_that_lets_go_of_its_goal_in_the_context():
    # Four agents in the context, one outside; losing a goal is not letting go of it.
    events = no_goal_events(
        5,
        change_goal=[True, False, False, False, True],
        stop_goal=[False, True, False, False, False],
        continue_goal=[False, False, True, True, False],
        lost_taken=[False, False, False, True, False],
        local_any=[True, True, True, True, False],
        global_any=[True] * 5,
    )
    counts = count_goals(step([(1.0, 0.0)] * 5, [[0]] * 5, events))
    assert tuple(counts) == COUNTS
    found = {name: np.asarray(count, float).tolist() for name, count in counts.items()}
    assert found["met_local_any"] == [1, 1, 1, 1, 0]
    assert found["gave_way_local_any"] == [1, 1, 0, 0, 0]
    assert found["met_global_any"] == [1, 1, 1, 1, 1]
    assert found["gave_way_global_any"] == [1, 1, 0, 0, 1]
    for name in set(CONTEXTS) - {"local_any", "global_any"}:
        assert found[f"met_{name}"] == found[f"gave_way_{name}"] == [0] * 5


def test_only_agents_that_choose_their_goals_have_counts_of_them():
    fixed = init_stats(EnvConfig(num_agents=2), PLAN).tallies
    chosen = init_stats(config(2), PLAN).tallies
    assert not set(COUNTS) & set(fixed)
    assert set(COUNTS) <= set(chosen)
    assert all(jnp.all(chosen[name] == 0.0) for name in COUNTS)
