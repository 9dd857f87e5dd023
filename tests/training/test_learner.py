"""The learner: the update of Brax's PPO, the NaN guard, the GPU kernel."""

import dataclasses
import re
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.envs.base import State
from brax.training import acting
from brax.training import pmap as brax_pmap
from brax.training.agents.ppo import losses as ppo_losses
from brax.training.agents.ppo import train as brax_ppo
from brax.training.types import Transition
from helpers.sliding import POSES
from jax.flatten_util import ravel_pytree
from jax.sharding import PartitionSpec

from carpark_mj.config import EnvConfig
from carpark_mj.mdp.actions import ActionSpec
from carpark_mj.observations.compose import OWN
from carpark_mj.observations.fields import Field
from carpark_mj.policy.networks import MIN_DEVIATION, NetworkConfig, make_networks
from carpark_mj.training.ppo import learner as learners
from carpark_mj.training.ppo.collect import AXIS, Rollout, compute_advantages
from carpark_mj.training.ppo.config import PPOConfig
from carpark_mj.training.ppo.learn import learn, network_params
from carpark_mj.training.ppo.learner import Learner
from carpark_mj.training.ppo.parts import PRESETS
from carpark_mj.training.ppo.variants import Minibatch, Weights, ppo_loss

TINY = dataclasses.replace(
    PRESETS["cpu"],
    num_lots=2,
    unroll_length=8,
    num_minibatches=1,
    num_epochs=3,
    num_steps=320,
    entropy_cost=0.0,  # Brax's entropy is sampled: with other keys it differs
    entropy_cost_end=0.0,
    learning_rate_end=PRESETS["cpu"].learning_rate,
    networks=NetworkConfig((16, 16), (16,), encoder="flat"),
    env=EnvConfig(physics="bicycle", observation=POSES, num_agents=2),
)
AGENTS = TINY.num_lots * TINY.env.num_agents


@pytest.fixture(scope="module")
def learner():
    return Learner(TINY)


@pytest.fixture(scope="module")
def update(learner):
    return learner.compile()


@pytest.fixture(scope="module")
def state(learner):
    return learner.init()


def canned_data(learner, state, seed: int) -> Transition:
    """A made-up unroll (time, agents, ...) with terminations.

    Nothing is truncated: Brax counts such steps where we do not.
    """
    rng = np.random.default_rng(seed)
    shape = (TINY.unroll_length, AGENTS)

    def normal(*size):
        return jnp.asarray(rng.normal(size=(*shape, *size)), jnp.float32)

    distribution = learner.networks.parametric_action_distribution

    @jax.jit
    def act(observation, noise):
        apply = learner.networks.policy_network.apply
        logits = apply(state.normalizer, state.policy, observation)
        raw = distribution.sample_no_postprocessing(logits, jax.random.key(seed))
        return logits, raw, distribution.log_prob(logits, raw) + 0.1 * noise

    # Close to what the first normalizer expects, so that ratios stay finite after it.
    observation = 0.2 + 1.1 * normal(learner.env.observation_size)
    logits, raw, log_prob = act(observation, normal())
    done = jnp.asarray(rng.random(shape) < 0.2, jnp.float32)
    return Transition(
        observation=observation,
        action=jnp.tanh(raw),
        reward=normal(),
        discount=1.0 - done,
        next_observation=normal(learner.env.observation_size),
        extras={
            "policy_extras": {
                "log_prob": log_prob,
                "raw_action": raw,
                "distribution_params": logits,
            },
            "state_extras": {
                "truncation": jnp.zeros(shape),
                "episode_done": done,
                "episode_metrics": {},
            },
        },
    )


def as_rollout(data: Transition) -> Rollout:
    """The same as our update takes it."""
    extras: Any = data.extras
    truncated = extras["state_extras"]["truncation"]
    return Rollout(
        observation=data.observation,
        raw_action=extras["policy_extras"]["raw_action"],
        log_prob=extras["policy_extras"]["log_prob"],
        reward=data.reward,
        terminated=1.0 - data.discount - truncated,
        truncated=truncated,
        final_observation=data.next_observation[-1],
    )


