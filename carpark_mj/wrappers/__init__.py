"""Adapters to other libraries; each imports its target only in its own file."""

from carpark_mj.rendering.gl import choose_gl

choose_gl()  # before anything imports MuJoCo

# Before Brax, which would import MJX too: this one is quiet about missing Warp.
import carpark_mj.physics.mjx_step  # noqa: E402, F401  # pyright: ignore[reportUnusedImport]
