import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from helpers.sliding import SlidePhysics

from carpark_mj.config import Distribution, EnvConfig, RandomizationConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.fleet.randomization import check_randomization, draw, randomize
from carpark_mj.policy.runs import from_dict
from carpark_mj.vehicle import COMPACT, PRESETS, Vehicle, make_vehicle
from carpark_mj.vehicle.load import with_mass
from carpark_mj.vehicle.mjcf import car_model
from carpark_mj.vehicle.parameters import GRAVITY
from carpark_mj.vehicle.surfaces import SURFACES, on_surface

ABSOLUTE = {"relative": False}
EVERYTHING = RandomizationConfig(
    mass=Distribution(width=0.2),
    cg_x=Distribution(width=0.1, **ABSOLUTE),
    cg_height=Distribution("normal", width=0.05),
    friction=Distribution(width=0.3, mean=-0.1),
    tyre_stiffness=Distribution("normal", width=0.1),
    brake_gain=Distribution(width=0.25),
    steering_offset=Distribution("normal", width=0.01, **ABSOLUTE),
    steering_lag=Distribution(width=0.05, mean=0.1, **ABSOLUTE),
)
KEY = jax.random.key(0)


def leaves(tree):
    return [np.asarray(x) for x in jax.tree.leaves(tree)]


def same(a, b):
    return all(np.array_equal(x, y) for x, y in zip(leaves(a), leaves(b), strict=True))


@pytest.fixture(scope="module")
def fleet(compact: Vehicle) -> Vehicle:
    """2000 random cars."""
    make = jax.jit(jax.vmap(lambda key: randomize(EVERYTHING, compact, key)))
    return make(jax.random.split(KEY, 2000))


def test_nothing_varies_by_default(compact: Vehicle):
    assert not RandomizationConfig().is_on
    assert same(randomize(RandomizationConfig(), compact, KEY), compact)


@pytest.mark.parametrize("kind", ["uniform", "normal"])
@pytest.mark.parametrize("relative", [True, False])
def test_draws_fill_their_range_and_stay_in_it(kind, relative):
    distribution = Distribution(kind, width=0.3, mean=0.2, relative=relative)
    draws = jax.vmap(lambda key: draw(distribution, jnp.array(2.0), key))
    values = np.asarray(draws(jax.random.split(KEY, 5000)))
    low, high = distribution.bounds(2.0)
    scale = 2.0 if relative else 1.0
    reach = 0.3 * (2.0 if kind == "normal" else 1.0)
    assert (low, high) == pytest.approx(
        (2.0 + scale * (0.2 - reach), 2.0 + scale * (0.2 + reach))
    )
    assert low - 1e-6 <= values.min() < low + 0.05 * (high - low)
    assert high - 0.05 * (high - low) < values.max() <= high + 1e-6
    # Standard deviations: uniform w / sqrt 3; a normal cut at 2 sigma 0.880 w.
    spread = {"uniform": 0.3 / np.sqrt(3), "normal": 0.3 * 0.880}[kind] * scale
    assert values.mean() == pytest.approx(2.0 + 0.2 * scale, abs=0.05 * spread)
    assert values.std() == pytest.approx(spread, rel=0.05)


