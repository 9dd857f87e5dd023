"""Refuses sizes that cannot fit, before an allocation ends the process."""

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
    """Bytes of all local devices together, or of the machine where they are CPUs."""
    stats = [device.memory_stats() for device in jax.local_devices()]
    if jax.default_backend() != "cpu" and all(stats):
        return sum(stat["bytes_limit"] for stat in stats if stat)
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def require_memory(needed: int, largest: str = "num_lots") -> None:
    """Refuses what needs more memory than there is.

    Args:
        needed: memory needed at least [bytes].
        largest: the setting to lower first.

    Raises:
        ValueError: there are fewer.
    """
    available = device_memory()
    if needed > available:
        raise ValueError(
            f"these sizes need {needed / 2**30:.3g} GiB of memory at least, there are "
            f"{available / 2**30:.3g} GiB: lower {largest}, or the largest of "
            "the others"
        )
