"""Cars of several kinds in one lot: they fit where they are, and drive as alone."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.registering import restore_after
from helpers.scenes import cars, check_occupancy, lot
from helpers.sliding import SlidePhysics, placed, sliding
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
from carpark_mj.observations import ContinuousObservation
from carpark_mj.spawning.fleet import randomize_all
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


# They lie along two sides of a field on which cars spawn, 12 m from them.
SIDES = ((-20.0, math.pi / 2), (20.0, -math.pi / 2))
LAYOUT = build.assemble(
    (70.0, 30.0),
    build.bays(
        jnp.array([(x, *side) for side in SIDES for x in np.linspace(-60, 60, 20)]),
        jnp.array(BAY_SIZES)[np.random.default_rng(0).permutation(40)],
    ),
    build.walls(jnp.array([[0.0, 29.0, 0.0]]), (140.0, 1.0)),
    build.spawns(jnp.zeros((1, 3)), (120.0, 10.0), np.pi),
)


ENV = ParkingEnv(CONFIG, SlidePhysics())


@pytest.fixture(scope="module")
def started():
    """A thousand lots, just reset, and their observations."""
    reset = jax.jit(jax.vmap(lambda key: ENV.reset_to_layout(LAYOUT, key)))
    return reset(jax.random.split(jax.random.key(0), KEYS))


def check_lots(state):
    """Asserts of lots that every car fits where it is or heads for."""
    state = jax.tree.map(np.asarray, state.replace(key=None))
    cars = state.parked_cars
    goal, bay, here = state.goal, cars.bay, cars.present
    # Absent cars count as bays of their own.
    own = LAYOUT.num_bays + np.arange(cars.bay.shape[-1])
    every = np.ones((*goal.shape[:-1], LAYOUT.num_bays + len(own)), bool)
    check_occupancy(goal, np.where(here, bay, own), every)
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


@pytest.fixture(scope="module")
def driven(started):
    """Thirty steps in which episodes end by chance, a third of them by parking."""
    state = jax.tree.map(lambda x: x[:LOTS], started[0])
    rng, states, step = np.random.default_rng(0), [], jax.jit(jax.vmap(ENV.step))
    for _ in range(30):
        end = rng.choice(3, (LOTS, 4), p=(0.5, 0.25, 0.25))
        last = CONFIG.episode.max_steps
        goal = np.asarray(LAYOUT.bay_pose)[np.asarray(state.goal)]
        pose = np.where((end == 2)[..., None], goal, state.motion.pose_w)
        before = placed(ENV, state, pose).replace(
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


def test_randomization_varies_about_each_agents_own_car():
    random = RandomizationConfig(mass=(0.9, 1.1))
    kind, key = ENV.fleet.draw_kinds(LAYOUT, jax.random.key(1))
    nominal = ENV.fleet.of_kind(kind)
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
    env, reset, step = sliding(config)
    state, _ = reset(jax.random.key(0))
    mass, seen = np.array([COMPACT.mass, heavy.mass]), []
    for _ in range(6):  # three respawns
        np.testing.assert_allclose(state.physics.vehicle.mass, mass[state.kind])
        seen.append(np.asarray(state.kind))
        state, _ = step(state, jnp.zeros((6, 2)))
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
