"""Cars of several kinds in one lot: they fit where they are, and drive as alone."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.registering import restore_after
from helpers.scenes import cars, check_occupancy, fields_of, lot
from helpers.sliding import SlidePhysics, placed
from helpers.states import parked_in, state_of
from helpers.transitions import no_events

from carpark_mj.config import (
    PARKED_RULES,
    EnvConfig,
    EpisodeConfig,
    FleetConfig,
    JitterConfig,
    RandomizationConfig,
)
from carpark_mj.env import ParkingEnv
from carpark_mj.geometry import box_inside
from carpark_mj.layouts import build
from carpark_mj.layouts.base import LayoutConfig
from carpark_mj.mdp.parked_cars import AWAY, relocate_parked_cars
from carpark_mj.observations import ContinuousObservation, observation_size
from carpark_mj.spawning.randomization import randomize_all
from carpark_mj.types import NO_BAY
from carpark_mj.vehicle import COMPACT, PRESETS, VEHICLES, register_vehicle

AGENTS, PARKED = ("city", "suv", "van"), ("city", "sedan", "van")
CONFIG = EnvConfig(
    num_agents=4,
    num_parked_cars=20,
    occupancy=(0.05, 0.5),
    fleet=FleetConfig(AGENTS, PARKED),
    jitter=JitterConfig(
        along=(-0.6, 0.3), across=(-0.4, 0.4), heading=(-0.1, 0.2), scale=(0.95, 1.02)
    ),
    observation=ContinuousObservation(tracked_parked_cars=4, own_car=True),
)
KEYS, LOTS = 1000, 16

# Bays of every kind: for all, for all but vans, for city cars only, and parallel ones.
BAY_SIZES = [(5.3, 2.5)] * 14 + [(4.8, 2.4)] * 12 + [(3.9, 2.0)] * 8 + [(6.2, 2.0)] * 6


def mixed_lot():
    """Forty bays along two sides of a field on which cars spawn, 12 m from them."""
    x = np.linspace(-60, 60, 20)
    sides = [[(a, y, math.copysign(math.pi / 2, -y)) for a in x] for y in (-20, 20)]
    pose = np.concatenate(sides).astype(np.float32)
    order = np.random.default_rng(0).permutation(40)
    return build.assemble(
        (70.0, 30.0),
        build.bays(jnp.asarray(pose), jnp.array(BAY_SIZES)[order]),
        build.walls(jnp.array([[0.0, 29.0, 0.0]]), (140.0, 1.0)),
        build.spawns(jnp.zeros((1, 3)), (120.0, 10.0), np.pi),
    )


LAYOUT = mixed_lot()


@pytest.fixture(scope="module")
def env():
    return ParkingEnv(CONFIG, SlidePhysics())


@pytest.fixture(scope="module")
def started(env):
    """A thousand lots, just reset, and their observations."""
    reset = jax.jit(jax.vmap(lambda key: env.reset_to_layout(LAYOUT, key)))
    return reset(jax.random.split(jax.random.key(0), KEYS))


def check_bays(goal, cars):
    """Asserts that goals and bays of cars that are there are all different."""
    count = LAYOUT.num_bays + cars.bay.shape[-1]
    # Absent cars count as bays of their own.
    own = np.arange(LAYOUT.num_bays, count)
    every = np.ones((*goal.shape[:-1], count), bool)
    check_occupancy(goal, np.where(cars.present, cars.bay, own), every)


def check_lots(state):
    """Asserts of lots that every car fits where it is or heads for."""
    state = jax.tree.map(np.asarray, state.replace(key=None))
    cars = state.parked_cars
    goal, bay, here = state.goal, cars.bay, cars.present
    check_bays(goal, cars)
    size = np.asarray(LAYOUT.bay_size)
    slack = PARKED_RULES["strict"].slack
    assert (state.motion.size + slack <= size[goal] + 1e-5).all()
    parked_bay = np.where(here, bay, 0)
    fit = (cars.size <= size[parked_bay]).all(axis=-1)
    assert fit[here].all()
    pose, bays = cars.pose_w, np.asarray(LAYOUT.bay_pose)[parked_bay]
    bay_size = size[parked_bay] + 4e-4  # float32 at 60 m
    assert np.asarray(box_inside(pose, cars.size, bays, bay_size))[here].all()
    assert (pose[..., 0] >= AWAY)[~here].all()
    return here


def test_a_thousand_lots_start_with_everybody_where_it_fits(started):
    state, observation = started
    assert np.isfinite(observation).all()
    here = check_lots(state)
    # From 0.05 to 0.5 of 40 bays, each number as likely: 53 of a thousand.
    count = np.bincount(here.sum(axis=1), minlength=21)
    assert count.size == 21
    assert count[:2].sum() == 0
    assert count[2:].min() > 25  # 4 deviations


def kinds(size, names):
    """Index of the preset of footprints (..., 2), by their proportions."""
    shape = np.array([PRESETS[n].length / PRESETS[n].width for n in names])
    ratio = np.asarray(size[..., 0] / size[..., 1])
    return np.abs(ratio[..., None] - shape).argmin(axis=-1)


def test_presets_are_drawn_equally_often(started):
    state, _ = started
    # Vans find room in 20 of 40 bays, which four agents cannot all take.
    share = np.bincount(kinds(state.motion.size, AGENTS).ravel(), minlength=3) / 4000
    np.testing.assert_allclose(share, 1 / 3, atol=0.035)  # 5 deviations
    here = np.asarray(state.parked_cars.present)
    drawn = kinds(state.parked_cars.size, PARKED)[here]
    assert np.bincount(drawn, minlength=3).min() > 0.25 * here.sum()


def test_jitter_fills_its_ranges_and_stays_in_them(started):
    state, _ = started
    wish = np.asarray(state.parked_cars.offset).reshape(-1, 3)
    low, high = np.array([(-0.6, 0.3), (-0.4, 0.4), (-0.1, 0.2)]).T
    assert (wish >= low - 1e-6).all()
    assert (wish <= high + 1e-6).all()
    np.testing.assert_allclose(wish.min(axis=0), low, atol=0.01)
    np.testing.assert_allclose(wish.max(axis=0), high, atol=0.01)
    size = np.asarray(state.parked_cars.size)
    presets = np.array([(PRESETS[n].length, PRESETS[n].width) for n in PARKED])
    scale = size / presets[kinds(size, PARKED)]
    np.testing.assert_allclose(scale[..., 0], scale[..., 1], rtol=1e-5)
    np.testing.assert_allclose([scale.min(), scale.max()], [0.95, 1.02], atol=1e-3)


def test_absent_parked_cars_are_not_observed(env, started):
    state, observation = started
    named = fields_of(observation, env.config)
    present = sum(named[f"parked_car_{k}_present"][:, 0, 0] for k in range(4))
    here = np.asarray(state.parked_cars.present)
    np.testing.assert_array_equal(present, np.minimum(here.sum(axis=1), 4))
    away = state.parked_cars.pose_w[..., :2] - state.motion.pose_w[:, :1, :2]
    gap = np.linalg.norm(away, axis=-1)
    seen = np.linalg.norm(named["parked_car_0_position"][:, 0] * 20.0, axis=-1)
    np.testing.assert_allclose(seen, gap.min(axis=1), atol=1e-4)
    nearest = np.asarray(state.parked_cars.size)[np.arange(KEYS), gap.argmin(axis=1)]
    sizes = named["parked_car_0_size"][:, 0] * 5.0
    np.testing.assert_allclose(sizes, nearest, atol=1e-5)


@pytest.fixture(scope="module")
def step(env):
    return jax.jit(jax.vmap(env.step))


@pytest.fixture(scope="module")
def driven(env, started, step):
    """Thirty steps in which episodes end by chance, a third of them by parking."""
    state = jax.tree.map(lambda x: x[:LOTS], started[0])
    rng, states = np.random.default_rng(0), []
    for _ in range(30):
        end = rng.choice(3, (LOTS, 4), p=(0.5, 0.25, 0.25))
        last = env.config.episode.max_steps
        goal = np.asarray(LAYOUT.bay_pose)[np.asarray(state.goal)]
        pose = np.where((end == 2)[..., None], goal, state.motion.pose_w)
        before = placed(env, state, pose).replace(
            step=jnp.asarray(np.where(end == 1, last, 0), jnp.int32)
        )
        state, timestep = step(before, jnp.zeros((LOTS, 4, 2)))
        ends = before.replace(key=None), timestep, state.replace(key=None)
        states.append(jax.device_get(ends))
    assert step._cache_size() == 1
    return states


def test_everybody_still_fits_after_cars_have_come_and_gone(driven):
    parked = sum(int(t.events.parked.sum()) for _, t, _ in driven)
    assert parked > 200
    for before, _, after in driven:
        check_lots(after)
        # The parked cars of a lot stay what they are, however they move.
        cars = [state.parked_cars for state in (before, after)]
        np.testing.assert_array_equal(*(x.size for x in cars))
        np.testing.assert_array_equal(*(x.present for x in cars))


def test_agents_change_cars_when_they_respawn_and_only_then(driven):
    seen, changed = set(), 0
    for before, timestep, after in driven:
        done = timestep.events.done
        for old, new in zip(
            jax.tree.leaves(before.physics.vehicle),
            jax.tree.leaves(after.physics.vehicle),
            strict=True,
        ):
            np.testing.assert_array_equal(old[~done], new[~done])
        changed += (before.motion.size != after.motion.size).any(-1)[done].sum()
        seen |= set(kinds(after.motion.size, AGENTS)[done])
        # An agent that finds no bay for its new car keeps goal and car; few do here.
        same = (before.goal == after.goal) & done
        assert (before.motion.size == after.motion.size)[same].all()
    assert seen == {0, 1, 2}
    assert changed > 200


def test_no_parked_car_stays_on_a_goal_that_is_kept(started, step):
    """Everybody parks where, but for their goals, bays are for city cars only."""
    state = jax.tree.map(lambda x: x[:LOTS], started[0])
    goal = np.asarray(state.goal)
    size = np.full((LOTS, LAYOUT.num_bays, 2), (3.9, 2.0), np.float32)
    np.put_along_axis(size, goal[..., None], np.float32([5.3, 2.5]), axis=1)
    state = state.replace(layout=state.layout.replace(bay_size=jnp.asarray(size)))
    pose = np.asarray(LAYOUT.bay_pose)[goal]
    env = ParkingEnv(CONFIG, SlidePhysics())
    after, timestep = step(placed(env, state, pose), jnp.zeros((LOTS, 4, 2)))
    assert timestep.events.parked.all()
    kept = np.asarray(after.goal) == goal
    assert kept.sum() > LOTS
    check_bays(after.goal, after.parked_cars)


def test_farthest_car_that_fits_is_relocated():
    # Five bays 20 m apart; car 0 fits in the first three, car 1 in all.
    sizes = jnp.array([(5.0, 2.5)] * 3 + [(4.0, 2.0)] * 2)
    row = lot([(20.0 * k, 30.0, 1.57) for k in range(5)], bay_size=sizes)
    agent, parked = cars([[100.0, 30.0, 0.0]]), no_events(1, parked=[True])

    def bays_after(goal, bay):
        standing = parked_in(row, bay, [(4.5, 2.2), (3.9, 1.9)])
        state = state_of(row, agent, goal, parked_cars=standing)
        after = relocate_parked_cars(CONFIG, state, parked, jax.random.key(0))
        np.testing.assert_array_equal(after.size, standing.size)
        return after.bay.tolist()

    # Car 0 is farther away in both cases.
    assert bays_after(2, [0, 1]) == [2, 1]
    assert bays_after(3, [0, 1]) == [0, 3]
    # Neither a car that does not fit comes nor one that the lot has not.
    for bay in ([0, NO_BAY], [NO_BAY, NO_BAY]):
        assert bays_after(3, bay) == bay


def test_agents_see_what_they_drive_only_with_a_fleet(env, started):
    state, observation = started
    named = fields_of(observation, env.config)
    cars = state.physics.vehicle
    np.testing.assert_allclose(named["own_size"] * 5.0, cars.size, atol=1e-5)
    for index, name in enumerate(AGENTS):
        mine = kinds(state.motion.size, AGENTS) == index
        params = PRESETS[name]
        radius = params.wheelbase / math.tan(params.max_steering)
        expected = (params.wheelbase, params.centre_offset, radius)
        fields = ("own_wheelbase", "own_rear_axle", "own_turning_radius")
        for field, value in zip(fields, expected, strict=True):
            np.testing.assert_allclose(named[field][mine] * 5.0, value, rtol=1e-5)
    alike = EnvConfig(fleet=FleetConfig(parked_cars=PARKED))
    own_car = ContinuousObservation(own_car=True)
    mixed = EnvConfig(fleet=FleetConfig(AGENTS), observation=own_car)
    sizes = [observation_size(x) for x in (EnvConfig(), alike, mixed)]
    assert sizes == [89, 89, 94]


def test_a_collision_is_of_the_own_footprint(env, started, step):
    """A wall 2.1 m ahead of the centre: 1.77 m of city car, 2.28 of SUV."""
    state = jax.tree.map(lambda x: x[:LOTS], started[0])
    wall = jnp.broadcast_to(jnp.array([[0.0, 2.6, 0.0]]), state.layout.wall_pose.shape)
    pose = jnp.array([[20.0 * k, 0.0, math.pi / 2] for k in range(4)])
    state = placed(env, state, jnp.broadcast_to(pose, (LOTS, 4, 3)))
    state = state.replace(layout=state.layout.replace(wall_pose=wall))
    _, timestep = step(state, jnp.zeros((LOTS, 4, 2)))
    driven = kinds(state.motion.size, AGENTS)
    assert set(driven.ravel()) == {0, 1, 2}
    np.testing.assert_array_equal(timestep.events.hit_wall, driven > 0)


def test_randomization_varies_about_each_agents_own_car(env):
    random = RandomizationConfig(mass=(0.9, 1.1))
    kind, key = env.fleet.draw_kinds(LAYOUT, jax.random.key(1))
    nominal = env.fleet.of_kind(kind)
    cars = randomize_all(random, nominal, key)
    assert len(set(np.asarray(nominal.mass))) > 1
    ratio = np.asarray(cars.mass / nominal.mass)
    assert len(set(ratio)) == 4
    assert (np.abs(ratio - 1.0) <= 0.1 + 1e-5).all()
    np.testing.assert_array_equal(cars.wheelbase, nominal.wheelbase)


def test_presets_of_one_size_are_told_apart(monkeypatch):
    restore_after(monkeypatch, VEHICLES)
    heavy = register_vehicle("heavy", dataclasses.replace(COMPACT, mass=1900.0))
    names = ("compact", "heavy")
    config = EnvConfig(
        num_agents=6,
        num_parked_cars=8,
        fleet=FleetConfig(agents=names, parked_cars=names),
        observation=ContinuousObservation(own_car=True),
        episode=EpisodeConfig(max_steps=2),
    )
    env = ParkingEnv(config, SlidePhysics())
    state, _ = jax.jit(env.reset)(jax.random.key(0))
    mass, seen = np.array([COMPACT.mass, heavy.mass]), []
    for _ in range(6):  # three respawns
        np.testing.assert_allclose(state.physics.vehicle.mass, mass[state.kind])
        seen.append(np.asarray(state.kind))
        state, _ = jax.jit(env.step)(state, jnp.zeros((6, 2)))
    assert {*np.unique(seen)} == {0, 1}
    assert len(np.unique(seen, axis=0)) > 1
    parked = env.fleet.parked_vehicles(state.parked_cars)
    assert {car.mass for car in parked} == {COMPACT.mass, heavy.mass}


@dataclasses.dataclass(frozen=True)
class Narrow(LayoutConfig):
    """Starts between two walls, 4.5 m apart in most lots and 6.5 m in the others."""

    family: str = "narrow"
    min_bays = 1

    def generate(self, key):
        half = jnp.where(jax.random.bernoulli(key, 0.8), 2.25, 3.25)
        ends = jnp.zeros((2, 3)).at[:, 0].set(jnp.stack([-half, half]) - 10.0)
        return build.assemble(
            (30.0, 10.0),
            build.bays(jnp.array([[10.0, 0.0, 0.0]]), (6.5, 3.0)),
            build.walls(ends, (0.02, 6.0)),
            build.spawns(jnp.array([[-10.0, 0.0, 0.0]]), (0.02, 0.02), 0.05),
        )


def test_a_car_without_room_to_start_leaves_its_place_to_a_smaller_one():
    """A city car of 3.5 m can start in all lots, a van of 4.9 m in some."""
    config = EnvConfig(
        layout=Narrow(),
        num_agents=1,
        num_parked_cars=0,
        fleet=FleetConfig(agents=("city", "van"), snug=0.5),
        observation=ContinuousObservation(own_car=True),
        episode=EpisodeConfig(max_steps=3),
    )
    env = ParkingEnv(config, SlidePhysics())
    reset = jax.jit(jax.vmap(lambda key: env.reset(key)[0]))
    step = jax.jit(jax.vmap(env.step))
    state = reset(jax.random.split(jax.random.key(0), 64))
    present, began = [np.asarray(state.present)], 0
    for _ in range(20):
        state, timestep = step(state, jnp.zeros((64, 1, 2)))
        assert not np.asarray(timestep.events.crashed).any()
        present.append(np.asarray(state.present))
        began += int((np.asarray(state.step) == 0)[present[-1]].sum())
    assert 0.2 < present[0].mean() < 0.9  # a van has less room in its bay
    assert np.any(present, axis=0).all()  # no lot waits for ever
    assert began > 64
