"""Goals that agents choose: by hand, in the environment, and which bays they track.

Cars slide (`helpers.sliding`) where only the task matters.
"""

import math
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import cars, lot
from helpers.sliding import SlidePhysics, placed, sliding
from helpers.states import parked_in, state_of
from helpers.transitions import CHOICES, no_events

from carpark_mj.config import EnvConfig, EpisodeConfig, FleetConfig, GoalConfig, insert
from carpark_mj.env import ParkingEnv
from carpark_mj.layouts import Maxima, pad_layout
from carpark_mj.mdp.goals import choose_goals, target_bay, track_bays, update_goals
from carpark_mj.observations import ContinuousObservation
from carpark_mj.types import NO_BAY

AGENTS, SLOTS, BAYS = 4, 3, 36
CONFIG = EnvConfig(
    num_agents=AGENTS,
    num_parked_cars=16,
    goals=GoalConfig(dynamic=True, num_tracked_bays=SLOTS),
    episode=EpisodeConfig(parked_rule="tanner", max_steps=30),
)
APART = np.array([[-7.0, 0, 0], [0.0, 0, 0], [7.0, 0, 0], [0.0, 7, 0]], np.float32)


def slide(respawn=True):
    return sliding(insert(CONFIG, {"episode.respawn": respawn}))


def act(choice):
    """Actions (agents, 3) of cars that stand."""
    return np.pad(np.float32(choice)[:, None], ((0, 0), (2, 0)))


def start(respawn=True, pose=APART, goal=None):
    """One lot with its agents standing at given poses; goals by hand."""
    env, reset, step = slide(respawn)
    state = placed(env, reset(jax.random.key(0))[0], pose)
    if goal is not None:
        goal = jnp.asarray(goal, jnp.int32)
        state = state.replace(
            goal=goal, tracked_bays=jnp.full((AGENTS, SLOTS), NO_BAY).at[:, 0].set(goal)
        )
    return env, step, state


def free(state):
    """Bays without a parked car."""
    return np.setdiff1d(np.arange(BAYS), state.parked_cars.bay)


# Starting


# Steps by hand


def test_a_choice_is_made_before_the_step_and_judged_with_it():
    _, step, state = start()
    mine = state.layout.bay_pose[state.tracked_bays[1, 2]]
    pose = APART.copy()
    pose[1] = mine
    # JAX reads a row past the end as the last: no goal must not mean the last bay.
    pose[3] = np.asarray(state.layout.bay_pose[BAYS - 1])
    state = placed(slide()[0], state, pose)
    _, explores = step(state, act([0, 0, 0, 0]))
    assert not explores.events.parked.any()  # in a bay, but without a goal
    after, timestep = step(state, act([1, 3, 0, 0]))
    np.testing.assert_array_equal(timestep.events.parked, [False, True, False, False])
    chosen = [state.tracked_bays[0, 0], state.tracked_bays[1, 2], NO_BAY, NO_BAY]
    assert timestep.goal.tolist() == chosen
    assert timestep.reward_terms["park"][1] == CONFIG.reward.park
    assert after.goal[1] == NO_BAY  # the new episode explores
    assert state.tracked_bays[1, 2] in after.parked_cars.bay


def test_parked_agent_keeps_its_bay_without_respawn():
    state = start(respawn=False)[2]
    gap = np.linalg.norm(state.layout.bay_pose[:, :2] - APART[0, :2], axis=1)
    bay = int(min(free(state), key=lambda bay: gap[bay]))  # agent 0 would track it
    pose = APART.copy()
    pose[1] = np.asarray(state.layout.bay_pose[bay])
    _, step, state = start(False, pose, [bay, bay, NO_BAY, NO_BAY])
    before = state.parked_cars.bay
    state, timestep = step(state, act([1, 1, 0, 0]))
    np.testing.assert_array_equal(timestep.goal_events.lost_taken, [True, *[0] * 3])
    assert state.goal.tolist() == [NO_BAY, bay, NO_BAY, NO_BAY]
    np.testing.assert_array_equal(state.parked_cars.bay, before)
    for choice in (0, 1, 2):
        state, timestep = step(state, act([1, choice, 1, 1]))
        assert bay not in np.delete(np.asarray(state.tracked_bays), 1, axis=0)
        assert state.goal[1] == bay
        assert timestep.reward[1] == 0.0
        assert not any(flag[1] for flag in jax.tree.leaves(timestep.goal_events))