def on_one_device(function):
    """The function compiled for one device, over which learning averages."""
    alone = jax.make_mesh(
        (1,),
        (AXIS,),
        axis_types=(jax.sharding.AxisType.Auto,),
        devices=jax.devices()[:1],
    )
    whole = PartitionSpec()
    return jax.jit(
        jax.shard_map(
            function, mesh=alone, in_specs=whole, out_specs=whole, check_vma=False
        )
    )


class StandInEnv:
    """What Brax's trainer asks of an environment before it acts."""

    def __init__(self, observation_size: int) -> None:
        self.action_size = 2
        self.observation_size = observation_size
        self._obs = jnp.zeros((AGENTS, observation_size))

    def reset(self, keys):
        zero = jnp.zeros(keys.shape[0])
        info = {"truncation": zero, "episode_done": zero, "episode_metrics": {}}
        return State(None, self._obs, zero, zero, {}, info)


def brax_update(learner, state, data, monkeypatch):
    """Parameters after one update of `brax.training.agents.ppo.train` on the data."""

    def replicate(tree, devices):
        return jax.tree.map(lambda x: jnp.stack([jnp.asarray(x)] * len(devices)), tree)

    monkeypatch.setattr(jax, "device_put_replicated", replicate, raising=False)
    # Its check of replicas means nothing on one device, and fails under this JAX.
    monkeypatch.setattr(brax_pmap, "assert_is_replicated", lambda tree: None)
    monkeypatch.setattr(acting, "generate_unroll", lambda env, s, *_, **__: (s, data))

    def factory(observation_size, action_size, preprocess_observations_fn):
        del preprocess_observations_fn
        fields = [Field("all", observation_size[-1], -1.0, 1.0, "")]
        networks: Any = make_networks(TINY.networks, fields, ActionSpec(action_size))

        def take(network):  # Brax's statistics are of the vector as a whole
            return dataclasses.replace(
                network, apply=lambda n, *args: network.apply({OWN: n}, *args)
            )

        return networks.replace(
            policy_network=take(networks.policy_network),
            value_network=take(networks.value_network),
        )

    _, params, _ = brax_ppo.train(
        StandInEnv(learner.env.observation_size),  # pyright: ignore
        num_timesteps=1,
        wrap_env=False,
        num_envs=AGENTS,
        episode_length=100,
        learning_rate=TINY.learning_rate,
        entropy_cost=0.0,
        discounting=TINY.discount,
        unroll_length=TINY.unroll_length,
        batch_size=AGENTS,
        num_minibatches=1,
        num_updates_per_batch=TINY.num_epochs,
        normalize_observations=True,
        clipping_epsilon=TINY.clip,
        gae_lambda=TINY.gae_lambda,
        max_grad_norm=TINY.max_grad_norm,
        network_factory=factory,
        max_devices_per_host=1,
        run_evals=False,
        restore_params=(state.normalizer[OWN], state.policy, state.value),
    )
    return params


@pytest.fixture(scope="module")
def learned(learner):
    """What `learn` makes of a state and a rollout, compiled."""

    @on_one_device
    def update(state, rollout):
        key = jax.random.key(5)
        networks, inputs = learner.networks, learner.inputs
        return learn(TINY, networks, inputs, learner.optimizer, state, rollout, key)[0]

    return update


