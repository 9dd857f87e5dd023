"""Shared by all tests: JAX on the CPU, and the one car most of them drive."""

import os

os.environ["JAX_PLATFORMS"] = "cpu"

from carpark_mj.rendering.gl import choose_gl

choose_gl()  # before anything imports MuJoCo

import pytest

from carpark_mj.vehicle import COMPACT, Vehicle, make_vehicle


@pytest.fixture(scope="session")
def compact() -> Vehicle:
    return make_vehicle(COMPACT)
