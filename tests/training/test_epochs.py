"""What the epochs of an update learn with: schedules, advantages, and which steps."""

import collections

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from brax.training.agents.ppo.losses import compute_gae
from helpers.learning import begun, rollout

from carpark_mj.config import EnvConfig
from carpark_mj.mdp.actions import ActionSpec
from carpark_mj.observations.compose import ObservationSets
from carpark_mj.observations.fields import Field
from carpark_mj.policy.networks import NetworkConfig, make_networks
from carpark_mj.training.ppo import variants
from carpark_mj.training.ppo.collect import AXIS, compute_advantages
from carpark_mj.training.ppo.config import CurriculumConfig, PPOConfig
from carpark_mj.training.ppo.learn import learn, schedule

LENGTH, AGENTS, SIZE, PARTS = 6, 12, 3, 4
CONFIG = PPOConfig(
    num_steps=100 * LENGTH * AGENTS,  # 100 updates
    num_lots=AGENTS,
    unroll_length=LENGTH,
    num_minibatches=PARTS,
    num_epochs=3,
    entropy_cost=0.4,
    entropy_cost_end=0.1,
    clip=0.3,
    clip_end=0.1,
    discount=0.9,
    gae_lambda=1.0,
    curriculum=CurriculumConfig(discount_end=0.99),
    networks=NetworkConfig((4,), (4,), encoder="flat"),
    env=EnvConfig(num_agents=1),
)
NETWORKS = make_networks(
    CONFIG.networks, [Field("x", SIZE, -1.0, 1.0, "")], ActionSpec(2)
)


def test_schedules_are_linear_and_stay_at_their_ends():
    progress = jnp.array([-1.0, 0.0, 0.25, 1.0, 3.0])
    np.testing.assert_allclose(
        schedule(1e-3, 2e-4, progress), [1e-3, 1e-3, 8e-4, 2e-4, 2e-4], rtol=1e-6
    )


def steps():
    """Agents that observe their own number; the last step alone pays."""
    number = jnp.arange(AGENTS, dtype=jnp.float32)[:, None]
    return rollout(
        (LENGTH, AGENTS),
        observation=jnp.broadcast_to(number, (LENGTH, AGENTS, SIZE)),
        reward=jnp.zeros((LENGTH, AGENTS)).at[-1].set(1.0),
        final_observation=jnp.broadcast_to(number, (AGENTS, SIZE)),
    )


def watched(monkeypatch, watch, update=0):
    """The mean of what `watch(batch, weights)` reports of the minibatches of an update.

    The critic says 0 of everything, and learns nothing.
    """

    def loss(params, networks, normalizer, batch, weights, key):
        total = sum(jnp.sum(x) for x in jax.tree.leaves(params))
        return 0.0 * total, watch(batch, weights)

    monkeypatch.setattr(variants, "ppo_loss", loss)
    optimizer, inputs = optax.scale_by_adam(), ObservationSets(SIZE)
    state = begun(NETWORKS, inputs, jax.random.key(0), update)
    state.value = jax.tree.map(jnp.zeros_like, state.value)

    def learned(key):
        return learn(CONFIG, NETWORKS, inputs, optimizer, state, steps(), key)[1]

    keys = jax.random.split(jax.random.key(2), 1)
    found = jax.jit(jax.vmap(learned, axis_name=AXIS))(keys)
    jax.effects_barrier()
    return {name: float(x[0]) for name, x in found.items()}


@pytest.mark.parametrize(
    ("update", "entropy_cost", "clip", "horizon"),
    [(0, 0.4, 0.3, 10.0), (55, 0.235, 0.19, 55.0), (100, 0.1, 0.1, 100.0)],
)
def test_an_update_learns_with_the_settings_of_its_progress(
    monkeypatch, update, entropy_cost, clip, horizon
):
    def watch(batch, weights):
        first = batch.target.reshape(LENGTH, -1)[0]
        return {"cost": weights.entropy_cost, "clip": weights.clip, "x": first.mean()}

    found = watched(monkeypatch, watch, update)
    assert found["cost"] == pytest.approx(entropy_cost, rel=1e-5)
    assert found["clip"] == pytest.approx(clip, rel=1e-5)
    # Paid after five more steps, each of which discounts it.
    discount = 1.0 - 1.0 / horizon
    assert found["x"] == pytest.approx(discount ** (LENGTH - 1), rel=1e-5)


def test_every_epoch_learns_from_all_agents_in_other_minibatches(monkeypatch):
    seen = []

    def note(numbers):
        seen.append(tuple(np.unique(numbers).astype(int).tolist()))

    def watch(batch, weights):
        jax.debug.callback(note, batch.observation[:, 0])
        return {}

    watched(monkeypatch, watch)
    assert len(seen) == CONFIG.num_epochs * PARTS
    assert {len(agents) for agents in seen} == {AGENTS // PARTS}
    times = collections.Counter(agent for agents in seen for agent in agents)
    assert times == dict.fromkeys(range(AGENTS), CONFIG.num_epochs)
    # In any fixed order the same four would come in every epoch.
    assert len(set(seen)) > 2 * PARTS


def made(*ends):
    """A rollout with a reward, and whether it terminated or was cut off."""
    names, arrays = ("reward", "terminated", "truncated"), map(jnp.float32, ends)
    return rollout(ends[0].shape, **dict(zip(names, arrays, strict=True)))


def three_steps(reward, terminated, truncated):
    """Advantages and targets of one agent: values 1, 2, 3, then 4."""
    values = jnp.array([[1.0], [2.0], [3.0]])
    steps = made(*(np.reshape(x, (3, 1)) for x in (reward, terminated, truncated)))
    found = compute_advantages(steps, values, jnp.array([4.0]), 0.5, 0.9)
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
    steps = made(reward, ends - cut, cut)
    ours = compute_advantages(steps, values, final, 0.99, gae_lambda)
    targets, advantages = compute_gae(
        cut, ends - cut, reward, values, final, gae_lambda, 0.99
    )
    np.testing.assert_array_equal(ours[0], advantages)
    np.testing.assert_array_equal(ours[1], targets)
