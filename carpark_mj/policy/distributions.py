"""Distributions of actions with discrete choices, in Brax's interface.

Raw actions are samples of a network's distribution: numbers before tanh, and indices.
Brax's PPO loss uses raw actions.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config.networks import MIN_STD
from carpark_mj.mdp.actions import ActionSpec
from carpark_mj.policy.brax import (
    IdentityPostprocessor,
    NormalTanhDistribution,
    ParametricDistribution,
    TanhBijector,
)


def action_distribution(
    spec: ActionSpec, min_std: float = MIN_STD, max_std: float = 0.0, bins: int = 0
) -> ParametricDistribution:
    """The distribution for actions of a kind: tanh-normal, categorical, or both.

    Args:
        spec: the kind.
        min_std: least standard deviation of the numbers before tanh, above 0.
        max_std: largest; 0 = no limit.
        bins: values that each number is chosen from; 0 = any, tanh-normal.
    """
    if not spec.continuous:
        return MultiCategorical(spec.choices)
    if bins:
        return Binned(spec, bins)
    normal = NormalTanhDistribution(spec.continuous, min_std=min_std)
    if max_std:
        normal = BoundedNormalTanh(spec.continuous, min_std, max_std)
    if not spec.choices:
        return normal
    return TanhNormalCategorical(normal, spec.choices)


class BoundedNormalTanh(NormalTanhDistribution):
    """Brax's distribution with an upper bound of its standard deviations."""

    def __init__(self, event_size: int, min_std: float, max_std: float) -> None:
        """Takes the number of numbers and the bounds, before tanh."""
        super().__init__(event_size, min_std=min_std)
        self._max_std = max_std

    def create_dist(self, parameters: jax.Array) -> Any:
        """Brax's normal distribution of parameters (..., param_size)."""
        normal = super().create_dist(parameters)
        normal.scale = jnp.minimum(normal.scale, self._max_std)
        return normal


class Categoricals:
    """Independent categorical distributions, one for each of k branches."""

    def __init__(self, logits: tuple[jax.Array, ...]) -> None:
        """Normalises the unnormalised log-probabilities (..., n_i) of the branches."""
        self._log_p = [jax.nn.log_softmax(branch, axis=-1) for branch in logits]

    def sample(self, seed: jax.Array) -> jax.Array:
        """Indices (..., k) int32."""
        keys = jax.random.split(seed, len(self._log_p))
        pairs = zip(keys, self._log_p, strict=True)
        drawn = [jax.random.categorical(key, log_p) for key, log_p in pairs]
        return jnp.stack(drawn, axis=-1).astype(jnp.int32)

    def mode(self) -> jax.Array:
        """Most probable indices (..., k) int32, the first of equals."""
        best = [jnp.argmax(log_p, axis=-1) for log_p in self._log_p]
        return jnp.stack(best, axis=-1).astype(jnp.int32)

    def log_prob(self, index: jax.Array) -> jax.Array:
        """Log-probabilities (..., k) of indices (..., k)."""
        index = index.astype(jnp.int32)
        found = [
            jnp.take_along_axis(log_p, index[..., i, None], axis=-1)
            for i, log_p in enumerate(self._log_p)
        ]
        return jnp.concatenate(found, axis=-1)

    def entropy(self) -> jax.Array:
        """Entropies (..., k) [nat]."""
        parts = [-jnp.sum(jnp.exp(log_p) * log_p, axis=-1) for log_p in self._log_p]
        return jnp.stack(parts, axis=-1)

    @property
    def loc(self) -> jax.Array:
        """Mean index (..., k); Brax's loss reports it beside `scale`."""
        return self._moment(1)

    @property
    def scale(self) -> jax.Array:
        """Standard deviation of the index (..., k)."""
        return jnp.sqrt(jnp.maximum(self._moment(2) - self._moment(1) ** 2, 0.0))

    def _moment(self, power: int) -> jax.Array:
        def mean(log_p: jax.Array) -> jax.Array:
            index = jnp.arange(log_p.shape[-1], dtype=log_p.dtype)
            return jnp.sum(jnp.exp(log_p) * index**power, axis=-1)

        return jnp.stack([mean(log_p) for log_p in self._log_p], axis=-1)


class MultiCategorical(ParametricDistribution):
    """Indices (..., k) int32; parameters are the logits of branch after branch."""

    def __init__(self, choices: tuple[int, ...]) -> None:
        """Takes the number of choices in each of the k branches."""
        super().__init__(
            param_size=sum(choices),
            postprocessor=IdentityPostprocessor(),
            event_ndims=1,
            reparametrizable=False,
        )
        self._ends = np.cumsum(choices)[:-1]

    def create_dist(self, parameters: jax.Array) -> Any:
        """The `Categoricals` of parameters (..., param_size)."""
        return Categoricals(tuple(jnp.split(parameters, self._ends, axis=-1)))


