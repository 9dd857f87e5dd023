"""ONNX models act as the policy, and their graphs compute what JAX does."""

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

from carpark_formats.onnx.car import plain_values
from carpark_formats.onnx.export import environment_rows
from carpark_formats.onnx.models import (
    METADATA,
    decisions,
    from_onnx,
    inputs_of,
    join_inputs,
    make_car_model,
    make_model,
    make_session,
    model_differences,
    onnx_inputs,
    policy_actions,
    require_outside,
    rounding_error,
    sensitivity,
    split_observation,
    ties,
)
from carpark_formats.onnx.program import make_graph
from carpark_mj.config import (
    EnvConfig,
    FleetConfig,
    GoalConfig,
    RayConfig,
    RingConfig,
    UltrasoundConfig,
)
from carpark_mj.env import ParkingEnv
from carpark_mj.geometry import boxes, norm, to_local, wrap_angle
from carpark_mj.mdp.actions import action_spec
from carpark_mj.observations import ContinuousObservation, make_fields, observe
from carpark_mj.observations.ego import TURNS, Past
from carpark_mj.policy.loading import load_policy
from carpark_mj.policy.named import find_named
from carpark_mj.registry import FIRST, environment

WIDE = ContinuousObservation(
    global_information=True, own_car=True, rays=RayConfig(count=5), tracked_movers=2
)
ENVS = {
    "fixed": EnvConfig(),
    "chosen": EnvConfig(goals=GoalConfig(dynamic=True, num_tracked_bays=3)),
    "wide": EnvConfig(observation=WIDE),
    "past": EnvConfig(observation=ContinuousObservation(own_past=True)),
}
CHOICES = {"past": {"bins": 9, "dither": 30.0, "mirrored": True}}


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


@pytest.mark.parametrize(
    ("name", "encoder"), [*((name, "set") for name in sorted(ENVS)), ("fixed", "flat")]
)
def test_a_model_acts_like_its_policy(name, encoder):
    env = ENVS[name]
    loaded = untrained(env, encoder, **CHOICES.get(name, {}))
    model = make_model(loaded)
    seen = observations(env)
    alike = model_differences(model, loaded, seen) <= 1e-5
    assert (~alike).mean() <= ties(loaded)
    assert rounding_error(loaded, seen[:50]) <= 1e-4  # also with 64 bits
    assert model_differences(model, loaded, seen[:1]).max() <= 1e-5  # any batch size
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


def test_a_model_drives_as_its_policy(tmp_path):
    loaded, file = untrained(ENVS["fixed"]), tmp_path / "policy.onnx"
    file.write_bytes(make_model(loaded).SerializeToString())
    seen, key = observations(loaded.env, 7), jax.random.key(0)
    found = jax.jit(from_onnx(file)(ParkingEnv(loaded.env)))(seen, key)[0]
    np.testing.assert_allclose(found, loaded.policy(seen, key)[0], atol=1e-4)
    with pytest.raises(ValueError, match=r"policy fails on .*agent_present"):
        find_named(f"onnx:{file}")(ParkingEnv(FIRST))
    (tmp_path / "other.onnx").write_text("no model")
    with pytest.raises(ValueError, match=r"other\.onnx cannot be loaded"):
        find_named(f"onnx:{tmp_path / 'other.onnx'}")


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
    assert model_differences(model, untrained(env, seed=2), seen).max() > 0.01
    broken = dataclasses.replace(
        loaded, policy=lambda observation, key: (jnp.full((2, 2), jnp.nan), {})
    )
    assert model_differences(model, broken, seen[:2]).max() == np.inf
    broken_model = make_model(broken)
    assert model_differences(broken_model, broken, seen[:2]).max() == np.inf
    assert rounding_error(broken, seen[:2]) == np.inf


LOTS = 32
MORE = {
    "square": {"others": 9, "parked": 24, "walls": 30, "discs": 2}
    | {"people": 2, "movers": 1}  # which its lots do not have
}
# Lots that compile in seconds, with required ends, and cars of different response.
FLEET = FleetConfig(agents=("compact", "city"))
SIMPLER = {"valet": {"layout": "clutter", "fleet": FLEET}}


@functools.cache
def driven(name):
    """A shipped policy, rows of a model of it, and states in its environment."""
    env = dataclasses.replace(load_policy(name).env, **SIMPLER.get(name, {}))
    loaded = load_policy(name, env=env)
    rows = environment_rows(loaded.env, MORE.get(name, {}))
    # Random motion takes the place of any physics.
    return loaded, rows, *states(ParkingEnv(loaded.env, SlidePhysics()), rows)


def moving(key, group):
    """Obstacles that all move, with all headings: those of a reset stand."""
    key = jax.random.fold_in(key, group.kind)
    velocity = jax.random.uniform(key, (group.count, 2), minval=-1.5, maxval=1.5)
    return dataclasses.replace(group, velocity_w=velocity)


