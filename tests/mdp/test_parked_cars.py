"""Where parked cars stand in their bays, and which makes room for an agent."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from helpers.scenes import cars, fields_of, lot, polygons
from helpers.sliding import SlidePhysics, placed
from helpers.spawning import many
from helpers.states import parked_in, state_of
from helpers.transitions import no_events

from carpark_mj.config import EnvConfig, RingConfig, SpawnConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.geometry import to_local, to_world
from carpark_mj.geometry.obstacles import Boxes, Discs, Movers, ObstacleKind
from carpark_mj.layouts import make_layout
from carpark_mj.mdp.parked_cars import (
    AWAY,
    free_bays,
    in_bays,
    relocate_parked_cars,
    stand_in_bay,
)
from carpark_mj.observations import ContinuousObservation
from carpark_mj.observations.fields import FAR
from carpark_mj.spawning.fleet import shuffled_bays
from carpark_mj.spawning.starts import pick
from carpark_mj.types import NO_BAY

COUNT = 3000
ROUNDING = 2e-4  # m, float32 at coordinates of some 30 m and arcs near their ends


def test_a_car_stands_in_the_lines_as_it_wishes_if_these_allow():
    """Random cars in random bays; a wish is an offset from the middle."""
    rng = np.random.default_rng(0)
    bay = rng.uniform((-30, -30, -np.pi), (30, 30, np.pi), (COUNT, 3))
    bay_size = rng.uniform((3.5, 1.8), (6.5, 3.0), (COUNT, 2))
    size = rng.uniform((3.3, 1.5), (5.2, 2.2), (COUNT, 2))
    wish = rng.normal(0, (0.5, 0.3, 0.3), (COUNT, 3))
    args = [x.astype(np.float32) for x in (bay, bay_size, size, wish)]
    pose, (bay, bay_size, size, wish) = np.asarray(jax.jit(stand_in_bay)(*args)), args
    fit = (size <= bay_size).all(axis=1)
    assert 500 < fit.sum() < COUNT - 500
    lines = polygons(bay, bay_size)
    within = shapely.covers(shapely.buffer(lines, ROUNDING), polygons(pose, size))
    assert within[fit].all()
    # The offset is at most as wished, and exact if possible.
    off = np.asarray(to_local(bay, pose))
    assert (np.abs(off) <= np.abs(wish) + ROUNDING).all()
    assert (off * wish >= -ROUNDING).all()
    wished = np.asarray(to_world(bay, wish))
    inside = shapely.covers(lines, polygons(wished, size))
    assert inside.sum() > 50
    np.testing.assert_allclose(off[inside], wish[inside], atol=ROUNDING)
    # The heading is cut no more than the lines demand.
    cut = fit & (np.abs(off[:, 2]) < np.abs(wish[:, 2]) - 0.02)
    assert cut.sum() > 300
    more = bay.copy()
    more[:, 2] += off[:, 2] + 0.01 * np.sign(wish[:, 2])
    assert not shapely.covers(lines, polygons(more, size))[cut].any()


def test_car_too_large_for_its_bay_is_centred():
    bay, size = jnp.zeros(3), jnp.array([5.0, 2.0])
    wish = jnp.array([0.5, 0.4, 0.2])
    stand = jax.jit(stand_in_bay)
    too_small = stand(bay, jnp.array([4.9, 1.9]), size, wish)
    np.testing.assert_allclose(too_small, [0.0, 0.0, 0.0], atol=1e-6)
    too_narrow = stand(bay, jnp.array([7.0, 1.9]), size, wish)
    np.testing.assert_allclose(too_narrow, [0.5, 0.0, 0.0], atol=1e-6)
    roomy = stand(bay, jnp.array([9.0, 9.0]), size, wish)
    np.testing.assert_allclose(roomy, wish, atol=1e-6)


def test_pushed_car_keeps_its_pose_and_a_moved_one_its_place():
    pushed = jnp.array([[0.4, -0.2, 0.1], [10.3, 0.1, -0.1], [AWAY, 0.0, 0.0]])
    parked = parked_in(ROW, [0, 1, NO_BAY]).replace(pose_w=pushed)
    same = in_bays(ROW, parked, parked.bay)
    np.testing.assert_array_equal(same.pose_w, pushed)
    moved = in_bays(ROW, parked, jnp.array([0, 4, NO_BAY], jnp.int32))
    assert moved.bay.tolist() == [0, 4, NO_BAY]
    np.testing.assert_array_equal(moved.pose_w[1], ROW.bay_pose[4])
    np.testing.assert_array_equal(moved.pose_w[::2], pushed[::2])
    # A car that moves takes its place in the bay along.
    offset = jnp.array([[0.5, -0.2, 0.05], [0.3, 0.1, -0.05]])
    parked = parked_in(ROW, [0, 1]).replace(offset=offset)
    moved = in_bays(ROW, parked, jnp.array([0, 3], jnp.int32))
    np.testing.assert_array_equal(moved.pose_w[0], ROW.bay_pose[0])
    expected = to_world(ROW.bay_pose[3], offset[1])
    np.testing.assert_allclose(moved.pose_w[1], expected, atol=1e-5)


# Six bays in a row, 10 m apart, on the x axis.
ROW = lot([(10.0 * k, 0.0, 0.0) for k in range(6)])
FURTHEST = EnvConfig()


def random_rule(num_tracked):
    """The rule that moves a random car, of those that agents do not track."""
    observation = ContinuousObservation(tracked_parked_cars=num_tracked)
    return EnvConfig(spawn=SpawnConfig(relocation="random"), observation=observation)


def row_of(goal, bay, x):
    """A state of the row with agents at x (num_agents,)."""
    motion = cars([(float(k), 0.0, 0.0) for k in x])
    return state_of(ROW, motion, goal, parked_cars=parked_in(ROW, bay))


def relocated(config, state, parked, key=None):
    """Parked cars when some agents (indices) have parked."""
    count = state.goal.shape[0]
    events = no_events(count, parked=jnp.isin(jnp.arange(count), jnp.array(parked)))
    key = jax.random.key(0) if key is None else key
    return relocate_parked_cars(config, state, events, key)


def test_the_car_farthest_from_all_agents_moves_into_the_bay():
    # Gaps to the nearer of the agents at x = 0 and 48: cars at 10, 30, 40 have 10,
    # 18, 8. The car at 40 is farthest from agent 0 alone, yet the one at 30 moves.
    after = relocated(FURTHEST, row_of([0, 5], [1, 3, 4], [0, 48]), [0])
    np.testing.assert_array_equal(after.bay, [1, 0, 4])
    np.testing.assert_array_equal(after.pose_w, ROW.bay_pose[after.bay])
    # The car of bay 3, 30 m away, has been pushed to 3 m from the agent.
    state = row_of([0], [2, 3], [0.0])
    pushed = state.parked_cars.pose_w.at[1, 0].set(3.0)
    state = state.replace(parked_cars=state.parked_cars.replace(pose_w=pushed))
    assert relocated(FURTHEST, state, [0]).bay.tolist() == [0, 3]


def test_a_random_car_moves_that_no_agent_tracks():
    # Agents at 0 and 48 track the cars at 10 and 40; those at 20 and 30 are left.
    state = row_of([0, 5], [1, 2, 3, 4], [0, 48])

    def moves(rule):
        after = many(lambda key: relocated(rule, state, [0], key).bay, 1000)
        moved = after != np.array([1, 2, 3, 4])
        assert (moved.sum(axis=1) == 1).all()
        assert (after[moved] == 0).all()
        return moved.mean(axis=0)

    # Deviation of a share of 1,000 at most 1.6 %: five of them.
    np.testing.assert_allclose(moves(random_rule(1)), [0, 0.5, 0.5, 0], atol=0.08)
    anyone = EnvConfig(spawn=SpawnConfig(relocation="any"))
    for rule in (random_rule(0), random_rule(5), anyone):
        np.testing.assert_allclose(moves(rule), [0.25] * 4, atol=0.07)


def test_no_car_moves_to_where_a_mover_is():
    # An agent has parked in bay 0; then somebody stands there, or in the bay beside.
    state = row_of([0, 5], [1, 3, 4], [0, 48])
    for bay, radius in ((0, 0.3), (2, 0.3)):
        there = ROW.bay_pose[bay : bay + 1, :2] + 0.4
        person = Discs(there, jnp.array([radius]), kind=ObstacleKind.PERSON)
        driver = Boxes(ROW.bay_pose[bay : bay + 1], jnp.array([[4.0, 1.8]]))
        for group in (person, driver):
            among = state.replace(movers=Movers((), ((group,),)))
            after = relocated(FURTHEST, among, [0])
            assert bool((after.bay == state.parked_cars.bay).all()) == (bay == 0)


class PushedPhysics(SlidePhysics):
    """Sliding cars whose parked cars stand where they are said to, as if pushed."""

    def __init__(self, pose_w):
        self.pose_w = jnp.asarray(pose_w, jnp.float32)

    def parked_poses(self, state, intended):
        return self.pose_w


def test_pushed_parked_cars_are_observed_and_hit():
    pushed = [[5.0, 1.0, 0.0], [-8.0, 0.5, 1.5]]
    config = EnvConfig(
        num_agents=2,
        num_parked_cars=2,
        observation=ContinuousObservation(rings=RingConfig((5.0, 8.0), 9, cars=True)),
    )
    env = ParkingEnv(config, PushedPhysics(pushed))
    state, _ = jax.jit(env.reset)(jax.random.key(0))
    state = placed(env, state, [(0.0, 0.0, 0.0), (-8.0, 0.0, 0.0)])
    free = state.layout.replace(wall_mask=jnp.zeros_like(state.layout.wall_mask))
    state = state.replace(layout=free)
    bay = state.parked_cars.bay
    state, timestep = jax.jit(env.step)(state, jnp.zeros((2, 2)))
    np.testing.assert_array_equal(state.parked_cars.pose_w, pushed)
    np.testing.assert_array_equal(state.parked_cars.bay, bay)  # they still belong there
    assert timestep.events.hit_parked_car.tolist() == [False, True]
    seen = fields_of(timestep.observation, config)
    first = {name: value[0] for name, value in seen.items()}
    position = first["parked_car_0_position"]
    np.testing.assert_allclose(position, np.array([5.0, 1.0]) / FAR, atol=1e-6)
    # It begins 2.9 m away, and nothing else is near.
    assert first["ring_5m"] == 0
    np.testing.assert_allclose(first["ring_8m"], 1 / 9, atol=1e-6)


@pytest.mark.parametrize("rule", [FURTHEST, random_rule(2)])
def test_no_bay_stays_occupied_for_ever_while_another_is_free(rule):
    """Theorem 2 of Tanner 2022: relocation is free of deadlocks.

    Agents stand anywhere and park in random free bays: as if they chose their goals.
    """
    layout, ends, lots = make_layout("square"), 4000, 8

    def end(carry, key):
        goal, bay = carry
        keys = jax.random.split(key, 4)
        agent = jax.random.randint(keys[0], (), 0, 3)
        xy = jax.random.uniform(keys[1], (3, 2), minval=-11.8, maxval=11.8)
        scores = jax.random.uniform(keys[2], (layout.num_bays,))
        goal = goal.at[agent].set(pick(free_bays(layout, bay), scores))
        motion = cars(jnp.pad(xy, ((0, 0), (0, 1))))
        state = state_of(layout, motion, goal, parked_cars=parked_in(layout, bay))
        events = no_events(3, parked=jnp.arange(3) == agent)
        bay = relocate_parked_cars(rule, state, events, keys[3]).bay
        return (goal, bay), bay

    def run(key):
        order = shuffled_bays(layout, key)
        start = order[:3], order[3:19]
        return jax.lax.scan(end, start, jax.random.split(key, ends))[1]

    bay = many(run, lots)
    assert bay.shape[2] == 16
    assert (np.diff(np.sort(bay, axis=2), axis=2) > 0).all()  # all there, all apart
    taken = (bay[..., None] == np.arange(36)).any(axis=2)
    stay = longest = np.zeros((lots, 36), int)
    for k in range(ends):
        stay = np.where(taken[:, k], stay + 1, 0)
        longest = np.maximum(longest, stay)
    assert longest.max() < 2000  # of 4,000 ends
    assert longest.min() > 0  # and every bay has its turn
