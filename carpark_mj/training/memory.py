"""Refuses sizes that do not fit into memory, before an allocation ends the process."""

import math
import os
from typing import Any

import jax


def num_bytes(tree: Any) -> int:
    """Size of a pytree of arrays, or of their shapes."""
    return sum(
        math.prod(leaf.shape) * leaf.dtype.itemsize for leaf in jax.tree.leaves(tree)
    )


def device_memory() -> int:
    """Bytes of all local devices together; on CPUs, of the machine."""
    stats = [device.memory_stats() for device in jax.local_devices()]
    if jax.default_backend() != "cpu" and all(stats):
        return sum(stat["bytes_limit"] for stat in stats if stat)
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def require_memory(needed: int, largest: str = "num_lots") -> None:
    """Refuses sizes that need more memory than available.

    Args:
        needed: least memory needed [bytes].
        largest: the setting to lower first.

    Raises:
        ValueError: less memory is available.
    """
    available = device_memory()
    if needed > available:
        raise ValueError(
            f"these sizes need {needed / 2**30:.3g} GiB of memory at least, there are "
            f"{available / 2**30:.3g} GiB: lower {largest}, or the largest of "
            "the others"
        )