# Whatever happens


def drive(env, num_steps=300, parks=0.1):
    """Random driving and choosing; states before and after every step, numpy.

    With a chance of `parks` an agent with a goal is put into its bay beforehand.
    """

    def one(state, key):
        keys, goal = jax.random.split(key, 4), state.goal
        index = jax.random.randint(keys[0], (AGENTS,), 0, 1 + SLOTS)
        held = jnp.argmax(state.tracked_bays == goal[:, None], axis=1) + 1
        held = jnp.where(goal == NO_BAY, 0, held)
        keep = jax.random.bernoulli(keys[1], 0.7, (AGENTS,))
        index = jnp.where(keep, held, index)[:, None]
        numbers = jax.random.uniform(keys[2], (AGENTS, 2), minval=-0.5)
        put = jax.random.bernoulli(keys[3], parks, (AGENTS,)) & (goal != NO_BAY)
        pose = state.layout.bay_pose[jnp.minimum(goal, BAYS - 1)]
        physics = env.physics.place(state.physics, put, pose, state.physics.vehicle)
        state = state.replace(physics=physics, motion=env.physics.read(physics))
        after, timestep = env.step(state, jnp.concatenate([numbers, index], axis=1))
        bare = [x.replace(physics=None, key=None) for x in (state, after)]
        return after, (*bare, timestep)

    def run(key):
        state, _ = env.reset(key)
        return jax.lax.scan(one, state, jax.random.split(key, num_steps))[1]

    return jax.device_get(jax.jit(run)(jax.random.key(1)))


def tracks(state, goal):
    """Which agents track a bay."""
    return (state.tracked_bays == goal[..., None]).any(axis=-1)


