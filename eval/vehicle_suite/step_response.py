"""The yaw response of the linear car to a step of the steering.

Source: Pacejka, Tyre and Vehicle Dynamics (2012), ch. 1.3.2 (single
track), 1.3.4 (roll) and 7.2 (relaxing tyres).
"""

import numpy as np
from scipy import linalg

from carpark_mj.vehicle.parameters import GRAVITY, VehicleParameters
from vehicle_suite.formulas import axle_stiffness


def step_response(
    params: VehicleParameters, speed: float, time: np.ndarray
) -> np.ndarray:
    """Yaw rate (T,) per steering angle [1/s] after a step of the front wheels at t = 0.

    Linear single-track car with roll about an axis on the ground and relaxing tyres:
    states v_y, yaw rate, roll angle and rate, and the bristles w of the axles,
    dw/dt = v_contact - v w / sigma, F = -(C / sigma w + d dw/dt).
    """
    m, v, h = params.mass, speed, params.cg_height
    a, b = params.cg_to_front_axle, params.cg_to_rear_axle
    tyre = params.tyre
    k_w = np.array(axle_stiffness(params)) / tyre.lateral_relaxation
    d_w, rate = 2 * tyre.lateral_damping, v / tyre.lateral_relaxation
    roll_stiffness = tyre.vertical_stiffness * params.track_width**2
    roll_damping = tyre.vertical_damping * params.track_width**2
    # Bristle rates and axle forces as rows over (v_y, r, phi, phi', w_f, w_r, delta).
    w_rate = np.array(
        [[1, a, 0, 0, -rate, 0, -v], [1, -b, 0, 0, 0, -rate, 0]], dtype=float
    )
    force = -d_w * w_rate
    force[0, 4] -= k_w[0]
    force[1, 5] -= k_w[1]
    # m (v_y' + v r - h phi'') = F and I phi'' = h F + (m g h - k) phi - c phi'.
    spring = np.array(
        [0, 0, m * GRAVITY * h - roll_stiffness, -roll_damping, 0, 0, 0], dtype=float
    )
    total = force.sum(0)
    roll_rate = (h * total + spring) / params.roll_inertia
    side = total / m + h * roll_rate
    side[1] -= v
    yaw = (a * force[0] - b * force[1]) / params.yaw_inertia
    roll = np.array([0, 0, 0, 1, 0, 0, 0], dtype=float)
    system = np.vstack([side, yaw, roll, roll_rate, w_rate, np.zeros(7)])
    step = linalg.expm(system * (time[1] - time[0]))
    state, found = np.array([0, 0, 0, 0, 0, 0, 1.0]), []
    for _ in time:
        found.append(state[1])
        state = step @ state
    return np.array(found)