def driven_before(key, cars):
    """A random past: up to eight turns, of which half are remembered."""
    places, changes, rest = jax.random.split(key, 3)
    return Past(
        turns_w=jax.random.uniform(places, (*cars, TURNS, 3), minval=-9.0, maxval=9.0),
        changes=1.0 * jax.random.randint(changes, cars, 0, 2 * TURNS),
        path=jnp.zeros(cars),
        rest=1.0 * jax.random.randint(rest, cars, 0, 80),
    )


def states(env, rows):
    """Inputs and observations of all agents of random lots, in random motion."""

    def draw(key):
        start, speed, yaw_rate, steering, choice, gear, walk = jax.random.split(key, 7)
        state, _ = env.reset(start)
        motion, cars = state.motion, state.goal.shape
        motion = dataclasses.replace(
            motion,
            velocity_b=jax.random.uniform(speed, (*cars, 2), minval=-2.0, maxval=3.0),
            yaw_rate=jax.random.uniform(yaw_rate, cars, minval=-1.0),
            steering=jax.random.uniform(steering, cars, minval=-0.5, maxval=0.5),
        )
        direction = jax.random.randint(gear, cars, -1, 2).astype(jnp.float32)
        stats = dataclasses.replace(state.stats, direction=direction)
        groups = tuple(moving(walk, group) for group in state.movers.groups)
        movers = dataclasses.replace(state.movers, obstacles=(groups,))
        state = dataclasses.replace(
            state,
            motion=motion,
            stats=stats,
            movers=movers,
            step=jax.random.randint(key, cars, 0, 400),
        )
        if "past" in state.memory:
            state = state.replace(memory={"past": driven_before(key, cars)})
        if state.tracked_bays is not None:  # some have chosen a bay
            goal = jnp.where(
                jax.random.bernoulli(choice, 0.5, cars),
                state.tracked_bays[:, 0],
                state.goal,
            )
            state = dataclasses.replace(state, goal=goal)
        known = env.config.observation.known(env.config, state)
        return plain_values(rows, state, known), observe(env.config, state)

    keys = jax.random.split(jax.random.key(3), LOTS)
    found, seen = jax.device_get(jax.jit(jax.vmap(draw))(keys))
    there = seen.any(axis=-1)  # absent agents observe zeros
    return {name: value[there] for name, value in found.items()}, seen[there]


@pytest.mark.parametrize(
    "name",
    ["square", "dynamic", "valet", pytest.param("anywhere", marks=pytest.mark.slow)],
)
def test_it_acts_as_the_policy_does_in_the_environment(name):
    loaded, rows, known, seen = driven(name)
    model = make_car_model(loaded, rows)
    assert len(seen) >= LOTS
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


PAST = ContinuousObservation(rings=RingConfig((5.0,), history=2))
HEARS = ContinuousObservation(ultrasound=UltrasoundConfig(on=True))


@pytest.mark.parametrize(
    ("env", "reason"),
    [
        (EnvConfig(observation=PAST), "rings.history"),
        (environment("sees"), "pictures .camera_depth, camera_seen"),
        (EnvConfig(observation=HEARS), "ultrasound.noise 0.01"),
    ],
)
def test_what_a_car_outside_cannot_observe_is_refused(env, reason):
    with pytest.raises(ValueError, match=reason):
        require_outside(env)


RANDOM = np.random.default_rng(0)
X = RANDOM.normal(size=(4, 5)).astype(np.float32)
Y = RANDOM.normal(size=(4, 5)).astype(np.float32)
INDEX = np.array([3, -1, 0, 2], np.int32)
FLAGS = X > 0
SIGNS = np.array([[-2.0, 0.0, 0.5]], np.float32)


def ran(function, *arrays):
    """The outputs of the graph of a function, in order."""
    names = "abcdef"
    inputs = {
        name: jax.ShapeDtypeStruct(array.shape, array.dtype)
        for name, array in zip(names, arrays, strict=False)
    }
    model = make_graph(lambda *x: {"out": function(*x)}, inputs)
    session = onnxruntime.InferenceSession(model.SerializeToString())
    needed = {value.name for value in session.get_inputs()}
    feed = {n: a for n, a in zip(names, arrays, strict=False) if n in needed}
    return session.run(None, feed)[0], needed


def loop(x):
    return jax.lax.fori_loop(0, 4, lambda _, carry: jnp.sin(carry) + x, x)