def test_invariants_when_many_park_start_close_and_share_goals():
    env = ParkingEnv(insert(CONFIG, {"spawn.close_ratio": 1.0}), SlidePhysics())
    before, after, timestep = drive(env)
    events, goals, goal = timestep.events, timestep.goal_events, after.goal
    parked_bay = np.sort(after.parked_cars.bay, axis=1)
    assert (np.diff(parked_bay, axis=1) > 0).all()  # none lost, none doubled
    assert (parked_bay >= 0).all()
    assert (parked_bay < BAYS).all()
    assert events.parked.sum() > 20
    # Where an agent parks a car moves in, though several do in one step.
    filled = (timestep.goal[..., None] == after.parked_cars.bay[:, None]).any(axis=2)
    assert filled[events.parked].all()
    assert (events.parked.sum(axis=1) > 1).any()
    # Tracked bays are the nearest free ones.
    assert (before.tracked_bays != NO_BAY).all()
    bays = after.layout.bay_pose[0, :, :2]
    free = np.ones((len(parked_bay), BAYS), bool)
    np.put_along_axis(free, parked_bay, False, axis=1)
    xy = after.motion.pose_w[:, :, None, :2]
    gap = np.where(free[:, None], np.linalg.norm(xy - bays, axis=-1), np.inf)
    nearest = np.sort(gap, axis=-1)[..., :SLOTS]
    found = np.sort(np.take_along_axis(gap, after.tracked_bays, axis=-1), axis=-1)
    np.testing.assert_allclose(found, nearest, atol=1e-4)
    # A bay that stays among them keeps its slot.
    goes_on = ~events.done
    old, new = before.tracked_bays[goes_on], after.tracked_bays[goes_on]
    stays = (old[:, :, None] == new[:, None, :]).any(axis=2)
    np.testing.assert_array_equal(old[stays], new[stays])
    # Goals are tracked, those that new episodes start with too; lost ones are none.
    assert ((goal == NO_BAY) | tracks(after, goal)).all()
    # Taken is one in which another has just parked.
    same = timestep.goal[:, :, None] == timestep.goal[:, None]
    same &= ~np.eye(AGENTS, dtype=bool)
    has = goes_on & (timestep.goal != NO_BAY)
    taken = has & (same & events.parked[:, None]).any(axis=2)
    np.testing.assert_array_equal(goals.lost_taken, taken)
    untracked = has & ~taken & ~tracks(after, timestep.goal)
    np.testing.assert_array_equal(goals.lost_untracked, untracked)
    kept = np.where(taken | untracked, NO_BAY, timestep.goal)
    np.testing.assert_array_equal(goal[goes_on], kept[goes_on])
    np.testing.assert_array_equal(goals.exploring, timestep.goal == NO_BAY)
    # One transition each, every one of them happens, and they are paid by name.
    terms, pay = timestep.reward_terms, env.config.reward.goals
    paid = {name: getattr(pay, name) for name in CHOICES} | {"stop_goal": pay.stop}
    for name in CHOICES:
        flag = getattr(goals, name)
        assert flag.any(), name
        np.testing.assert_allclose(terms[name], paid[name] * flag, atol=1e-7)
    assert (sum(getattr(goals, name).astype(int) for name in CHOICES) == 1).all()
    assert untracked.any()
    assert taken.any()
    np.testing.assert_allclose(terms["lost_goal"], pay.stop * untracked)
    np.testing.assert_allclose(timestep.reward, sum(terms.values()), atol=1e-5)
    assert not (events.parked & goals.exploring).any()
    assert (terms["progress"][goals.exploring] <= 0).all()
    # Metrics of an episode are the sums of what happened in it.
    sums = {
        name: flag for name, flag in vars(goals).items() if name in timestep.metrics
    }
    assert {"lost_untracked", "lost_taken", "stop_goal", "change_goal"} <= {*sums}
    sums |= {"explored_steps": goals.exploring, "length": np.ones_like(goals.exploring)}
    sums |= {"episode_return": timestep.reward}
    sums |= {f"return_{name}": term for name, term in terms.items()}
    for name, flag in sums.items():
        total = np.zeros(AGENTS)
        for t in range(len(goal)):
            total = total + flag[t]
            # float32 sums of 30 numbers up to 4.
            np.testing.assert_allclose(timestep.metrics[name][t], total, atol=1e-4)
            total[events.done[t]] = 0
    assert np.isfinite(timestep.observation).all()
    # Half of the close starts have the bay beside them for a goal: it may be taken, or
    # not be among the nearest.
    begun = goal[events.done]
    assert len(begun) > 50
    assert 0.25 < (begun != NO_BAY).mean() < 0.6
    tracked = (after.tracked_bays[events.done] == begun[:, None]).any(axis=1)
    np.testing.assert_array_equal(tracked, begun != NO_BAY)


# Five bays in a row, 4 m apart, agents in front of it, and as many bays of padding.
ROW = lot([(x, 10.0, math.pi / 2) for x in (0, 4, 8, 12, 16)])
LINE = pad_layout(ROW, Maxima(8, 1, 1, 0, 1))


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
    goals = GoalConfig(dynamic=True, num_tracked_bays=3)
    config = EnvConfig(num_agents=1, goals=goals)
    motion, parked = cars([(0.0, 0.0, 0.0)]), parked_in(ROW, [0, 2, 3])
    tracked = [[4, NO_BAY, 1]]
    before = state_of(ROW, motion, [goal], parked_cars=parked, tracked_bays=tracked)
    after = choose_goals(config, before, jnp.array([choice]))
    assert (after.goal.tolist(), after.goal.dtype) == ([expected], jnp.int32)
    ended, events = update_goals(config, before, after, no_events(1))
    assert ended.goal.tolist() == [expected]
    flags = {name: flag for name, flag in vars(events).items() if name != "contexts"}
    assert [name for name, flag in flags.items() if flag[0]] == [name]
    assert bool(events.exploring[0]) == (expected == NO_BAY)


