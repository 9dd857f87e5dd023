"""What all commands share: errors in one line, compiled programs kept on disk."""

import os
from pathlib import Path

USER_ERRORS = (ValueError, OSError, OverflowError)


def one_line(error: BaseException) -> str:
    """What went wrong, in a line that names the file or the value."""
    if isinstance(error, OSError) and error.filename and error.strerror:
        return f"cannot use {error.filename}: {error.strerror}"
    if isinstance(error, OverflowError):
        return f"a number is too large, the seed perhaps: {error}"
    return " ".join(str(error).split())


def keep_compiled_programs() -> None:
    """Turns JAX's persistent compilation cache on, in the user's cache folder."""
    import jax

    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        cache = Path.home() / ".cache" / "carpark_mj" / "jax"
        jax.config.update("jax_compilation_cache_dir", str(cache))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 1.0)
