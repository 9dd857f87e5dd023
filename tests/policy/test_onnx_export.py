"""ONNX models act as the policy: inputs by field, or the state of a car."""

import dataclasses
import functools
import json

import jax
import jax.numpy as jnp
import numpy as np
import onnxruntime
import pytest
from helpers.exporting import observations, untrained
from helpers.sliding import SlidePhysics

from carpark_mj.cli.export import environment_rows
from carpark_mj.config import (
    EnvConfig,
    GoalConfig,
    RayConfig,
    RingConfig,
    UltrasoundConfig,
)
from carpark_mj.env import ParkingEnv
from carpark_mj.mdp.actions import action_spec
from carpark_mj.observations import ContinuousObservation, make_fields, observe
from carpark_mj.policy.loading import load_policy
from carpark_mj.policy.onnx_export import (
    METADATA,
    decisions,
    inputs_of,
    join_inputs,
    largest_difference,
    make_car_model,
    make_model,
    make_session,
    onnx_inputs,
    policy_actions,
    require_outside,
    rounding_error,
    sensitivity,
    split_observation,
)
from carpark_mj.policy.outside import INPUTS, plain_values
from carpark_mj.registry import environment

WIDE = ContinuousObservation(
    global_information=True, own_car=True, rays=RayConfig(count=5), tracked_movers=2
)
ENVS = {
    "fixed": EnvConfig(),
    "chosen": EnvConfig(goals=GoalConfig(dynamic=True, num_tracked_bays=3)),
    "wide": EnvConfig(observation=WIDE),
}


@pytest.mark.parametrize("name", sorted(ENVS))
def test_inputs_are_the_observation_taken_apart_by_field(name):
    env = ENVS[name]
    seen = observations(env, 4)
    inputs, start = split_observation(env, seen), 0
    assert {x.name: (4, *x.shape) for x in onnx_inputs(env)} == {
        name: value.shape for name, value in inputs.items()
    }
    joined = join_inputs(env, *map(jnp.asarray, inputs.values()))
    np.testing.assert_array_equal(joined, seen)
    for field in make_fields(env):
        name = field.name.replace(f"{field.group}_{field.index}_", f"{field.group}_")
        value = inputs[name][:, field.index] if field.group else inputs[name]
        np.testing.assert_array_equal(value, seen[:, start : start + field.size])
        start += field.size


@pytest.mark.parametrize("name", sorted(ENVS))
def test_random_observations_are_in_the_ranges_of_their_fields(name):
    env = ENVS[name]
    seen, start = observations(env), 0
    assert seen.dtype == np.float32
    for field in make_fields(env):
        part = seen[:, start : start + field.size]
        assert (part >= field.low).all(), field.name
        assert (part <= field.high).all(), field.name
        assert (part.std(axis=0) > 0).all(), field.name
        start += field.size


@pytest.mark.parametrize(
    ("name", "encoder"), [*((name, "set") for name in sorted(ENVS)), ("fixed", "flat")]
)
def test_a_model_acts_like_its_policy(name, encoder):
    env = ENVS[name]
    loaded = untrained(env, encoder)
    model = make_model(loaded)
    seen = observations(env)
    assert largest_difference(model, loaded, seen) <= 1e-5
    assert largest_difference(model, loaded, seen[:1]) <= 1e-5  # any batch size
    session = onnxruntime.InferenceSession(model.SerializeToString())
    found = {value.name: value.shape for value in session.get_inputs()}
    assert found == {entry.name: ["batch", *entry.shape] for entry in onnx_inputs(env)}
    [output] = session.get_outputs()
    [action] = session.run(None, split_observation(env, seen))
    spec = action_spec(env)
    assert output.name == "action"
    assert action.shape == (len(seen), spec.size)
    assert action.dtype == spec.dtype
    assert np.ptp(action, axis=0).min() > 0.1  # it depends on what is seen


def test_rounding_is_that_of_float32_and_small_for_small_sums():
    env = ENVS["fixed"]
    seen = observations(env, 100)
    assert 0 < rounding_error(untrained(env), seen) <= 1e-5

    def cancel(observation, key):
        # Of 1e4 float32 keeps steps of 2^-10: half a step is the most that is lost.
        first = observation[:, :2]
        return jax.lax.optimization_barrier(first + 1e4) - 1e4, {}

    lost = rounding_error(dataclasses.replace(untrained(env), policy=cancel), seen)
    assert 2**-12 < lost <= 2**-11


def test_rounding_counts_what_observations_cannot_hold():
    env = ENVS["fixed"]
    seen = np.maximum(np.abs(observations(env, 100)), 0.5)

    def steep(observation, key):
        # Exact in float32; it magnifies what float32 cannot hold of an observation.
        return observation[:, :2] * 2.0**10, {}

    lost = rounding_error(dataclasses.replace(untrained(env), policy=steep), seen)
    assert lost == pytest.approx(np.abs(seen[:, :2]).max() * 2.0**-14, rel=1e-6)
    steep_policy = dataclasses.replace(untrained(env), policy=steep)
    assert rounding_error(steep_policy, np.round(seen)) == 0.0  # flags and indices