class Binned(MultiCategorical):
    """Numbers (..., k) in [-1, 1], of some values at equal distances, then indices.

    Unlike a normal distribution it may have two modes: a car that could as well drive
    forwards as backwards does not stand still between them.
    """

    def __init__(self, spec: ActionSpec, bins: int) -> None:
        """Takes the kind of action, and how many values each of its numbers has."""
        super().__init__((bins,) * spec.continuous + spec.choices)
        self._postprocessor = _Spaced(spec, bins)


class _Spaced(IdentityPostprocessor):
    """The first indices as numbers at equal distances in [-1, 1]; the others stay."""

    def __init__(self, spec: ActionSpec, bins: int) -> None:
        numbers, others = np.ones(spec.continuous), np.ones(len(spec.choices))
        scale = np.concatenate([numbers * 2 / (bins - 1), others])
        self._scale = scale.astype(np.float32)
        self._least = np.concatenate([-numbers, 0 * others]).astype(np.float32)

    def forward(self, x: jax.Array) -> jax.Array:
        return x * self._scale + self._least

    def inverse(self, x: jax.Array) -> jax.Array:
        return jnp.round((x - self._least) / self._scale).astype(jnp.int32)


class NormalAndCategoricals:
    """A normal distribution over the first numbers, categorical ones over the rest.

    Attributes:
        loc: mean of the numbers before tanh; Brax's loss reports it and `scale`.
        scale: standard deviation of the numbers before tanh.
    """

    def __init__(self, normal, categoricals: Categoricals) -> None:
        """Joins Brax's normal distribution over numbers with indices."""
        self._normal, self._categoricals = normal, categoricals
        self.loc, self.scale = normal.loc, normal.scale

    def sample(self, seed: jax.Array) -> jax.Array:
        """Numbers before tanh and indices (..., size), float32."""
        normal_key, choice_key = jax.random.split(seed)
        choice = self._categoricals.sample(choice_key)
        return _join(self._normal.sample(normal_key), choice)

    def mode(self) -> jax.Array:
        """Mode of the numbers before tanh, and most probable indices (..., size)."""
        return _join(self._normal.mode(), self._categoricals.mode())

    def log_prob(self, x: jax.Array) -> jax.Array:
        """Log-densities and log-probabilities (..., size) of raw actions."""
        numbers, index = jnp.split(x, [self.loc.shape[-1]], axis=-1)
        log_prob = self._normal.log_prob(numbers)
        return _join(log_prob, self._categoricals.log_prob(index))

    def entropy(self) -> jax.Array:
        """Entropies (..., size) before tanh [nat]."""
        return _join(self._normal.entropy(), self._categoricals.entropy())


class _TanhOfFirst:
    """Tanh of the first numbers; indices stay."""

    def __init__(self, continuous: int) -> None:
        self._continuous = continuous

    def forward(self, x: jax.Array) -> jax.Array:
        numbers, index = jnp.split(x, [self._continuous], axis=-1)
        return _join(TanhBijector().forward(numbers), index)

    def inverse(self, y: jax.Array) -> jax.Array:
        numbers, index = jnp.split(y, [self._continuous], axis=-1)
        return _join(TanhBijector().inverse(numbers), index)

    def forward_log_det_jacobian(self, x: jax.Array) -> jax.Array:
        numbers, index = jnp.split(x, [self._continuous], axis=-1)
        slope = TanhBijector().forward_log_det_jacobian(numbers)
        return _join(slope, jnp.zeros_like(index))


class TanhNormalCategorical(ParametricDistribution):
    """Numbers in [-1, 1], then indices, (..., size) float32, all independent.

    Parameters are those of Brax's `NormalTanhDistribution`, then the branches' logits.
    """

    def __init__(
        self, normal: NormalTanhDistribution, choices: tuple[int, ...]
    ) -> None:
        """Takes the distribution of the numbers, and sizes of the branches."""
        self._normal, self._categoricals = normal, MultiCategorical(choices)
        super().__init__(
            param_size=normal.param_size + self._categoricals.param_size,
            postprocessor=_TanhOfFirst(normal.param_size // 2),
            event_ndims=1,
            reparametrizable=False,
        )

    def create_dist(self, parameters: jax.Array) -> Any:
        """The `NormalAndCategoricals` of parameters (..., param_size)."""
        normal, logits = jnp.split(parameters, [self._normal.param_size], axis=-1)
        return NormalAndCategoricals(
            self._normal.create_dist(normal), self._categoricals.create_dist(logits)
        )


def _join(numbers: jax.Array, choices: jax.Array) -> jax.Array:
    return jnp.concatenate([numbers, choices.astype(numbers.dtype)], axis=-1)
