"""Callbacks of programs on one core, which must not wait for themselves."""

import os
import subprocess
import sys

import pytest

# A program whose argument is still being computed, and callbacks with 1 MB.
PROGRAM = """
import os
os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
from carpark_mj.cli.process import dispatch_synchronously
dispatch_synchronously()
import jax, jax.numpy as jnp, numpy as np

def step(x, _):
    shape = jax.ShapeDtypeStruct((), jnp.float32)
    seen = jax.pure_callback(lambda y: np.asarray(y)[0], shape, jnp.sin(x))
    return x + seen, None

run = jax.jit(lambda x: jax.lax.scan(step, x, None, 20)[0])
for seed in range(40):
    x = jax.random.normal(jax.random.key(seed), (250_000,))
    run(x).block_until_ready()
print("ended")
"""


@pytest.mark.skipif(
    not hasattr(os, "sched_setaffinity"), reason="processes keep to no core here"
)
def test_callbacks_with_large_arrays_end_on_one_core():
    command = [sys.executable, "-c", PROGRAM]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.stdout == "ended\n", done.stderr
