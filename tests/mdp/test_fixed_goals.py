import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import check_occupancy, lot

from carpark_mj.layouts import Maxima, make_layout, pad_layout
from carpark_mj.mdp.goals import Occupancy, evolve, init_occupancy, new_goal

MIN_DISTANCE = 7.38  # m
LOTS = 8


def history(layout, num_agents, num_parked_cars, num_steps, seed=0, reach=20.0):
    """Random episode ends in a batch of lots; occupancy after each, and the agent."""

    def end(carry, key):
        occupancy = carry
        keys = jax.random.split(key, 4)
        agent = jax.random.randint(keys[0], (), 0, num_agents)
        xy = jax.random.uniform(keys[1], (num_agents, 2), minval=-reach, maxval=reach)
        parked = jax.random.bernoulli(keys[2])
        occupancy = evolve(layout, occupancy, agent, xy, parked)
        occupancy = new_goal(layout, occupancy, agent, xy, MIN_DISTANCE, keys[3])
        return occupancy, (occupancy, agent)

    def run(key):
        start_key, key = jax.random.split(key)
        start = init_occupancy(layout, num_agents, num_parked_cars, start_key)
        return start, jax.lax.scan(end, start, jax.random.split(key, num_steps))[1]

    keys = jax.random.split(jax.random.key(seed), LOTS)
    start, (later, agent) = jax.jit(jax.vmap(run))(keys)
    return jax.device_get((start, later, agent))


@pytest.mark.parametrize("num_parked_cars", [0, 16, 33])
def test_a_lot_starts_with_distinct_goals_and_parked_cars_elsewhere(num_parked_cars):
    layout = make_layout("tanner")
    start = jax.vmap(lambda key: init_occupancy(layout, 3, num_parked_cars, key))(
        jax.random.split(jax.random.key(1), 200)
    )
    assert start.goal.shape == (200, 3)
    assert start.parked_bay.shape == (200, num_parked_cars)
    assert start.goal.dtype == start.parked_bay.dtype == jnp.int32
    mask = np.broadcast_to(layout.bay_mask, (200, 36))
    check_occupancy(start.goal, start.parked_bay, mask)


def test_initial_goals_and_parked_cars_are_spread_over_all_bays():
    layout = make_layout("tanner")
    start = jax.vmap(lambda key: init_occupancy(layout, 2, 9, key))(
        jax.random.split(jax.random.key(2), 3600)
    )
    goals = np.bincount(np.ravel(start.goal), minlength=36)
    cars = np.bincount(np.ravel(start.parked_bay), minlength=36)
    # Binomial with means 200 and 900, deviations 14 and 26: five of them.
    np.testing.assert_allclose(goals, 200, atol=70)
    np.testing.assert_allclose(cars, 900, atol=130)


@pytest.mark.parametrize(
    ("num_agents", "num_parked_cars"), [(1, 0), (2, 16), (7, 16), (7, 28)]
)
def test_no_goal_ever_holds_a_parked_car(num_agents, num_parked_cars):
    # Four padding bays, which must never be used.
    layout = pad_layout(make_layout("tanner"), Maxima(40, 8, 0, 0, 1))
    start, later, _ = history(layout, num_agents, num_parked_cars, 1500)
    mask = np.broadcast_to(layout.bay_mask, (LOTS, 1500, 40))
    check_occupancy(start.goal, start.parked_bay, mask[:, 0])
    check_occupancy(later.goal, later.parked_bay, mask)
    # The number of parked cars is constant, and they do move.
    assert later.parked_bay.shape == (LOTS, 1500, num_parked_cars)
    moves = np.diff(later.parked_bay, axis=1) != 0
    assert moves.any(axis=1).all()


def test_every_bay_becomes_every_agents_goal_and_none_stays_taken_for_ever():
    layout = make_layout("tanner")
    _, later, agent = history(layout, 3, 16, 3000)
    steps = np.arange(3000)
    drawn = np.zeros((LOTS, 3, 36), int)
    for k in range(LOTS):
        np.add.at(drawn[k], (agent[k], later.goal[k, steps, agent[k]]), 1)
    # About 1000 draws per agent over 36 bays, 28 each.
    assert drawn.min() >= 5
    cars = later.parked_bay[..., None] == np.arange(36)
    taken = cars.any(axis=2)  # (lots, steps, bays)
    assert (~taken).any(axis=1).all()
    assert taken.any(axis=1).all()


@pytest.mark.parametrize("num_agents", [1, 2, 7])
def test_a_full_lot_keeps_its_invariants(num_agents):
    layout = make_layout("tanner")
    _, later, _ = history(layout, num_agents, 36 - num_agents, 1500)
    mask = np.broadcast_to(layout.bay_mask, (LOTS, 1500, 36))
    check_occupancy(later.goal, later.parked_bay, mask)
    # Nevertheless goals change: the car in the new goal swaps with the old one.
    assert (np.diff(later.goal, axis=1) != 0).any(axis=(1, 2)).all()


