"""Fixed goals as episodes end at random, and starts of agents that explore."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import cars, check_occupancy, lot
from helpers.spawning import many
from helpers.states import parked_in, state_of
from helpers.transitions import no_events

from carpark_mj.config import WORLD_UNIT, EnvConfig, SpawnConfig
from carpark_mj.layouts import BayKind, Maxima, make_layout, pad_layout
from carpark_mj.mdp.parked_cars import relocate_parked_cars
from carpark_mj.spawning.fleet import Fleet
from carpark_mj.spawning.goals import first_goals, new_goal, place_exploring
from carpark_mj.spawning.placing import SpawnInputs, start_placing
from carpark_mj.types import NO_BAY
from carpark_mj.vehicle import COMPACT

MIN_DISTANCE = 7.38  # m
CONFIG = EnvConfig(spawn=SpawnConfig(min_distance=MIN_DISTANCE))
LOTS = 8


def start_lot(layout, num_agents, num_parked_cars, key):
    """Goals and bays of parked cars of a lot that begins."""
    with jax.ensure_compile_time_eval():
        config = EnvConfig(num_agents=num_agents, num_parked_cars=num_parked_cars)
        fleet = Fleet(config, COMPACT)
    start = fleet.start(layout, key)
    return start.goal, start.parked_cars.bay


def drawn_goal(layout, goal, parked_bay, agent, xy, key):
    """The lot when one agent has drawn a new goal; agents stand at xy."""
    pose = jnp.pad(xy, ((0, 0), (0, 1)))
    inputs = SpawnInputs(layout, parked_in(layout, parked_bay))
    waiting = jnp.arange(goal.shape[0]) == agent
    placing = start_placing(goal, parked_bay, pose, waiting)
    scores = jax.random.uniform(key, (2, layout.num_bays))
    return new_goal(CONFIG, inputs, placing, agent, scores)


def history(layout, num_agents, num_parked_cars, num_steps, seed=0, reach=20.0):
    """Goals and bays of parked cars at the start and after random ends of episodes."""

    def end(carry, key):
        goal, parked_bay = carry
        keys = jax.random.split(key, 5)
        agent = jax.random.randint(keys[0], (), 0, num_agents)
        xy = jax.random.uniform(keys[1], (num_agents, 2), minval=-reach, maxval=reach)
        parked = jax.random.bernoulli(keys[2]) & (jnp.arange(num_agents) == agent)
        motion = cars(jnp.pad(xy, ((0, 0), (0, 1))))
        parked_cars = parked_in(layout, parked_bay)
        state = state_of(layout, motion, goal, parked_cars=parked_cars)
        events = no_events(num_agents, parked=parked)
        bay = relocate_parked_cars(CONFIG, state, events, keys[4]).bay
        drawn = drawn_goal(layout, goal, bay, agent, xy, keys[3])
        return (drawn.goal, drawn.parked_bay), (drawn.goal, drawn.parked_bay)

    def run(key):
        start_key, key = jax.random.split(key)
        start = start_lot(layout, num_agents, num_parked_cars, start_key)
        return start, jax.lax.scan(end, start, jax.random.split(key, num_steps))[1]

    return many(run, LOTS, seed)


def test_initial_goals_and_parked_cars_are_spread_over_all_bays():
    layout = make_layout("square")
    goal, bay = many(lambda key: start_lot(layout, 2, 9, key), 3600, 2)
    goals = np.bincount(np.ravel(goal), minlength=36)
    parked = np.bincount(np.ravel(bay), minlength=36)
    # Binomial with means 200 and 900, deviations 14 and 26: five of them.
    np.testing.assert_allclose(goals, 200, atol=70)
    np.testing.assert_allclose(parked, 900, atol=130)


@pytest.mark.parametrize(("num_agents", "num_parked_cars"), [(1, 0), (7, 28)])
def test_no_goal_ever_holds_a_parked_car(num_agents, num_parked_cars):
    # Four padding bays, which must never be used.
    layout = pad_layout(make_layout("square"), Maxima(40, 8, 0, 0, 1))
    start, (goal, bay) = history(layout, num_agents, num_parked_cars, 1500)
    mask = np.broadcast_to(layout.bay_mask, (LOTS, 1500, 40))
    check_occupancy(*start, mask[:, 0])
    check_occupancy(goal, bay, mask)
    # The number of parked cars is constant, and they do move.
    assert bay.shape == (LOTS, 1500, num_parked_cars)
    assert (np.diff(bay, axis=1) != 0).any(axis=1).all()


# Six bays in a row, 10 m apart, on the x axis.
ROW = lot([(10.0 * k, 0.0, 0.0) for k in range(6)])


def draws(goal, parked_bay, xy, count=400):
    """Many draws of a goal for agent 0 from one state of the row, as numpy."""
    lot = jnp.array(goal, jnp.int32), jnp.array(parked_bay, jnp.int32), 0, jnp.array(xy)
    return many(lambda key: drawn_goal(ROW, *lot, key), count)


def test_a_new_goal_is_uniform_over_bays_that_are_nobodys_goal():
    after = draws([0, 5], [2], [[0.0, 20.0], [50.0, 20.0]], count=4000)
    count = np.bincount(after.goal[:, 0], minlength=6)
    np.testing.assert_array_equal(count[[0, 5]], 0)
    # Mean 1000, deviation 27: five of them.
    np.testing.assert_allclose(count[1:5], 1000, atol=140)
    np.testing.assert_array_equal(after.goal[:, 1], 5)
    assert after.found.all()


FAR, NEAR = [[0.0, 0.0], [50.0, 20.0]], [[0.0, 0.0], [0.0, 7.0]]
FULL = (1, 2, 3, 4)


@pytest.mark.parametrize(
    ("goal", "parked", "xy", "expected"),
    [
        # A car on the new goal makes way to the old goal.
        ([0, 5], (2, 3), FAR, {1: "23", 2: "03", 3: "20", 4: "23"}),
        # Elsewhere if another agent is closer to it than MIN_DISTANCE.
        ([0, 5], (2, 3), NEAR, {1: "23", 2: "13 43", 3: "21 24", 4: "23"}),
        # Or if a car stands there, as after a relocation.
        ([0, 5], (0, 3), FAR, {1: "03", 2: "03", 3: "01 02 04", 4: "03"}),
        # Without a refuge only bays without cars are drawn: agents 1 and 2 stand near
        # the free bays 0 (the old goal), 1 and 2.
        ([0, 5, 4], (3,), [[0.0, 0.0], [5.0, 1.0], [15.0, 1.0]], {1: "3", 2: "3"}),
        # Where every other bay is taken the goal is kept, or swapped with a car.
        ([0, 5], FULL, NEAR, {0: "1234"}),
        ([0, 5], FULL, FAR, {1: "0234", 2: "1034", 3: "1204", 4: "1230"}),
    ],
)
def test_goals_drawn_and_bays_of_parked_cars_by_hand(goal, parked, xy, expected):
    after = draws(goal, parked, xy)
    found = {}
    for own, bays in zip(after.goal[:, 0].tolist(), after.parked_bay, strict=True):
        found.setdefault(own, set()).add("".join(map(str, bays)))
    assert found == {own: {*bays.split()} for own, bays in expected.items()}
    np.testing.assert_array_equal(after.goal[:, 1:], [goal[1:]] * 400)
    np.testing.assert_array_equal(after.found[:, 0], after.goal[:, 0] != goal[0])


def test_car_on_a_kept_goal_makes_way_even_near_an_agent():
    # As after a relocation from bay 3: the only bays that are not reserved are goals.
    kind = jnp.full(6, BayKind.RESERVED).at[jnp.array([1, 5])].set(BayKind.STANDARD)
    row = ROW.replace(bay_kind=kind)
    xy = jnp.array([[10.0, 0.0], [30.0, 5.0]])  # agent 1 is 5 m from the free bay
    goal, parked_bay = jnp.array([1, 5]), jnp.array([1, 0, 2, 4])
    after = drawn_goal(row, goal, parked_bay, 0, xy, jax.random.key(0))
    assert after.goal.tolist() == [1, 5]
    assert after.parked_bay.tolist() == [3, 0, 2, 4]


@pytest.mark.parametrize("occupancy", [None, (1.0, 1.0)])
def test_goals_take_reserved_bays_only_when_no_other_is_free(occupancy):
    kind = jnp.full(36, BayKind.RESERVED).at[jnp.array([4, 20])].set(0)
    layout = make_layout("square").replace(bay_kind=kind)
    count = 33 if occupancy is None else 36
    config = EnvConfig(num_agents=3, num_parked_cars=count, occupancy=occupancy)
    fleet = Fleet(config, COMPACT)
    start = many(lambda key: fleet.start(layout, key), 40)
    goals, bays = start.goal, start.parked_cars.bay
    assert (np.isin(goals, [4, 20]).sum(axis=1) == 2).all()
    assert len(set(goals[~np.isin(goals, [4, 20])].tolist())) > 5
    assert not (goals[:, :, None] == bays[:, None]).any()


HALF = 21 * WORLD_UNIT
LAYOUT = pad_layout(make_layout("square"), Maxima(40, 8, 0, 0, 1))
CLOSE = SpawnConfig(close_ratio=1.0)
# Agent 0 starts; 1 heads for bay 3, 2 explores.
GOAL = jnp.array([NO_BAY, 3, NO_BAY], jnp.int32)
PARKED = (0, 1, 2, 10, NO_BAY)
POSE = jnp.array([[0.0, 0.0, 0.0], [-9.0, -9.0, 0.0], [9.0, 9.0, 0.0]])


@functools.partial(jax.jit, static_argnums=0)
def draw(config, inputs, placing, keys):
    def one(key):
        drawn = place_exploring(config, inputs, placing, jnp.array(0), key)
        others = (drawn.goal[1:], drawn.pose_w[1:], drawn.close_bay[1:])
        return drawn.pose_w[0], drawn.close_bay[0], drawn.conflict, others

    return jax.vmap(one)(keys)


def starts(config, parked=PARKED, layout=LAYOUT, size=None, count=2000):
    """Poses of agent 0, bays next to which they are, whether it is in conflict."""
    cars = parked_in(layout, parked)
    sizes = None if size is None else jnp.broadcast_to(jnp.asarray(size), (3, 2))
    inputs = SpawnInputs(layout, cars, sizes, sizes)
    placing = start_placing(GOAL, cars.bay, POSE, jnp.arange(3) == 0)
    keys = jax.random.split(jax.random.key(0), count)
    drawn = jax.device_get(draw(config, inputs, placing, keys))
    pose, close_bay, conflict, (goal, others, others_bay) = drawn
    # Nobody else is touched.
    np.testing.assert_array_equal(goal, np.tile(GOAL[1:], (count, 1)))
    np.testing.assert_array_equal(others, np.tile(POSE[1:], (count, 1, 1)))
    assert (others_bay == NO_BAY).all()
    assert not conflict[:, 1:].any()
    return pose, close_bay, conflict[:, 0]


def test_a_close_start_is_near_a_free_bay_that_is_nobody_s_goal():
    pose, close_bay, conflict = starts(CLOSE)
    drawn = np.unique(close_bay)
    # Parked cars, agent 1's goal and padding are out.
    assert not set(drawn) & {0, 1, 2, 3, 10, 36, 37, 38, 39, NO_BAY}
    assert 5 in drawn
    assert len(drawn) > 20  # those near another agent come seldom
    goal = np.asarray(LAYOUT.bay_pose)[close_bay, :2]
    nearest = np.clip(goal, -HALF, HALF)
    gap = np.linalg.norm(pose[:, :2] - nearest, axis=1)
    assert gap.max() <= CLOSE.close_distance + 1e-4
    assert not conflict.any()


def test_without_a_free_bay_to_start_near_the_start_is_random():
    every = tuple(range(36))
    pose, close_bay, _ = starts(CLOSE, parked=every)
    assert (close_bay == NO_BAY).all()
    random = dataclasses.replace(CLOSE, close_ratio=0.0)
    np.testing.assert_allclose(pose, starts(random, parked=every)[0], atol=1e-5)


TRACKED = jnp.array([7, 3, NO_BAY, 8], jnp.int32)


def goals(close_bay=NO_BAY, conflict=False, others=(3, 8, NO_BAY, NO_BAY), count=2000):
    """First goals of an agent that tracks bays 7, 3 and 8, and how often each came."""
    goal = jnp.array([NO_BAY, *others], jnp.int32)
    num_agents = goal.shape[0]
    begun = jnp.arange(num_agents) == 0
    placing = start_placing(goal, goal, jnp.zeros((num_agents, 3)), begun)
    placing = placing.replace(
        close_bay=placing.close_bay.at[0].set(close_bay),
        conflict=placing.conflict.at[0].set(conflict),
    )
    tracked = jnp.tile(TRACKED, (num_agents, 1))
    keys = jax.random.split(jax.random.key(1), count)
    drawn = jax.vmap(lambda key: first_goals(placing, tracked, goal, begun, key))(keys)
    assert drawn.dtype == jnp.int32
    assert (drawn[:, 1:] == goal[1:]).all()
    values, counts = np.unique(np.asarray(drawn[:, 0]), return_counts=True)
    return dict(zip(values.tolist(), (counts / count).tolist(), strict=True))


def test_first_goals_are_tracked_bays_of_close_starts_and_conflicts():
    assert goals() == {NO_BAY: 1.0}  # a random start begins exploring
    share = goals(close_bay=7)
    # Deviation 1.1 %: five of them.
    assert share == pytest.approx({7: 0.5, NO_BAY: 0.5}, abs=0.056)
    assert goals(close_bay=9) == {NO_BAY: 1.0}
    # A start in conflict shares a tracked goal.
    assert goals(conflict=True) == pytest.approx({3: 0.5, 8: 0.5}, abs=0.056)
    assert goals(conflict=True, others=(8, 9, 8)) == {8: 1.0}
    # Nobody heads for a tracked bay; who explores has no goal to share.
    assert goals(conflict=True, others=(9, NO_BAY)) == {NO_BAY: 1.0}


def test_first_goals_are_those_of_the_agents_that_start():
    goal = jnp.array([NO_BAY, 8, NO_BAY, NO_BAY], jnp.int32)
    begun = jnp.array([True, False, True, False])
    placing = start_placing(goal, goal, jnp.zeros((4, 3)), begun)
    placing = placing.replace(conflict=jnp.array([True, True, False, True]))
    tracked = jnp.tile(TRACKED, (4, 1))
    got = first_goals(placing, tracked, goal, begun, jax.random.key(0))
    # 0 joins agent 1, who drives on; 2 is in no conflict, 3 does not start.
    np.testing.assert_array_equal(got, [8, 8, NO_BAY, NO_BAY])
