"""Compares the car with the CommonRoad vehicle models; writes `referee.md`.

python eval/referee.py
python eval/referee.py --out runs/referee

Needs the package `commonroad-vehicle-models` (in the extra `test`).

Source: M. Althoff, G. Würsching, CommonRoad: Vehicle Models (2020); parameter set 2 is
a BMW 320i, its tyres a Magic Formula fit from the ADAMS handbook. STD is the single
track with drift (Magic Formula, load transfer), MB the multi-body model (suspended
masses, roll, pitch, four wheels).
"""

from carpark_mj.cli.process import enter

if __name__ == "__main__":  # before the imports, which take seconds
    enter("referee", "referee:main")

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from scipy import integrate

from carpark_mj.evaluation.tables import markdown
from carpark_mj.files import require_writable, write_text
from carpark_mj.vehicle import COMPACT, VehicleParameters
from shell import Folder, command
from vehicle_suite.testbed import Run, Track, tracks_of

Inputs = Callable[[float], tuple[float, float]]  # steering angle [rad], m/s^2 asked


class Reference(NamedTuple):
    """A reference car: times (n,), its reference point (n, 2), and yaws (n,)."""

    time: np.ndarray
    position: np.ndarray
    yaw: np.ndarray


def published_set() -> Any:
    """Parameter set 2 of the package."""
    from vehiclemodels.parameters_vehicle2 import parameters_vehicle2

    return parameters_vehicle2()


def our_car() -> VehicleParameters:
    """The published set as a car of this package, as far as the models allow.

    Taken over: masses, wheelbase, centre of gravity, inertias, mean track, wheel
    radius and inertia, brake and drive split, initial slopes p_ky1 and p_kx1 and
    lateral peak p_dy1 of the tyres; suspension and tyre springs in series, mean of the
    axles. MB steers both front wheels by one angle. Its tyres have
    neither relaxation nor rolling resistance nor scrub torque, which are set as low as
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
        ackermann=0.0,
        tyre=tyre,
    )


def our_run(inputs: Inputs, duration: float, speed: float) -> Run:
    """The models' inputs for the car: m a at the wheels, driving or braking."""
    params = our_car()
    steering, asked = (
        lambda time, k=k: np.array([inputs(float(t))[k] for t in time]) for k in (0, 1)
    )
    return Run(
        params,
        duration,
        speed=speed,
        steering=steering,
        force=lambda time: params.mass * np.maximum(asked(time), 0.0),
        brake=lambda time: params.mass * np.maximum(-asked(time), 0.0),
    )


def solve(model: str, inputs: Inputs, duration: float, speed: float) -> Reference:
    """Simulates the reference model `MB` or `STD` open loop.

    The steering angle and acceleration of `inputs` are over time [s], from an angle of
    0; the speed [m/s] is that at the start.
    """
    from vehiclemodels.init_mb import init_mb
    from vehiclemodels.init_std import init_std
    from vehiclemodels.vehicle_dynamics_mb import vehicle_dynamics_mb
    from vehiclemodels.vehicle_dynamics_std import vehicle_dynamics_std

    p = published_set()
    begin, dynamics = {
        "MB": (init_mb, vehicle_dynamics_mb),
        "STD": (init_std, vehicle_dynamics_std),
    }[model]
    start = begin([0.0, 0.0, 0.0, speed, 0.0, 0.0, 0.0], p)

    def rates(time: float, state: np.ndarray) -> list[float]:
        step = 1e-3  # s, central difference of the steering angle
        rate = (inputs(time + step)[0] - inputs(time - step)[0]) / (2 * step)
        return dynamics(list(state), [rate, inputs(time)[1]], p)

    time = np.linspace(0.0, duration, round(duration / 0.05) + 1)
    options: Any = {"method": "LSODA", "max_step": 0.02, "rtol": 1e-6, "atol": 1e-8}
    solved = integrate.solve_ivp(rates, (0.0, duration), start, t_eval=time, **options)
    if not solved.success:
        raise ValueError(f"{model} could not be solved: {solved.message}")
    return Reference(time, solved.y[:2].T, solved.y[4])


class Trial(NamedTuple):
    """A manoeuvre of our car, and paths of the reference models by their names."""

    name: str
    track: Track
    paths: dict[str, Reference]

    def apart(self, model: str) -> tuple[np.ndarray, np.ndarray]:
        """Distance [m] and yaw difference [rad] from a model's car, (n,) each.

        Positions are of the centre of gravity, from 0.
        """
        reference, cg = self.paths[model], self.track.cg[:, :2]
        rows = np.rint(reference.time / self.track.dt).astype(int)
        path = (cg - cg[0])[rows]
        distance = np.linalg.norm(path - reference.position, axis=1)
        return distance, self.track.yaw[rows] - reference.yaw


def slalom(time: float) -> tuple[float, float]:
    """Steering 0.2 rad (11.5 deg) to both sides in 4 s, building up; no pedal."""
    amplitude = 0.2 * min(max(time, 0.0), 1.0)
    return amplitude * math.sin(math.pi / 2 * time), 0.0


def brake_in_turn(time: float) -> tuple[float, float]:
    """Steering to 0.12 rad (a_y about 1.7 m/s^2 at 6 m/s), braked from 2 s on."""
    return 0.12 * min(max(2 * time, 0.0), 1.0), -3.0 if time >= 2.0 else 0.0


def trials() -> list[Trial]:
    """Drives everything."""
    found: list[Trial] = []
    for name, inputs, duration, speed in (
        ("slalom at 3 m/s", slalom, 8.0, 3.0),
        ("brake in a turn at 6 m/s", brake_in_turn, 3.6, 6.0),
    ):
        (track,) = tracks_of([our_run(inputs, duration, speed)])
        paths = {m: solve(m, inputs, duration, speed) for m in ("MB", "STD")}
        found.append(Trial(name, track, paths))
    return found


def table(found: list[Trial]) -> str:
    """Largest and final differences as markdown."""
    rows = []
    for trial in found:
        for model, path in trial.paths.items():
            distance, yaw = trial.apart(model)
            steps, degrees = np.diff(path.position, axis=0), np.degrees(yaw)
            row = {"manoeuvre": trial.name, "model": model}
            row["path [m]"] = f"{np.linalg.norm(steps, axis=1).sum():.1f}"
            row["largest distance [m]"] = f"{distance.max():.3f}"
            row["final distance [m]"] = f"{distance[-1]:.3f}"
            row["largest yaw difference [deg]"] = f"{abs(degrees).max():.2f}"
            rows.append(row | {"final yaw difference [deg]": f"{degrees[-1]:+.2f}"})
    return markdown(rows)


def run(config: Folder) -> None:
    """Drives the trials, writes the page and prints the table."""
    out = Path(config.out)
    require_writable(out / "referee.md", new_folders=True)  # refused before the work
    jax.config.update("jax_platforms", "cpu")  # one car: no work for a GPU
    found = trials()
    numbers: dict[str, float] = {}
    for name, trial in zip(("slalom_mb_std", "brake_mb_std"), found, strict=True):
        apart = trial.paths["MB"].position - trial.paths["STD"].position
        numbers[name] = float(np.linalg.norm(apart, axis=1).max())
    text = (Path(__file__).parent / "referee.md").read_text()
    out.mkdir(parents=True, exist_ok=True)
    write_text(out / "referee.md", text.format(table=table(found), **numbers))
    print(f"{table(found)}\nwrote {config.out}/referee.md")


main = command(Folder("docs/physics"), run, __doc__, fused=True)
