"""Tracked bays, choices, lost goals and their rewards, apart from the environment."""

import dataclasses
import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import cars, lot

from carpark_mj.config import (
    EnvConfig,
    GoalConfig,
    GoalRewards,
    ObservationConfig,
    RewardConfig,
    reward_preset,
)
from carpark_mj.layouts import Maxima, make_layout, pad_layout
from carpark_mj.mdp.chosen_goals import (
    GOAL_COUNTS,
    GoalEvents,
    aims,
    choose_goals,
    goal_counts,
    goal_events,
    lose_goals,
    taken_by_others,
)
from carpark_mj.mdp.goal_rewards import dynamic_progress, dynamic_terms
from carpark_mj.mdp.tracked_bays import (
    free_bays,
    nearer_to_any,
    no_spaces,
    track_spaces,
)

# Five bays in a row, 4 m apart, and as many bays' worth of padding.
ROW = pad_layout(
    lot([(x, 10.0, math.pi / 2) for x in (0, 4, 8, 12, 16)]), Maxima(8, 1, 1, 0, 1)
)
NONE = 8


def spaces_at(x, taken=(), tracked=None, count=2):
    """Bays tracked by one agent at (x, 0)."""
    free = free_bays(ROW, jnp.asarray(list(taken), jnp.int32))
    tracked = no_spaces(1, count, NONE) if tracked is None else jnp.array([tracked])
    return track_spaces(ROW, jnp.array([[x, 0.0]]), free, tracked)[0].tolist()


# Tracked bays


def test_an_agent_that_looks_round_first_numbers_the_nearest_bays_by_distance():
    assert spaces_at(0.0) == [0, 1]
    assert spaces_at(15.0, count=3) == [4, 3, 2]
    assert spaces_at(0.0, taken=[0, 2, NONE]) == [1, 3]


def test_a_bay_keeps_its_slot_for_as_long_as_it_is_among_the_nearest():
    assert spaces_at(3.0, tracked=[0, 1]) == [0, 1]  # bay 1 is nearer now
    assert spaces_at(7.0, tracked=[0, 1]) == [2, 1]  # bay 0 has left its slot to 2
    assert spaces_at(16.0, tracked=[0, 1]) == [4, 3]  # both are new
    assert spaces_at(3.0, taken=[1], tracked=[0, 1]) == [0, 2]  # somebody parked


def test_slots_for_which_there_is_no_bay_are_empty():
    assert spaces_at(0.0, taken=[0, 1, 2, 4]) == [3, NONE]
    assert spaces_at(0.0, taken=[0, 1, 2, 4], tracked=[0, 3]) == [NONE, 3]
    assert spaces_at(0.0, taken=range(5)) == [NONE, NONE]
    assert spaces_at(0.0, count=7) == [0, 1, 2, 3, 4, NONE, NONE]


def test_tracking_on_random_states_keeps_slots_and_finds_the_nearest():
    layout, agents, count = make_layout("tanner"), 5, 4

    def step(tracked, key):
        place, cars_key = jax.random.split(key)
        xy = jax.random.uniform(place, (agents, 2), minval=-20, maxval=20)
        free = jax.random.bernoulli(cars_key, 0.12, (agents, 36))
        spaces = track_spaces(layout, xy, free, tracked)
        return spaces, (xy, free, tracked, spaces)

    keys = jax.random.split(jax.random.key(0), 300)
    _, seen = jax.jit(lambda k: jax.lax.scan(step, no_spaces(agents, count, 36), k))(
        keys
    )
    bays, full = np.asarray(layout.bay_pose)[:, :2], 0
    rows = [np.asarray(x).reshape(-1, *x.shape[2:]) for x in seen]
    for xy, free, before, after in zip(*rows, strict=True):
        gap = np.where(free, np.linalg.norm(bays - xy, axis=-1), np.inf)
        nearest = np.argsort(gap, kind="stable")[: min(count, free.sum())]
        assert sorted(after[after < 36]) == sorted(nearest)
        assert (after[after == 36] == 36).all()
        stays = np.isin(before, nearest)
        np.testing.assert_array_equal(after[stays], before[stays])
        newcomers = [bay for bay in nearest if bay not in before]
        entered = [bay for bay in after[~stays] if bay < 36]
        assert entered == newcomers  # the nearest into the first empty slot
        full += len(nearest) == count
    assert 300 < full < 1500


# Choices


