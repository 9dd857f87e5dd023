"""Advantages by hand, and Brax's."""

import jax.numpy as jnp
import numpy as np
import pytest
from brax.training.agents.ppo.losses import compute_gae

from carpark_mj.training.ppo.collect import Rollout, compute_advantages


def rollout(reward, terminated, truncated) -> Rollout:
    none = jnp.zeros(())
    given = (jnp.asarray(x, jnp.float32) for x in (reward, terminated, truncated))
    return Rollout(none, none, none, *given, none)


def three_steps(reward, terminated, truncated):
    """Advantages and targets of one agent: values 1, 2, 3, then 4."""
    column = [np.reshape(x, (3, 1)) for x in (reward, terminated, truncated)]
    values = jnp.array([[1.0], [2.0], [3.0]])
    found = compute_advantages(rollout(*column), values, jnp.array([4.0]), 0.5, 0.9)
    return [np.asarray(x)[:, 0] for x in found]


NEVER, SECOND = (0, 0, 0), (0, 1, 0)


def test_a_terminated_step_is_worth_its_reward():
    advantage, target = three_steps((1, 1, 1), SECOND, NEVER)
    # Backwards: 1 + 0.5 * 4 - 3; 1 - 2; 1 + 0.5 * (2 - 1) - 1.
    np.testing.assert_allclose(advantage, [0.5, -1.0, 0.0])
    # With lambda 0.9: 1 + 0.5 * 2 - 1 + 0.45 * -1 above the value of 1.
    np.testing.assert_allclose(target, [1.55, 1.0, 3.0], rtol=1e-6)


def test_a_truncated_step_is_masked_and_bootstrapped():
    advantage, target = three_steps((1, 2, 1), NEVER, SECOND)
    # The first: 1 + 0.5 * 2 - 1, as if the second step had met its value of 2.
    np.testing.assert_allclose(advantage, [1.0, 0.0, 0.0])
    np.testing.assert_allclose(target, [2.0, 2.0, 3.0])


@pytest.mark.parametrize("gae_lambda", [0.0, 0.92, 1.0])
def test_advantages_are_brax_s(gae_lambda):
    rng = np.random.default_rng(0)
    reward, values = jnp.asarray(rng.normal(size=(2, 20, 30)), jnp.float32)
    final = jnp.asarray(rng.normal(size=30), jnp.float32)
    ends = jnp.asarray(rng.random((20, 30)) < 0.2, jnp.float32)
    cut = ends * (rng.random((20, 30)) < 0.5)
    ours = compute_advantages(
        rollout(reward, ends - cut, cut), values, final, 0.99, gae_lambda
    )
    targets, advantages = compute_gae(
        cut, ends - cut, reward, values, final, gae_lambda, 0.99
    )
    np.testing.assert_array_equal(ours[0], advantages)
    np.testing.assert_array_equal(ours[1], targets)
