"""Choices and losses of goals, and which free bays agents track, in which slots."""

import functools
import math
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import cars, lot
from helpers.states import parked_in, state_of
from helpers.transitions import CHOICES, no_events

from carpark_mj.config import EnvConfig, EpisodeConfig, GoalConfig
from carpark_mj.layouts import Maxima, make_layout, pad_layout
from carpark_mj.mdp.goals import (
    choose_goals,
    nearest_bays,
    target_bay,
    track_bays,
    update_goals,
)
from carpark_mj.types import NO_BAY

# Five bays in a row, 4 m apart, and agents in front of it.
ROW = lot([(x, 10.0, math.pi / 2) for x in (0, 4, 8, 12, 16)])


def dynamic_goals(agents, slots, respawn=True):
    """The shipped rules for some agents, and slots of tracked bays."""
    return EnvConfig(
        num_agents=agents,
        goals=GoalConfig(dynamic=True, num_tracked_bays=slots),
        episode=EpisodeConfig(respawn=respawn),
    )


@pytest.mark.parametrize(
    ("goal", "choice", "expected", "name"),
    [
        (NO_BAY, 0, NO_BAY, "continue_explore"),
        (NO_BAY, 1, 4, "stop_explore"),
        (NO_BAY, 2, NO_BAY, "continue_explore"),  # an empty slot
        (4, 0, NO_BAY, "stop_goal"),
        (4, 1, 4, "continue_goal"),
        (4, 2, 4, "continue_goal"),  # an empty slot
        (4, 3, 1, "change_goal"),
        (1, 1, 4, "change_goal"),
    ],
)
def test_every_choice_by_hand(goal, choice, expected, name):
    config = dynamic_goals(1, 3)
    before = state_of(
        ROW,
        cars([(0.0, 0.0, 0.0)]),
        [goal],
        parked_cars=parked_in(ROW, [0, 2, 3]),
        tracked_bays=[[4, NO_BAY, 1]],
    )
    after = choose_goals(config, before, jnp.array([choice]))
    assert (after.goal.tolist(), after.goal.dtype) == ([expected], jnp.int32)
    ended, events = update_goals(config, before, after, no_events(1))
    assert ended.goal.tolist() == [expected]
    flags = {name: flag for name, flag in vars(events).items() if name != "contexts"}
    assert [name for name, flag in flags.items() if flag[0]] == [name]
    assert bool(events.exploring[0]) == (expected == NO_BAY)


@functools.cache
def random_steps(respawn=True, lots=1500, agents=4, slots=3):
    """What becomes of goals in random states of a row with a parked car, as numpy.

    Returns:
        States before, when goals are chosen, and at the end; events, goal events.
    """
    config = dynamic_goals(agents, slots, respawn)

    def step(key):
        keys = jax.random.split(key, 8)
        x = jax.random.uniform(keys[0], (agents,), minval=-8, maxval=24)
        tracked = jax.vmap(lambda k: jax.random.permutation(k, 7)[:slots])(
            jax.random.split(keys[1], agents)
        )
        tracked = jnp.where(tracked < 5, tracked, NO_BAY)
        slot = jax.random.randint(keys[2], (agents,), 0, slots)
        active = jax.random.bernoulli(keys[3], 0.8, (agents,))
        goal = tracked[jnp.arange(agents), slot]
        before = state_of(
            ROW,
            cars(jnp.pad(x[:, None], ((0, 0), (0, 2)))),
            jnp.where(active, goal, NO_BAY),  # the finished ones have crashed
            active=active,
            parked_cars=parked_in(ROW, jax.random.randint(keys[4], (1,), 0, 5)),
            tracked_bays=tracked,
        )
        choice = jax.random.randint(keys[5], (agents,), 0, slots + 1)
        chosen = choose_goals(config, before, choice)
        # Anybody may park that has a goal, but only one in a bay, or crash.
        able = before.active & (chosen.goal != NO_BAY)
        parked = able & jax.random.bernoulli(keys[6], 0.3, (agents,))
        same = jnp.tril(chosen.goal[:, None] == chosen.goal, k=-1)
        parked = parked & ~(same & parked).any(axis=1)
        crashed = (
            before.active & ~parked & jax.random.bernoulli(keys[7], 0.1, (agents,))
        )
        events = no_events(agents, parked=parked, crashed=crashed)
        after = chosen
        if not respawn:
            after = chosen.replace(active=chosen.active & ~events.done)
        ended, named = update_goals(config, before, after, events)
        bare = [x.replace(key=None) for x in (before, chosen, ended)]
        return *bare, events, named

    keys = jax.random.split(jax.random.key(1), lots)
    return jax.device_get(jax.jit(jax.vmap(step))(keys))


