"""The CommonRoad vehicle models as a reference: their car as ours, their solutions.

Source: M. Althoff, G. Würsching, CommonRoad: Vehicle Models (2020); parameter set 2 is
a BMW 320i, its tyres a Magic Formula fit from the ADAMS handbook. KS is the kinematic
single track, STD the single track with drift (Magic Formula, load transfer), MB the
multi-body model (suspended masses, roll, pitch, four wheels).
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy import integrate

from carpark_mj.vehicle import COMPACT, VehicleParameters
from vehicle_suite.runs import Run
from vehicle_suite.tracks import Track

Inputs = Callable[[float], tuple[float, float]]  # steering angle [rad], m/s^2 asked


@dataclasses.dataclass(frozen=True)
class Path:
    """Trajectory of a reference model's car, (n,) instants.

    Attributes:
        time: (n,) [s].
        position: (n, 2) of its reference point [m].
        yaw: (n,) [rad].
    """

    time: np.ndarray
    position: np.ndarray
    yaw: np.ndarray


def published_set() -> Any:
    """Parameter set 2 of the package."""
    from vehiclemodels.parameters_vehicle2 import parameters_vehicle2

    return parameters_vehicle2()


def our_car(ackermann: float = 0.0) -> VehicleParameters:
    """The published set as our car, as far as the models allow.

    Taken over: masses, wheelbase, centre of gravity, inertias, mean track, wheel
    radius and inertia, brake and drive split, initial slopes p_ky1 and p_kx1 and
    lateral peak p_dy1 of the tyres; suspension and tyre springs in series, mean of the
    axles. MB steers both front wheels by the same angle (`ackermann` 0). Its tyres have
    neither relaxation nor rolling resistance nor scrub torque: ours get as little as
    the equations allow. Their steering limit of 61 deg is not a BMW's; it is not used.
    """
    p = published_set()
    wheelbase = p.a + p.b
    axle = p.m_uf / 2
    knuckle = 6.0  # kg, what of the unsprung mass is steered does not matter here
    height, lift = p.h_cg, (p.h_s - p.h_cg) ** 2
    lower = (p.h_cg - p.R_w) ** 2
    # Whole car about its centre of gravity: sprung mass and the two axles.
    roll = p.I_Phi_s + p.m_s * lift + 2 * p.I_uf + 2 * p.m_uf * lower
    pitch = p.I_y_s + p.m_s * lift + p.m_uf * (p.a**2 + p.b**2 + 2 * lower)
    front = 1 / (1 / p.K_sf + 1 / p.K_zt)
    rear = 1 / (1 / p.K_sr + 1 / p.K_zt)
    tyre = dataclasses.replace(
        COMPACT.tyre,
        friction=p.tire.p_dy1,
        cornering_stiffness=-p.tire.p_ky1,
        slip_stiffness=p.tire.p_kx1,
        lateral_relaxation=0.1,
        longitudinal_relaxation=0.1,
        patch_radius=1e-4,
        rolling_resistance=1e-6,
        vertical_stiffness=(front + rear) / 2,
        vertical_damping=(p.K_sdf + p.K_sdr) / 2,
    )
    return dataclasses.replace(
        COMPACT,
        length=p.l,
        width=p.w,
        wheelbase=wheelbase,
        track_width=(p.T_f + p.T_r) / 2,
        rear_overhang=0.95,
        mass=p.m,
        cg_to_front_axle=p.a,
        cg_height=height,
        roll_inertia=roll,
        pitch_inertia=pitch,
        yaw_inertia=p.I_z,
        wheel_radius=p.R_w,
        wheel_inertia=p.I_y_w,
        wheel_tilt_inertia=p.I_y_w / 2 + 0.1,
        wheel_mass=axle - knuckle,
        knuckle_mass=knuckle,
        front_drive=float(p.T_se),
        front_brake=p.T_sb,
        ackermann=ackermann,
        tyre=tyre,
    )


def our_run(
    params: VehicleParameters, inputs: Inputs, duration: float, speed: float
) -> Run:
    """The reference models' inputs as ours: m a at the wheels, driving or braking."""

    def signal(pick: Callable[[float, float], float]):
        return lambda time: np.array([pick(*inputs(float(t))) for t in time])

    return Run(
        params,
        duration,
        speed=speed,
        steering=signal(lambda angle, _: angle),
        force=signal(lambda _, a: params.mass * max(a, 0.0)),
        brake=signal(lambda _, a: params.mass * max(-a, 0.0)),
    )


def solve(model: str, inputs: Inputs, duration: float, speed: float) -> Path:
    """Simulates a reference model open loop.

    Args:
        model: `MB`, `STD` (about the centre of gravity) or `KS` (about the rear axle).
        inputs: steering angle and acceleration over time; the angle must start at 0.
        duration: [s].
        speed: at the start [m/s].
    """
    from vehiclemodels.init_mb import init_mb
    from vehiclemodels.init_std import init_std
    from vehiclemodels.vehicle_dynamics_ks import vehicle_dynamics_ks
    from vehiclemodels.vehicle_dynamics_mb import vehicle_dynamics_mb
    from vehiclemodels.vehicle_dynamics_std import vehicle_dynamics_std

    p = published_set()
    core = [0.0, 0.0, 0.0, speed, 0.0, 0.0, 0.0]
    start, dynamics = {
        "MB": (lambda: init_mb(core, p), vehicle_dynamics_mb),
        "STD": (lambda: init_std(core, p), vehicle_dynamics_std),
        "KS": (lambda: core[:5], vehicle_dynamics_ks),
    }[model]

    def rates(time: float, state: np.ndarray) -> list[float]:
        step = 1e-3  # s, central difference of the steering angle
        rate = (inputs(time + step)[0] - inputs(time - step)[0]) / (2 * step)
        return dynamics(list(state), [rate, inputs(time)[1]], p)

    time = np.linspace(0.0, duration, round(duration / 0.05) + 1)
    solved = integrate.solve_ivp(
        rates,
        (0.0, duration),
        start(),
        method="LSODA",
        t_eval=time,
        max_step=0.02,
        rtol=1e-6,
        atol=1e-8,
    )
    if not solved.success:
        raise ValueError(f"{model} could not be solved: {solved.message}")
    return Path(time, solved.y[:2].T, solved.y[4])


def apart(track: Track, path: Path, rear_axle: bool = False) -> tuple[np.ndarray, ...]:
    """Distance [m] and yaw difference [rad] of our car from the reference's, (n,) each.

    Args:
        track: ours, which starts with its rear axle in the origin.
        path: the reference model's, whose reference point starts in the origin.
        rear_axle: compare rear axles, else centres of gravity.
    """
    ours = track.position if rear_axle else (track.cg - track.cg[0])[:, :2]
    rows = np.rint(path.time / track.dt).astype(int)
    distance = np.linalg.norm(ours[rows] - path.position, axis=1)
    return distance, track.yaw[rows] - path.yaw
