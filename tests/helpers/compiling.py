"""Programs that run longer than they compile."""

import contextlib
import functools

import jax
import numpy as np

from carpark_mj.geometry import obstacles as near

# The tests' default is no optimisation (conftest.py): programs run up to 90 times as
# long, which only short ones do not feel.
optimized_jit = functools.partial(
    jax.jit, compiler_options={"xla_backend_optimization_level": 2}
)


def both_phases(function):
    """A function of lots in batches, twice: tests every pair, or only what is near."""

    def make(most):
        run = jax.jit(jax.vmap(function))

        def call(*scene):
            before, near.MANY_PAIRS = near.MANY_PAIRS, most
            try:
                return np.asarray(run(*scene))
            finally:
                near.MANY_PAIRS = before

        return call

    return make(10**9), make(0)


def text_for(platform, function, *args):
    """The program of a function for a platform that may be absent here."""
    with contextlib.ExitStack() as stack:
        if platform == "cuda" and jax.__version_info__ >= (0, 11):
            device = jax.sharding.AbstractDevice("NVIDIA H100", None, "gpu")
            mesh = jax.sharding.AbstractMesh((1,), ("lot",), abstract_device=device)
            stack.enter_context(jax.sharding.use_abstract_mesh(mesh))
        traced = jax.jit(function).trace(*args)
        return traced.lower(lowering_platforms=(platform,)).as_text()
