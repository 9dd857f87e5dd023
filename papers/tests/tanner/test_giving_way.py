"""Contexts of giving way, by the definition and by hand; what they pay in a lot."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import cars, lot
from helpers.sliding import SlidePhysics, placed
from helpers.states import parked_at, state_of

from carpark_mj.config import (
    EnvConfig,
    GivingWayConfig,
    GoalConfig,
    GoalRewards,
    RewardConfig,
)
from carpark_mj.env import ParkingEnv
from carpark_mj.mdp.goals import find_contexts, init_tracked_bays, track_bays, tracks
from carpark_mj.mdp.metrics import CONTEXTS
from carpark_mj.observations import ContinuousObservation, observation_size
from carpark_mj.registry import environment
from carpark_mj.types import NO_BAY
from carpark_papers.tanner.observation import TannerObservation

STATES, AGENTS, BAYS, PARKED, TRACKED = 1000, 5, 3, 3, 2
TEMPLATE = lot([(0.0, 0.0, 0.0)] * BAYS)


def state_at(pose, goal, bay_pose=TEMPLATE.bay_pose, parked=(), **changes):
    """Agents, bays and parked cars at poses."""
    layout = TEMPLATE.replace(bay_pose=jnp.asarray(bay_pose, jnp.float32))
    parked_cars = parked_at(parked, present=changes.pop("present", True))
    return state_of(layout, cars(pose), goal, parked_cars=parked_cars, **changes)


def tracked_agents(state, count):
    """Who tracks whom among the nearest cars, parked ones included."""
    config = EnvConfig(observation=TannerObservation(tracked_cars=count))
    return tracks(config, state)


@jax.jit
@jax.vmap
def situation(pose, goal, chosen, bay_pose, parked, active):
    state = state_at(pose, goal, bay_pose, parked, active=active)
    tracked = tracked_agents(state, TRACKED)
    return tracked, find_contexts(state, chosen, tracked)


@pytest.fixture(scope="module")
def states():
    """Cars on a small grid, so that equal distances occur; shared goals, explorers."""
    rng = np.random.default_rng(0)

    def poses(count):
        xy = rng.integers(-4, 5, (STATES, count, 2))
        return np.concatenate([xy, np.zeros((STATES, count, 1))], -1).astype(np.float32)

    goals = rng.integers(0, BAYS + 1, (2, STATES, AGENTS), dtype=np.int32)
    goal, chosen = np.where(goals == BAYS, NO_BAY, goals).astype(np.int32)
    return {
        "pose": poses(AGENTS),
        "goal": goal,
        "chosen": chosen,
        "bay_pose": poses(BAYS),
        "parked": poses(PARKED),
        "active": rng.random((STATES, AGENTS)) < 0.9,
    }


@pytest.fixture(scope="module")
def situations(states):
    return jax.device_get(situation(*states.values()))


def by_the_book(pose, goal, chosen, bay_pose, active, tracked):
    """The six contexts and their readings, agent by agent, in whole numbers."""
    rows = []
    for i in range(AGENTS):
        better = set()
        if goal[i] != NO_BAY and active[i]:
            aim = bay_pose[goal[i], :2]
            way = ((pose[:, :2] - aim) ** 2).sum(-1)
            better = {j for j in range(AGENTS) if active[j] and way[j] < way[i]}
        local = {j for j in better if tracked[i, j]}
        # Those of lower number have chosen already.
        same = {j for j in better if (chosen if j < i else goal)[j] == goal[i]}
        rows.append(
            {
                "local_same": bool(local & same),
                "local_any": bool(local),
                "global_same": bool(same),
                "global_any": bool(better),
                "untracked_same": bool(same - local),
                "untracked_any": bool(better - local),
                "untracked_other": bool(better - local - same),
                "only_untracked_same": bool(same) and not local & same,
                "only_untracked_any": bool(better) and not local,
                "global_same_not_local_any": bool(same) and not local,
            }
        )
    return rows


def test_contexts_are_those_of_the_definition(states, situations):
    tracked, contexts = situations
    assert set(contexts) == set(CONTEXTS)
    known = {name: x for name, x in states.items() if name != "parked"}
    for k in range(STATES):
        rows = by_the_book(**{n: x[k] for n, x in known.items()}, tracked=tracked[k])
        for name in CONTEXTS:
            assert [row[name] for row in rows] == contexts[name][k].tolist(), (k, name)
    assert all(0.0 < met.mean() < 1.0 for met in contexts.values())


def test_tracked_agents_are_the_nearest_cars_parked_ones_included():
    pose = [[0, 0, 0], [1, 0, 0], [5, 0, 0], [9.2, 0, 0]]
    parked = [[2.1, 0, 0], [8.7, 0, 0]]

    def pairs(parked, count, present=True):
        state = state_at(pose, NO_BAY, parked=parked, present=present)
        found = np.argwhere(np.asarray(tracked_agents(state, count)))
        return {(int(i), int(j)) for i, j in found}

    # One car each: 0 and 1 track each other; the parked car at 2.1 is nearer to 2 than
    # any agent, and the one at 8.7 is nearest to 3.
    assert pairs(parked, 1) == {(0, 1), (1, 0)}
    assert pairs(parked, 2) == {(0, 1), (1, 0), (3, 2)}
    # An absent car is not tracked.
    present = jnp.array([True, False])
    assert pairs(parked, 1, present) == {(0, 1), (1, 0), (3, 2)}
    assert pairs([], 1) == {(0, 1), (1, 0), (2, 1), (3, 2)}
    assert pairs(parked, 5) == {(i, j) for i in range(4) for j in range(4) if i != j}
    assert pairs(parked, 0) == set()


def scene(others):
    """Contexts of agent 0, 5 m before bay 0, that tracks its two nearest agents.

    Args:
        others: distance to bay 0 and goal of three agents in a row behind it.
    """
    pose = [[-5.0, 0.0, 0.0]] + [[way, 0.0, 0.0] for way, _ in others]
    goal = [0] + [aim for _, aim in others]
    state = state_at(pose, goal, [[0.0, 0, 0], [50.0, 0, 0], [90.0, 0, 0]])
    found = find_contexts(state, state.goal, tracked_agents(state, 2))
    return {name for name, value in found.items() if value[0]}


OUT = NO_BAY
FAR_AWAY = (40.0, OUT)
LOCAL_ANY = {"local_any", "global_any"}
LOCAL_SAME = LOCAL_ANY | {"local_same", "global_same"}
UNSEEN_OTHER = {"global_any", "untracked_any", "untracked_other", "only_untracked_any"}
UNSEEN_SAME = {
    "global_any",
    "global_same",
    "untracked_any",
    "untracked_same",
    "only_untracked_any",
    "only_untracked_same",
    "global_same_not_local_any",
}


@pytest.mark.parametrize(
    ("others", "expected"),
    [
        ([FAR_AWAY, FAR_AWAY, FAR_AWAY], set()),
        ([(5.0, 0), FAR_AWAY, FAR_AWAY], set()),  # as near is not nearer
        ([(-4.0, 0), FAR_AWAY, FAR_AWAY], LOCAL_SAME),
        ([(-4.0, 1), FAR_AWAY, FAR_AWAY], LOCAL_ANY),
        ([(-4.0, OUT), FAR_AWAY, FAR_AWAY], LOCAL_ANY),
        # The two tracked ones are behind, a third is nearer to the bay.
        ([(-6.0, 0), (-7.0, 0), (1.0, 0)], UNSEEN_SAME),
        ([(-6.0, 0), (-7.0, 0), (1.0, 1)], UNSEEN_OTHER),
        # A tracked and an untracked agent are nearer: the readings of G+ differ.
        (
            [(-4.0, 0), (-6.0, 1), (1.0, 0)],
            LOCAL_SAME | {"untracked_same", "untracked_any"},
        ),
        # The leak: (G,S) by one that is not tracked, beside (L,A) by one that is.
        (
            [(-4.0, 1), (-6.0, 1), (1.0, 0)],
            (LOCAL_ANY | {"global_same", "untracked_same", "untracked_any"})
            | {"only_untracked_same"},
        ),
        (
            [(-4.0, 0), (-6.0, 1), (1.0, 1)],
            LOCAL_SAME | {"untracked_any", "untracked_other"},
        ),
    ],
)
def test_contexts_of_hand_placed_scenes(others, expected):
    assert scene(others) == expected


# In the environment

NEAR, FAR = (0.0, -9.0, 0.0), (0.0, -2.0, 0.0)
BAY = 4  # at (0, -18), the first that agents at both places track
EXPLORE, KEEP, CHANGE = 0, 1, 2


@pytest.fixture(scope="module")
def drive():
    """Makes steps of two agents that track each other and two bays; all standing.

    They start with the goal `BAY`. Returns the state and the steps.
    """
    config = EnvConfig(
        num_agents=2,
        num_parked_cars=0,
        goals=GoalConfig(dynamic=True, num_tracked_bays=2),
        giving_way=GivingWayConfig("L,L,S", -0.1),
        reward=RewardConfig(goals=GoalRewards(continue_goal=0.03)),
        observation=ContinuousObservation(tracked_agents=1),
    )
    env = ParkingEnv(config, SlidePhysics())
    start, _ = jax.jit(env.reset)(jax.random.key(0))
    step = jax.jit(env.step)

    def drive(poses, *choices, goal=(BAY, BAY), tracked=None):
        empty = init_tracked_bays(env.config)
        state = placed(env, start, poses).replace(tracked_bays=empty)
        state = track_bays(env.config, state)
        assert (state.tracked_bays[:, 0] == BAY).all()
        if tracked is not None:
            state = state.replace(tracked_bays=jnp.array(tracked, jnp.int32))
        state = state.replace(goal=jnp.array(goal, jnp.int32))
        timesteps = []
        for pair in choices:
            action = jnp.array([[0.0, 0.0, slot] for slot in pair], jnp.float32)
            state, timestep = step(state, action)
            timesteps.append(timestep)
        return state, timesteps

    return drive


@pytest.mark.parametrize(
    ("poses", "choice", "bad", "kept"),
    [
        ((FAR, NEAR), (KEEP, KEEP), [-0.1, 0.0], [0.0, 0.03]),
        ((NEAR, FAR), (KEEP, KEEP), [0.0, -0.1], [0.03, 0.0]),
        ((FAR, NEAR), (EXPLORE, KEEP), [0.0, 0.0], [0.0, 0.03]),
        ((FAR, NEAR), (CHANGE, KEEP), [0.0, 0.0], [0.0, 0.03]),
        # In turn: the nearer one gives up after the other has chosen, or before.
        ((FAR, NEAR), (KEEP, EXPLORE), [-0.1, 0.0], [0.0, 0.0]),
        ((NEAR, FAR), (EXPLORE, KEEP), [0.0, 0.0], [0.0, 0.03]),
    ],
)
def test_a_step_pays_for_keeping_a_bad_goal(drive, poses, choice, bad, kept):
    _, (timestep,) = drive(poses, choice)
    terms = timestep.reward_terms
    np.testing.assert_array_equal(terms["bad_goal"], np.float32(bad))
    np.testing.assert_array_equal(terms["continue_goal"], np.float32(kept))
    total = np.sum([np.asarray(term) for term in terms.values()], axis=0)
    np.testing.assert_allclose(timestep.reward, total, atol=1e-6)


def test_an_episode_counts_contexts_and_who_gave_way(drive):
    # The first one is farther from the bay: keeps it, explores, takes and changes it.
    state, timesteps = drive(
        (FAR, NEAR), (KEEP, KEEP), (EXPLORE, KEEP), (KEEP, KEEP), (CHANGE, KEEP)
    )
    named = timesteps[-1].metrics
    for name in ("local_same", "local_any", "global_same", "global_any"):
        np.testing.assert_array_equal(named[f"met_{name}"], [3.0, 0.0])
        np.testing.assert_array_equal(named[f"gave_way_{name}"], [2.0, 0.0])
        np.testing.assert_array_equal(state.stats.tallies[f"met_{name}"], [3, 0])
    for name in CONTEXTS[4:]:
        np.testing.assert_array_equal(named[f"met_{name}"], [0.0, 0.0])


def test_a_goal_that_is_lost_is_not_given_up(drive):
    far_bay = 20  # on the other side of the lot; tracked so far, and no more
    tracked = [[BAY, far_bay], [BAY, BAY + 1]]
    _, (timestep,) = drive((NEAR, FAR), (2, 1), goal=(far_bay, BAY), tracked=tracked)
    assert timestep.goal_events.lost_untracked.tolist() == [True, False]
    np.testing.assert_array_equal(timestep.metrics["met_local_any"], [1.0, 1.0])
    np.testing.assert_array_equal(timestep.metrics["gave_way_local_any"], [0.0, 0.0])


@pytest.mark.parametrize(("scheme", "size"), [("L,L,A", 11), ("G,G,A", 13)])
def test_under_global_schemes_agents_observe_two_numbers_more(scheme, size):
    way = GivingWayConfig(scheme, -0.1)
    seen = TannerObservation(global_information=way.global_information)
    config = replace(environment("tanner-dynamic"), giving_way=way, observation=seen)
    assert observation_size(config) == size
