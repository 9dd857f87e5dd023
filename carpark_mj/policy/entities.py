"""The layers of one kind of entity, and the maximum over those that are present.

XLA writes the features of every entity to memory and reads them again for each of the
steps, which takes half of the learning of a set encoder. `largest_in_kernel`, on
Triton, keeps the features of a block of samples in registers; only the maximum leaves
it, with the entity that has it. Its gradient computes the features anew.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from flax import linen

EPSILON = 1e-6  # added to variances, as in flax's LayerNorm


class EntityLayers(NamedTuple):
    """Weights of dense layer, normalisation, swish and dense layer."""

    first: tuple[jax.Array, jax.Array]  # kernel (size, features), bias (features,)
    norm: tuple[jax.Array, jax.Array]  # scale and bias (features,)
    second: tuple[jax.Array, jax.Array]  # kernel (features, features) and bias


def encode(layers: EntityLayers, entities: jax.Array) -> jax.Array:
    """Features (..., features) of entities (..., size)."""
    kernel, bias = layers.first
    hidden = entities @ kernel + bias
    centred = hidden - hidden.mean(axis=-1, keepdims=True)
    # A difference of two means, the fast variance, loses digits.
    variance = jnp.square(centred).mean(axis=-1, keepdims=True)
    scale, bias = layers.norm
    hidden = linen.swish(centred * (jax.lax.rsqrt(variance + EPSILON) * scale) + bias)
    kernel, bias = layers.second
    return hidden @ kernel + bias


def largest(layers: EntityLayers, entities: jax.Array, present: jax.Array) -> jax.Array:
    """The largest of each feature (..., features) over the entities that are present.

    0 where none is. Entities (..., count, size), normalised; present (..., count) bool.
    """
    hidden = encode(layers, entities)
    found = jnp.max(jnp.where(present[..., None], hidden, -jnp.inf), axis=-2)
    return jnp.where(present.any(axis=-1, keepdims=True), found, 0.0)


BLOCK = 64  # samples that a program holds at a time
WARPS = 4
PROGRAMS = 264  # of the gradient: two for each multiprocessor of an H100
_LEAST = 16  # smallest side of a matrix product on Triton


def fits(features: int) -> bool:
    """Whether the kernel takes this number of features: a power of 2 from 16 on."""
    return features >= _LEAST and features & (features - 1) == 0


def largest_in_kernel(
    layers: EntityLayers,
    entities: jax.Array,
    present: jax.Array,
    dtype: Any = jnp.float32,
    interpret: bool = False,
) -> jax.Array:
    """As `largest`, with gradients of the weights alone: observations have none.

    The features must fit, see `fits`. Factors of matrix products are of `dtype`, and
    added up in float32. Tests `interpret` it on any device, slowly.
    """
    lead, (count, size) = entities.shape[:-2], entities.shape[-2:]
    samples = present.reshape(-1, count).shape[0]
    more = -samples % BLOCK
    width = max(_LEAST, 1 << (size - 1).bit_length())
    rows = jnp.moveaxis(entities.reshape(samples, count, size), 1, 0)
    rows = jnp.pad(rows, ((0, 0), (0, more), (0, width - size)))
    there = present.reshape(samples, count).T.astype(jnp.float32)
    there = jnp.pad(there, ((0, 0), (0, more)))
    (kernel, bias), norm, second = layers
    kernel = jnp.pad(kernel, ((0, width - size), (0, 0)))
    weights = (kernel, bias, *norm, *second)
    found: Any = _largest(_How(dtype, interpret), rows, there, weights)
    return found[:samples].reshape(*lead, -1)


class _How(NamedTuple):
    """Arithmetic of the kernel."""

    dtype: Any
    interpret: bool

    def dot(self, a: jax.Array, b: jax.Array, axes: tuple[int, int] = (1, 0)) -> Any:
        """The matrix product, along these axes of the factors."""
        along = (((axes[0],), (axes[1],)), ((), ()))
        a, b = a.astype(self.dtype), b.astype(self.dtype)
        return jax.lax.dot_general(a, b, along, preferred_element_type=jnp.float32)

    def options(self) -> dict[str, Any]:
        """For `pallas_call`."""
        from jax.experimental.pallas import triton  # slow to import

        parameters = triton.CompilerParams(num_warps=WARPS, num_stages=1)
        return {"compiler_params": parameters, "interpret": self.interpret}


@functools.partial(jax.custom_vjp, nondiff_argnums=(0,))
def _largest(how: _How, rows: jax.Array, there: jax.Array, weights: Any) -> jax.Array:
    """Maxima (samples, features) over entities `rows` (count, samples, width).

    Weights are kernel and bias, scale and bias, kernel and bias.
    """
    return _forward(how, rows, there, weights)[0]


def _forward(how: _How, rows: jax.Array, there: jax.Array, weights: Any) -> Any:
    """The maxima, and what the gradient needs."""
    from jax.experimental import pallas as pl  # slow to import

    count, samples, width = rows.shape
    features = weights[0].shape[1]

    def kernel(rows: Any, there: Any, *refs: Any) -> None:
        *weights, found, owner = refs
        layers = [ref[...] for ref in weights]

        def entity(i: Any, best: Any) -> Any:
            value, of = best
            _, _, hidden = _hidden(how, rows[i], layers)
            hidden = how.dot(hidden, layers[4]) + layers[5]
            better = (there[i] > 0.0)[:, None] & (hidden > value)
            return jnp.where(better, hidden, value), jnp.where(better, i, of)

        nothing = jnp.full((BLOCK, features), -jnp.inf, jnp.float32)
        nobody = jnp.full((BLOCK, features), -1, jnp.int32)
        value, of = jax.lax.fori_loop(0, count, entity, (nothing, nobody))
        found[...] = jnp.where(of >= 0, value, 0.0)
        owner[...] = of.astype(jnp.int8)

    block = pl.BlockSpec((BLOCK, features), lambda i: (i, 0))
    maxima, form = (samples, features), jax.ShapeDtypeStruct
    found, owner = pl.pallas_call(
        kernel,
        grid=(samples // BLOCK,),
        in_specs=[
            pl.BlockSpec((count, BLOCK, width), lambda i: (0, i, 0)),
            pl.BlockSpec((count, BLOCK), lambda i: (0, i)),
            *(_whole(x) for x in weights),
        ],
        out_specs=(block, block),
        out_shape=(form(maxima, jnp.float32), form(maxima, jnp.int8)),
        name="entities",
        **how.options(),
    )(rows, there, *weights)
    return found, (rows, there, weights, owner)


def _backward(how: _How, kept: Any, change: jax.Array) -> tuple[Any, ...]:
    """Gradients of the weights: every program adds up those of its blocks."""
    from jax.experimental import pallas as pl

    rows, there, weights, owner = kept
    count, samples, _ = rows.shape
    blocks = samples // BLOCK
    programs = min(PROGRAMS, blocks)

    def kernel(rows: Any, owner: Any, change: Any, *refs: Any) -> None:
        layers, sums = [ref[...] for ref in refs[:6]], refs[6:]
        first = pl.program_id(0)

        def block(j: Any, totals: Any) -> Any:
            at = pl.ds((first + j * programs) * BLOCK, BLOCK)
            of, gained = owner[at, :].astype(jnp.int32), change[at, :]

            def entity(i: Any, totals: Any) -> Any:
                own = jnp.where(of == i, gained, 0.0)
                new = _gradients(how, rows[i, at, :], own, layers)
                return [total + x for total, x in zip(totals, new, strict=True)]

            return jax.lax.fori_loop(0, count, entity, totals)

        zeros = [jnp.zeros(ref.shape, jnp.float32) for ref in refs[:6]]
        mine = (blocks - first + programs - 1) // programs
        totals = jax.lax.fori_loop(0, mine, block, zeros)
        for ref, total in zip(sums, totals, strict=True):
            ref[...] = total[None]

    form = jax.ShapeDtypeStruct
    sums = pl.pallas_call(
        kernel,
        grid=(programs,),
        in_specs=[*(_whole(x) for x in (rows, owner, change, *weights))],
        out_specs=[_row(x) for x in weights],
        out_shape=[form((programs, *x.shape), jnp.float32) for x in weights],
        name="entities_gradient",
        **how.options(),
    )(rows, owner, change, *weights)
    gradients = tuple(x.sum(axis=0) for x in sums)
    return jnp.zeros_like(rows), jnp.zeros_like(there), gradients


_largest.defvjp(_forward, _backward)


def _hidden(how: _How, x: jax.Array, layers: Any) -> tuple[jax.Array, ...]:
    """Of entities (block, width): normalised features, 1 / deviation, activations."""
    features = layers[0].shape[1]
    hidden = how.dot(x, layers[0]) + layers[1]
    centred = hidden - (jnp.sum(hidden, axis=1) / features)[:, None]
    variance = jnp.sum(centred * centred, axis=1) / features
    inverse = jax.lax.rsqrt(variance + EPSILON)[:, None]
    normal = centred * inverse
    scaled = normal * layers[2] + layers[3]
    return normal, inverse, scaled * jax.nn.sigmoid(scaled)


def _gradients(
    how: _How, x: jax.Array, change: jax.Array, layers: Any
) -> list[jax.Array]:
    """Of the weights, from those of an entity's features (block, features)."""
    features = layers[0].shape[1]
    normal, inverse, hidden = _hidden(how, x, layers)
    scaled = normal * layers[2] + layers[3]
    gate = jax.nn.sigmoid(scaled)
    slope = gate * (1.0 + scaled * (1.0 - gate))
    of_scaled = how.dot(change, layers[4], (1, 1)) * slope
    of_normal = of_scaled * layers[2]
    mean = jnp.sum(of_normal, axis=1) / features
    along = jnp.sum(of_normal * normal, axis=1) / features
    of_first = inverse * (of_normal - mean[:, None] - normal * along[:, None])
    return [
        how.dot(x, of_first, (0, 0)),
        jnp.sum(of_first, axis=0),
        jnp.sum(of_scaled * normal, axis=0),
        jnp.sum(of_scaled, axis=0),
        how.dot(hidden, change, (0, 0)),
        jnp.sum(change, axis=0),
    ]


def _whole(x: jax.Array) -> Any:
    """All of an array for every program."""
    from jax.experimental import pallas as pl

    return pl.BlockSpec(x.shape, lambda i: (0,) * x.ndim)


def _row(x: jax.Array) -> Any:
    """A row of an array for each program."""
    from jax.experimental import pallas as pl

    return pl.BlockSpec((1, *x.shape), lambda i: (i,) + (0,) * x.ndim)
