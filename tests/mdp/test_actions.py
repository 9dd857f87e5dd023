"""What an action consists of, and what becomes of an invalid one."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.sliding import SlidePhysics

from carpark_mj.config import EnvConfig, GoalConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.mdp.actions import action_spec, parse

NAN, INF = np.nan, np.inf
CHOOSING = EnvConfig(goals=GoalConfig(dynamic=True, num_tracked_bays=3))


@pytest.mark.parametrize(
    ("action", "sanitized", "invalid"),
    [
        ([0.3, -0.7], [0.3, -0.7], False),
        ([1.0, -1.0], [1.0, -1.0], False),
        ([NAN, 0.5], [0.0, 0.5], True),
        ([0.5, NAN], [0.5, 0.0], True),
        ([INF, -INF], [1.0, -1.0], True),
        ([1.0001, 0.0], [1.0, 0.0], True),
        ([0.0, -7.0], [0.0, -1.0], True),
    ],
)
def test_nan_becomes_zero_and_the_rest_is_clipped(action, sanitized, invalid):
    actions = jnp.array([action, [0.1, 0.2]], jnp.float32)
    controls, choice, flagged = jax.jit(parse, static_argnums=0)(EnvConfig(), actions)
    np.testing.assert_array_equal(controls[0], np.float32(sanitized))
    assert choice is None
    assert flagged.tolist() == [invalid, False]


@pytest.mark.parametrize(
    ("index", "sanitized", "invalid"),
    [
        (0, 0, False),
        (3, 3, False),
        (4, 3, True),
        (-1, 0, True),
        (INF, 3, True),
        (NAN, 1, True),  # of 0 to 3 the lower of both in the middle
        (1.4, 1, True),
        (1.6, 2, True),
    ],
)
def test_invalid_index_becomes_the_nearest_and_nan_the_middle(
    index, sanitized, invalid
):
    actions = jnp.array([[0.1, 0.2, index], [0.1, 0.2, 1]], jnp.float32)
    controls, choice, flagged = parse(CHOOSING, actions)
    np.testing.assert_array_equal(controls, actions[:, :2])
    assert choice.dtype == jnp.int32
    assert choice.tolist() == [sanitized, 1]
    assert flagged.tolist() == [invalid, False]


@pytest.mark.parametrize("config", [EnvConfig(), CHOOSING])
def test_the_middle_of_the_ranges_is_a_valid_action(config):
    spec = action_spec(config)
    assert spec.middle.shape == (spec.size,)
    assert spec.middle.dtype == spec.dtype
    assert not parse(config, spec.middle[None]).invalid.any()


def test_environment_sanitizes_actions_and_counts_them():
    env = ParkingEnv(EnvConfig(num_agents=3, num_parked_cars=0), SlidePhysics())
    step = jax.jit(env.step)
    state, _ = jax.jit(env.reset)(jax.random.key(0))
    wild = jnp.array([[NAN, 0.5], [0.2, 9.0], [0.2, 0.5]])
    tame = jnp.array([[0.0, 0.5], [0.2, 1.0], [0.2, 0.5]])
    got, timestep = step(state, wild)
    expected, plain = step(state, tame)
    np.testing.assert_array_equal(got.motion.pose_w, expected.motion.pose_w)
    np.testing.assert_array_equal(timestep.reward, plain.reward)
    np.testing.assert_array_equal(timestep.metrics["invalid_actions"], [1, 1, 0])
    assert not plain.metrics["invalid_actions"].any()
    _, timestep = step(got, wild)
    count = np.where(timestep.events.done, 0, timestep.metrics["invalid_actions"])
    assert (count <= [2, 2, 0]).all()
    assert count.any()
