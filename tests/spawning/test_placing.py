"""Starts as the environment makes them: agents placed one after the other."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import cars, lot
from helpers.spawning import many, meets, placing_one
from helpers.states import parked_at, parked_in, state_of

from carpark_mj.config import WORLD_UNIT, EnvConfig, SpawnConfig
from carpark_mj.layouts import build, make_layout
from carpark_mj.mdp.collisions import find_hits
from carpark_mj.mdp.parked_cars import BayFits
from carpark_mj.spawning import special_starts
from carpark_mj.spawning.fleet import Fleet
from carpark_mj.spawning.goals import new_goal, place_agent, place_shapes
from carpark_mj.spawning.placing import (
    SpawnInputs,
    place_waiting,
    start_placing,
    surroundings,
)
from carpark_mj.spawning.starts import draw_kind, draw_uniform
from carpark_mj.types import NO_BAY
from carpark_mj.vehicle import COMPACT

AGENTS, CARS = 7, 16
AREA = 42 * WORLD_UNIT  # m, side of the study's spawn area
MIXED = SpawnConfig(close_ratio=0.2, conflict_ratio=0.5, close_distance=0.5)
CONFLICT = SpawnConfig(close_ratio=0.0, conflict_ratio=1.0)
FIRST = np.arange(AGENTS) == 0
LAYOUT = make_layout("square")
BAY_XY = np.asarray(LAYOUT.bay_pose, np.float64)[:, :2]


def config_of(spawn):
    return EnvConfig(num_agents=AGENTS, num_parked_cars=CARS, spawn=spawn)


@functools.cache
def lots(count, seed=1):
    """Random goals and parked cars, and poses of seven agents."""
    keys = jax.random.split(jax.random.key(seed), count)
    fleet = Fleet(config_of(MIXED), COMPACT)
    start = jax.vmap(lambda key: fleet.start(LAYOUT, key))(keys)
    pose = np.random.default_rng(seed).uniform(-AREA / 2, AREA / 2, (count, AGENTS, 3))
    return start.goal, start.parked_cars, jnp.asarray(pose, jnp.float32)


def place_all(config, inputs, placing, key):
    return place_waiting(functools.partial(place_agent, config), inputs, placing, key)


@functools.partial(jax.jit, static_argnums=0)
def place_lots(config, goal, parked_cars, pose, done, keys):
    def one(goal, parked_cars, pose, key):
        placing = start_placing(goal, parked_cars.bay, pose, done)
        return place_all(config, SpawnInputs(LAYOUT, parked_cars), placing, key)

    return jax.vmap(one)(goal, parked_cars, pose, keys)


def placed(spawn, count=2000, done=FIRST):
    """Goals before, and the agents after those that are done have been placed."""
    goal, parked_cars, pose = lots(count)
    keys = jax.random.split(jax.random.key(2), count)
    after = place_lots(config_of(spawn), goal, parked_cars, pose, done, keys)
    assert not after.waiting.any()
    assert after.found.all()
    return np.asarray(goal), jax.device_get(after)


def wanted():
    """Lots in which agent 0 is to start close, and on a collision course."""
    shapes = place_shapes(MIXED, AGENTS, LAYOUT.num_bays)

    def kind(key):
        draws = draw_uniform(shapes, jax.random.split(key, AGENTS)[0])
        return draw_kind(MIXED, draws["kind"])

    return many(kind, 2000, 2)


def test_close_crash_and_random_starts_come_in_their_ratios():
    _, after = placed(MIXED)
    close, crash, *_ = wanted()
    assert not (close & crash).any()
    # Deviations 0.9 % and 1.1 %: five of them.
    assert close.mean() == pytest.approx(0.2, abs=0.045)
    assert crash.mean() == pytest.approx(0.5, abs=0.056)
    start, goal = after.pose_w.astype(np.float64), BAY_XY[after.goal]
    course = meets(CONFLICT, start[:, 0], start[..., :2], goal).any(axis=1)
    assert course[~crash].mean() < 0.005  # by chance: within 2 mm of six agents' ways
    assert course[crash].mean() > 0.7  # of ten attempts one succeeds, among six others
    nearest = np.clip(goal[:, 0], -AREA / 2, AREA / 2)
    near = np.linalg.norm(after.pose_w[:, 0, :2] - nearest, axis=1) <= 0.5 + 1e-4
    assert near[close].mean() > 0.4  # where no other agent is
    assert near[~close].mean() < 0.01


def test_after_a_rejected_try_the_start_is_random():
    goal, parked_cars, pose = jax.tree.map(lambda x: x[0], lots(300))
    placing = start_placing(goal, parked_cars.bay, pose, FIRST)

    @functools.partial(jax.jit, static_argnums=0)
    def start(ratio, tries):
        config = config_of(SpawnConfig(close_ratio=ratio, min_distance=0.0))
        before = dataclasses.replace(placing, tries=jnp.full(AGENTS, tries))
        inputs, key = SpawnInputs(LAYOUT, parked_cars), jax.random.key(3)
        return place_agent(config, inputs, before, jnp.array(0), key).pose_w[0]

    np.testing.assert_array_equal(start(1.0, 1), start(0.0, 0))
    assert (start(1.0, 0) != start(0.0, 0)).any()


def test_reset_starts_are_on_course_for_earlier_agents():
    goal, parked_cars, _ = lots(300)
    everybody, nowhere = jnp.ones(AGENTS, bool), jnp.zeros((AGENTS, 3))

    def place(goal, parked_cars, key):
        placing = start_placing(goal, parked_cars.bay, nowhere, everybody)
        inputs = SpawnInputs(LAYOUT, parked_cars, first=True)
        return place_all(config_of(CONFLICT), inputs, placing, key)

    keys = jax.random.split(jax.random.key(5), 300)
    after = jax.device_get(jax.jit(jax.vmap(place))(goal, parked_cars, keys))
    assert not after.waiting.any()
    np.testing.assert_array_equal(after.goal, goal)
    np.testing.assert_array_equal(after.parked_bay, parked_cars.bay)
    pose, goal_xy = after.pose_w.astype(np.float64), BAY_XY[np.asarray(goal)]
    met = np.zeros(AGENTS)
    for agent in range(1, AGENTS):
        order = [agent, *range(agent)]
        courses = meets(CONFLICT, pose[:, agent], pose[:, order, :2], goal_xy[:, order])
        met[agent] = courses.any(axis=1).mean()
    assert met[1] > 0.1  # of a single target; its way is often too short
    assert (met[3:] > 0.35).all()  # and later there is less and less room


# Cars of several sizes. Five bays in a row, 20 m apart; parked cars 0 and 1 fit in the
# first three and in all.
ROW = build.assemble(
    (100.0, 40.0),
    build.bays(jnp.array([(20.0 * k, 30.0, 1.57) for k in range(5)]), (5.0, 2.5)),
    build.spawns(jnp.zeros((1, 3)), (10.0, 10.0), np.pi),
)
FITS = jnp.array([[True, True, True, False, False], [True] * 5])


def in_row(agent_fits, parked_fits, parked_bay):
    """The row of bays, and who fits into which."""
    fits = BayFits(jnp.array([agent_fits]), parked_fits)
    return SpawnInputs(ROW, parked_in(ROW, parked_bay), fits=fits)


def test_a_new_goal_fits_and_cars_make_way_to_bays_they_fit_in():
    config = EnvConfig(spawn=SpawnConfig(min_distance=5.0))

    def drawn(parked_bay, parked_fits):
        inputs = in_row([True, True, False, True, True], parked_fits, parked_bay)
        placing = placing_one(inputs, 4, (0.0, -30.0, 0.0))

        def draw(key):
            scores = jax.random.uniform(key, (2, 5))
            return new_goal(config, inputs, placing, jnp.array(0), scores)

        after = many(draw, 300)
        assert after.found.all()
        return after.goal[:, 0], after.parked_bay

    # The old goal is 4, where car 0 does not fit: it makes way to 2 from 0 and 1.
    goal, bay = drawn([0, 1], FITS)
    assert set(goal) == {0, 1, 3}
    assert set(bay[goal == 0, 0]) == {2}
    assert set(bay[goal == 1, 1]) == {4}
    np.testing.assert_array_equal(bay[goal == 3], [[0, 1]] * (goal == 3).sum())
    # With 1 and 2 taken car 0 has nowhere to go, and its bay cannot be a goal.
    goal, _ = drawn([0, 1, 2], jnp.concatenate([FITS, FITS[1:]]))
    assert set(goal) == {1, 3}


def test_agent_without_a_bay_for_its_new_car_keeps_its_goal():
    @jax.jit
    def placed(agent_fits):
        inputs = in_row(agent_fits, FITS, [1, 2])
        placing = placing_one(inputs, 0)
        return place_all(EnvConfig(), inputs, placing, jax.random.key(0))

    nowhere = placed([True, False, False, False, False])
    np.testing.assert_array_equal(nowhere.goal, [0])
    np.testing.assert_array_equal(nowhere.parked_bay, [1, 2])
    assert not nowhere.found.any()
    somewhere = placed([True, False, False, False, True])
    np.testing.assert_array_equal(somewhere.goal, [4])
    assert somewhere.found.all()


@pytest.mark.parametrize(
    ("parked_bay", "bays"), [([0, 2], {1}), ([2, 0], {1, 3, 4}), ([0, 1, 2], {3, 4})]
)
def test_a_car_that_has_come_to_a_goal_that_is_kept_makes_way(parked_bay, bays):
    """To a bay that it fits into, or to any if it fits into none that is free."""
    fits = jnp.concatenate([FITS, FITS[1:]])[: len(parked_bay)]
    inputs = in_row([True, False, False, False, False], fits, parked_bay)
    placing = placing_one(inputs, 0)
    after = many(lambda key: place_all(EnvConfig(), inputs, placing, key), 100)
    assert (after.goal == 0).all()
    assert not after.found.any()
    comes = parked_bay.index(0)
    assert set(after.parked_bay[:, comes]) == bays
    stay = np.delete(np.tile(parked_bay, (100, 1)), comes, axis=1)
    np.testing.assert_array_equal(np.delete(after.parked_bay, comes, axis=1), stay)


@pytest.mark.parametrize("found", [True, False])
def test_a_start_has_room_for_the_car_that_is_driven(found):
    """The new car if there is a bay for it, otherwise the one driven before."""
    new, old = jnp.array([[4.9, 1.9]]), jnp.array([[1.0, 1.0]])
    inputs = SpawnInputs(LAYOUT, parked_at(), new, old)
    placing = placing_one(inputs, 0).replace(found=jnp.array([found]))
    size = surroundings(inputs, placing, jnp.array(0)).size
    np.testing.assert_array_equal(size, (new if found else old)[0])


def test_no_start_is_on_course_to_the_absent_or_finished(monkeypatch):
    """Targets are recorded in the pose that a stand-in for `course_pose` returns."""

    def count_targets(config, layout, around, goal_xy, targets, draws):
        mask = targets.mask.astype(jnp.float32)
        return jnp.stack([mask.sum(), mask[0], mask[3]]), jnp.bool_(True)

    monkeypatch.setattr(special_starts, "course_pose", count_targets)
    goal, parked_cars, pose = jax.tree.map(lambda x: x[0], lots(300))
    goal, waiting = goal.at[4:].set(NO_BAY), np.isin(np.arange(AGENTS), (1, 2))
    placing = start_placing(goal, parked_cars.bay, pose, waiting)
    inputs, keys = SpawnInputs(LAYOUT, parked_cars), (jnp.int32(1), jax.random.key(1))
    after = place_agent(config_of(CONFLICT), inputs, placing, *keys)
    assert after.pose_w[1].tolist() == [2.0, 1.0, 1.0]  # agents 0 and 3


def test_starts_touch_what_collisions_say():
    """Car 0 where it has been pushed, car 1 on its way from bay 0 to bay 2."""
    rng = np.random.default_rng(2)
    layout = lot(
        [(0.0, 0.0, 0.0), (2.0, 6.0, 0.7), (-5.0, -6.0, 2.0)],
        walls=[(4.0, 0.0, 0.3), (-6.0, 3.0, 0.0)],
        wall_size=(6.0, 0.4),
        discs=[(0.0, -5.0, 0.4)],
    )
    layout = layout.replace(wall_mask=jnp.array([True, False]))
    pose = rng.uniform((-9, -9, -3), (9, 9, 3), (600, 3)).astype(np.float32)
    size, parked_size = jnp.array([[4.6, 1.9]]), jnp.array([[4.9, 1.9], [3.5, 1.6]])
    after = parked_in(layout, [1, 2], parked_size)
    pushed = after.pose_w.at[0].add(jnp.array([1.0, -0.5, 0.4]))
    after = after.replace(pose_w=pushed)

    def judge(pose):
        here = cars(pose[None], size=size[0])
        return find_hits(state_of(layout, here, 0, parked_cars=after))

    hits = jax.vmap(judge)(jnp.asarray(pose))
    expected = np.asarray(hits["parked_car"] | hits["wall"])[:, 0]
    assert 100 < expected.sum() < 500
    before = parked_in(layout, [1, 0], parked_size)
    before = before.replace(pose_w=before.pose_w.at[0].set(pushed[0]))
    inputs = SpawnInputs(layout, before, size, size)
    placing = start_placing(jnp.array([0]), after.bay, jnp.zeros((1, 3)), FIRST[:1])
    around = surroundings(inputs, placing, jnp.array(0))
    np.testing.assert_array_equal(around.touches(jnp.asarray(pose)), expected)
