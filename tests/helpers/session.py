"""Shared by all tests: JAX on the CPU, its compilation cache, and the one car most
of them drive."""

import contextlib
import gc
import hashlib
import importlib.metadata
import os
import platform
import shutil
from pathlib import Path

os.environ["JAX_PLATFORMS"] = os.environ.get("TEST_PLATFORM", "cpu")
# Most of the time goes into compiling programs that run once. A third of it is enough:
# no optimisation, no second thread, XLA's older and quicker emitter of fused
# operations, and no record of the Python lines that operations come from.
quick = (
    "--xla_backend_optimization_level=0 --xla_cpu_parallel_codegen_split_count=1 "
    "--xla_backend_extra_options=xla_cpu_disable_new_fusion_emitters"
)
os.environ["XLA_FLAGS"] = f"{quick} {os.environ.get('XLA_FLAGS', '')}".strip()
os.environ["JAX_TRACEBACK_IN_LOCATIONS_LIMIT"] = "0"
gc.set_threshold(200_000, 20, 50)  # tracing makes many objects, few of them garbage
MAX_MAPS = 4000  # memory maps of a process between files, 2 GB [est]
MAX_KEPT = 2e9  # bytes of compiled programs; a run leaves 0.1e9


def kept_programs():
    """Folder of compiled programs, for all runs with this JAX on such a processor."""
    processor = platform.processor()
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        processor = next(line for line in lines if line.startswith("flags"))
    code = importlib.metadata.version("jaxlib") + platform.machine() + processor
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    digest = hashlib.sha256(code.encode()).hexdigest()[:12]
    return home / "carpark_mj" / "tests" / digest


if "JAX_COMPILATION_CACHE_DIR" not in os.environ:  # the workers inherit it
    kept = kept_programs()
    if sum(file.stat().st_size for file in kept.glob("*")) > MAX_KEPT:
        shutil.rmtree(kept, ignore_errors=True)
    os.environ["JAX_COMPILATION_CACHE_DIR"] = str(kept)
# Small programs too: reading one takes a tenth of compiling it, and workers share them.
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")

from carpark_mj.rendering.gl import choose_gl

choose_gl()  # before anything imports MuJoCo

import jax
import pytest

from carpark_mj.vehicle import COMPACT, make_vehicle

LONG = {"integration", "training", "wrappers", "policy"}  # folders of long files


def pytest_collection_modifyitems(items):
    """Begins with the slow files: no process has one left when the others are done."""
    items.sort(key=lambda item: LONG.isdisjoint(item.path.parts))


@pytest.fixture(scope="module", autouse=True)
def released_programs():
    """Releases compiled programs between two files where there are many.

    Files share the small programs of single operations. Each program takes tens of
    memory maps, of which Linux allows a process 65,530: beyond them the next program to
    load ends it with a segmentation fault.
    """
    yield
    maps = Path("/proc/self/maps")
    if not maps.exists() or maps.read_bytes().count(b"\n") > MAX_MAPS:
        jax.clear_caches()


@pytest.fixture(scope="session")
def compact():
    return make_vehicle(COMPACT)