@pytest.mark.parametrize(
    ("goal", "choice", "expected", "name"),
    [
        (NONE, 0, NONE, "continue_explore"),
        (NONE, 1, 4, "stop_explore"),
        (NONE, 2, NONE, "continue_explore"),  # an empty slot
        (4, 0, NONE, "stop_goal"),
        (4, 1, 4, "continue_goal"),
        (4, 2, 4, "continue_goal"),  # an empty slot
        (4, 3, 1, "change_goal"),
        (1, 1, 4, "change_goal"),
    ],
)
def test_every_transition_by_hand(goal, choice, expected, name):
    before = jnp.array([goal], jnp.int32)
    spaces = jnp.array([[4, NONE, 1]], jnp.int32)
    chosen = choose_goals(before, spaces, jnp.array([choice]), NONE)
    assert (chosen.tolist(), chosen.dtype) == ([expected], jnp.int32)
    nothing = jnp.zeros(1, bool)
    events = goal_events(before, chosen, nothing, nothing, ~nothing, NONE)
    happened = [k for k, flag in vars(events).items() if flag[0]]
    assert happened == [name]
    assert bool(events.exploring[0]) == (expected == NONE)


def random_events(key, count=4000):
    """Random goals and choices among the bays of `ROW`, and what becomes of them."""
    keys = jax.random.split(key, 6)
    before, active = (
        jax.random.randint(keys[0], (count,), 0, NONE + 1),
        jax.random.bernoulli(keys[1], 0.8, (count,)),
    )
    spaces = jax.random.randint(keys[2], (count, 3), 0, NONE + 1)
    choice = jax.random.randint(keys[3], (count,), 0, 4)
    chosen = choose_goals(before, spaces, choice, NONE)
    chosen = jnp.where(active, chosen, before)
    untracked, taken = (
        lose_goals(chosen, jax.random.bernoulli(k, 0.2, (count,)) & active, NONE)[1]
        for k in keys[4:]
    )
    untracked = untracked & ~taken
    events = goal_events(before, chosen, untracked, taken, active, NONE)
    return before, chosen, active, events


FIVE = (
    "continue_explore",
    "stop_explore",
    "continue_goal",
    "change_goal",
    "stop_goal",
)


def test_the_five_transitions_partition_the_steps_of_active_agents():
    before, chosen, active, events = jax.device_get(random_events(jax.random.key(1)))
    flags = np.stack([getattr(events, name) for name in FIVE])
    np.testing.assert_array_equal(flags.sum(axis=0), active)
    assert flags.any(axis=1).all()
    np.testing.assert_array_equal(events.exploring, active & (chosen == NONE))
    had = active & (before < NONE)
    np.testing.assert_array_equal(flags[2:].any(axis=0), had)
    assert not (events.lost_untracked & events.lost_taken).any()
    lost = events.lost_untracked | events.lost_taken
    assert not (lost & events.exploring).any()
    assert lost.any()


def test_counts_of_an_episode_conserve_its_steps():
    counts = dict.fromkeys(GOAL_COUNTS, jnp.zeros(500))
    nearer = jnp.arange(500) % 3 == 0
    sums = {name: np.zeros(500) for name in vars(random_events(jax.random.key(0))[3])}
    for k in range(4):
        _, _, _, events = random_events(jax.random.key(k), 500)
        counts = jax.tree.map(jnp.add, counts, goal_counts(events, nearer))
        for name, flag in vars(events).items():
            sums[name] += np.asarray(flag)
    for name in GOAL_COUNTS[2:]:
        np.testing.assert_array_equal(counts[name], sums[name])
    explored = sums["continue_explore"] + sums["stop_goal"]
    np.testing.assert_array_equal(counts["explored_steps"], explored)
    towards = np.where(nearer, explored, 0)  # with a goal it does not count
    np.testing.assert_array_equal(counts["towards_space_steps"], towards)


def test_nearer_to_any_tracked_bay_asks_all_of_them_and_no_empty_slot():
    layout = lot([(10.0, 0.0, 0.0), (-10.0, 0.0, 0.0), (0.0, 10.0, 0.0)])
    none = layout.num_bays
    spaces = jnp.array([[0, 1], [0, none], [none, none], [1, 2], [2, none]], jnp.int32)
    before = jnp.zeros((5, 2))
    # The third comes nearer to the last bay, which JAX reads for an empty slot.
    after = jnp.array([[1.0, 0], [-1.0, 0], [0.0, 1.0], [0.0, 1.0], [5.0, 0.1]])
    nearer = nearer_to_any(layout, spaces, before, after)
    assert nearer.tolist() == [True, False, False, True, False]


