"""Gradients of a drive from rest with regard to its controls: central differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from carpark_mj.config import SimConfig
from carpark_mj.physics import unrolled as kernel
from carpark_mj.physics.bicycle import BicyclePhysics
from carpark_mj.physics.mjx import MjxPhysics

PROBE = 1e-5  # of the controls
CONTROLS = np.array([[0.3, 0.6], [-0.2, 0.5]])  # 0.4 s, pulling away


@pytest.mark.parametrize(
    "physics", [BicyclePhysics, pytest.param(MjxPhysics, marks=pytest.mark.slow)]
)
def test_gradients_of_the_final_pose_are_central_differences(physics, compact):
    with jax.enable_x64(True):
        cars = physics(SimConfig())
        vehicle = jax.tree.map(lambda x: jnp.asarray(x, jnp.float64), compact)
        start = cars.init(jnp.array([1.0, 2.0, 0.5]), vehicle)

        @jax.jit
        def end(controls):
            def step(state, control):
                return cars.step(state, control), None

            pose = cars.read(jax.lax.scan(step, start, controls)[0]).pose_w
            return jnp.dot(pose, jnp.array([1.0, 2.0, 3.0]))

        found = jax.jit(jax.grad(end))(jnp.array(CONTROLS))
        for entry in np.ndindex(CONTROLS.shape):
            step = np.zeros_like(CONTROLS)
            step[entry] = PROBE
            gained = end(CONTROLS + step) - end(CONTROLS - step)
            assert found[entry] == pytest.approx(float(gained) / (2 * PROBE), abs=1e-8)
        assert abs(found[0, 1]) > 0.1  # m for the whole pedal


def test_the_kernel_for_gpus_has_the_gradient_of_the_loop(monkeypatch, compact):
    monkeypatch.setattr(kernel, "has_triton", lambda: True)
    cars = MjxPhysics(SimConfig())
    start = cars.init(jnp.zeros(3), compact)

    def end(controls):
        return cars.step(start, controls).trace_w.sum()

    traced = jax.jit(jax.grad(end)).trace(jnp.zeros(2))
    assert "triton" not in traced.lower(lowering_platforms=("cuda",)).as_text()
