"""Programs that run longer than they compile."""

import functools

import jax

# The tests' default is no optimisation (conftest.py): programs run up to 90 times as
# long, which only short ones do not feel.
optimized_jit = functools.partial(
    jax.jit, compiler_options={"xla_backend_optimization_level": 2}
)
