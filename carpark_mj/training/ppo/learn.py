"""What an update learns from a rollout, and its schedules over a training.

Evaluations never see a curriculum: they run in `PPOConfig.env` as it is.
"""

import dataclasses
import math
from typing import Any

import jax
import jax.numpy as jnp
import optax
from jax.flatten_util import ravel_pytree

from carpark_mj.config import EnvConfig
from carpark_mj.layouts import layout_config
from carpark_mj.layouts.stored import StoredConfig
from carpark_mj.observations.compose import ObservationSets
from carpark_mj.policy.brax import PPONetworkParams, PPONetworks
from carpark_mj.policy.networks import update_normalizer
from carpark_mj.training.ppo import collect
from carpark_mj.training.ppo.config import CurriculumConfig, PPOConfig
from carpark_mj.training.ppo.parts import VARIANTS
from carpark_mj.training.ppo.variants import Minibatch, Variant, Weights

# Progress at which a change begins, and at which it ends.
DISCOUNT_CHANGES = (0.3, 0.8)
SHARE_RISES = (0.2, 0.6)  # [est]; shared from the start, agents learned later


def schedule(start: float, end: float, progress: jax.Array) -> jax.Array:
    """Linear from `start` to `end` as `progress` goes from 0 to 1."""
    return start + (end - start) * jnp.clip(progress, 0.0, 1.0)


def crash_scale(config: CurriculumConfig, progress: jax.Array) -> jax.Array:
    """Factor () on the crash penalty."""
    return schedule(1.0, config.crash_scale, _within(progress, 0, config.crash_until))


def discount(config: PPOConfig, progress: jax.Array) -> jax.Array:
    """Discount factor () per control step."""
    changes = config.curriculum
    if not changes.discount_end:
        return jnp.float32(config.discount)
    start, end = 1 / (1 - config.discount), 1 / (1 - changes.discount_end)
    part = _within(progress, *DISCOUNT_CHANGES)
    return 1.0 - 1.0 / schedule(start, end, part)


def neighbour_share(config: CurriculumConfig, progress: jax.Array) -> jax.Array | None:
    """Weight () of the neighbours' mean advantage; None if there never is any."""
    if not config.neighbour_share:
        return None
    return schedule(0.0, config.neighbour_share, _within(progress, *SHARE_RISES))


def teacher_cost(config: CurriculumConfig, progress: jax.Array) -> jax.Array | None:
    """Weight () of the distance to the teacher's actions; None without a teacher."""
    if not config.teacher:
        return None
    part = _within(progress, 0, config.teacher_until)
    return schedule(config.teacher_cost, 0.0, part)


def _within(progress: jax.Array, start: float, end: float) -> jax.Array:
    """Progress () from 0 at `start` to 1 at `end`; a step if they are equal."""
    part = (progress - start) / max(end - start, 1e-6)
    return jnp.where(progress < end, jnp.clip(part, 0.0, 1.0), 1.0)


def training_env(config: PPOConfig) -> EnvConfig:
    """The environment with the starts of the curriculum, and stored lots."""
    names = ("conflict_ratio", "reverse_ratio", "misaligned_ratio")
    asked = {name: getattr(config.curriculum, name) for name in names}
    changes = {name: ratio for name, ratio in asked.items() if ratio}
    spawn = dataclasses.replace(config.env.spawn, **changes)
    layout = config.env.layout
    if config.stored_lots and layout_config(layout).is_random:
        layout = StoredConfig(layout_config(layout), config.stored_lots)
    return dataclasses.replace(config.env, spawn=spawn, layout=layout)


def network_params(policy: Any, value: Any) -> Any:
    """Actor and critic together."""
    params: Any = PPONetworkParams  # its fields are hidden from Pyright
    return params(policy=policy, value=value)