@pytest.mark.filterwarnings("ignore")  # Brax's trainer uses deprecated JAX names
def test_an_update_equals_brax_s_own_on_the_same_data(
    learner, learned, state, monkeypatch
):
    data = canned_data(learner, state, seed=0)
    ours = learned(jax.device_get(state), as_rollout(data))
    theirs = brax_update(learner, state, data, monkeypatch)
    for a, b in zip(*map(jax.tree.leaves, (ours[0][OWN], theirs[0])), strict=True):
        # Sums of numbers of about 1, in another order.
        np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-6)
    moved = 0.0
    for mine, brax, old in zip(
        ours[1:3], theirs[1:], (state.policy, state.value), strict=True
    ):
        for a, b, c in zip(*map(jax.tree.leaves, (mine, brax, old)), strict=True):
            # Three Adam steps of 1.5e-3; measured agreement 2e-7.
            np.testing.assert_allclose(a, b, atol=2e-6, equal_nan=False)
            moved = max(moved, float(np.abs(np.asarray(a) - np.asarray(c)).max()))
    assert moved > 1e-3


def test_the_loss_of_a_minibatch_equals_brax_s(learner, state):
    data = canned_data(learner, state, seed=1)
    rollout, params = as_rollout(data), network_params(state.policy, state.value)
    weights = Weights(entropy_cost=jnp.float32(0.3), clip=jnp.float32(0.05))

    def ours(params, key):
        def value(observation):
            return learner.networks.value_network.apply(
                state.normalizer, params.value, observation
            )

        advantage, target = compute_advantages(
            rollout,
            value(rollout.observation),
            value(rollout.final_observation),
            TINY.discount,
            TINY.gae_lambda,
        )
        batch = Minibatch(
            observation=rollout.observation,
            raw_action=rollout.raw_action,
            log_prob=rollout.log_prob,
            advantage=advantage,
            target=target,
            weight=jnp.ones_like(target),
        )
        return ppo_loss(params, learner.networks, state.normalizer, batch, weights, key)

    def brax(params, key):
        return ppo_losses.compute_ppo_loss(
            params,
            state.normalizer,
            jax.tree.map(lambda x: jnp.swapaxes(x, 0, 1), data),
            key,
            learner.networks,
            entropy_cost=0.3,
            discounting=TINY.discount,
            gae_lambda=TINY.gae_lambda,
            clipping_epsilon=0.05,
        )

    key = jax.random.key(6)
    mine = on_one_device(jax.grad(ours, has_aux=True))(params, key)
    theirs = jax.jit(jax.grad(brax, has_aux=True))(params, key)
    assert set(mine[1]) == set(theirs[1])
    for name in set(mine[1]) - {"kl_mean"}:
        np.testing.assert_allclose(mine[1][name], theirs[1][name], rtol=1e-5, atol=1e-6)
    for a, b in zip(*map(jax.tree.leaves, (mine[0], theirs[0])), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-6)
    assert min(np.abs(x).max() for x in jax.tree.leaves(mine[0])) > 1e-4


def test_what_was_done_in_a_truncated_step_changes_nothing(learner, learned, state):
    rollout = as_rollout(canned_data(learner, state, seed=3))
    cut = jnp.asarray(np.random.default_rng(4).random(rollout.reward.shape) < 0.2)
    rollout = dataclasses.replace(
        rollout, truncated=cut.astype(jnp.float32), terminated=jnp.zeros(cut.shape)
    )
    other = dataclasses.replace(
        rollout,
        raw_action=jnp.where(cut[..., None], 0.5, rollout.raw_action),
        log_prob=jnp.where(cut, -3.0, rollout.log_prob),
        reward=jnp.where(cut, 7.0, rollout.reward),
    )
    start = jax.device_get(state)
    ours, same, more = (
        learned(start, x)
        for x in (
            rollout,
            other,
            dataclasses.replace(other, truncated=jnp.zeros(cut.shape)),
        )
    )
    for a, b in zip(*map(jax.tree.leaves, (ours, same)), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-7)
    moved = jax.tree.map(lambda a, b: np.abs(a - b).max(), ours[1], more[1])
    assert max(jax.tree.leaves(moved)) > 1e-3  # which it does if they are not