def test_every_parameter_varies_within_its_bounds(fleet: Vehicle, compact: Vehicle):
    def share(name):
        return np.asarray(getattr(fleet, name)) / np.asarray(getattr(compact, name))

    stiffness = fleet.tyres.lateral_stiffness / fleet.tyres.static_load
    nominal = compact.tyres.lateral_stiffness / compact.tyres.static_load
    values = {
        "mass": share("mass"),
        "cg_x": np.asarray(fleet.cg[:, 0] - compact.cg[0]),
        "cg_height": np.asarray(fleet.cg[:, 2] / compact.cg[2]),
        "friction": np.asarray(fleet.tyres.friction / compact.tyres.friction),
        "tyre_stiffness": np.asarray(stiffness / nominal)[:, 0],
        "brake_gain": share("max_deceleration"),
        "steering_offset": np.asarray(fleet.steering_offset),
        "steering_lag": np.asarray(fleet.steering_lag),
    }
    assert set(values) == set(EVERYTHING.distributions())
    for name, distribution in EVERYTHING.distributions().items():
        low, high = distribution.bounds(1.0 if distribution.relative else 0.0)
        got = values[name]
        assert low - 1e-5 <= got.min() < low + 0.1 * (high - low), name
        assert high - 0.1 * (high - low) < got.max() <= high + 1e-5, name
    # The hold weakens with the brake; everything but the listed stays as it is.
    np.testing.assert_allclose(
        share("hold_deceleration"), values["brake_gain"], rtol=1e-5
    )
    for name in ("size", "wheelbase", "hub", "max_steering", "rated_mass"):
        assert (np.asarray(getattr(fleet, name)) == getattr(compact, name)).all()


def test_parameters_are_drawn_independently_of_each_other(fleet: Vehicle):
    columns = [
        fleet.mass,
        fleet.cg[:, 0],
        fleet.cg[:, 2],
        fleet.tyres.friction,
        fleet.max_deceleration,
        fleet.steering_offset,
        fleet.steering_lag,
    ]
    correlation = np.corrcoef(np.stack(columns)) - np.eye(len(columns))
    # 2000 cars: standard error 0.022.
    assert np.abs(correlation).max() < 0.09


def test_switching_one_parameter_on_changes_no_other(compact: Vehicle):
    lag = RandomizationConfig(steering_lag=EVERYTHING.steering_lag)
    both = dataclasses.replace(lag, friction=EVERYTHING.friction)
    one, two = randomize(lag, compact, KEY), randomize(both, compact, KEY)
    assert one.steering_lag == two.steering_lag
    assert one.tyres.friction != two.tyres.friction


@pytest.mark.parametrize("params", PRESETS.values(), ids=PRESETS)
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
    built = dataclasses.replace(
        params,
        mass=float(mass),
        cg_to_front_axle=params.wheelbase - float(cg[0]),
        yaw_inertia=1.25 * params.yaw_inertia,
        roll_inertia=1.25 * params.roll_inertia,
        pitch_inertia=1.25 * params.pitch_inertia,
    )
    expected, got = make_vehicle(built).tyres, loaded.tyres
    for field in dataclasses.fields(expected):
        np.testing.assert_allclose(
            getattr(got, field.name), getattr(expected, field.name), rtol=1e-5
        )


def test_surfaces_scale_grip_and_scrub_alike(compact: Vehicle):
    assert same(on_surface(compact, "dry"), compact)
    for name, friction in SURFACES.items():
        tyre = dataclasses.replace(COMPACT.tyre, friction=friction)
        built = make_vehicle(dataclasses.replace(COMPACT, tyre=tyre))
        for got, expected in zip(
            leaves(on_surface(compact, name)), leaves(built), strict=True
        ):
            np.testing.assert_allclose(got, expected, rtol=1e-6)


IMPOSSIBLE = [
    ({"mass": Distribution(width=0.95)}, r"randomization.mass must stay within"),
    ({"cg_x": Distribution(width=2.0, **ABSOLUTE)}, "randomization.cg_x"),
    ({"cg_height": Distribution("normal", width=0.6)}, "randomization.cg_height"),
    ({"friction": Distribution(width=1.0)}, "randomization.friction"),
    ({"tyre_stiffness": Distribution(mean=3.0)}, "randomization.tyre_stiffness"),
    ({"brake_gain": Distribution(mean=-1.1)}, "randomization.brake_gain"),
    (
        {"steering_offset": Distribution(width=0.5, **ABSOLUTE)},
        "randomization.steering_offset",
    ),
    ({"steering_lag": Distribution(width=0.1, **ABSOLUTE)}, "steering_lag .* -0.1"),
]