# By what they show; each of arrays of the given kinds.
CASES = {
    "arithmetic": (lambda x, y: x * y - x / (y + 9.0) + (-x) ** 3 + x**2, X, Y),
    "functions": (lambda x: jnp.tanh(x) + jnp.cos(x) * jnp.tan(x) + jnp.exp(x), X),
    "roots": (lambda x: jnp.sqrt(jnp.abs(x)) + jax.lax.rsqrt(x * x + 1.0), X),
    "rounding": (lambda x: jnp.floor(x) + jnp.ceil(3 * x) + jnp.sign(x), X),
    "sigmoid": (lambda x: jax.nn.sigmoid(x) * jax.nn.silu(x), X),
    "remainder": (lambda x, y: jnp.mod(x, 0.7) + jnp.mod(y, -0.3), X, Y),
    "limits": (
        lambda x, y: jnp.clip(jnp.maximum(x, y), -0.5, jnp.minimum(x, 1.0)),
        X,
        Y,
    ),
    "comparisons": (lambda x, y: (x < y) | (x >= 1.0) & ~(y <= 0.0) ^ (x != y), X, Y),
    "finite": (lambda x: jnp.isfinite(x / jnp.floor(x)), X),
    "choice of numbers": (lambda f, x, y: jnp.where(f, x, y), FLAGS, X, Y),
    "choice of flags": (lambda f, x, y: jnp.where(f, x > y, x < 0.0), FLAGS, X, Y),
    "whole numbers": (lambda i: (i * 3 + 1) % 4 + jnp.where(i < 0, -i, i), INDEX),
    "casts": (
        lambda f, i: f.astype(jnp.float32) + i[:, None].astype(jnp.float32),
        FLAGS,
        INDEX,
    ),
    "sums and extremes": (lambda x: jnp.stack([x.sum(1), x.max(1), x.min(1)]), X),
    "of none": (lambda x: jnp.min(x[:, :0], axis=1, initial=jnp.inf), X),
    "all and any": (lambda f: f.all(axis=0) | f.any(axis=1)[0], FLAGS),
    "nearest": (lambda x: jnp.stack([jnp.argmin(x, 1), jnp.argmax(x, 1)]), X),
    "broadcast": (lambda x: x[:, None] - x[None] + jnp.ones((2, 1, 1, 1)), X),
    "slices": (lambda x: x[1:3, ::2] + x[-2:, :3], X),
    "joined and cut": (lambda x, y: jnp.concatenate([x, y, x])[5:7] * x[:2], X, Y),
    "joined across": (lambda x, y: jnp.concatenate([x, y])[3:5], X, Y),
    "split": (lambda x: sum(jnp.split(x, [2, 4], axis=0)[:1]) + x[:1], X),
    "padding": (lambda x: jnp.pad(x, ((1, 0), (0, 2)), constant_values=7.0), X),
    "axes": (lambda x: jnp.moveaxis(x[None], 0, -1).reshape(5, 4).T, X),
    "rows": (lambda x, i: x[i], X, INDEX),
    "of rows": (lambda x, i: x[i, 1:3], X, INDEX),
    "cells": (lambda x, i: x[i, -i - 1], X, INDEX),
    "columns": (lambda x, i: x[:, i], X, INDEX),
    "in every row": (lambda x, i: jnp.take_along_axis(x, i[:, None], axis=1), X, INDEX),
    "beyond": (lambda x, i: x[i + 2**30], X, np.abs(INDEX)),
    "filled": (lambda x, i: jnp.take(x, i + 2, axis=0, fill_value=5.0), X, INDEX),
    "one of many": (lambda i: jax.nn.one_hot(i, 5), INDEX),
    "matrices": (lambda x, y: x @ y.T + 1.0, X, Y),
    "batches": (lambda x, y: jnp.einsum("bi,bi->b", x, y), X, Y),
    "outer": (lambda x, y: jnp.einsum("bi,ci,i->cb", x, y, x[0]), X, Y),
    "loop": (loop, X),
    "poses": (lambda x, y: to_local(x[:, :3], y[:, :3]), X, Y),
    "directions": (lambda x, y: jnp.arctan2(x, y.T), SIGNS, SIGNS),
    "angles": (lambda x: wrap_angle(9.0 * x), X),
    "lengths": (lambda x: norm(x[..., :2]), X),
    "distances": (
        lambda x, y: boxes.box_distance(
            x[:, :3], x[:, 3:] ** 2, y[:, None, :3], y[:, None, 3:] ** 2
        ),
        X,
        Y,
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_the_graph_computes_what_the_program_does(name):
    function, *arrays = CASES[name]
    expected = np.asarray(function(*map(jnp.asarray, arrays)))
    found, _ = ran(function, *arrays)
    assert found.shape == expected.shape
    assert found.dtype == expected.dtype
    np.testing.assert_allclose(found, expected, rtol=2e-6, atol=2e-6)


def test_rays_along_walls_are_the_same_to_the_edge():
    """Infinite ways and 0 / 0, where a ray runs along an edge."""
    pose, size = jnp.array([[2.0, 0.0, 0.0]]), jnp.array([[2.0, 2.0]])
    along = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]], np.float32)[:, None]
    origin = np.array([[0.0, y] for y in (-1.5, -1.0, 0.0, 1.0)], np.float32)

    def ways(origin, along):
        return boxes.ray_box_distance(origin, along, pose, size)

    found, _ = ran(ways, origin, along)
    np.testing.assert_array_equal(found, ways(origin, along))
    assert np.isinf(found).any()


def test_only_what_is_read_is_an_input():
    found, needed = ran(
        lambda x, y, i: jnp.concatenate([x, y])[:2] + 0.0 * len(i), X, Y, INDEX
    )
    np.testing.assert_array_equal(found, X[:2])
    assert needed == {"a"}


def test_a_primitive_without_operator_is_named():
    with pytest.raises(NotImplementedError, match="cumsum"):
        ran(lambda x: jnp.cumsum(x), X)