# Six bays in a row, 10 m apart, on the x axis.
ROW = lot([(10.0 * k, 0.0, 0.0) for k in range(6)])


def occupancy(goal, parked_bay):
    return Occupancy(jnp.array(goal, jnp.int32), jnp.array(parked_bay, jnp.int32))


def draws(before, agent, xy, seed=0, count=400):
    """Many draws of `new_goal` from one occupancy, as numpy."""
    keys = jax.random.split(jax.random.key(seed), count)
    draw = jax.jit(
        jax.vmap(
            lambda key: new_goal(ROW, before, agent, jnp.array(xy), MIN_DISTANCE, key)
        )
    )
    return jax.device_get(draw(keys))


def test_evolve_moves_the_car_farthest_from_all_agents_into_the_bay():
    before = occupancy([0, 5], [1, 3, 4])
    # Gaps to the nearer of the agents at x = 0 and 48: cars at 10, 30, 40 have 10,
    # 18, 8. The car at 40 is farthest from agent 0 alone, yet the one at 30 moves.
    xy = jnp.array([[0.0, 0.0], [48.0, 0.0]])
    after = evolve(ROW, before, jnp.array(0), xy, jnp.array(True))
    np.testing.assert_array_equal(after.parked_bay, [1, 0, 4])
    np.testing.assert_array_equal(after.goal, before.goal)


def test_a_random_car_moves_that_no_agent_tracks():
    # Agents at 0 and 48 track the cars at 10 and 40; those at 20 and 30 are left.
    before = occupancy([0, 5], [1, 2, 3, 4])
    xy = jnp.array([[0.0, 0.0], [48.0, 0.0]])

    def moves(tracked, parked_bay=(1, 2, 3, 4)):
        cars = occupancy([0, 5], parked_bay)

        def one(key):
            return evolve(ROW, cars, 0, xy, jnp.array(True), random=(key, tracked))

        after = jax.vmap(one)(jax.random.split(jax.random.key(0), 1000)).parked_bay
        moved = np.asarray(after) != np.array(parked_bay)
        assert (moved.sum(axis=1) == 1).all()
        assert (np.asarray(after)[moved] == 0).all()
        return moved.mean(axis=0)

    # Deviation of a share of 1,000 at most 1.6 %: five of them.
    np.testing.assert_allclose(moves(1), [0, 0.5, 0.5, 0], atol=0.08)
    np.testing.assert_allclose(moves(0), [0.25] * 4, atol=0.07)
    np.testing.assert_allclose(moves(4), [0.25] * 4, atol=0.07)
    np.testing.assert_array_equal(before.goal, [0, 5])


def longest_stays(moves, seed=0, ends=4000):
    """Longest stay of cars in any bay, in ends of episodes, and cars after each.

    Agents stand anywhere and park in random free bays: as if they chose their goals.
    """
    layout = make_layout("tanner")

    def end(before, key):
        keys = jax.random.split(key, 4)
        agent = jax.random.randint(keys[0], (), 0, 3)
        xy = jax.random.uniform(keys[1], (3, 2), minval=-11.8, maxval=11.8)
        free = jnp.ones(36, bool).at[before.parked_bay].set(False)
        bay = jax.random.categorical(keys[2], jnp.where(free, 0.0, -jnp.inf))
        before = before.replace(goal=before.goal.at[agent].set(bay))
        after = moves(layout, before, agent, xy, keys[3])
        return after, after.parked_bay

    def run(key):
        start = init_occupancy(layout, 3, 16, key)
        return jax.lax.scan(end, start, jax.random.split(key, ends))[1]

    keys = jax.random.split(jax.random.key(seed), LOTS)
    cars = np.asarray(jax.jit(jax.vmap(run))(keys))
    taken = (cars[..., None] == np.arange(36)).any(axis=2)
    stay = longest = np.zeros((LOTS, 36), int)
    for k in range(ends):
        stay = np.where(taken[:, k], stay + 1, 0)
        longest = np.maximum(longest, stay)
    return longest, cars


EVOLUTIONS = {
    "furthest": lambda *args: evolve(*args[:4], jnp.array(True)),
    "random": lambda *args: evolve(*args[:4], jnp.array(True), random=(args[4], 2)),
}


@pytest.mark.parametrize("rule", EVOLUTIONS)
def test_no_bay_stays_occupied_for_ever_while_another_is_free(rule):
    """Theorem 2 of Tanner 2022: evolution is free of deadlocks."""
    longest, cars = longest_stays(EVOLUTIONS[rule])
    assert cars.shape[2] == 16
    assert (np.diff(np.sort(cars, axis=2), axis=2) > 0).all()  # all there, all apart
    assert longest.max() < 2000  # of 4,000 ends
    assert longest.min() > 0  # and every bay has its turn