def track(state, usable=None, by_distance=False):
    """Tracked bays of a state; all are usable if None."""
    config = SimpleNamespace(
        varies=False,
        goals=GoalConfig(dynamic=True, slots_by_distance=by_distance),
        observation=SimpleNamespace(bays_in_view=lambda state: usable),
    )
    return track_bays(config, state).tracked_bays


NONE = [NO_BAY] * 2


@pytest.mark.parametrize(
    ("x", "taken", "tracked", "slots", "by_distance"),
    [
        (0.0, [], NONE, [0, 1], [0, 1]),  # the nearest first
        (15.0, [], [*NONE, NO_BAY], [4, 3, 2], [4, 3, 2]),
        (0.0, [0, 2, NO_BAY], NONE, [1, 3], [1, 3]),
        (3.0, [], [0, 1], [0, 1], [1, 0]),  # bay 1 is nearer now
        (7.0, [], [0, 1], [2, 1], [2, 1]),  # bay 0 has left its slot to 2
        (16.0, [], [0, 1], [4, 3], [4, 3]),  # both are new
        (3.0, [1], [0, 1], [0, 2], [0, 2]),  # somebody parked
        (3.0, [1], [2, 0], [2, 0], [0, 2]),
        (0.0, [0, 1, 2, 4], NONE, [3, NO_BAY], [3, NO_BAY]),  # no bay for a slot
        (0.0, [0, 1, 2, 4], [0, 3], [NO_BAY, 3], [3, NO_BAY]),
        (0.0, range(5), NONE, NONE, NONE),
        (0.0, [], [NO_BAY] * 7, [0, 1, 2, 3, 4, *NONE], [0, 1, 2, 3, 4, *NONE]),
    ],
)
def test_slots_by_hand(x, taken, tracked, slots, by_distance):
    motion, parked = cars([(x, 0.0, 0.0)]), parked_in(LINE, list(taken))
    state = state_of(LINE, motion, NO_BAY, parked_cars=parked, tracked_bays=[tracked])
    assert track(state).tolist() == [slots]
    assert track(state, by_distance=True).tolist() == [by_distance]


def test_bays_of_finished_agents_and_useless_ones_are_left_out():
    motion, active = cars([(0.0, 0.0, 0.0)] * 3), jnp.array([False, True, False])
    goal = [0, 1, NO_BAY]
    state = state_of(LINE, motion, goal, active=active, tracked_bays=[NONE] * 3)
    assert track(state).tolist() == [[1, 2]] * 3
    usable = jnp.ones((3, 8), bool).at[0].set(jnp.arange(8) == 3)
    assert track(state, usable).tolist() == [[3, NO_BAY], [1, 2], [1, 2]]


def test_agents_of_a_fleet_track_only_bays_they_fit_in():
    """A van of 4.90 m and a city car, in bays of which two are long enough for it."""
    config = EnvConfig(
        num_agents=2,
        fleet=FleetConfig(("city", "van")),
        observation=ContinuousObservation(own_car=True),
        goals=GoalConfig(dynamic=True),
    )
    size = jnp.full((8, 2), 4.95).at[jnp.array([2, 4])].set(5.5)
    motion = cars([(0.0, 0.0, 0.0)] * 2, size=[(4.9, 1.9), (3.6, 1.7)])
    layout = LINE.replace(bay_size=size)
    state = state_of(layout, motion, NO_BAY, tracked_bays=[NONE] * 2)
    assert track_bays(config, state).tracked_bays.tolist() == [[2, 4], [0, 1]]


def test_target_is_the_goal_or_the_nearest_tracked_bay():
    xy = jnp.zeros((3, 2))
    tracked = jnp.array([[4, 2], [NO_BAY, 1], [NO_BAY, NO_BAY]])
    bay, known = target_bay(LINE, jnp.array([0, NO_BAY, NO_BAY]), tracked, xy)
    assert known.tolist() == [True, True, False]
    np.testing.assert_array_equal(bay[:2], [0, 1])
    bay, _ = target_bay(LINE, jnp.array([NO_BAY, 3, 3]), tracked, xy)
    np.testing.assert_array_equal(bay, [2, 3, 3])
