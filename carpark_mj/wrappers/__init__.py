"""Adapters to other libraries; each imports its target only in its own file."""

# Before Brax, which would import MJX too: this one is quiet about missing Warp.
import carpark_mj.physics.mjx  # noqa: F401  # pyright: ignore[reportUnusedImport]
