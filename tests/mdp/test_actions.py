import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import SlidePhysics

from carpark_mj.config import EnvConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.mdp.actions import check_actions, neutralise

NAN, INF = np.nan, np.inf


@pytest.mark.parametrize(
    ("action", "harmless", "invalid"),
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
def test_nan_becomes_zero_and_the_rest_is_clipped(action, harmless, invalid):
    got, flagged = jax.jit(neutralise)(jnp.array([action, [0.1, 0.2]], jnp.float32))
    np.testing.assert_array_equal(got[0], np.float32(harmless))
    assert flagged.tolist() == [invalid, False]


def test_the_environment_drives_on_with_the_neutral_action_and_counts():
    env = ParkingEnv(EnvConfig(num_agents=3, num_parked_cars=0), SlidePhysics())
    step = jax.jit(env.step)
    state, _ = jax.jit(env.reset)(jax.random.key(0))
    wild = jnp.array([[NAN, 0.5], [0.2, 9.0], [0.2, 0.5]])
    tame = jnp.array([[0.0, 0.5], [0.2, 1.0], [0.2, 0.5]])
    got, timestep = step(state, wild)
    expected, plain = step(state, tame)
    np.testing.assert_array_equal(got.vehicle.pose_w, expected.vehicle.pose_w)
    np.testing.assert_array_equal(timestep.reward, plain.reward)
    np.testing.assert_array_equal(timestep.metrics["invalid_actions"], [1, 1, 0])
    assert not plain.metrics["invalid_actions"].any()
    _, timestep = step(got, wild)
    count = np.where(timestep.events.done, 0, timestep.metrics["invalid_actions"])
    assert (count <= [2, 2, 0]).all()
    assert count.any()


def test_good_actions_from_outside_pass_as_float32():
    action = check_actions([[0.5, -1.0], [1, 0]], (2, 2))
    assert action.dtype == np.float32
    np.testing.assert_array_equal(action, [[0.5, -1.0], [1.0, 0.0]])


@pytest.mark.parametrize(
    ("action", "message"),
    [
        ([[0.0, 0.0]], r"shape \(2, 2\), not \(1, 2\)"),
        ([[0.0, 0.0], [NAN, 0.0]], r"action\[1, 0\] must lie in .* not nan"),
        ([[0.0, 1.5], [0.0, 0.0]], r"action\[0, 1\] must lie in .* not 1.5"),
        ([[0.0, 0.0], [0.0, -INF]], r"action\[1, 1\] must lie in .* not -inf"),
    ],
)
def test_bad_actions_from_outside_are_refused_in_one_sentence(action, message):
    with pytest.raises(ValueError, match=message) as refusal:
        check_actions(action, (2, 2))
    assert "\n" not in str(refusal.value)
