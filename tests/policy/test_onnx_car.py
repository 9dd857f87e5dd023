"""Models with the observation inside act as the policy does in the environment."""

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from carpark_mj.cli.export import environment_rows
from carpark_mj.config import EnvConfig, RingConfig, UltrasoundConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.observations import ContinuousObservation, observe
from carpark_mj.policy.loading import load_policy
from carpark_mj.policy.onnx_export import (
    METADATA,
    decisions,
    inputs_of,
    make_car_model,
    make_session,
    policy_actions,
    require_outside,
    sensitivity,
)
from carpark_mj.policy.outside import INPUTS, plain_values
from carpark_mj.registry import environment

pytest.importorskip("onnxruntime")
LOTS = 32
MORE = {"others": 9, "parked": 24, "walls": 30, "discs": 2}


def states(env, rows, lots=LOTS):
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

    keys = jax.random.split(jax.random.key(3), lots)
    found, seen = jax.device_get(jax.jit(jax.vmap(draw))(keys))
    there = seen.any(axis=-1)  # absent agents observe zeros
    return {name: value[there] for name, value in found.items()}, seen[there]


@pytest.mark.parametrize(
    ("name", "counts"),
    [
        ("square", MORE),
        ("dynamic", {}),
        pytest.param("anywhere", {}, marks=pytest.mark.slow),
    ],
)
def test_it_acts_as_the_policy_does_in_the_environment(name, counts):
    loaded = load_policy(name)
    rows = environment_rows(loaded.env, counts)
    model = make_car_model(loaded, rows)
    known, seen = states(ParkingEnv(loaded.env), rows)
    assert len(seen) >= 90
    action = decisions(make_session(model), known)
    expected = policy_actions(loaded, seen)
    np.testing.assert_allclose(action, expected, atol=1e-5, rtol=0)
    assert np.ptp(expected, axis=0).min() > 0.5


def test_an_action_depends_on_the_last_places_of_its_inputs():
    loaded = load_policy("hope")
    rows = environment_rows(loaded.env, {})
    known, _ = states(ParkingEnv(loaded.env), rows, 8)
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
    loaded = load_policy("hope")
    model = make_car_model(loaded, environment_rows(loaded.env, {}))
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


def test_names_are_unique_and_units_those_of_lengths_angles_and_times():
    assert len({entry.name for entry in INPUTS}) == len(INPUTS)
    for entry in INPUTS:
        has_unit = entry.dtype == "float32"
        assert bool(entry.unit) == has_unit, entry.name
        assert set(entry.unit.replace(",", "").replace("/s", "").split()) <= {
            "m",
            "rad",
        }


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
