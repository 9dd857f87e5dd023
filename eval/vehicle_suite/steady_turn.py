"""The steady turn of a two-track car on brush tyres, solved from its balances.

Source: Pacejka, Tyre and Vehicle Dynamics (2012), ch. 1.3 (steady turns) and 3 (brush).
"""

import dataclasses
import math

import numpy as np
from scipy import optimize

from carpark_mj.vehicle.mjcf import STEER_STIFFNESS
from carpark_mj.vehicle.parameters import GRAVITY, VehicleParameters
from vehicle_suite.formulas import (
    axle_loads,
    axle_stiffness,
    front_wheel_angles,
    lateral_load_transfer,
)


@dataclasses.dataclass(frozen=True)
class Turn:
    """A steady turn: rear-axle radius [m], wheels' drag to be driven against [N]."""

    radius: float
    drag: float


def steady_turn(
    params: VehicleParameters,
    steering: float,
    speed: float,
    locked: bool = False,
    factors: tuple[float, float] = (1.0, 1.0),
) -> Turn:
    """Steady turn of the two-track car on brush tyres with scrub torque.

    Solves the three balances (along, across, about the rear axle) for side velocity,
    yaw rate and drive force. Each wheel's force follows from its own slip angle and
    load, its scrub moment k_t sigma_t omega / |v_i| from the twist of the patch, which
    also twists the steering servos. The wheels of a locked axle turn at one speed, and
    their forces follow from their slip.

    Args:
        params: the car.
        steering: commanded bicycle angle [rad], left.
        speed: of the rear axle along the car [m/s], negative in reverse.
        locked: the driven wheels turn as one.
        factors: on the cornering stiffness, front and rear.
    """
    tyre, way = params.tyre, math.copysign(1.0, speed)
    x = np.array([params.wheelbase, params.wheelbase, 0.0, 0.0])
    y = params.track_width / 2 * np.array([1.0, -1.0, 1.0, -1.0])
    static = np.repeat(axle_loads(params), 2) / 2
    cornering = np.repeat(axle_stiffness(params, factors), 2) / 2
    share = np.repeat([params.front_drive, 1.0 - params.front_drive], 2) / 2
    axle = np.where(share > 0, 1.0, 0.0) * float(locked)
    command = np.array([*front_wheel_angles(params, steering), 0.0, 0.0])

    def balance(unknown: np.ndarray) -> tuple[np.ndarray, float]:
        side, yaw_rate, drive = unknown[0], unknown[1], unknown[2]
        shift = lateral_load_transfer(params, speed * yaw_rate) / 2
        load = static - np.sign(y) * shift
        forward, left = speed - yaw_rate * y, side + yaw_rate * x
        along = forward * np.cos(command) + left * np.sin(command)
        twist = tyre.torsion_relaxation * yaw_rate / np.abs(along)
        scrub_limit = tyre.friction * 2 / 3 * tyre.patch_radius * load
        scrub = -scrub_limit * np.clip(twist / tyre.torsion_yield, -1, 1)
        angle = command + np.where(x > 0, scrub / STEER_STIFFNESS, 0.0)
        cos, sin = np.cos(angle), np.sin(angle)
        along, across = forward * cos + left * sin, left * cos - forward * sin
        rolling = way * tyre.rolling_resistance * load
        # Unknown of a locked axle is its speed, else the drive force; both about 1.
        slip_x = axle * (speed * (1 + drive / 100) - along) / np.abs(along)
        slip_y = -across / np.abs(along)
        pull = tyre.slip_stiffness * static * slip_x
        push = cornering * slip_y
        limit = tyre.friction * load
        shape = np.array(
            [
                brush_shape(v, m)
                for v, m in zip(np.hypot(pull, push), limit, strict=True)
            ]
        )
        given = share * drive * params.mass - rolling
        force_x = np.where(axle > 0, pull * shape, given)
        force_y = push * shape
        total_x = force_x * cos - force_y * sin
        total_y = force_x * sin + force_y * cos
        arm = params.cg_to_rear_axle
        rest = np.array(
            [
                total_x.sum() + params.mass * yaw_rate * (side + arm * yaw_rate),
                total_y.sum() - params.mass * yaw_rate * speed,
                (x * total_y - y * total_x + scrub).sum()
                - params.mass * arm * yaw_rate * speed,
            ]
        )
        drag = way * np.sum((force_x + rolling) * (share > 0))
        return rest / static.sum(), float(drag)

    yaw_rate = speed * math.tan(steering) / params.wheelbase
    guess = np.array([0.0, yaw_rate, way * GRAVITY / 50])
    solved = optimize.root(lambda unknown: balance(unknown)[0], guess, tol=1e-12)
    if not solved.success:
        raise ValueError(f"no steady turn at {math.degrees(steering):.1f} deg, {speed}")
    side, yaw_rate, _ = solved.x
    return Turn(abs(math.hypot(speed, side) / yaw_rate), balance(solved.x)[1])


def brush_shape(linear: float, limit: float) -> float:
    """Brush force over its linear part C s: 1 - s/3 + s^2/27, at most the limit."""
    s = max(abs(linear) / limit, 1e-12)
    capped = min(s, 3.0)
    return (1 - capped / 3 + capped**2 / 27) * capped / s


def brush_slip(force: float, stiffness: float, limit: float) -> float:
    """Slip at which a brush of slip stiffness C [N] gives a force below its limit [N].

    Inverse of F = limit (s - s^2/3 + s^3/27), C slip = limit s.
    """
    return 3 * (1 - (1 - abs(force) / limit) ** (1 / 3)) * limit / stiffness