def test_a_rule_that_always_moves_the_same_car_would_be_a_deadlock():
    def first_car(layout, before, agent, xy, key):
        del layout, xy, key
        moved = before.parked_bay.at[0].set(before.goal[agent])
        return before.replace(parked_bay=moved)

    assert longest_stays(first_car)[0].max() == 4000


def test_evolve_moves_nothing_when_nobody_has_parked():
    before = occupancy([0, 5], [1, 3, 4])
    after = evolve(ROW, before, jnp.array(0), jnp.zeros((2, 2)), jnp.array(False))
    np.testing.assert_array_equal(after.parked_bay, before.parked_bay)


def test_evolve_without_parked_cars_does_nothing():
    before = occupancy([0], [])
    after = evolve(ROW, before, jnp.array(0), jnp.zeros((1, 2)), jnp.array(True))
    assert after.parked_bay.shape == (0,)


def test_a_new_goal_is_uniform_over_bays_that_are_nobodys_goal():
    after = draws(occupancy([0, 5], [2]), 0, [[0.0, 20.0], [50.0, 20.0]], count=4000)
    count = np.bincount(after.goal[:, 0], minlength=6)
    np.testing.assert_array_equal(count[[0, 5]], 0)
    # Mean 1000, deviation 27: five of them.
    np.testing.assert_allclose(count[1:5], 1000, atol=140)
    np.testing.assert_array_equal(after.goal[:, 1], 5)


def test_a_car_on_the_new_goal_makes_way_to_the_old_goal():
    after = draws(occupancy([0, 5], [2, 3]), 0, [[0.0, 0.0], [50.0, 20.0]])
    for bay, car in ((2, 0), (3, 1)):
        drawn = after.goal[:, 0] == bay
        assert drawn.any()
        np.testing.assert_array_equal(after.parked_bay[drawn, car], 0)
        np.testing.assert_array_equal(after.parked_bay[drawn, 1 - car], 5 - bay)
    free = np.isin(after.goal[:, 0], [1, 4])
    np.testing.assert_array_equal(after.parked_bay[free], [[2, 3]] * free.sum())


def test_a_car_makes_way_elsewhere_when_another_agent_is_near_the_old_goal():
    # Agent 1 stands 7 m from bay 0, closer than MIN_DISTANCE.
    after = draws(occupancy([0, 5], [2, 3]), 0, [[0.0, 0.0], [0.0, 7.0]])
    evicted = after.goal[:, 0] == 2
    assert evicted.any()
    # Bay 5 is a goal, 2 and 3 are taken, 0 is too near: 1 and 4 are left.
    assert set(after.parked_bay[evicted, 0]) == {1, 4}


def test_a_car_makes_way_elsewhere_when_the_old_goal_has_just_been_filled():
    # As after `evolve`: a car stands in agent 0's old goal.
    after = draws(occupancy([0, 5], [0, 3]), 0, [[0.0, 20.0], [50.0, 20.0]])
    evicted = after.goal[:, 0] == 3
    assert evicted.any()
    assert set(after.parked_bay[evicted, 1]) == {1, 2, 4}
    np.testing.assert_array_equal(after.parked_bay[:, 0], 0)


def test_without_a_refuge_only_bays_without_cars_are_drawn():
    # Agents 1 and 2 stand near the free bays 0 (the old goal), 1 and 2.
    before = occupancy([0, 5, 4], [3])
    after = draws(before, 0, [[0.0, 0.0], [5.0, 1.0], [15.0, 1.0]])
    assert set(after.goal[:, 0]) == {1, 2}
    np.testing.assert_array_equal(after.parked_bay, 3)


def test_an_agent_keeps_its_goal_when_every_other_bay_is_taken():
    # No refuge: agent 1 is near the old goal, the only bay without a car.
    before = occupancy([0, 5], [1, 2, 3, 4])
    after = draws(before, 0, [[0.0, 0.0], [0.0, 7.0]])
    np.testing.assert_array_equal(after.goal, [[0, 5]] * 400)
    np.testing.assert_array_equal(after.parked_bay, [[1, 2, 3, 4]] * 400)


def test_a_full_row_swaps_goal_and_car_when_nobody_is_near():
    before = occupancy([0, 5], [1, 2, 3, 4])
    after = draws(before, 0, [[0.0, 0.0], [50.0, 20.0]])
    assert set(after.goal[:, 0]) == {1, 2, 3, 4}
    moved = after.parked_bay[np.arange(400), after.goal[:, 0] - 1]
    np.testing.assert_array_equal(moved, 0)
