"""Contact wheels in MJX: against C MuJoCo, against formulas, and locked."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from carpark_mj.config import SimConfig
from carpark_mj.physics.mjx_step import ContactPhysics, axle_friction
from carpark_mj.vehicle import COMPACT, make_vehicle, preset
from vehicle_suite.in_c import CCar

SIM = SimConfig(sim_dt=0.004, ctrl_dt=0.02, trace_dt=0.02, tyres="contact")
START = (1.0, 2.0, 0.3)


def pedals(*stretches):
    """Controls (T, 2) from (seconds, steer, pedal)."""
    return np.concatenate(
        [np.tile([s, p], (round(t / SIM.ctrl_dt), 1)) for t, s, p in stretches]
    ).astype(np.float32)


CASES = {  # 5 s each
    "turn": pedals((2.5, 0.8, 0.5), (1.5, -0.4, 0.2), (0.5, 0.0, -1.0), (0.5, 0, 0)),
    "stop": pedals((2.0, 0.0, 1.0), (0.68, 0.0, -1.0), (2.32, 0.0, 0.0)),
    "rest": pedals((5.0, 0.0, 0.0)),
}


@functools.cache
def driven():
    """Poses (cases, T, 3) and speeds (cases, T) in MJX, all cases in one batch."""
    physics = ContactPhysics(SIM)
    vehicle = make_vehicle(COMPACT)
    controls = jnp.array(np.stack(list(CASES.values()), axis=1))
    count = len(CASES)
    fleet = jax.tree.map(lambda x: jnp.broadcast_to(x, (count, *x.shape)), vehicle)
    state = physics.init(jnp.tile(jnp.array(START), (count, 1)), fleet)

    def step(state, control):
        state = physics.step(state, control)
        read = physics.read(state)
        return state, (read.pose_w, read.speed, state.qpos[..., 2])

    _, out = jax.jit(lambda s: jax.lax.scan(step, s, controls))(state)
    return [np.asarray(x).swapaxes(0, 1) for x in out]


def test_five_seconds_with_a_braked_turn_agree_with_c_mujoco():
    poses = driven()[0][list(CASES).index("turn")]
    expected = CCar(COMPACT, SIM, START).drive(CASES["turn"])
    assert np.linalg.norm(expected[-1, :2] - expected[0, :2]) > 2.0
    assert np.abs(poses - expected).max() < 1e-3


def test_full_braking_stops_by_the_formula_without_a_throw():
    pose, speed, height = (x[list(CASES).index("stop")] for x in driven())
    begin = round(2.0 / SIM.ctrl_dt) - 1
    top = speed[begin]
    assert top > 2.5
    way = np.linalg.norm(pose[-1, :2] - pose[begin, :2])
    assert way == pytest.approx(top**2 / (2 * COMPACT.max_deceleration), rel=0.08)
    assert abs(speed[-1]) < 1e-3
    assert speed.min() > -0.05  # not thrown backwards
    assert np.abs(height).max() < 5e-3


def test_a_car_at_rest_stays_at_rest():
    pose = driven()[0][list(CASES).index("rest")]
    assert np.abs(pose[-1] - pose[0]).max() < 1e-4


def test_friction_of_the_axles_is_rolling_resistance_and_brake():
    vehicle = make_vehicle(preset("van"))
    loss = axle_friction(vehicle, jnp.array([10.0, 10.0, 0.0, 0.0]))
    van = preset("van")
    rolling = van.tyre.rolling_resistance * van.mass * 9.81 * van.wheel_radius
    assert float(loss.sum()) == pytest.approx(rolling + 20.0, rel=1e-5)
