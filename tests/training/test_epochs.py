"""What the epochs of an update learn with: schedules, the discount, and which steps."""

import collections

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from helpers.learning import begun, rollout

from carpark_mj.config import EnvConfig
from carpark_mj.mdp.actions import ActionSpec
from carpark_mj.observations.compose import ObservationSets
from carpark_mj.observations.fields import Field
from carpark_mj.policy.networks import NetworkConfig, make_networks
from carpark_mj.training.ppo import variants
from carpark_mj.training.ppo.collect import AXIS
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
