"""Random cars: their ranges, what stays upright, and whom the environment renews."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from helpers.cars import ROAD_CARS
from helpers.sliding import sliding
from helpers.trees import leaves, same

from carpark_mj.config import EnvConfig, RandomizationConfig, SimConfig
from carpark_mj.physics.mjx import MjxPhysics
from carpark_mj.spawning.fleet import randomize
from carpark_mj.vehicle import COMPACT, PRESETS, make_vehicle
from carpark_mj.vehicle.mjcf import car_model
from carpark_mj.vehicle.parameters import GRAVITY
from carpark_mj.vehicle.vehicle import SURFACES, in_conditions, with_mass

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
    for got, expected in zip(leaves(loaded.tyres), leaves(built.tyres), strict=True):
        np.testing.assert_allclose(got, expected, rtol=1e-5)


def test_surfaces_scale_grip_and_scrub_alike(compact):
    assert same(in_conditions(compact, SimConfig()), compact)
    for name, friction in SURFACES.items():
        tyre = dataclasses.replace(COMPACT.tyre, friction=friction)
        built = make_vehicle(dataclasses.replace(COMPACT, tyre=tyre))
        both = leaves(in_conditions(compact, SimConfig(surface=name))), leaves(built)
        for got, expected in zip(*both, strict=True):
            np.testing.assert_allclose(got, expected, rtol=1e-6)


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


# In the environment


CONFIG = EnvConfig(num_agents=3, num_parked_cars=2, randomization=EVERYTHING)


def test_only_respawned_agents_get_new_cars():
    _, reset, step = sliding(CONFIG)
    state, _ = reset(KEY)
    mass = np.asarray(state.physics.vehicle.mass)
    assert len(set(mass)) == 3
    last = CONFIG.episode.max_steps - 1
    state = state.replace(step=jnp.array([0, last, 0], jnp.int32))
    after, timestep = step(state, jnp.zeros((3, 2)))
    done = np.asarray(timestep.events.done)
    assert done[1]
    both = leaves(state.physics.vehicle), leaves(after.physics.vehicle)
    for old, new in zip(*both, strict=True):
        np.testing.assert_array_equal(old[~done], new[~done])
    renewed = np.asarray(after.physics.vehicle.mass)
    assert (renewed[done] != mass[done]).all()
    # Another lot and another seed: other cars, the same program.
    other, _ = reset(jax.random.key(1))
    assert not set(np.asarray(other.physics.vehicle.mass)) & set(mass)
    step(other, jnp.zeros((3, 2)))
    assert step._cache_size() == 1
    assert reset._cache_size() == 1


def test_without_randomization_all_cars_are_the_nominal_one(compact):
    off = dataclasses.replace(CONFIG, randomization=RandomizationConfig())
    state, _ = sliding(off)[1](KEY)
    both = leaves(state.physics.vehicle), leaves(compact)
    for got, nominal in zip(*both, strict=True):
        np.testing.assert_array_equal(got, np.broadcast_to(nominal, got.shape))
    assert state.sensors is None


def test_no_key_is_used_twice():
    """The cars of consecutive steps and of neighbouring agents are all different."""
    _, reset, step = sliding(CONFIG)
    state, _ = reset(KEY)
    seen = list(np.asarray(state.physics.vehicle.mass))
    keys = [tuple(np.asarray(jax.random.key_data(state.key)))]
    over = jnp.full(3, CONFIG.episode.max_steps, jnp.int32)
    for _ in range(5):
        state, _ = step(state.replace(step=over), jnp.zeros((3, 2)))
        seen += list(np.asarray(state.physics.vehicle.mass))
        keys.append(tuple(np.asarray(jax.random.key_data(state.key))))
    assert len(set(seen)) == 18
    assert len(set(keys)) == 6