def test_the_five_choices_partition_the_steps_of_active_agents():
    before, chosen, _, _, events = random_steps()
    active, has = before.active, chosen.goal != NO_BAY
    flags = np.stack([getattr(events, name) for name in CHOICES])
    np.testing.assert_array_equal(flags.sum(axis=0), active)
    assert flags.any(axis=(1, 2)).all()
    np.testing.assert_array_equal(events.exploring, active & ~has)
    had = active & (before.goal != NO_BAY)
    np.testing.assert_array_equal(flags[2:].any(axis=0), had)
    np.testing.assert_array_equal(chosen.goal[~active], before.goal[~active])
    assert not (events.lost_untracked & events.lost_taken).any()
    lost = events.lost_untracked | events.lost_taken
    assert not (lost & events.exploring).any()
    assert events.lost_untracked.any()
    assert events.lost_taken.any()


@pytest.mark.parametrize("respawn", [True, False])
def test_goals_are_lost_if_taken_or_untracked(respawn):
    before, chosen, ended, events, goals = random_steps(respawn)
    done, goal = events.parked | events.crashed, chosen.goal
    goes_on, has = before.active & ~done, goal != NO_BAY
    others = ~np.eye(goal.shape[1], dtype=bool)
    same = (goal[:, :, None] == goal[:, None]) & others
    taken = goes_on & has & (same & events.parked[:, None]).any(axis=2)
    np.testing.assert_array_equal(goals.lost_taken, taken)
    tracked = (ended.tracked_bays == goal[..., None]).any(axis=2)
    lost = goes_on & has & ~tracked & ~taken
    np.testing.assert_array_equal(goals.lost_untracked, lost)
    kept = np.where(goes_on & has & tracked & ~taken, goal, NO_BAY)
    np.testing.assert_array_equal(ended.goal[goes_on], kept[goes_on])
    # Whoever has parked and stays keeps the bay, in which it stands.
    stays = events.parked & (not respawn)
    kept = np.where(stays, goal, NO_BAY)
    np.testing.assert_array_equal(ended.goal[done], kept[done])


# Five bays in a row, 4 m apart, and as many bays' worth of padding.
LINE = pad_layout(
    lot([(x, 10.0, math.pi / 2) for x in (0, 4, 8, 12, 16)]), Maxima(8, 1, 1, 0, 1)
)


def track(state, usable=None, by_distance=False):
    """Tracked bays of a state; all are usable if None."""
    config = SimpleNamespace(
        varies=False,
        goals=GoalConfig(dynamic=True, slots_by_distance=by_distance),
        observation=SimpleNamespace(bays_in_view=lambda state: usable),
    )
    return track_bays(config, state).tracked_bays


def tracked_at(x, taken=(), tracked=None, count=2, by_distance=False):
    """Bays tracked by one agent at (x, 0), by the parked cars that there are."""
    state = state_of(
        LINE,
        cars([(x, 0.0, 0.0)]),
        NO_BAY,
        parked_cars=parked_in(LINE, list(taken)),
        tracked_bays=[[NO_BAY] * count if tracked is None else tracked],
    )
    return track(state, None, by_distance)[0].tolist()


def test_first_slots_are_by_distance():
    assert tracked_at(0.0) == [0, 1]
    assert tracked_at(15.0, count=3) == [4, 3, 2]
    assert tracked_at(0.0, taken=[0, 2, NO_BAY]) == [1, 3]


def test_tracked_bay_keeps_its_slot_while_among_the_nearest():
    assert tracked_at(3.0, tracked=[0, 1]) == [0, 1]  # bay 1 is nearer now
    assert tracked_at(7.0, tracked=[0, 1]) == [2, 1]  # bay 0 has left its slot to 2
    assert tracked_at(16.0, tracked=[0, 1]) == [4, 3]  # both are new
    assert tracked_at(3.0, taken=[1], tracked=[0, 1]) == [0, 2]  # somebody parked


