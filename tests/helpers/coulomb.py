"""Cars on four locked Coulomb wheels in the plane, apart from MuJoCo and JAX."""

import numpy as np

from carpark_mj.vehicle.parameters import GRAVITY

STICK = 1e-3  # m/s, below which friction falls off, so that a car comes to rest


def slide(params, pose, rates, seconds, dt=2e-4):
    """Poses (n, 3) of rear axles after n slides.

    Args:
        params: the cars; their wheels bear their loads at rest.
        pose: (n, 3) of the rear axles at the start [m, m, rad].
        rates: (n, 3) of them.
        seconds: how long.
        dt: time step [s].
    """
    pose, rates = np.asarray(pose, float), np.asarray(rates, float)
    ahead, base = params.cg_to_rear_axle, params.wheelbase
    x = np.array([base, base, 0.0, 0.0]) - ahead
    y = np.array([1.0, -1.0, 1.0, -1.0]) * params.track_width / 2
    share = np.array([ahead, ahead, base - ahead, base - ahead]) / (2 * base)
    grip = params.tyre.friction * params.mass * GRAVITY * share
    nose, yaw, turn = np.exp(1j * pose[:, 2]), pose[:, 2], rates[:, 2]  # complex plane
    centre = pose[:, 0] + 1j * pose[:, 1] + ahead * nose
    velocity = rates[:, 0] + 1j * rates[:, 1] + 1j * turn * ahead * nose
    for _ in range(round(seconds / dt)):
        nose = np.exp(1j * yaw)
        arm = nose[:, None] * (x + 1j * y)
        slip = velocity[:, None] + 1j * turn[:, None] * arm
        force = -grip * slip / np.maximum(np.abs(slip), STICK)
        moment = (arm.conj() * force).imag.sum(-1)
        velocity = velocity + dt * force.sum(-1) / params.mass
        turn = turn + dt * moment / params.yaw_inertia
        centre, yaw = centre + dt * velocity, yaw + dt * turn
    axle = centre - ahead * np.exp(1j * yaw)
    return np.stack([axle.real, axle.imag, yaw], axis=-1)
