"""How JAX compiles: kept programs, no kernels that take XLA minutes, any mesh."""

import contextlib
import functools
import gc
import importlib.util
import os
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

P = ParamSpec("P")
R = TypeVar("R")

# On a GPU XLA tries fusions with reductions as Triton kernels, too. One kernel of the
# reset of 4,096 lots then compiles for two minutes, and is slower than XLA's own.
FUSION_AUTOTUNER = "xla_gpu_experimental_enable_fusion_autotuner"
SKIP_SLOW_KERNELS = f"--{FUSION_AUTOTUNER}=false"
# On a CPU XLA makes a function of each small loop, as those of random numbers are. As
# plain loops they share their kernels: programs with many compile in a third less time.
EXTRA_OPTIONS = "--xla_backend_extra_options="
SHARED_LOOPS = "xla_cpu_small_while_loop_byte_threshold=0"
SHARE_LOOPS = EXTRA_OPTIONS + SHARED_LOOPS
# XLA's older emitter of kernels compiles in two thirds to four fifths of the CPU time.
# One lot then steps as fast, many take half as long again.
ONE_LOT = f"{EXTRA_OPTIONS}xla_cpu_disable_new_fusion_emitters,{SHARED_LOOPS}"
GPU_PLUGINS = ("jax_cuda12_plugin", "jax_cuda13_plugin", "jax_rocm7_plugin")

# What takes longer to compile is kept [s]; JAX's own value leaves small programs out.
LEAST_TIME = 0.1
# More objects are exempt from garbage collection only where the user has called
# `gc.freeze`; Python 3.12 itself exempts hundreds.
FROZEN = 1000
_TIME = "jax_persistent_cache_min_compile_time_secs"


def choose_xla_flags() -> None:
    """Makes XLA compile faster, unless the user decides.

    On a GPU it does not try fusions as Triton kernels; on a CPU small loops share their
    kernels, where `XLA_FLAGS` is not set. Importing `carpark_mj.env` calls it, before
    JAX's first computation, when XLA reads `XLA_FLAGS`. Later it has no effect. A file
    that `XLA_FLAGS` names stays as it is.
    """
    flags = os.environ.setdefault("XLA_FLAGS", SHARE_LOOPS).strip()
    is_file = bool(flags) and not flags.startswith("--")
    decided = is_file or FUSION_AUTOTUNER in flags
    if not decided and any(map(importlib.util.find_spec, GPU_PLUGINS)):
        os.environ["XLA_FLAGS"] = f"{flags} {SKIP_SLOW_KERNELS}".strip()


def compile_for_one_lot() -> None:
    """Makes XLA on a CPU compile faster at the cost of batches; see `ONE_LOT`.

    Adapters of one lot and commands that show one call it. It has an effect before
    JAX's first computation, and none where the user has set `XLA_FLAGS`.
    """
    flags = os.environ.get("XLA_FLAGS", SHARE_LOOPS)
    os.environ["XLA_FLAGS"] = flags.replace(SHARE_LOOPS, ONE_LOT)


def keep_compiled_programs() -> None:
    """Turns JAX's persistent compilation cache on, unless the user has decided.

    Every `ParkingEnv` calls it. A folder that `JAX_COMPILATION_CACHE_DIR` or
    `jax.config` names stays as it is, `JAX_ENABLE_COMPILATION_CACHE=false` keeps no
    programs, and nothing happens where the folder cannot be written. Several processes
    may use the folder, and it may be deleted at any time.
    """
    import jax

    named = "JAX_COMPILATION_CACHE_DIR" in os.environ
    if named or jax.config.values["jax_compilation_cache_dir"]:
        return
    try:
        folder = cache_folder()
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except (OSError, RuntimeError):  # no home
        return
    if os.access(folder, os.W_OK | os.X_OK):
        if _TIME.upper() not in os.environ and jax.config.values[_TIME] == 1.0:
            jax.config.update(_TIME, LEAST_TIME)
        jax.config.update("jax_compilation_cache_dir", str(folder))


def cache_folder() -> Path:
    """Where programs are kept by default: `~/.cache/carpark_mj/jax`."""
    caches = Path(os.environ.get("XDG_CACHE_HOME", ""))
    if not caches.is_absolute():  # or not set
        caches = Path.home() / ".cache"
    return caches / "carpark_mj" / "jax"


@contextlib.contextmanager
def without_collection() -> Generator[None]:
    """Inside, Python's garbage collector rests, and takes what is new for old.

    Tracing makes hundreds of thousands of objects, which stay. Searching them for
    garbage would take a quarter of its time.
    """
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            if gc.get_freeze_count() < FROZEN:  # else those of the user would thaw
                gc.freeze()
                gc.unfreeze()  # into the oldest generation
            gc.enable()


def shard_automatically(function: Callable[P, R]) -> Callable[P, R]:
    """Leaves shardings within a function to XLA, on meshes with explicit axes too.

    There JAX asks every gather for the sharding of its result. Without the batch that
    `jax.vmap` adds, arrays of an environment are on all devices. Its other arguments
    may be of any type.
    """

    @functools.wraps(function)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> R:
        import jax
        from jax.sharding import AxisType, PartitionSpec

        if AxisType.Explicit not in jax.sharding.get_abstract_mesh().axis_types:
            return function(*args, **kwargs)
        leaves, tree = jax.tree.flatten((args, kwargs))
        places = [i for i, leaf in enumerate(leaves) if isinstance(leaf, jax.Array)]

        def of_arrays(arrays: list[Any]) -> Any:
            filled = dict(enumerate(leaves)) | dict(zip(places, arrays, strict=True))
            args, kwargs = jax.tree.unflatten(tree, list(filled.values()))
            return cast(Any, function)(*args, **kwargs)

        call: Any = jax.sharding.auto_axes(of_arrays, out_sharding=PartitionSpec())
        return call([leaves[i] for i in places])

    return wrapped
