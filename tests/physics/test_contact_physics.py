"""Contact wheels in MJX: against C MuJoCo, against formulas, and locked."""

import functools
import math

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from carpark_mj.config import SimConfig
from carpark_mj.physics.mjx_step import ContactPhysics, axle_friction, contact_car_model
from carpark_mj.vehicle import COMPACT, drive, make_vehicle, preset

SIM = SimConfig(sim_dt=0.004, ctrl_dt=0.02, trace_dt=0.02, tyres="contact")


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
    state = physics.init(jnp.tile(jnp.array([1.0, 2.0, 0.3]), (count, 1)), fleet)

    def step(state, control):
        state = physics.step(state, control)
        read = physics.read(state)
        return state, (read.pose_w, read.speed, state.qpos[..., 2])

    _, out = jax.jit(lambda s: jax.lax.scan(step, s, controls))(state)
    return [np.asarray(x).swapaxes(0, 1) for x in out]


def in_c(controls):
    """The same in C MuJoCo; poses (T, 3) of the footprint."""
    model = contact_car_model(COMPACT, SIM)
    data = mujoco.MjData(model)
    yaw, vehicle = 0.3, make_vehicle(COMPACT)
    offset = COMPACT.centre_offset
    data.qpos[:2] = 1.0 - offset * math.cos(yaw), 2.0 - offset * math.sin(yaw)
    data.qpos[3:7] = math.cos(yaw / 2), 0, 0, math.sin(yaw / 2)
    spin = [model.joint(f"spin_{w}").dofadr[0] for w in ("fl", "fr", "rl", "rr")]
    actuate = jax.jit(functools.partial(drive.actuate, vehicle, dt=SIM.sim_dt))
    friction = jax.jit(functools.partial(axle_friction, vehicle))
    actuators, poses = drive.init_actuators(vehicle), []
    for control in controls:
        for _ in range(SIM.num_substeps):
            w, x, y, z = data.qpos[3:7]
            ahead = 1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)
            rolled = COMPACT.wheel_radius * (data.qvel[spin] @ vehicle.drive_share)
            speeds = np.array(ahead) @ data.qvel[:3], rolled
            actuators, ctrl, brake = actuate(actuators, tuple(control), *speeds)
            data.ctrl[:] = ctrl
            data.qfrc_applied[spin] = actuators.drive * vehicle.drive_share
            model.dof_frictionloss[spin] = friction(brake * vehicle.brake_share)
            data.qacc_warmstart[:] = 0.0
            mujoco.mj_step(model, data)
        w, x, y, z = data.qpos[3:7]
        heading = math.atan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))
        x, y = data.qpos[:2] + offset * np.array([math.cos(heading), math.sin(heading)])
        poses.append([x, y, heading])
    return np.array(poses)


def test_five_seconds_with_a_braked_turn_agree_with_c_mujoco():
    poses = driven()[0][list(CASES).index("turn")]
    expected = in_c(CASES["turn"])
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