def test_slots_by_distance_have_the_nearest_bay_first():
    assert tracked_at(3.0, tracked=[0, 1], by_distance=True) == [1, 0]
    assert tracked_at(7.0, tracked=[0, 1], by_distance=True) == [2, 1]
    assert tracked_at(3.0, [1], [2, 0], by_distance=True) == [0, 2]
    assert tracked_at(0.0, [0, 1, 2, 4], [0, 3], by_distance=True) == [3, NO_BAY]


def test_slots_for_which_there_is_no_bay_are_empty():
    assert tracked_at(0.0, taken=[0, 1, 2, 4]) == [3, NO_BAY]
    assert tracked_at(0.0, taken=[0, 1, 2, 4], tracked=[0, 3]) == [NO_BAY, 3]
    assert tracked_at(0.0, taken=range(5)) == [NO_BAY, NO_BAY]
    assert tracked_at(0.0, count=7) == [0, 1, 2, 3, 4, NO_BAY, NO_BAY]


def test_only_bays_of_finished_agents_are_taken():
    state = state_of(
        LINE,
        cars([(0.0, 0.0, 0.0)] * 3),
        [0, 1, NO_BAY],
        active=jnp.array([False, True, False]),
        tracked_bays=[[NO_BAY] * 2] * 3,
    )
    assert track(state).tolist() == [[1, 2]] * 3


def test_only_usable_bays_are_tracked():
    usable = jnp.zeros((2, 8), bool).at[0, 3].set(True).at[1, 1:].set(True)
    motion = cars([(0.0, 0.0, 0.0)] * 2)
    state = state_of(LINE, motion, NO_BAY, tracked_bays=[[NO_BAY] * 2] * 2)
    tracked = track(state, usable)
    assert tracked.tolist() == [[3, NO_BAY], [1, 2]]


def test_tracking_keeps_slots_and_finds_the_nearest():
    layout, agents, count = make_layout("square"), 5, 4

    def step(tracked, key):
        place, cars_key = jax.random.split(key)
        xy = jax.random.uniform(place, (agents, 2), minval=-20, maxval=20)
        free = jax.random.bernoulli(cars_key, 0.12, (agents, 36))
        after = nearest_bays(layout, xy, free, tracked)
        return after, (xy, free, tracked, after)

    keys = jax.random.split(jax.random.key(0), 300)
    empty = jnp.full((agents, count), NO_BAY, jnp.int32)
    _, seen = jax.jit(lambda k: jax.lax.scan(step, empty, k))(keys)
    bays, full = np.asarray(layout.bay_pose)[:, :2], 0
    rows = [np.asarray(x).reshape(-1, *x.shape[2:]) for x in seen]
    for xy, free, before, after in zip(*rows, strict=True):
        gap = np.where(free, np.linalg.norm(bays - xy, axis=-1), np.inf)
        nearest = np.argsort(gap, kind="stable")[: min(count, free.sum())]
        assert sorted(after[after != NO_BAY]) == sorted(nearest)
        stays = np.isin(before, nearest)
        np.testing.assert_array_equal(after[stays], before[stays])
        newcomers = [bay for bay in nearest if bay not in before]
        entered = [bay for bay in after[~stays] if bay != NO_BAY]
        assert entered == newcomers  # the nearest into the first empty slot
        full += len(nearest) == count
    assert 300 < full < 1500


def test_target_is_the_goal_or_the_nearest_tracked_bay():
    xy = jnp.zeros((3, 2))
    tracked = jnp.array([[4, 2], [NO_BAY, 1], [NO_BAY, NO_BAY]])
    bay, known = target_bay(LINE, jnp.array([0, NO_BAY, NO_BAY]), tracked, xy)
    assert known.tolist() == [True, True, False]
    np.testing.assert_array_equal(bay[:2], [0, 1])
    bay, _ = target_bay(LINE, jnp.array([NO_BAY, 3, 3]), tracked, xy)
    np.testing.assert_array_equal(bay, [2, 3, 3])
