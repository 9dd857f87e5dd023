"""Contexts of giving way, what they pay and how they are counted."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from carpark_mj.mdp.searching import look_round
from helpers.scenes import SlidePhysics, placed

from carpark_mj.config import (
    TANNER_OBSERVATION,
    EnvConfig,
    GivingWayConfig,
    GoalConfig,
    GoalRewards,
    ObservationConfig,
    RewardConfig,
)
from carpark_mj.env import ParkingEnv
from carpark_mj.evaluation.aggregation import complete_row, pool
from carpark_mj.evaluation.catalogue import GOALS
from carpark_mj.evaluation.rollout import HITS, OUTCOMES, summarise
from carpark_mj.mdp.giving_way import (
    CONTEXTS,
    COUNTS,
    count,
    enforce,
    find_contexts,
    goals_in_turn,
)
from carpark_mj.observations.tracking import tracks
from carpark_mj.registry import environment

STATES, AGENTS, BAYS, PARKED, TRACKED = 4000, 5, 3, 3, 2


def tracked_agents(pose, parked_pose, count, present=None):
    """Who tracks whom among the nearest cars, parked ones included."""
    config = replace(TANNER_OBSERVATION, tracked_cars=count)
    return tracks(config, pose, parked_pose[:, :2], present)


def situation(pose, goal, met_goal, bay_pose, parked_pose, active):
    tracked = tracked_agents(pose, parked_pose, TRACKED)
    found = find_contexts(pose, goal, met_goal, bay_pose, tracked, active)
    return tracked, found


@pytest.fixture(scope="module")
def compiled():
    return jax.jit(jax.vmap(situation))


def draw_states(seed):
    """Cars on a small grid, so that equal distances occur; shared goals, explorers."""
    rng = np.random.default_rng(seed)

    def poses(count):
        xy = rng.integers(-4, 5, (STATES, count, 2))
        return np.concatenate([xy, np.zeros((STATES, count, 1))], -1).astype(np.float32)

    before, after = rng.integers(0, BAYS + 1, (2, STATES, AGENTS), dtype=np.int32)
    met = np.asarray(jax.vmap(goals_in_turn)(before, after))
    active = rng.random((STATES, AGENTS)) < 0.9
    return poses(AGENTS), before, met, poses(BAYS), poses(PARKED), active


@pytest.fixture(scope="module")
def states():
    return draw_states(0)


@pytest.fixture(scope="module")
def found(compiled, states):
    return jax.device_get(compiled(*states))


def by_the_book(pose, goal, met_goal, bay_pose, tracked, active):
    """The six contexts and their readings, agent by agent, in whole numbers."""
    rows = []
    for i in range(AGENTS):
        better = set()
        if goal[i] < BAYS and active[i]:
            aim = bay_pose[goal[i], :2]
            way = ((pose[:, :2] - aim) ** 2).sum(-1)
            better = {j for j in range(AGENTS) if active[j] and way[j] < way[i]}
        local = {j for j in better if tracked[i, j]}
        same = {j for j in better if met_goal[i, j] == goal[i]}
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


def test_contexts_are_those_of_the_definition(states, found):
    pose, goal, met, bay, _, active = states
    tracked, contexts = found
    for k in range(400):
        rows = by_the_book(pose[k], goal[k], met[k], bay[k], tracked[k], active[k])
        for name in CONTEXTS:
            assert [row[name] for row in rows] == contexts[name][k].tolist(), (k, name)


def test_contexts_lie_within_each_other(found):
    """C2 is within C1 where the study calls C1 the stronger; all are met and differ."""
    c = found[1]
    within = [
        ("local_same", "global_same"),
        ("local_same", "local_any"),
        ("global_same", "global_any"),
        ("local_any", "global_any"),
        ("untracked_same", "global_same"),
        ("untracked_any", "global_any"),
        ("untracked_same", "untracked_any"),
        ("untracked_other", "untracked_any"),
        # With no tracked agent nearer, whoever is nearer is not tracked.
        ("only_untracked_same", "untracked_same"),
        ("only_untracked_any", "untracked_any"),
        ("global_same_not_local_any", "only_untracked_same"),
        ("global_same_not_local_any", "only_untracked_any"),
    ]
    for inner, outer in within:
        assert not (c[inner] & ~c[outer]).any(), (inner, outer)
        assert (c[outer] & ~c[inner]).any(), (inner, outer)
    # (G,S) and (L,A) are not comparable.
    assert (c["global_same"] & ~c["local_any"]).any()
    assert (c["local_any"] & ~c["global_same"]).any()


def test_only_the_set_difference_is_disjoint_from_the_local_context(found):
    c = found[1]
    for which in ("same", "any"):
        local, either = c[f"local_{which}"], c[f"global_{which}"]
        only, exists = c[f"only_untracked_{which}"], c[f"untracked_{which}"]
        assert not (local & only).any()
        assert ((local | only) == either).all()
        assert (local & exists).any()  # the reading by existence overlaps
        assert ((local | exists) == either).all()
    any_untracked = c["untracked_same"] | c["untracked_other"]
    assert (any_untracked == c["untracked_any"]).all()


def test_explorers_and_finished_agents_are_in_no_context(states, found):
    goal, active = states[1], states[5]
    idle = (goal == BAYS) | ~active
    assert idle.any()
    assert not idle.all()
    for name in CONTEXTS:
        assert not found[1][name][idle].any()


def test_renumbered_agents_are_in_the_same_contexts(compiled, states, found):
    pose, goal, met, bay, parked, active = states
    # Tracking breaks ties by number, and so needs poses without any.
    noise = np.random.default_rng(5).uniform(-0.4, 0.4, pose.shape).astype(np.float32)
    pose = pose + noise
    order = np.random.default_rng(6).permutation(AGENTS)
    plain = compiled(pose, goal, met, bay, parked, active)
    renumbered = compiled(
        pose[:, order],
        goal[:, order],
        met[:, order][:, :, order],
        bay,
        parked,
        active[:, order],
    )
    np.testing.assert_array_equal(renumbered[0], plain[0][:, order][:, :, order])
    for name in CONTEXTS:
        np.testing.assert_array_equal(renumbered[1][name], plain[1][name][:, order])


def test_tracked_agents_are_the_nearest_cars_parked_ones_included():
    pose = jnp.array([[0, 0, 0], [1, 0, 0], [5, 0, 0], [9.2, 0, 0]], jnp.float32)
    parked = jnp.array([[2.1, 0, 0], [8.7, 0, 0]], jnp.float32)

    def pairs(*args):
        matrix = np.asarray(tracked_agents(pose, *args))
        return {(int(i), int(j)) for i, j in np.argwhere(matrix)}

    # One car each: 0 and 1 track each other; the parked car at 2.1 is nearer to 2 than
    # any agent, and the one at 8.7 is nearest to 3.
    assert pairs(parked, 1) == {(0, 1), (1, 0)}
    assert pairs(parked, 2) == {(0, 1), (1, 0), (3, 2)}
    # A car that this lot has not is not tracked.
    assert pairs(parked, 1, jnp.array([True, False])) == {(0, 1), (1, 0), (3, 2)}
    assert pairs(parked[:0], 1) == {(0, 1), (1, 0), (2, 1), (3, 2)}
    assert pairs(parked, 9) == {(i, j) for i in range(4) for j in range(4) if i != j}
    assert pairs(parked, 0) == set()


def scene(others):
    """Contexts of agent 0, 5 m before bay 0, that tracks its two nearest agents.

    Args:
        others: distance to bay 0 and goal of three agents in a row behind it.
    """
    pose = jnp.array([[-5.0, 0, 0]] + [[way, 0.0, 0.0] for way, _ in others])
    goal = jnp.array([0] + [aim for _, aim in others], jnp.int32)
    bay_pose = jnp.array([[0.0, 0, 0], [50.0, 0, 0]])
    met = jnp.broadcast_to(goal, (4, 4))
    tracked = tracked_agents(pose, jnp.zeros((0, 3)), 2)
    active = jnp.ones(4, bool)
    found = find_contexts(pose, goal, met, bay_pose, tracked, active)
    return {name for name, value in found.items() if value[0]}


OUT = 2  # exploring
FAR_AWAY = (40.0, OUT)
LOCAL_ANY = {"local_any", "global_any"}
LOCAL_SAME = LOCAL_ANY | {"local_same", "global_same"}
UNSEEN_OTHER = {
    "global_any",
    "untracked_any",
    "untracked_other",
    "only_untracked_any",
}
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


def test_agents_choose_in_turn():
    before, after = jnp.array([0, 1, 2]), jnp.array([10, 11, 12])
    expected = [[0, 1, 2], [10, 1, 2], [10, 11, 2]]
    np.testing.assert_array_equal(goals_in_turn(before, after), expected)


def test_a_bad_goal_pays_its_own_reward_instead():
    # All but the third are in the contexts; the first and the third keep their goal.
    contexts = {name: jnp.array([True, True, False, True]) for name in CONTEXTS}
    contexts["global_same"] = jnp.zeros(4, bool)
    kept = jnp.array([True, False, True, False])
    terms = {
        "continue_goal": jnp.float32([0.01, 0.0, 0.01, 0.0]),
        "change_goal": jnp.float32([0.0, -0.05, 0.0, -0.05]),
    }
    paid = enforce(GivingWayConfig("G,G,A", -0.1), contexts, kept, terms)
    np.testing.assert_array_equal(paid["continue_goal"], np.float32([0, 0, 0.01, 0]))
    np.testing.assert_array_equal(paid["bad_goal"], np.float32([-0.1, 0, 0, 0]))
    np.testing.assert_array_equal(paid["change_goal"], terms["change_goal"])
    # A reward of 0 replaces as well; in another context nobody is.
    paid = enforce(GivingWayConfig("L,L,S"), contexts, kept, terms)
    np.testing.assert_array_equal(paid["continue_goal"], np.float32([0, 0, 0.01, 0]))
    paid = enforce(GivingWayConfig("G,G,S", -0.1), contexts, kept, terms)
    np.testing.assert_array_equal(paid["bad_goal"], np.zeros(4))
    assert enforce(GivingWayConfig(), contexts, kept, terms) == terms


def test_conformity_by_hand():
    # Two agents, three steps; the first is always in the way, the second sometimes.
    met = [[True, False], [True, True], [True, True]]
    let_go = [[False, True], [True, False], [True, False]]
    totals = dict.fromkeys(COUNTS, 0.0)
    for now, gone in zip(met, let_go, strict=True):
        contexts = {name: jnp.zeros(2, bool) for name in CONTEXTS}
        contexts["local_any"] = jnp.array(now)
        step = count(contexts, jnp.array(gone))
        totals = {name: totals[name] + float(step[name].sum()) for name in COUNTS}
    assert totals["met_local_any"] == 5.0
    assert totals["gave_way_local_any"] == 2.0  # letting go in no context is not one
    rows = [totals, dict.fromkeys(COUNTS, 0.0)]  # two episodes
    known = {metric.name: metric for metric in GOALS}
    ratios = {name: pool(known[f"conformity_{name}"], rows) for name in CONTEXTS}
    assert ratios.pop("local_any") == 2 / 5  # not the mean of 2/3 and 0
    assert all(np.isnan(value) for value in ratios.values())


def test_an_evaluation_adds_steps_up_over_episodes_before_it_divides():
    numbers = ("path", "gear_changes", "final_distance", "final_heading", "final_speed")
    common = dict.fromkeys(
        (*OUTCOMES, *HITS, *numbers, "length", "episode_return"), 0.0
    )
    rows = []
    for met, gave_way in ((8.0, 8.0), (1.0, 0.0), (0.0, 0.0)):
        counts = dict.fromkeys(COUNTS, 0.0)
        counts |= {"met_global_any": met, "gave_way_global_any": gave_way}
        rows.append(complete_row(common | counts, 0.2))
    metrics = summarise(rows, 0.2)["metrics"]
    assert metrics["conformity_global_any"] == 8 / 9
    assert np.isnan(metrics["conformity_local_same"])
    fixed = summarise([complete_row(common, 0.2)], 0.2)["metrics"]
    assert not any(name.startswith("conformity") for name in fixed)


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
        goals=GoalConfig(dynamic=True, num_spaces=2),
        giving_way=GivingWayConfig("L,L,S", -0.1),
        reward=RewardConfig(goals=GoalRewards(continue_goal=0.03)),
        observation=ObservationConfig(tracked_agents=1),
    )
    env = ParkingEnv(config, SlidePhysics())
    start, _ = jax.jit(env.reset)(jax.random.key(0))
    step = jax.jit(env.step)

    def drive(poses, *choices, goal=(BAY, BAY), spaces=None):
        state, _ = look_round(placed(env, start, poses), None)
        assert (state.spaces[:, 0] == BAY).all()
        if spaces is not None:
            state = state.replace(spaces=jnp.array(spaces, jnp.int32))
        goal = jnp.array(goal, jnp.int32)
        state = state.replace(occupancy=state.occupancy.replace(goal=goal))
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
    assert named.keys() >= set(COUNTS)
    for name in ("local_same", "local_any", "global_same", "global_any"):
        np.testing.assert_array_equal(named[f"met_{name}"], [3.0, 0.0])
        np.testing.assert_array_equal(named[f"gave_way_{name}"], [2.0, 0.0])
        np.testing.assert_array_equal(state.stats.tallies[f"met_{name}"], [3, 0])
    for name in CONTEXTS[4:]:
        np.testing.assert_array_equal(named[f"met_{name}"], [0.0, 0.0])


def test_a_goal_that_is_lost_is_not_given_up(drive):
    far_bay = 20  # on the other side of the lot; tracked so far, and no more
    spaces = [[BAY, far_bay], [BAY, BAY + 1]]
    _, (timestep,) = drive((NEAR, FAR), (2, 1), goal=(far_bay, BAY), spaces=spaces)
    assert timestep.goal_events.lost_untracked.tolist() == [True, False]
    np.testing.assert_array_equal(timestep.metrics["met_local_any"], [1.0, 1.0])
    np.testing.assert_array_equal(timestep.metrics["gave_way_local_any"], [0.0, 0.0])


@pytest.mark.parametrize(("scheme", "size"), [("L,L,A", 11), ("G,G,A", 13)])
def test_the_scheme_says_whether_agents_see_global_information(scheme, size):
    way = GivingWayConfig(scheme, -0.1)
    env = ParkingEnv(replace(environment("tanner-dynamic"), giving_way=way))
    assert env.observation_size == size


def test_a_scheme_needs_agents_that_choose_their_goals():
    with pytest.raises(ValueError, match="scheme 'G,G,A' needs dynamic goals"):
        EnvConfig(giving_way=GivingWayConfig("G,G,A"))


@pytest.mark.parametrize(
    ("scheme", "information", "context"),
    [
        ("L,L,S", False, "local_same"),
        ("L,L,A", False, "local_any"),
        ("G,L,S", True, "local_same"),
        ("G,L,A", True, "local_any"),
        ("G,G,S", True, "global_same"),
        ("G,G,A", True, "global_any"),
        (None, False, None),
    ],
)
def test_schemes_say_what_is_known_and_what_is_enforced(scheme, information, context):
    config = GivingWayConfig(scheme)
    assert config.global_information is information
    assert config.context == context


@pytest.mark.parametrize("scheme", ["L,G,S", "G,G", "LLS", "", "g,g,a"])
def test_an_unknown_scheme_is_refused_with_the_six_known_ones(scheme):
    with pytest.raises(ValueError, match=f"unknown scheme '{scheme}'; choose") as error:
        GivingWayConfig(scheme)
    for known in ("L,L,S", "L,L,A", "G,L,S", "G,L,A", "G,G,S", "G,G,A"):
        assert f"'{known}'" in str(error.value)


@pytest.mark.parametrize("value", [0.1, float("nan"), -float("inf")])
def test_a_bad_goal_is_not_rewarded(value):
    with pytest.raises(ValueError, match="bad_goal must be at most 0"):
        GivingWayConfig("G,G,A", value)
    with pytest.raises(ValueError, match=r"bad_goal -0\.1 needs a scheme"):
        GivingWayConfig(bad_goal=-0.1)
