"""Compares policies on the held-out hard cases: `carpark_mj suite POLICY…`."""

import importlib
from collections.abc import Sequence

from carpark_mj.rendering.gl import choose_gl


def run(arguments: Sequence[str] | None = None) -> object:
    """Runs the suite of HOPE's levels; returns what it returns."""
    choose_gl()  # before the study imports MuJoCo
    program = importlib.import_module("carpark_mj.studies.hope.program")
    return program.run(arguments)
