"""Cars of several kinds in a lot and random cars: where they fit, what they weigh."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from helpers.cars import ROAD_CARS
from helpers.scenes import check_occupancy
from helpers.sliding import SlidePhysics, placed
from helpers.trees import agent_of, assert_close, same

from carpark_mj.config import (
    PARKED_RULES,
    EnvConfig,
    EpisodeConfig,
    FleetConfig,
    JitterConfig,
    RandomizationConfig,
    SimConfig,
)
from carpark_mj.env import ParkingEnv
from carpark_mj.geometry import box_inside
from carpark_mj.layouts import build
from carpark_mj.layouts.base import LayoutConfig
from carpark_mj.mdp.parked_cars import AWAY
from carpark_mj.observations import ContinuousObservation
from carpark_mj.physics.mjx import MjxPhysics
from carpark_mj.spawning.fleet import randomize
from carpark_mj.vehicle import COMPACT, PRESETS, make_vehicle
from carpark_mj.vehicle.mjcf import car_model
from carpark_mj.vehicle.parameters import GRAVITY
from carpark_mj.vehicle.vehicle import SURFACES, in_conditions, with_mass

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
    randomization=RandomizationConfig(mass=(0.9, 1.1)),
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


MASSES = np.array([PRESETS[name].mass for name in AGENTS])


def test_cars_vary_about_their_own_presets(started):
    state, _ = started
    vehicle, kind = state.physics.vehicle, np.asarray(state.kind)
    ratio = np.asarray(vehicle.mass) / MASSES[kind]
    assert 0.9 - 1e-5 < ratio.min() < 0.901
    assert 1.099 < ratio.max() < 1.1 + 1e-5
    assert len(np.unique(ratio)) > 0.99 * ratio.size  # no key is used twice
    bases = np.array([PRESETS[n].wheelbase for n in AGENTS])[kind]
    np.testing.assert_allclose(vehicle.wheelbase, bases, rtol=1e-6)


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
    seen, changed, masses = set(), 0, []
    for before, timestep, after in driven:
        done = timestep.events.done
        cars = [agent_of(x.physics.vehicle, ~done) for x in (before, after)]
        assert same(*cars)
        changed += (before.motion.size != after.motion.size).any(-1)[done].sum()
        seen |= set(kinds(after.motion.size, AGENTS)[done])
        # An agent that finds no bay for its new car keeps goal and car; few do here.
        stays = (before.goal == after.goal) & done
        assert (before.motion.size == after.motion.size)[stays].all()
        assert (
            np.abs(after.physics.vehicle.mass / MASSES[after.kind] - 1) < 0.11
        ).all()
        masses += after.physics.vehicle.mass[done & ~stays].tolist()
    assert seen == {0, 1, 2}
    assert changed > 200
    assert len(set(masses)) > 0.99 * len(masses)


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


def test_a_car_without_room_leaves_its_place_to_a_smaller_one():
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


# Random cars: their ranges, what they weigh, and what stays upright

EVERYTHING = RandomizationConfig(
    mass=(0.8, 1.2),
    cg_x=(0.93, 1.06),
    cg_height=(0.9, 1.1),
    friction=(0.6, 1.2),
    tyre_stiffness=(0.8, 1.2),
    brake_gain=(0.75, 1.25),
    steering_offset=(-0.02, 0.02),
    steering_lag=(0.05, 0.15),
)
KEY = jax.random.key(0)


@pytest.fixture(scope="module")
def fleet(compact):
    """2000 random cars."""
    make = jax.jit(jax.vmap(lambda key: randomize(EVERYTHING, compact, key)))
    return make(jax.random.split(KEY, 2000))


def test_every_parameter_fills_its_range_and_stays_in_it(fleet, compact):
    def factor(name):
        return np.asarray(getattr(fleet, name) / getattr(compact, name))

    stiffness = fleet.tyres.lateral_stiffness / fleet.tyres.static_load
    nominal = compact.tyres.lateral_stiffness / compact.tyres.static_load
    values = {
        "mass": factor("mass"),
        "cg_x": factor("cg")[:, 0],
        "cg_height": factor("cg")[:, 2],
        "friction": np.asarray(fleet.tyres.friction / compact.tyres.friction),
        "tyre_stiffness": np.asarray(stiffness / nominal)[:, 0],
        "brake_gain": factor("max_deceleration"),
        "steering_offset": np.asarray(fleet.steering_offset),
        "steering_lag": np.asarray(fleet.steering_lag),
    }
    assert set(values) == set(EVERYTHING.ranges())
    for name, (low, high) in EVERYTHING.ranges().items():
        got, width = values[name], high - low
        assert low - 1e-5 <= got.min() < low + 0.02 * width, name
        assert high - 0.02 * width < got.max() <= high + 1e-5, name
        # Uniform; the mean of 2000 has a standard error of 0.0065 widths.
        assert got.mean() == pytest.approx((low + high) / 2, abs=0.025 * width), name
        assert got.std() == pytest.approx(width / math.sqrt(12), rel=0.05), name
    # The hold weakens with the brake; everything but the listed stays as it is.
    np.testing.assert_allclose(
        factor("hold_deceleration"), values["brake_gain"], rtol=1e-5
    )
    for name in ("size", "wheelbase", "hub", "max_steering", "rated_mass"):
        assert (np.asarray(getattr(fleet, name)) == getattr(compact, name)).all()


def test_parameters_are_drawn_independently_of_each_other(fleet):
    columns = [fleet.mass, fleet.cg[:, 0], fleet.cg[:, 2], fleet.tyres.friction]
    columns += [fleet.max_deceleration, fleet.steering_offset, fleet.steering_lag]
    correlation = np.corrcoef(np.stack(columns)) - np.eye(len(columns))
    # 2000 cars: standard error 0.022.
    assert np.abs(correlation).max() < 0.09


def test_switching_one_parameter_on_changes_no_other(compact):
    lag = RandomizationConfig(steering_lag=EVERYTHING.steering_lag)
    both = dataclasses.replace(lag, friction=EVERYTHING.friction)
    one, two = randomize(lag, compact, KEY), randomize(both, compact, KEY)
    assert one.steering_lag == two.steering_lag
    assert one.tyres.friction != two.tyres.friction


@pytest.mark.parametrize("params", ROAD_CARS.values(), ids=ROAD_CARS)
def test_a_loaded_car_has_the_mass_properties_of_one_built_so(params):
    vehicle = make_vehicle(params)
    mass = jnp.float32(1.25 * params.mass)
    cg = vehicle.cg + jnp.array([0.15, 0.0, 0.05])
    loaded = with_mass(vehicle, mass, cg)
    model = car_model(params, 0.01, (0.0, 0.0, -GRAVITY))
    model.body_mass[:] = loaded.body_mass
    model.body_ipos[:] = loaded.body_ipos
    model.body_inertia[:] = loaded.body_inertia
    data = mujoco.MjData(model)
    mujoco.mj_setConst(model, data)
    mujoco.mj_forward(model, data)
    car = model.body("car").id
    # float32 rounding of moments of some 1e3 kg m.
    assert model.body_subtreemass[car] == pytest.approx(float(mass), rel=1e-6)
    np.testing.assert_allclose(data.subtree_com[car], cg, atol=1e-5)
    names = ("yaw_inertia", "roll_inertia", "pitch_inertia")
    inertias = {name: 1.25 * getattr(params, name) for name in names}
    inertias["cg_to_front_axle"] = params.wheelbase - float(cg[0])
    built = make_vehicle(dataclasses.replace(params, mass=float(mass), **inertias))
    assert_close(loaded.tyres, built.tyres, rtol=1e-5)


def test_surfaces_scale_grip_and_scrub_alike(compact):
    assert same(in_conditions(compact, SimConfig()), compact)
    for name, friction in SURFACES.items():
        tyre = dataclasses.replace(COMPACT.tyre, friction=friction)
        built = make_vehicle(dataclasses.replace(COMPACT, tyre=tyre))
        found = in_conditions(compact, SimConfig(surface=name))
        assert_close(found, built, rtol=1e-6)


def test_a_car_on_its_side_is_put_back_and_flagged():
    """Full steps of wheel and pedal, with loads on the roof."""
    runs, cars = 8, []
    for params in (PRESETS["city"], PRESETS["van"]):
        car, cg = make_vehicle(params), [params.wheelbase / 2, 0.0, params.height]
        cars.append(with_mass(car, 3.0 * car.mass, jnp.array(cg)))
    vehicle = jax.tree.map(lambda *x: jnp.repeat(jnp.stack(x), runs, axis=0), *cars)
    physics, rng = MjxPhysics(SimConfig()), np.random.default_rng(0)
    steps = np.repeat(rng.choice([-1.0, 1.0], (12, runs, 2)), 5, axis=0)
    controls = jnp.asarray(np.tile(steps, (1, len(cars), 1)), jnp.float32)

    @jax.jit
    def drive(state):
        def step(state, controls):
            state = physics.step(state, controls)
            x, y = state.qpos[:, 4], state.qpos[:, 5]
            return state, (state.finite, 1.0 - 2.0 * (x**2 + y**2))

        return jax.lax.scan(step, state, controls)[1]

    state = physics.init(jnp.zeros((len(cars) * runs, 3)), vehicle)
    finite, up = map(np.asarray, drive(state))
    over = ~finite.reshape(-1, len(cars), runs).all(axis=0)
    assert over.any(axis=1).all()
    assert up.min() > 0.5  # it never lies there