def test_whoever_has_the_goal_where_another_parks_loses_it():
    goal = jnp.array([3, 3, 2, NONE, 3, 2])
    parked = jnp.array([False, True, False, False, False, False])
    taken = taken_by_others(goal, parked)
    np.testing.assert_array_equal(taken, [True, False, False, False, True, False])
    after, lost = lose_goals(goal, taken | (goal == NONE), NONE)
    assert after.tolist() == [NONE, 3, 2, NONE, NONE, 2]
    np.testing.assert_array_equal(lost, taken)


def test_agents_are_after_their_goals_or_the_nearest_bays_they_track():
    xy = jnp.zeros((3, 2))
    spaces = jnp.array([[4, 2], [NONE, 1], [NONE, NONE]])
    pose, known = aims(ROW, jnp.array([0, NONE, NONE]), spaces, xy)
    assert known.tolist() == [True, True, False]
    np.testing.assert_array_equal(pose[:2], ROW.bay_pose[jnp.array([0, 1])])
    pose, _ = aims(ROW, jnp.array([NONE, 3, 3]), spaces, xy)
    np.testing.assert_array_equal(pose, ROW.bay_pose[jnp.array([2, 3, 3])])
    assert np.isfinite(pose).all()


# Rewards

WAY = RewardConfig(progress=0.2, alignment=0.0)


def progress(config, moves, goals, spaces=(0, 4)):
    """Progress of one agent over moves ((x, y, yaw) ...) with goals before each."""
    spaces = jnp.array([spaces], jnp.int32)
    poses = [cars([pose]) for pose in moves]
    goals = [jnp.array([goal], jnp.int32) for goal in goals]
    return [
        float(dynamic_progress(config, ROW, spaces, (goals[k], goals[k + 1]), *pair)[0])
        for k, pair in enumerate(itertools.pairwise(poses))
    ]


def test_progress_counts_towards_the_goal_chosen_in_the_step():
    # Along y = 10, through the bays' middles: bay 0 at x = 0, bay 4 at x = 16.
    at = [(x, 10.0, 0.0) for x in (6.0, 5.0)]
    assert progress(WAY, at, [0, 0]) == pytest.approx([0.2])
    assert progress(WAY, at, [4, 4]) == pytest.approx([-0.2])
    # Taking the nearer goal pays nothing, the farther one (10 m, not 6) the way lost.
    assert progress(WAY, at, [4, 0]) == pytest.approx([0.2], abs=1e-6)
    assert progress(WAY, at, [0, 4]) == pytest.approx([-0.2 - 0.8], abs=1e-6)
    # Exploring earns nothing, but costs the way from the nearest tracked bay.
    assert progress(WAY, at, [NONE, NONE]) == pytest.approx([0.0])
    assert progress(WAY, at[::-1], [NONE, NONE]) == pytest.approx([-0.2])
    assert progress(WAY, at[::-1], [0, NONE]) == pytest.approx([-0.2])
    assert progress(WAY, at, [NONE, 0]) == pytest.approx([0.2])
    # With nothing in sight there is nothing to come nearer to.
    assert progress(WAY, at, [NONE, NONE], (NONE, NONE)) == [0.0]


def test_no_closed_loop_of_motion_and_choices_pays():
    # 0.2 a metre and 0.5 a radian: every loop that an agent can drive is tried by
    # chance, 200 of 12 steps, choosing anything of what it tracks.
    rng = np.random.default_rng(0)
    loops, steps, tracked = 200, 12, np.array([0, 2, 4, NONE])
    pose = rng.uniform((-5, -5, -3), (20, 15, 3), (steps, loops, 3))
    goal = rng.choice(tracked, (steps, loops)).astype(np.int32)
    spaces = jnp.broadcast_to(jnp.array([0, 2, 4]), (loops, 3))
    step = jax.jit(
        lambda goals, before, after: dynamic_progress(
            reward_preset("shaped"), ROW, spaces, goals, before, after
        )
    )
    total = np.zeros(loops)
    for k in range(steps):
        ends = (goal[k], goal[(k + 1) % steps])
        total += step(ends, cars(pose[k]), cars(pose[(k + 1) % steps]))
    assert total.max() < 1e-4  # float32 sums of numbers up to 5
    assert np.median(total) < -1.0
    # With one goal all the time a loop costs nothing either.
    total = np.zeros(loops)
    for k in range(steps):
        ends = (jnp.full(loops, 2), jnp.full(loops, 2))
        total += step(ends, cars(pose[k]), cars(pose[(k + 1) % steps]))
    np.testing.assert_allclose(total, 0.0, atol=1e-4)


