"""The unrolled step against `mjx.step`."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from carpark_mj.config import RandomizationConfig, SimConfig
from carpark_mj.physics.mjx import MjxPhysics
from carpark_mj.physics.mjx_step import ContactPhysics, MjxStep
from carpark_mj.physics.unrolled import UnrolledStep
from carpark_mj.spawning.randomization import randomize_all
from carpark_mj.vehicle import PRESETS, make_vehicle
from vehicle_suite.shipped import drive

VARIED = RandomizationConfig(
    mass=(0.75, 1.25),
    cg_x=(0.9, 1.1),
    cg_height=(0.8, 1.2),
    friction=(0.6, 1.1),
    tyre_stiffness=(0.7, 1.3),
    steering_offset=(-0.03, 0.03),
    steering_lag=(0.0, 0.3),
)


def driven(stepper: str, x64: bool, **ground) -> np.ndarray:
    """Five seconds of random driving of all presets, as they are and randomized.

    Returns:
        (25, 12, 25) `qpos` and `qvel` after every control step.
    """
    with jax.enable_x64(x64):
        cars = [make_vehicle(params) for params in PRESETS.values()]
        fleet = jax.tree.map(lambda *x: jnp.stack(x), *cars)
        varied = randomize_all(VARIED, fleet, jax.random.key(0))
        fleet = jax.tree.map(lambda *x: jnp.concatenate(x), fleet, varied)
        rng, count = np.random.default_rng(0), 2 * len(cars)
        poses = rng.normal(size=(count, 3))
        controls = rng.uniform(-1, 1, (25, count, 2))
        sim = SimConfig(stepper=stepper, **ground)
        _, qpos, qvel = drive(sim, fleet, controls, pose=poses)
        return np.concatenate([qpos, qvel], -1)


@pytest.mark.parametrize(
    ("x64", "tolerance", "ground"),
    [
        # Metres, radians and their rates on paths of 2 m; wheels turn by 7 rad.
        # Measured 3e-6 and 6e-13.
        pytest.param(False, 3e-5, {}, id="float32-dry"),
        pytest.param(
            True,
            1e-11,
            {"surface": "ice", "grade_x": 0.1, "ramp": (-0.5, 0.5, 0.05)},
            id="float64-ice-slope-ramp",
        ),
    ],
)
def test_five_seconds_of_driving_agree_with_mjx(x64, tolerance, ground):
    ours, expected = (driven(name, x64, **ground) for name in ("unrolled", "mjx"))
    assert np.abs(expected[-1, :, :2] - expected[0, :, :2]).max() > 0.5  # they moved
    assert np.abs(ours - expected).max() < tolerance


def test_brush_tyres_are_stepped_unrolled_by_default():
    steps = {"auto": UnrolledStep, "unrolled": UnrolledStep, "mjx": MjxStep}
    for stepper, kind in steps.items():
        assert isinstance(MjxPhysics(SimConfig(stepper=stepper))._step, kind)
    contact = SimConfig(sim_dt=0.004, tyres="contact")
    assert isinstance(ContactPhysics(contact)._step, MjxStep)
