"""Shared by all commands: one-line errors, XLA's flags and compilation cache."""

import contextlib
import os
import sys
from collections.abc import Callable, Generator
from pathlib import Path

USER_ERRORS = (ValueError, OSError, OverflowError, MemoryError)
MAX_EPISODES = 1_000_000  # of an evaluation: some kilobytes each are held in memory
MAX_SECONDS = 3600  # of a recording, or an evaluation's horizon, both held in memory
OUTPUT_FUSION = "--xla_backend_extra_options=xla_cpu_use_multi_output_fusion"
# What installs the packages that commands need beside the library's own.
EXTRAS = dict.fromkeys(
    ("tyro", "rich", "matplotlib", "tensorboardX", "imageio_ffmpeg", "scipy"),
    "train,eval",
) | {"submitit": "sweep", "vehiclemodels": "test"}


def one_line(error: BaseException) -> str:
    """An error as one line that names the file or the value."""
    if isinstance(error, OSError) and error.filename and error.strerror:
        return f"cannot use {error.filename}: {error.strerror}"
    if isinstance(error, OverflowError):
        return f"a number is too large: {error}"
    if isinstance(error, MemoryError) or "RESOURCE_EXHAUSTED" in str(error):
        reason = str(error).partition("\n")[0] or "allocation failed"
        return f"not enough memory, choose smaller sizes: {reason}"
    return " ".join(str(error).split())


def run_command(program: str, command: Callable[[], object]) -> int:
    """Runs a command; errors that the user can fix end it with one line on stderr.

    Args:
        program: name before the line.
        command: returns the exit code; any value but an int means 0. It imports
            modules that need packages of `EXTRAS`, so that a missing package is such an
            error.

    Returns:
        The exit code, 2 for such errors.
    """
    try:
        code = command()
    except Exception as error:
        message = _for_the_user(error)
        if message is None:
            raise
        print(f"{program}: {message}", file=sys.stderr)
        return 2
    return code if isinstance(code, int) else 0


def _for_the_user(error: Exception) -> str | None:
    """Message for an error that the user can fix; None for a bug."""
    if isinstance(error, (*USER_ERRORS, *_loaded_errors())):
        return one_line(error)
    if isinstance(error, ModuleNotFoundError):
        return _missing_extra(error)
    if isinstance(error, RuntimeError) and "RESOURCE_EXHAUSTED" in str(error):
        return one_line(error)
    return _missing_device()


def _missing_extra(error: ModuleNotFoundError) -> str | None:
    extra = EXTRAS.get((error.name or "").partition(".")[0])
    return extra and f'{error}: pip install "carpark_mj[{extra}]"'


@contextlib.contextmanager
def naming_extras() -> Generator[None]:
    """Names the extra to install if an import inside misses a package of `EXTRAS`.

    Raises:
        ImportError: a package is missing.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        message = _missing_extra(error)
        if message is None:
            raise
        raise ImportError(message, name=error.name) from None


def _loaded_errors() -> tuple[type[Exception], ...]:
    """The library's own errors that the user can fix.

    They are not imported here: if JAX or MuJoCo cannot be imported, that is the error.
    """
    homes = {
        "carpark_mj.policy.checkpoints": "CheckpointError",
        "carpark_mj.rendering.renderer": "RenderingError",
    }
    found = [getattr(sys.modules.get(h), name, None) for h, name in homes.items()]
    return tuple(error for error in found if error is not None)


def _missing_device() -> str | None:
    """Message if JAX does not find a device that the user has requested.

    JAX fails in many ways then, sometimes without a message.
    """
    names = ("JAX_PLATFORMS", "JAX_NUM_CPU_DEVICES")
    asked = [f"{name}={os.environ[name]}" for name in names if os.environ.get(name)]
    jax = sys.modules.get("jax")
    if not asked or jax is None:
        return None
    try:
        jax.devices()
    except Exception as error:
        reason = str(error).partition("\n")[0] or "there is none"
        return f"JAX finds no device with {', '.join(asked)}: {reason}"
    return None


def enable_output_fusion() -> None:
    """Makes XLA on a CPU share results between loops, as on GPUs.

    Call it before JAX's first computation, when XLA reads `XLA_FLAGS`. It keeps a value
    that the user has set.
    """
    os.environ.setdefault("XLA_FLAGS", OUTPUT_FUSION)


def dispatch_synchronously() -> None:
    """Makes JAX on a CPU run programs in the thread that calls them.

    A program whose arguments are not ready yet runs in a thread of XLA's pool instead.
    On one core that is the pool's only thread, and a callback (the planner, `scene`
    physics) waits there for ever for arrays above 100 kB, which JAX copies in the pool
    (jax-ml/jax#25861). Call it before JAX's first computation.
    """
    import jax

    jax.config.update("jax_cpu_enable_async_dispatch", False)


def configure_jax() -> None:
    """One CPU device per core, over which trainers shard the lots; fused outputs."""
    import jax

    enable_output_fusion()
    cores = len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count()
    if cores == 1:
        dispatch_synchronously()
    if "JAX_NUM_CPU_DEVICES" not in os.environ:
        jax.config.update("jax_num_cpu_devices", cores or 1)


def keep_compiled_programs() -> None:
    """Turns JAX's persistent compilation cache on, in the user's cache folder."""
    import jax

    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        cache = Path.home() / ".cache" / "carpark_mj" / "jax"
        jax.config.update("jax_compilation_cache_dir", str(cache))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 1.0)