def events_of(**true):
    """Seven agents' events, each of which lists whom it holds for."""
    return GoalEvents(
        **{
            field.name: jnp.isin(jnp.arange(7), jnp.array(true.get(field.name, [9])))
            for field in dataclasses.fields(GoalEvents)
        }
    )


def test_transitions_pay_their_raw_weights_by_name():
    pay = GoalRewards(stop_explore=0.01, continue_goal=-0.003, taken_goal=-0.04)
    config = RewardConfig(goals=pay)
    events = events_of(
        continue_explore=[0],
        stop_explore=[1],
        continue_goal=[2, 5],
        change_goal=[3, 6],
        stop_goal=[4],
        lost_untracked=[5],
        lost_taken=[2],
    )
    diverged = jnp.arange(7) == 6
    ones = jnp.ones(7)
    got = dynamic_terms(
        config, {"approach": ones, "time": -ones}, ones, events, diverged
    )
    expected = {
        "approach": [0, 1, 1, 1, 0, 1, 0],  # not while exploring
        "time": [-1, -1, -1, -1, -1, -1, 0],
        "progress": [1, 1, 1, 1, 1, 1, 0],
        "continue_explore": [-0.002, 0, 0, 0, 0, 0, 0],
        "stop_explore": [0, 0.01, 0, 0, 0, 0, 0],
        "continue_goal": [0, 0, -0.003, 0, 0, -0.003, 0],
        "change_goal": [0, 0, 0, -0.05, 0, 0, 0],
        "stop_goal": [0, 0, 0, 0, -0.06, 0, 0],  # -0.05 - 0.01
        "lost_goal": [0, 0, 0, 0, 0, -0.06, 0],
        "taken_goal": [0, 0, -0.04, 0, 0, 0, 0],
    }
    assert got.keys() == expected.keys()
    for name, value in expected.items():
        np.testing.assert_allclose(got[name], value, atol=1e-7, err_msg=name)
        assert got[name].dtype == jnp.float32


def test_the_published_weights_are_the_defaults():
    pay = reward_preset("tanner").goals
    assert (pay.continue_explore, pay.stop_explore, pay.continue_goal) == (-0.002, 0, 0)
    assert pay.change_goal == pay.stop == pay.lost == -0.05
    assert GoalRewards(lost_goal=0.0).lost == 0.0
    assert GoalRewards(change_goal=-0.3, stop_explore=-0.2).stop == pytest.approx(-0.1)


# Refusals

DYNAMIC = GoalConfig(dynamic=True)
BAD_REWARDS = [
    ({"continue_explore": 0.0}, "continue_explore must be negative .* not 0.0"),
    ({"change_goal": 0.1}, "change_goal must be negative .* not 0.1"),
    ({"stop_goal": -0.06}, r"change_goal = stop_goal \+ .* -0.05 = -0.06 \+ 0.0"),
    ({"stop_explore": 0.1, "stop_goal": -0.05}, "change_goal = stop_goal"),
]


@pytest.mark.parametrize(("change", "message"), BAD_REWARDS)
def test_rewards_that_break_the_constraints_are_refused_with_dynamic_goals(
    change, message
):
    reward = RewardConfig(goals=GoalRewards(**change))
    EnvConfig(reward=reward)  # nobody is paid for fixed goals
    with pytest.raises(ValueError, match=message) as caught:
        EnvConfig(goals=DYNAMIC, reward=reward)
    assert "\n" not in str(caught.value)


def test_rewards_that_obey_the_constraints_to_rounding_are_taken():
    pay = GoalRewards(stop_explore=-0.1, stop_goal=-0.2, change_goal=-0.1 - 0.2)
    assert EnvConfig(goals=DYNAMIC, reward=RewardConfig(goals=pay)).goals.dynamic


def test_other_impossible_settings_are_refused_in_a_sentence():
    with pytest.raises(ValueError, match="num_spaces must be at least 1, not 0"):
        GoalConfig(num_spaces=0)
    with pytest.raises(ValueError, match="lost_goal must be finite, not nan"):
        GoalRewards(lost_goal=math.nan)
    indices = ObservationConfig(
        tracked_agents=0, tracked_parked_cars=0, encoding="indices"
    )
    with pytest.raises(ValueError, match="'indices' needs fixed goals"):
        EnvConfig(physics="grid", goals=DYNAMIC, observation=indices)
