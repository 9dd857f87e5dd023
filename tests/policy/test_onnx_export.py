"""ONNX models: inputs by field, and the policy's own actions out of onnxruntime."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import onnxruntime
import pytest
from helpers.exporting import observations, untrained

from carpark_mj.config import EnvConfig, GoalConfig, RayConfig
from carpark_mj.mdp.actions import action_spec
from carpark_mj.observations import (
    ContinuousObservation,
    make_fields,
)
from carpark_mj.policy.onnx_export import (
    join_inputs,
    largest_difference,
    make_model,
    onnx_inputs,
    rounding_error,
    split_observation,
)

WIDE = ContinuousObservation(
    global_information=True,
    own_car=True,
    rays=RayConfig(count=5),
    lane=True,
    tracked_movers=2,
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
    inputs = split_observation(env, seen)
    assert list(inputs) == [entry.name for entry in onnx_inputs(env)]
    np.testing.assert_array_equal(
        join_inputs(env, *map(jnp.asarray, inputs.values())), seen
    )
    start = 0
    for field in make_fields(env):
        name = field.name.replace(f"{field.group}_{field.index}_", f"{field.group}_")
        value = inputs[name][:, field.index] if field.group else inputs[name]
        np.testing.assert_array_equal(value, seen[:, start : start + field.size])
        start += field.size


def test_repeated_entities_are_rows_of_one_input():
    shapes = {entry.name: entry.shape for entry in onnx_inputs(ENVS["chosen"])}
    count = {
        group: 1 + max(f.index for f in make_fields(ENVS["chosen"]) if f.group == group)
        for group in ("agent", "parked_car", "bay")
    }
    assert count["bay"] == 3
    for group in count:
        assert shapes[f"{group}_position"] == (count[group], 2)
        assert shapes[f"{group}_present"] == (count[group], 1)
    assert shapes["goal_position"] == (2,)


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
    ("name", "encoder"),
    [*((name, "set") for name in sorted(ENVS)), ("fixed", "flat")],
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


def test_the_model_says_what_its_inputs_are():
    model = make_model(untrained(ENVS["chosen"]))
    meanings = {value.name: value.doc_string for value in model.graph.input}
    assert meanings["speed"] == "-1.5 … 1.5: own signed speed [forward limit]"
    assert all(meanings.values())
    assert model.graph.output[0].doc_string == (
        "steer and pedal in [-1, 1], an index below 4"
    )


def test_another_policy_is_a_difference():
    env = ENVS["fixed"]
    model, seen = make_model(untrained(env)), observations(env, 100)
    assert largest_difference(model, untrained(env, seed=2), seen) > 0.01


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


def test_numbers_that_are_not_finite_are_a_difference():
    loaded = untrained(ENVS["fixed"])
    seen = observations(ENVS["fixed"], 2)
    broken = dataclasses.replace(
        loaded, policy=lambda observation, key: (jnp.full((2, 2), jnp.nan), {})
    )
    assert largest_difference(make_model(loaded), broken, seen) == np.inf
    assert largest_difference(make_model(broken), broken, seen) == np.inf
    assert rounding_error(broken, seen) == np.inf