def test_rates_follow_the_time_used_without_another_compilation(learner, state):
    config = dataclasses.replace(TINY, minutes=1.0, learning_rate_end=0.0)
    rollout = as_rollout(canned_data(learner, state, seed=2))

    @on_one_device
    def moved(state, rollout):
        key = jax.random.key(5)
        new = learn(
            config,
            learner.networks,
            learner.inputs,
            learner.optimizer,
            state,
            rollout,
            key,
        )
        before, after = (
            ravel_pytree(x)[0] for x in ((state.policy, state.value), new[0][1:3])
        )
        return jnp.abs(after - before).max()

    seconds = (0.0, 30.0, 59.0, 60.0, 99.0)
    steps = [
        float(moved(jax.device_get(learner.set_seconds(state, s)), rollout))
        for s in seconds
    ]
    assert steps[0] > steps[1] > steps[2] > 0.0
    assert steps[3] == steps[4] == 0.0
    assert moved._cache_size() == 1


def learned_leaves(state) -> list[np.ndarray]:
    parts = (state.normalizer, state.policy, state.value, state.optimizer)
    return [np.array(leaf) for leaf in jax.tree.leaves(parts)]


def test_no_empty_array_is_an_input_of_the_compiled_update(update, state):
    """On several devices XLA of JAX 0.11.2 would crash."""
    assert state.env.pipeline_state.layout.disc_mask.size == 0
    program = update.lower(state).as_text()
    signature = program.split("@main(")[1].split(" -> ")[0]
    inputs = re.findall(r"%arg\d+: tensor<(\S*?)>", signature)
    walls = "x".join(map(str, state.env.pipeline_state.layout.wall_mask.shape))
    assert f"{walls}xi1" in inputs
    assert not [x for x in inputs if "0" in x.split("x")]


def test_a_non_finite_update_is_dropped_whole(learner, update):
    state = learner.init()
    good, _ = update(learner.place(jax.device_get(state)))
    before = jax.device_get(good)
    assert int(good.skipped) == 0
    kept = learned_leaves(before)
    # All bays are equal here: what never varied is not blown up either.
    assert before.normalizer[OWN].std.min() == np.float32(MIN_DEVIATION)
    poisoned = before.replace(
        env=before.env.replace(obs=np.full_like(before.env.obs, np.nan))
    )
    after, metrics = update(learner.place(poisoned))
    after = jax.device_get(after)
    assert int(after.skipped) == 1
    assert int(metrics["skipped"]) == 1
    for old, new in zip(kept, learned_leaves(after), strict=True):
        np.testing.assert_array_equal(new, old)
    # The cars' actions were NaN: they are contained, and the next update is fine.
    assert np.isfinite(after.env.obs).all()
    final, metrics = update(learner.place(after))
    assert int(final.skipped) == 1
    assert np.isfinite(metrics["loss/total_loss"])
    assert update._cache_size() == 1  # no weak type recompiled it
    # What a run leaves is the mean of the policies: of the first alone, then with the
    # third update's at a weight of 1/3; the dropped one changed nothing.
    final = jax.device_get(final)
    for first, same, last, mean in zip(
        *map(
            jax.tree.leaves,
            (before.policy, before.average, final.policy, final.average),
        ),
        strict=True,
    ):
        np.testing.assert_allclose(same, first, atol=1e-7)
        np.testing.assert_allclose(mean, first + (last - first) / 3, atol=1e-7)
        assert np.abs(mean - last).max() > 1e-5


ENCODED = PPOConfig(
    num_lots=2,
    unroll_length=4,
    num_minibatches=1,
    networks=NetworkConfig((16,), (16,), own_size=8, entity_size=16),
    env=EnvConfig(physics="bicycle", observation=POSES, num_agents=2),
)


@pytest.mark.parametrize("half", [False, True])
def test_on_a_gpu_sets_are_encoded_in_the_kernel(monkeypatch, half):
    monkeypatch.setattr(learners, "has_triton", lambda: True)
    learner = Learner(dataclasses.replace(ENCODED, half_precision=half))
    traced = learner.compile().trace(learner.shapes())
    program = str(traced.jaxpr)
    assert "name=entities_gradient" in program
    assert ("bf16" in program) == half
