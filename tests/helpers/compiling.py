"""Programs that run longer than they compile."""

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
