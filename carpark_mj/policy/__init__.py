"""Policies: networks, checkpoints and run folders."""

# Before Brax, which would import MJX too: this one is quiet about missing Warp.
import carpark_mj.physics.mjx_step  # noqa: F401  # pyright: ignore[reportUnusedImport]
