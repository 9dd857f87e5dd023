"""Adapters to other libraries; each imports its target only in its own file."""

from carpark_mj.rendering.gl import choose_gl

choose_gl()  # before anything imports MuJoCo