def learn(
    config: PPOConfig,
    networks: PPONetworks,
    inputs: ObservationSets,
    optimizer: optax.GradientTransformation,
    state: collect.TrainingState,
    rollout: collect.Rollout,
    key: jax.Array,
) -> tuple[tuple[Any, Any, Any, Any], dict[str, jax.Array]]:
    """Learns from the rollout of this device's agents, in epochs of minibatches.

    Values and advantages are those of the parameters at the start of an epoch. A
    minibatch holds all steps of its agents, and its parts on all devices are one. All
    this equals Brax's loss; `PPOConfig.variant` may change it.

    Returns:
        The new normalizer, policy, value and optimizer, and the mean losses.
    """
    progress = config.progress(state.update, state.seconds)
    learning_rate = schedule(config.learning_rate, config.learning_rate_end, progress)
    weights = Weights(
        entropy_cost=schedule(config.entropy_cost, config.entropy_cost_end, progress),
        clip=schedule(config.clip, config.clip_end, progress),
        teacher_cost=teacher_cost(config.curriculum, progress),
    )
    details: Variant = VARIANTS[config.variant]
    normalizer = state.normalizer
    if details.normalizes:
        normalizer = update_normalizer(
            inputs, normalizer, rollout.observation, rollout.weight, collect.AXIS
        )
    share = neighbour_share(config.curriculum, progress)
    near: Any = rollout.near  # with a share it is given
    rollout = dataclasses.replace(rollout, near=None)
    num_agents = rollout.reward.shape[1]
    kept = jnp.arange(num_agents)
    if rollout.weight is not None:
        key, drop_key = jax.random.split(key)
        count = num_learned(config, num_agents)
        rollout, kept = collect.drop_absent(rollout, count, drop_key)
        if share is not None:  # the advantages of those dropped are not computed
            is_kept = jnp.zeros(num_agents, bool).at[kept].set(True)
            of_lots = is_kept.reshape(-1, near.shape[-1])
            near &= jnp.repeat(of_lots, near.shape[-1], axis=0)
    weight = 1.0 - rollout.truncated
    if rollout.weight is not None:
        weight *= rollout.weight
    # One vector: one all-reduce and one Adam step instead of one for every layer.
    start, unravel = ravel_pytree(network_params(state.policy, state.value))

    def prepare(params: Any) -> Minibatch:
        """All steps, with the advantages that the critic in `params` gives them."""

        def value(observation: jax.Array) -> jax.Array:
            apply: Any = networks.value_network.apply
            return apply(normalizer, params.value, observation)

        if inputs.pictures:  # a step at a time: their features take much memory
            values = jax.lax.map(value, rollout.observation)
        else:
            values = value(_flat(rollout.observation)).reshape(rollout.reward.shape)
        advantage, target = collect.compute_advantages(
            rollout,
            values,
            value(rollout.final_observation),
            discount(config, progress),
            config.gae_lambda,
        )
        if share is not None:
            everyone = jnp.zeros(near.shape[:2]).at[:, kept].set(advantage)
            advantage += share * collect.neighbours_mean(near, everyone)[:, kept]
        return Minibatch(
            observation=rollout.observation,
            raw_action=rollout.raw_action,
            log_prob=rollout.log_prob,
            advantage=advantage,
            target=target,
            weight=weight,
            advice=rollout.advice,
        )

    steps_for = details.prepared(prepare, unravel(start), networks, normalizer)
    rate: Any = learning_rate
    if config.critic_steps:
        acts = (state.update >= config.critic_updates).astype(jnp.float32)
        moves = network_params(
            jax.tree.map(lambda x: jnp.full_like(x, acts), state.policy),
            jax.tree.map(jnp.ones_like, state.value),
        )
        rate = learning_rate * ravel_pytree(moves)[0]

    def epoch(carry: Any, key: jax.Array) -> tuple[Any, Any]:
        steps = steps_for(unravel(carry[0]))

        def minibatch(carry: Any, part: Any) -> tuple[Any, Any]:
            params, moments = carry
            chosen, loss_key = part
            batch = jax.tree.map(lambda x: _flat(x[:, chosen]), steps)
            grad = jax.grad(details.loss, has_aux=True)
            grads, losses = grad(
                unravel(params), networks, normalizer, batch, weights, loss_key
            )
            grads = jax.lax.pmean(ravel_pytree(grads)[0], collect.AXIS)
            updates: Any
            updates, moments = optimizer.update(grads, moments)
            return (params - rate * updates, moments), losses

        shuffle_key, loss_key = jax.random.split(key)
        order = jax.random.permutation(shuffle_key, steps.weight.shape[1])
        parts = (
            order.reshape(config.num_minibatches, -1),
            jax.random.split(loss_key, config.num_minibatches),
        )
        return jax.lax.scan(minibatch, carry, parts)

    (params, moments), losses = jax.lax.scan(
        epoch, (start, state.optimizer), jax.random.split(key, config.num_epochs)
    )
    params = unravel(params)
    learned = (normalizer, params.policy, params.value, moments)
    return learned, jax.lax.pmean(jax.tree.map(jnp.mean, losses), collect.AXIS)


def num_learned(config: PPOConfig, num_agents: int) -> int:
    """Of how many of a device's `num_agents` places an update learns.

    As many as are present on average, in whole minibatches.
    """
    size = math.ceil(config.present_share * num_agents / config.num_minibatches)
    return min(size * config.num_minibatches, num_agents)


def _flat(x: jax.Array) -> jax.Array:
    """Time and agents as one dimension, so that layers multiply plain matrices."""
    return x.reshape(-1, *x.shape[2:])
