"""Shared by all tests: JAX on the CPU, its compilation cache, and the one car most
of them drive."""

import atexit
import os
import shutil
import tempfile
from collections.abc import Iterator

os.environ["JAX_PLATFORMS"] = "cpu"
# Most of the time goes into compiling programs that run once: a third less of it.
quick = "--xla_backend_optimization_level=0"
os.environ["XLA_FLAGS"] = f"{quick} {os.environ.get('XLA_FLAGS', '')}".strip()
if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
    # Of this session only, and of all its processes: the same programs come again.
    cache = tempfile.mkdtemp(prefix="carpark_mj_tests_")
    os.environ["JAX_COMPILATION_CACHE_DIR"] = cache
    atexit.register(shutil.rmtree, cache, ignore_errors=True)

from carpark_mj.rendering.gl import choose_gl

choose_gl()  # before anything imports MuJoCo

import jax
import pytest

from carpark_mj.vehicle import COMPACT, Vehicle, make_vehicle


@pytest.fixture(scope="module", autouse=True)
def released_programs() -> Iterator[None]:
    """Releases a file's compiled programs behind it.

    Each takes tens of memory maps, of which Linux allows a process 65,530: beyond
    them the next program to load ends it with a segmentation fault.
    """
    yield
    jax.clear_caches()


@pytest.fixture(scope="session")
def compact() -> Vehicle:
    return make_vehicle(COMPACT)
