"""Actor and critic, sized by a frozen config, behind Brax's PPO interface.

Their inputs are normalised by running statistics that all entities of a kind share: an
entity means the same in every slot, and the statistics fit any number of slots. Padded
slots, which a set encoder masks, do not count. Pictures have none.
"""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import linen
from jax.tree_util import Partial

from carpark_mj.config.networks import NetworkConfig
from carpark_mj.mdp.actions import ActionSpec
from carpark_mj.observations.compose import OWN, ObservationSets, observation_sets
from carpark_mj.observations.ego import LONG
from carpark_mj.observations.fields import Field
from carpark_mj.policy.brax import networks as brax_networks
from carpark_mj.policy.brax import ppo_networks, running_statistics, specs
from carpark_mj.policy.distributions import action_distribution
from carpark_mj.policy.encoder import SetEncoder

# Smallest standard deviation by which observations (scaled to about 1) are divided.
# Numbers that hardly varied in training (sizes in a lot of equal bays) must not swamp
# the network when they do.
MIN_DEVIATION = 0.1

DITHERS, DITHER_STEP = 128, 0.2  # rows of noise, and the time between them [s]

Normalizer = dict[str, Any]  # Brax's running statistics by part


def init_normalizer(sets: ObservationSets) -> Normalizer:
    """Statistics at the start of training."""
    sizes = {OWN: sets.own_size, **{part.group: part.size for part in sets.sets}}
    start, number = running_statistics.init_state, np.dtype("float32")
    states = {name: start(specs.Array((n,), number)) for name, n in sizes.items()}
    return jax.tree.map(jnp.asarray, states)


def update_normalizer(
    sets: ObservationSets,
    normalizer: Normalizer,
    observation: jax.Array,
    weight: jax.Array | None = None,
    axis: str | None = None,
) -> Normalizer:
    """Statistics with observations added.

    Args:
        sets: parts of the vectors.
        normalizer: before.
        observation: (..., size); of its entities those that are present count.
        weight: (...) 0.0 of observations that do not count, else 1.0; None = all 1.
        axis: of devices whose observations are added together.
    """
    parts = sets.split(observation)
    counts: dict[str, jax.Array | None] = {OWN: weight}
    for group, present in sets.present(parts).items():
        of_observer = 1.0 if weight is None else weight[..., None]
        counts[group] = present * of_observer

    def update(name: str, state: Any) -> Any:
        new = running_statistics.update(
            state,
            parts[name],
            weights=counts[name],
            std_min_value=MIN_DEVIATION,
            pmap_axis_name=axis,
        )
        # Until the first entity of a kind is seen, its sums are divided by 0.
        count: Any = new.count  # brax's UInt64
        seen = (count.hi | count.lo) > 0
        return jax.tree.map(lambda new, old: jnp.where(seen, new, old), new, state)

    return {name: update(name, state) for name, state in normalizer.items()}


def normalize(
    normalizer: Normalizer, parts: dict[str, jax.Array]
) -> dict[str, jax.Array]:
    """Parts of observations, see `ObservationSets.split`, scaled to about unit size.

    Pictures stay as they are.
    """
    scaled = {
        name: running_statistics.normalize(parts[name], state)
        for name, state in normalizer.items()
    }
    return parts | scaled


Policy = Callable[[jax.Array, jax.Array], tuple[jax.Array, dict[str, Any]]]


def network_inputs(config: NetworkConfig, fields: Sequence[Field]) -> ObservationSets:
    """The parts of observations with these fields, as the networks read them."""
    if config.encoder == "set":
        return observation_sets(fields)
    return ObservationSets(sum(field.size for field in fields))


@dataclasses.dataclass(frozen=True)
class Arithmetic:
    """Numerics of networks with a set encoder, which parameters do not show."""

    in_kernel: bool = False  # whether sets are encoded in a GPU kernel
    dtype: Any = jnp.float32  # of all layers but the sets' and the last


