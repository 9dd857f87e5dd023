"""Elementwise functions as one GPU kernel, in Pallas on Triton.

XLA launches a few kernels for each iteration of a loop; launches and memory traffic
take longer than the arithmetic. In one kernel a thread keeps a car in its registers for
the whole control step. JAX 0.11 deprecates Pallas on Triton. Without it `on_cuda` can
be removed at the cost of speed only.
"""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap

from carpark_mj.geometry.se2 import with_gradient

Tree = TypeVar("Tree")

_WARP = 32  # threads
BLOCK = 4 * _WARP  # elements, a warp for each scheduler of a multiprocessor
_AMPERE = 8.0  # compute capability, the oldest that Triton is made for


def on_cuda(
    run: Callable[..., Tree], otherwise: Callable[..., Tree], *args: Any
) -> Tree:
    """Runs `run` in programs for CUDA GPUs that Triton supports, else `otherwise`.

    Gradients are always those of `otherwise`.
    """
    if not has_triton():
        return otherwise(*args)
    return _on_either(run, otherwise, args)


def _on_either(
    run: Callable[..., Tree], otherwise: Callable[..., Tree], args: Any
) -> Tree:
    """`on_cuda` where there may be a GPU; shared leaves of `args` stay shared.

    The wrappers pass each leaf as a separate array. Without sharing, the kernel would
    load parameters common to the wheels four times and run a fifth slower.
    """
    rows, restore = _share(args)

    def cuda(*rows: jax.Array) -> Tree:
        return run(*restore(rows))

    def default(*rows: jax.Array) -> Tree:
        return otherwise(*restore(rows))

    def either(*rows: jax.Array) -> Tree:
        return jax.lax.platform_dependent(*rows, cuda=cuda, default=default)

    return with_gradient(either, default)(*rows)


def _share(args: Any) -> tuple[list[jax.Array], Callable[[Sequence[jax.Array]], Any]]:
    """The distinct leaves of a tree, and a function that rebuilds the tree."""
    leaves, tree = jax.tree.flatten(args)
    unique = {id(leaf): leaf for leaf in leaves}  # wheels share their car's parameters
    row = {leaf: i for i, leaf in enumerate(unique)}
    places = [row[id(leaf)] for leaf in leaves]
    return list(unique.values()), lambda rows: jax.tree.unflatten(
        tree, [rows[place] for place in places]
    )


def run_in_kernel(
    function: Callable[[Any], Tree], args: Any, interpret: bool = False
) -> Tree:
    """Evaluates an elementwise function in one kernel, also under `jax.vmap`.

    There are no gradients; see `on_cuda`.

    Args:
        function: from a tree to a tree of floats; may loop, must not index.
        args: tree of arrays of one shape.
        interpret: run on any device, slowly, for tests.
    """
    shared, restore = _share(args)
    results, result_tree = jax.tree.flatten(jax.eval_shape(function, args))

    def of_rows(rows: list[jax.Array]) -> list[jax.Array]:
        return jax.tree.leaves(function(restore(rows)))

    @custom_vmap
    def call(*rows: jax.Array) -> list[jax.Array]:
        packed = jnp.stack([x.ravel() for x in rows])
        columns = _call_kernel(of_rows, packed, len(results), interpret)
        return [columns[:, i].reshape(rows[0].shape) for i in range(len(results))]

    @call.def_vmap
    def _(size: int, batched: Any, *rows: jax.Array) -> tuple[Any, Any]:
        rows = tuple(
            x if has else jnp.broadcast_to(x, (size, *x.shape))
            for x, has in zip(rows, batched, strict=True)
        )
        return call(*rows), [True] * len(results)

    return jax.tree.unflatten(result_tree, call(*shared))


def has_triton() -> bool:
    """Whether JAX computes on a CUDA GPU that Triton supports."""
    if jax.default_backend() != "gpu":
        return False
    capability = jax.devices()[0].compute_capability
    return capability[0].isdigit() and float(capability) >= _AMPERE  # "gfx..." is AMD's


def _call_kernel(
    function: Callable[[list[jax.Array]], list[jax.Array]],
    packed: jax.Array,
    num_results: int,
    interpret: bool,
) -> jax.Array:
    """Results (n, >= num_results) for arguments (k, n).

    One load and one store for all of them: Triton compiles for half a minute if each
    array has its own. Its sizes are powers of two.
    """
    from jax.experimental import pallas as pl  # slow to import
    from jax.experimental.pallas import triton

    k, n = packed.shape
    height, width = pl.next_power_of_2(k), pl.next_power_of_2(num_results)
    blocks = pl.cdiv(n, BLOCK)
    missing = ((0, height - k), (0, blocks * BLOCK - n))

    def kernel(arguments: Any, results: Any) -> None:
        rows = jax.lax.split(arguments[...], (1,) * height, axis=0)
        columns = function([x.reshape(BLOCK) for x in rows])
        columns += columns[:1] * (width - num_results)
        results[...] = _join(columns).reshape(BLOCK, width)

    return pl.pallas_call(
        kernel,
        grid=(blocks,),
        in_specs=[pl.BlockSpec((height, BLOCK), lambda i: (0, i))],
        out_specs=pl.BlockSpec((BLOCK, width), lambda i: (i, 0)),
        out_shape=jax.ShapeDtypeStruct((blocks * BLOCK, width), packed.dtype),
        compiler_params=triton.CompilerParams(num_warps=BLOCK // _WARP, num_stages=1),
        interpret=interpret,
        name="elementwise",
    )(jnp.pad(packed, missing, mode="edge"))[:n]


def _join(columns: list[jax.Array]) -> jax.Array:
    """Stacks along new axes of two, which is all that Triton can join."""
    if len(columns) == 1:
        return columns[0]
    return jnp.stack([_join(columns[0::2]), _join(columns[1::2])], -1)
