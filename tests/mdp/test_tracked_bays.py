"""Which free bays agents track, in which slots, and what they head for."""

import math
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
from helpers.scenes import cars, lot
from helpers.states import parked_in, state_of

from carpark_mj.config import GoalConfig
from carpark_mj.layouts import Maxima, make_layout, pad_layout
from carpark_mj.mdp.goals import nearest_bays, target_bay, track_bays
from carpark_mj.types import NO_BAY

# Five bays in a row, 4 m apart, and as many bays' worth of padding.
ROW = pad_layout(
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
        ROW,
        cars([(x, 0.0, 0.0)]),
        NO_BAY,
        parked_cars=parked_in(ROW, list(taken)),
        tracked_bays=[[NO_BAY] * count if tracked is None else tracked],
    )
    return track(state, None, by_distance)[0].tolist()


def test_an_agent_that_tracks_none_yet_numbers_the_nearest_bays_by_distance():
    assert tracked_at(0.0) == [0, 1]
    assert tracked_at(15.0, count=3) == [4, 3, 2]
    assert tracked_at(0.0, taken=[0, 2, NO_BAY]) == [1, 3]


def test_a_bay_keeps_its_slot_for_as_long_as_it_is_among_the_nearest():
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


def test_the_bays_of_finished_agents_are_not_free_and_goals_of_others_are():
    state = state_of(
        ROW,
        cars([(0.0, 0.0, 0.0)] * 3),
        [0, 1, NO_BAY],
        active=jnp.array([False, True, False]),
        tracked_bays=[[NO_BAY] * 2] * 3,
    )
    assert track(state).tolist() == [[1, 2]] * 3


def test_only_usable_bays_are_tracked():
    usable = jnp.zeros((2, 8), bool).at[0, 3].set(True).at[1, 1:].set(True)
    motion = cars([(0.0, 0.0, 0.0)] * 2)
    state = state_of(ROW, motion, NO_BAY, tracked_bays=[[NO_BAY] * 2] * 2)
    tracked = track(state, usable)
    assert tracked.tolist() == [[3, NO_BAY], [1, 2]]


def test_tracking_on_random_states_keeps_slots_and_finds_the_nearest():
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


def test_agents_head_for_their_goals_or_the_nearest_bays_they_track():
    xy = jnp.zeros((3, 2))
    tracked = jnp.array([[4, 2], [NO_BAY, 1], [NO_BAY, NO_BAY]])
    bay, known = target_bay(ROW, jnp.array([0, NO_BAY, NO_BAY]), tracked, xy)
    assert known.tolist() == [True, True, False]
    np.testing.assert_array_equal(bay[:2], [0, 1])
    bay, _ = target_bay(ROW, jnp.array([NO_BAY, 3, 3]), tracked, xy)
    np.testing.assert_array_equal(bay, [2, 3, 3])