def test_another_policy_or_a_broken_one_is_a_difference():
    env = ENVS["fixed"]
    loaded, seen = untrained(env), observations(env, 100)
    model = make_model(loaded)
    assert largest_difference(model, untrained(env, seed=2), seen) > 0.01
    broken = dataclasses.replace(
        loaded, policy=lambda observation, key: (jnp.full((2, 2), jnp.nan), {})
    )
    assert largest_difference(model, broken, seen[:2]) == np.inf
    assert largest_difference(make_model(broken), broken, seen[:2]) == np.inf
    assert rounding_error(broken, seen[:2]) == np.inf


LOTS = 32
MORE = {"square": {"others": 9, "parked": 24, "walls": 30, "discs": 2}}


@functools.cache
def driven(name):
    """A shipped policy, rows of a model of it, and states in its environment."""
    loaded = load_policy(name)
    rows = environment_rows(loaded.env, MORE.get(name, {}))
    # Random motion takes the place of any physics.
    return loaded, rows, *states(ParkingEnv(loaded.env, SlidePhysics()), rows)


def states(env, rows):
    """Inputs and observations of all agents of random lots, in random motion."""

    def draw(key):
        start, speed, yaw_rate, steering, choice = jax.random.split(key, 5)
        state, _ = env.reset(start)
        motion, cars = state.motion, state.goal.shape
        motion = dataclasses.replace(
            motion,
            velocity_b=jax.random.uniform(speed, (*cars, 2), minval=-2.0, maxval=3.0),
            yaw_rate=jax.random.uniform(yaw_rate, cars, minval=-1.0),
            steering=jax.random.uniform(steering, cars, minval=-0.5, maxval=0.5),
        )
        state = dataclasses.replace(state, motion=motion)
        if state.tracked_bays is not None:  # some have chosen a bay
            goal = jnp.where(
                jax.random.bernoulli(choice, 0.5, cars),
                state.tracked_bays[:, 0],
                state.goal,
            )
            state = dataclasses.replace(state, goal=goal)
        return plain_values(rows, state), observe(env.config, state)

    keys = jax.random.split(jax.random.key(3), LOTS)
    found, seen = jax.device_get(jax.jit(jax.vmap(draw))(keys))
    there = seen.any(axis=-1)  # absent agents observe zeros
    return {name: value[there] for name, value in found.items()}, seen[there]


@pytest.mark.parametrize(
    "name", ["square", "dynamic", pytest.param("anywhere", marks=pytest.mark.slow)]
)
def test_it_acts_as_the_policy_does_in_the_environment(name):
    loaded, rows, known, seen = driven(name)
    model = make_car_model(loaded, rows)
    assert len(seen) >= 90
    action = decisions(make_session(model), known)
    expected = policy_actions(loaded, seen)
    np.testing.assert_allclose(action, expected, atol=1e-5, rtol=0)
    assert np.ptp(expected, axis=0).min() > 0.5


def test_an_action_depends_on_the_last_places_of_its_inputs():
    loaded, rows, known, _ = driven("square")
    known = {name: value[:8] for name, value in known.items()}
    near = sensitivity(loaded, rows, known, 0)
    assert near.shape == (8,)
    assert (near > 0).all()
    assert near.max() < 1e-3
    steep = dataclasses.replace(
        loaded,
        policy=lambda seen, key: (lambda a: (1e3 * a[0], a[1]))(
            loaded.policy(seen, key)
        ),
    )
    np.testing.assert_allclose(sensitivity(steep, rows, known, 0), 1e3 * near, rtol=0.2)


def test_the_model_says_what_it_takes():
    alone = EnvConfig(physics="bicycle", num_agents=1, num_parked_cars=0)
    loaded = untrained(alone)
    model = make_car_model(loaded, environment_rows(alone, {}))
    [entry] = [entry for entry in model.metadata_props if entry.key == METADATA]
    about = json.loads(entry.value)
    shapes = {
        value.name: [dim.dim_value for dim in value.type.tensor_type.shape.dim]
        for value in model.graph.input
    }
    assert {x["name"]: x["dims"] for x in about["inputs"]} == shapes
    assert all(x["meaning"] for x in about["inputs"])
    assert [x["name"] for x in about["inputs"]] == [x.name for x in inputs_of(model)]
    assert about["decision_time"] == loaded.env.sim.ctrl_dt
    assert about["output"]["dims"] == [2]
    # A car alone, that sees walls: nothing of others.
    assert not any(name.startswith(("other", "parked", "bay")) for name in shapes)
    assert {"pose", "speed", "goal_pose", "wall_mask"} <= shapes.keys()


def test_names_are_unique_and_units_are_known():
    assert len({entry.name for entry in INPUTS}) == len(INPUTS)
    for entry in INPUTS:
        assert bool(entry.unit) == (entry.dtype == "float32"), entry.name
        units = entry.unit.replace(",", "").replace("/s", "").split()
        assert {*units} <= {"m", "rad"}


PAST = ContinuousObservation(rings=RingConfig((5.0,), history=2))
HEARS = ContinuousObservation(ultrasound=UltrasoundConfig(on=True))


@pytest.mark.parametrize(
    ("env", "reason"),
    [
        (EnvConfig(observation=PAST), "rings.history"),
        (environment("considerate"), "tracked_movers 6"),
        (environment("sees"), "pictures .camera_depth, camera_seen"),
        (EnvConfig(observation=HEARS), "ultrasound.noise 0.01"),
    ],
)
def test_what_a_car_outside_cannot_observe_is_refused(env, reason):
    with pytest.raises(ValueError, match=reason):
        require_outside(env)