@pytest.mark.parametrize(("change", "message"), IMPOSSIBLE)
def test_distributions_that_draw_impossible_cars_are_refused(change, message):
    config = EnvConfig(randomization=RandomizationConfig(**change))
    with pytest.raises(ValueError, match=message) as refusal:
        ParkingEnv(config)
    assert "\n" not in str(refusal.value)


def test_distributions_refuse_impossible_settings():
    with pytest.raises(ValueError, match="unknown kind 'beta'"):
        Distribution("beta")
    with pytest.raises(ValueError, match=r"width must be at least 0\.0"):
        Distribution(width=-1.0)
    with pytest.raises(ValueError, match="mean must be finite"):
        Distribution(mean=np.inf)
    with pytest.raises(ValueError, match="steering_offset must be absolute"):
        RandomizationConfig(steering_offset=Distribution(width=0.1))


@pytest.mark.parametrize("params", PRESETS.values(), ids=PRESETS)
def test_every_preset_bears_the_randomization_of_the_tests(params):
    check_randomization(EVERYTHING, params)


def test_a_randomized_environment_survives_its_config_file():
    config = EnvConfig(randomization=EVERYTHING)
    assert from_dict(EnvConfig, dataclasses.asdict(config)) == config


# In the environment


@pytest.fixture(scope="module")
def env() -> ParkingEnv:
    config = EnvConfig(num_agents=3, num_parked_cars=2, randomization=EVERYTHING)
    return ParkingEnv(config, SlidePhysics())


@pytest.fixture(scope="module")
def compiled(env):
    return jax.jit(env.reset), jax.jit(env.step)


def test_cars_are_drawn_anew_for_those_who_respawn_and_for_nobody_else(env, compiled):
    reset, step = compiled
    state, _ = reset(KEY)
    mass = np.asarray(state.physics.vehicle.mass)
    assert len(set(mass)) == 3
    last = env.config.episode.max_steps - 1
    state = state.replace(step=jnp.array([0, last, 0], jnp.int32))
    after, timestep = step(state, jnp.zeros((3, 2)))
    done = np.asarray(timestep.events.done)
    assert done[1]
    for old, new in zip(
        leaves(state.physics.vehicle), leaves(after.physics.vehicle), strict=True
    ):
        np.testing.assert_array_equal(old[~done], new[~done])
    renewed = np.asarray(after.physics.vehicle.mass)
    assert (renewed[done] != mass[done]).all()
    # Another lot and another seed: other cars, the same program.
    other, _ = reset(jax.random.key(1))
    assert not set(np.asarray(other.physics.vehicle.mass)) & set(mass)
    step(other, jnp.zeros((3, 2)))
    assert step._cache_size() == 1
    assert reset._cache_size() == 1


def test_without_randomization_all_cars_are_the_nominal_one(env, compact: Vehicle):
    off = dataclasses.replace(env.config, randomization=RandomizationConfig())
    state, _ = jax.jit(ParkingEnv(off, SlidePhysics()).reset)(KEY)
    for got, nominal in zip(
        leaves(state.physics.vehicle), leaves(compact), strict=True
    ):
        np.testing.assert_array_equal(got, np.broadcast_to(nominal, got.shape))
    assert state.sensors is None


def test_no_key_is_used_twice(env, compiled):
    """The cars of consecutive steps and of neighbouring agents are all different."""
    reset, step = compiled
    state, _ = reset(KEY)
    seen = list(np.asarray(state.physics.vehicle.mass))
    keys = [tuple(np.asarray(jax.random.key_data(state.key)))]
    over = jnp.full(3, env.config.episode.max_steps, jnp.int32)
    for _ in range(5):
        state, _ = step(state.replace(step=over), jnp.zeros((3, 2)))
        seen += list(np.asarray(state.physics.vehicle.mass))
        keys.append(tuple(np.asarray(jax.random.key_data(state.key))))
    assert len(set(seen)) == 18
    assert len(set(keys)) == 6