class SetNetwork(linen.Module):
    """The set encoder and hidden layers."""

    inputs: ObservationSets  # see `network_inputs`
    config: NetworkConfig  # the encoder
    layers: tuple[int, ...]  # sizes of the layers after it, the output included
    arithmetic: Arithmetic  # how they are computed

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
    """Brax's `MLP` with swish, whose hidden layers may have half precision."""

    sizes: tuple[int, ...]  # of the layers; the last has no activation, and float32
    dtype: Any  # of the others

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
    arithmetic: Arithmetic = Arithmetic(),
) -> ppo_networks.PPONetworks:
    """Builds actor and critic over observations with the given fields.

    They take a `Normalizer` of `network_inputs(config, fields)`.
    """
    inputs = network_inputs(config, fields)
    deviations = config.min_std, config.max_std
    distribution = action_distribution(action, *deviations, config.bins)
    make_finish(config, fields, action)  # refuses before a training
    networks: Any = ppo_networks.PPONetworks  # its fields are hidden from Pyright
    if config.encoder == "flat":

        def scaled(observation: jax.Array, normalizer: Normalizer) -> jax.Array:
            return normalize(normalizer, {OWN: observation})[OWN]

        alike: Any = {"preprocess_observations_fn": scaled, "activation": linen.swish}
        policy = brax_networks.make_policy_network(
            distribution.param_size,
            inputs.size,
            hidden_layer_sizes=config.policy_layers,
            **alike,
        )
        value = brax_networks.make_value_network(
            inputs.size, hidden_layer_sizes=config.value_layers, **alike
        )
    else:
        layers = (*config.policy_layers, distribution.param_size)
        policy = _set_network(SetNetwork(inputs, config, layers, arithmetic))
        layers = (*config.value_layers, 1)
        value = _set_network(SetNetwork(inputs, config, layers, arithmetic))
        apply = value.apply
        value = dataclasses.replace(value, apply=lambda *args: apply(*args)[..., 0])
    return networks(
        policy_network=policy,
        value_network=value,
        parametric_action_distribution=distribution,
    )


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


Logits = Callable[[jax.Array], jax.Array]  # of observations


def make_policy(
    networks: ppo_networks.PPONetworks,
    normalizer: Normalizer,
    policy_params: Any,
    deterministic: bool,
    finish: Callable[[Logits, jax.Array], jax.Array] | None = None,
) -> Policy:
    """An acting function `(observation, key) -> (action, extras)`.

    A deterministic one takes the likeliest of the logits that `finish` makes, see
    `make_finish`.
    """
    make: Any = ppo_networks.make_inference_fn(networks)

    def act(params: Any, observation: jax.Array, key: jax.Array) -> Any:
        if not (deterministic and finish):
            return make(params, deterministic=deterministic)(observation, key)
        logits: Any = functools.partial(networks.policy_network.apply, *params)
        chosen: Any = networks.parametric_action_distribution
        return chosen.mode(finish(logits, observation)), {}

    return Partial(act, (normalizer, policy_params))


def make_finish(
    config: NetworkConfig, fields: Sequence[Field], action: ActionSpec
) -> Callable[[Logits, jax.Array], jax.Array] | None:
    """Makes the logits (..., k) of a deterministic policy; None: as they are.

    `mirrored` averages those of the scene and of its mirror image. `dither` adds Gumbel
    noise, with which the likeliest choice is a sample, from a table by the time: an
    observation has one action. `ValueError` if agents do not observe the time, do not
    steer by numbers, or observe pictures, which have no mirror image here.
    """
    if not (config.dither or config.mirrored):
        return None
    names = [field.name for field in fields]
    if config.dither and "own_time" not in names:
        raise ValueError("networks.dither needs observation.own_past")
    lacks = any(x.shape or 0 in x.mirror for x in fields)
    if config.mirrored and (lacks or not action.continuous):
        raise ValueError(
            "networks.mirrored needs continuous actions, and fields with a mirror image"
        )
    size = config.bins * action.continuous + sum(action.choices)
    starts = np.cumsum([0, *(field.size for field in fields)])
    places = [field.mirror or range(1, field.size + 1) for field in fields]
    mirror = np.concatenate([np.array(x) for x in places])
    order = abs(mirror) - 1 + np.repeat(starts[:-1], np.diff(starts))
    sign = np.sign(mirror).astype(np.float32)
    other = np.r_[config.bins - 1 : -1 : -1, config.bins : size]  # steering reversed
    table = np.random.default_rng(0).gumbel(size=(DITHERS, size)).astype(np.float32)
    first = round(config.dither / DITHER_STEP)

    def finish(logits: Logits, observation: jax.Array) -> jax.Array:
        found = logits(observation)
        if config.mirrored:
            there = logits(observation[..., jnp.asarray(order)] * sign)
            found = (found + there[..., jnp.asarray(other)]) / 2
        if not config.dither:
            return found
        time = observation[..., starts[names.index("own_time")]]
        tick = jnp.floor(time * (LONG / DITHER_STEP) + 0.49).astype(int)  # halves down
        noise = jnp.asarray(table)[tick % DITHERS]
        return found + jnp.where(tick[..., None] < first, 0.0, noise)

    return finish
