"""The details of PPO in ML-Agents 0.27, which Tanner 2022 used.

They are `PPOConfig.variant = "ml-agents"`: generalised advantage estimation as it was
published (Brax applies lambda a step late), computed and normalised once, over the
whole update; minibatches of steps from anywhere in it; the ratio of every branch of an
action clipped by itself; the value's change clipped as well; observations as they are;
its own initial weights.
"""

from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj.policy.brax import PPONetworkParams, PPONetworks
from carpark_mj.training.ppo.config import PPOConfig
from carpark_mj.training.ppo.variants import (
    Minibatch,
    Prepare,
    Variant,
    Weights,
    balance,
    describe_policy,
    standardize,
)

VALUE_COST = 0.5  # weight of the value's squared error
LAST_LAYER = 0.1  # factor on the initial weights of the actor's last layer


@struct.dataclass
class Steps:
    """Steps (..., size) to learn from, with outputs of the networks before them."""

    observation: jax.Array  # of the agents
    raw_action: jax.Array  # of the agents
    log_prob: jax.Array  # (..., k) log-probabilities of its branches before the update
    advantage: jax.Array  # of the action, normalised
    target: jax.Array  # of the critic
    value: jax.Array  # of the critic before the update
    weight: jax.Array  # see `Minibatch`


def prepare_steps(
    params: PPONetworkParams, networks: PPONetworks, normalizer: Any, steps: Minibatch
) -> Steps:
    """All steps (n, ...) of an update, as one dimension.

    Advantages are what their targets, with lambda from the first step on, exceed the
    critic by; actor and critic are from before the update, the statistics from its
    start.
    """
    distribution: Any = networks.parametric_action_distribution
    actor: Any = networks.policy_network.apply
    critic: Any = networks.value_network.apply
    drawn_from = distribution.create_dist(
        actor(normalizer, params.policy, steps.observation)
    )
    value = critic(normalizer, params.value, steps.observation)
    weight = balance(steps.weight)
    return Steps(
        observation=steps.observation,
        raw_action=steps.raw_action,
        log_prob=drawn_from.log_prob(steps.raw_action),
        advantage=standardize(steps.target - value, weight, floor=1e-10),
        target=steps.target,
        value=value,
        weight=steps.weight,
    )


def ml_agents_loss(
    params: PPONetworkParams,
    networks: PPONetworks,
    normalizer: Any,
    batch: Steps,
    weights: Weights,
    key: jax.Array,
) -> tuple[jax.Array, dict[str, jax.Array]]:
    """The loss of a minibatch and its reported parts, like `ppo_loss`.

    As in ML-Agents, branches are averaged in the policy's loss and summed in the
    entropy. The key is unused: the entropy of choices is exact.
    """
    del key
    distribution: Any = networks.parametric_action_distribution
    actor: Any = networks.policy_network.apply
    critic: Any = networks.value_network.apply
    logits = actor(normalizer, params.policy, batch.observation)
    value = critic(normalizer, params.value, batch.observation)
    clip, drawn_from = weights.clip, distribution.create_dist(logits)
    weight = balance(batch.weight)

    def mean(x: jax.Array) -> jax.Array:
        return jnp.sum(weight * x)

    log_ratio = drawn_from.log_prob(batch.raw_action) - batch.log_prob
    ratio, advantage = jnp.exp(log_ratio), batch.advantage[..., None]
    clipped = jnp.clip(ratio, 1.0 - clip, 1.0 + clip)
    gain = jnp.minimum(ratio * advantage, clipped * advantage)
    policy_loss = -mean(gain.mean(axis=-1))
    near = batch.value + jnp.clip(value - batch.value, -clip, clip)
    error = jnp.maximum(
        jnp.square(batch.target - value), jnp.square(batch.target - near)
    )
    v_loss = VALUE_COST * mean(error)
    entropy_loss = -weights.entropy_cost * mean(drawn_from.entropy().sum(axis=-1))
    total_loss = policy_loss + v_loss + entropy_loss
    return total_loss, {
        "total_loss": total_loss,
        "policy_loss": policy_loss,
        "v_loss": v_loss,
        "entropy_loss": entropy_loss,
        "kl_mean": mean(jnp.sum(ratio - 1.0 - log_ratio, axis=-1)),
        **describe_policy(drawn_from),
    }


def initial_weights(params: PPONetworkParams, key: jax.Array) -> PPONetworkParams:
    """New weights for networks of dense layers; biases are 0.

    Hidden layers are normal with variance 1 / inputs; so is the actor's last layer,
    times `LAST_LAYER`. The critic's last layer is uniform with variance 2 / (inputs +
    outputs), Glorot's.
    """
    hidden = jax.nn.initializers.variance_scaling(1.0, "fan_in", "normal")
    glorot = jax.nn.initializers.glorot_uniform()

    def draw(tree: Any, key: jax.Array, is_actor: bool) -> Any:
        layers = tree["params"]
        last = f"hidden_{len(layers) - 1}"
        drawn = {}
        keys = jax.random.split(key, len(layers))
        for name, layer_key in zip(layers, keys, strict=True):
            shape = layers[name]["kernel"].shape
            kernel = hidden(layer_key, shape, jnp.float32)
            if name == last and is_actor:
                kernel = LAST_LAYER * kernel
            elif name == last:
                kernel = glorot(layer_key, shape, jnp.float32)
            bias = jnp.zeros_like(layers[name]["bias"])
            drawn[name] = {"kernel": kernel, "bias": bias}
        return {"params": drawn}

    policy_key, value_key = jax.random.split(key)
    fresh: Any = params
    return fresh.replace(
        policy=draw(params.policy, policy_key, True),
        value=draw(params.value, value_key, False),
    )


class MLAgents(Variant):
    """The details above."""

    normalizes = False

    def check(self, config: PPOConfig) -> None:
        """Refuses continuous actions, set encoders, absent agents, neighbours' shares.

        Advantages are what targets exceed the critic by, see `prepare_steps`.
        """
        needs = {
            "env.physics 'grid'": not config.env.physics_config.continuous,
            "networks.encoder 'flat'": config.networks.encoder == "flat",
            "env.min_agents None": len(config.env.agent_counts) == 1,
            "curriculum.neighbour_share 0": not config.curriculum.neighbour_share,
        }
        for need, is_met in needs.items():
            if not is_met:
                raise ValueError(f"variant 'ml-agents' needs {need}")

    def initial_weights(self, params: Any, key: jax.Array) -> tuple[Any, jax.Array]:
        """Redraws all weights."""
        key, weights_key = jax.random.split(key)
        return initial_weights(params, weights_key), key

    def prepared(
        self, prepare: Prepare, params: Any, networks: PPONetworks, normalizer: Any
    ) -> Prepare:
        """Steps from before the update, as if each were an agent's only one."""
        flat = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), prepare(params))
        steps = prepare_steps(params, networks, normalizer, flat)
        steps = jax.tree.map(lambda x: x[None], steps)
        return lambda params: steps

    def loss(
        self,
        params: Any,
        networks: PPONetworks,
        normalizer: Any,
        batch: Any,
        weights: Weights,
        key: jax.Array,
    ) -> tuple[jax.Array, dict[str, jax.Array]]:
        """See `ml_agents_loss`."""
        return ml_agents_loss(params, networks, normalizer, batch, weights, key)


ML_AGENTS = MLAgents()
