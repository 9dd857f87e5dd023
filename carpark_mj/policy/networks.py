"""Actor and critic, sized by a frozen config, behind Brax's PPO interface."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Annotated, Any, Literal

import jax
import jax.numpy as jnp
from brax.training import networks as brax_networks
from brax.training.agents.ppo import networks as ppo_networks
from flax import linen
from jax.tree_util import Partial

from carpark_mj.config.checks import Bounds, CheckedConfig, Count, Positive
from carpark_mj.mdp.actions import ActionSpec
from carpark_mj.observations.compose import OWN, ObservationSets, observation_sets
from carpark_mj.observations.fields import Field
from carpark_mj.policy.distributions import MIN_STD, action_distribution
from carpark_mj.policy.encoder import SetEncoder
from carpark_mj.policy.normalizer import Normalizer, normalize

Policy = Callable[[jax.Array, jax.Array], tuple[jax.Array, dict[str, Any]]]

EncoderName = Literal["set", "flat"]


@dataclasses.dataclass(frozen=True)
class NetworkConfig(CheckedConfig):
    """Sizes of the networks; activations are swish.

    Attributes:
        policy_layers: sizes of the actor's hidden layers.
        value_layers: sizes of the critic's hidden layers.
        encoder: encoder before the layers. `set`: all cars of a kind go through the
            same layers, see `carpark_mj.policy.encoder`; the weights fit any number of
            cars. `flat`: none, the layers read the vector.
        own_size: number of features of the own numbers in `set`.
        entity_size: number of features of a set of entities in `set`.
        picture_size: number of features of a picture in `set`, of each camera's.
        min_std: least standard deviation of continuous actions before tanh, above 0.
            With a small value a policy may stop exploring.
    """

    policy_layers: Annotated[tuple[int, ...], Bounds(ge=1)] = (128, 128)
    value_layers: Annotated[tuple[int, ...], Bounds(ge=1)] = (128, 128)
    encoder: EncoderName = "set"
    own_size: Count = 128
    entity_size: Count = 64
    # The first convolution has half of it.
    picture_size: Annotated[int, Bounds(ge=2)] = 64
    min_std: Positive = MIN_STD


def network_inputs(config: NetworkConfig, fields: Sequence[Field]) -> ObservationSets:
    """The parts of observations with these fields, as the networks read them."""
    if config.encoder == "set":
        return observation_sets(fields)
    return ObservationSets(sum(field.size for field in fields))


@dataclasses.dataclass(frozen=True)
class Arithmetic:
    """How networks with a set encoder are computed; their parameters do not tell.

    Attributes:
        in_kernel: whether sets are encoded in a GPU kernel.
        dtype: of all layers but the sets' and the last.
    """

    in_kernel: bool = False
    dtype: Any = jnp.float32


PLAIN = Arithmetic()


class SetNetwork(linen.Module):
    """The set encoder and hidden layers.

    Attributes:
        inputs: see `network_inputs`.
        config: the encoder.
        layers: sizes of the layers after it, the output included.
        arithmetic: how they are computed.
    """

    inputs: ObservationSets
    config: NetworkConfig
    layers: tuple[int, ...]
    arithmetic: Arithmetic

    @linen.compact
    def __call__(
        self, parts: dict[str, jax.Array], present: dict[str, jax.Array]
    ) -> jax.Array:
        """The output (..., layers[-1])."""
        config, how = self.config, self.arithmetic
        sizes = (config.own_size, config.entity_size, config.picture_size)
        encoder = SetEncoder(self.inputs, *sizes, how.in_kernel, how.dtype)
        hidden = encoder(parts, present)
        return _Layers(self.layers, how.dtype, name="MLP_0")(hidden)


class _Layers(linen.Module):
    """Brax's `MLP` with swish, whose hidden layers may have half precision.

    Attributes:
        sizes: of the layers; the last has no activation, and float32.
        dtype: of the others.
    """

    sizes: tuple[int, ...]
    dtype: Any

    @linen.compact
    def __call__(self, hidden: jax.Array) -> jax.Array:
        for i, size in enumerate(self.sizes):
            last = i == len(self.sizes) - 1
            hidden = linen.Dense(
                size,
                dtype=jnp.float32 if last else self.dtype,
                kernel_init=jax.nn.initializers.lecun_uniform(),
                name=f"hidden_{i}",
            )(hidden)
            hidden = hidden if last else linen.swish(hidden)
        return hidden


def make_networks(
    config: NetworkConfig,
    fields: Sequence[Field],
    action: ActionSpec,
    arithmetic: Arithmetic = PLAIN,
) -> ppo_networks.PPONetworks:
    """Builds actor and critic over observations with the given fields.

    They take a `Normalizer` of `network_inputs(config, fields)`.
    """
    inputs = network_inputs(config, fields)
    distribution = action_distribution(action, config.min_std)
    networks: Any = ppo_networks.PPONetworks  # its fields are hidden from Pyright
    if config.encoder == "flat":
        policy = brax_networks.make_policy_network(
            distribution.param_size,
            inputs.size,
            preprocess_observations_fn=_normalize_own,
            hidden_layer_sizes=config.policy_layers,
            activation=linen.swish,
        )
        value = brax_networks.make_value_network(
            inputs.size,
            preprocess_observations_fn=_normalize_own,
            hidden_layer_sizes=config.value_layers,
            activation=linen.swish,
        )
    else:
        layers = (*config.policy_layers, distribution.param_size)
        policy = _set_network(SetNetwork(inputs, config, layers, arithmetic))
        layers = (*config.value_layers, 1)
        value = _set_network(SetNetwork(inputs, config, layers, arithmetic))
        value = dataclasses.replace(value, apply=_scalar(value.apply))
    return networks(
        policy_network=policy,
        value_network=value,
        parametric_action_distribution=distribution,
    )


def _normalize_own(observation: Any, preprocessor_params: Any) -> Any:
    return normalize(preprocessor_params, {OWN: observation})[OWN]


def _set_network(network: SetNetwork) -> brax_networks.FeedForwardNetwork:
    inputs = network.inputs

    def init(key: jax.Array) -> Any:
        parts = inputs.split(jnp.zeros((1, inputs.size)))
        return network.init(key, parts, inputs.present(parts))

    def apply(normalizer: Normalizer, params: Any, observation: jax.Array) -> Any:
        parts = inputs.split(observation)
        present = inputs.present(parts)
        return network.apply(params, normalize(normalizer, parts), present)

    return brax_networks.FeedForwardNetwork(init=init, apply=apply)


def _scalar(apply: Callable[..., jax.Array]) -> Callable[..., jax.Array]:
    """The function without the output's last dimension, which is 1."""
    return lambda *args: apply(*args)[..., 0]


def make_policy(
    networks: ppo_networks.PPONetworks,
    normalizer: Normalizer,
    policy_params: Any,
    deterministic: bool,
) -> Policy:
    """An acting function `(observation, key) -> (action, extras)`."""
    make: Any = ppo_networks.make_inference_fn(networks)

    def act(params: Any, observation: jax.Array, key: jax.Array) -> Any:
        return make(params, deterministic=deterministic)(observation, key)

    return Partial(act, (normalizer, policy_params))
