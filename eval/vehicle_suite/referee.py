"""Trials of our car beside the CommonRoad vehicle models: inputs and paths."""

import dataclasses
import math

import numpy as np

from vehicle_suite import commonroad, formulas
from vehicle_suite.commonroad import Inputs
from vehicle_suite.runs import Run
from vehicle_suite.testbed import BrushTestbed
from vehicle_suite.tracks import Track


@dataclasses.dataclass(frozen=True)
class Trial:
    """A manoeuvre of our car and of the reference models.

    Attributes:
        name: of the manoeuvre.
        track: ours.
        paths: those of the reference models, by name.
    """

    name: str
    track: Track
    paths: dict[str, commonroad.Path]

    @property
    def rear_axle(self) -> bool:
        """Whether the models' reference point is the rear axle."""
        return "KS" in self.paths


def slalom(time: float) -> tuple[float, float]:
    """Steering 0.2 rad (11.5 deg) to both sides in 4 s, building up; no pedal."""
    amplitude = 0.2 * min(max(time, 0.0), 1.0)
    return amplitude * math.sin(math.pi / 2 * time), 0.0


def brake_in_turn(time: float) -> tuple[float, float]:
    """Steering to 0.12 rad (a_y about 1.7 m/s^2 at 6 m/s), braked from 2 s on."""
    return 0.12 * min(max(2 * time, 0.0), 1.0), -3.0 if time >= 2.0 else 0.0


# Accelerations of the parking manoeuvre: forwards, back, forwards, 1 m/s at most.
PARKING_TIMES = (0.0, 2.0, 4.0, 6.0, 7.5, 9.5, 11.5, 13.5, 15.0, 17.0, 18.0, 20.0)  # s
PARKING_ACCELERATIONS = (0.5, 0, -0.5, 0, -0.5, 0, 0.5, 0, 0.5, 0, -0.5, 0)  # m/s^2
PARKING_STEERING = (
    (0.0, 1.5, 5.2, 7.8, 13.0, 15.0, 18.0, 20.0),  # s, at most 0.35 rad/s of their 0.4
    (0.0, 0.45, 0.45, -0.45, -0.45, 0.2, 0.2, 0.0),  # rad
)


def parking(time: float) -> tuple[float, float]:
    """Walking pace with two gear changes, steering 26 deg to both sides."""
    row = int(np.searchsorted(PARKING_TIMES, time + 1e-9, side="right")) - 1
    return float(np.interp(time, *PARKING_STEERING)), PARKING_ACCELERATIONS[max(row, 0)]


def parking_run() -> Run:
    """The parking manoeuvre for our car, which holds the speed that KS has."""
    params = commonroad.our_car(ackermann=1.0)

    def acceleration(time: np.ndarray) -> np.ndarray:
        return np.array([parking(float(t))[1] for t in time])

    def speed(time: np.ndarray) -> np.ndarray:
        corners = np.append(PARKING_TIMES, 21.0)
        gained = np.append(0.0, np.cumsum(np.diff(corners) * PARKING_ACCELERATIONS))
        return np.interp(time, corners, gained)

    return Run(
        params,
        20.0,
        steering=lambda time: np.interp(time, *PARKING_STEERING),
        force=lambda time: formulas.rolling_mass(params) * acceleration(time),
        target=speed,
    )


def trials() -> list[Trial]:
    """Drives everything."""
    bed = BrushTestbed()
    found: list[Trial] = []
    cases: list[tuple[str, Inputs, float, float]] = [
        ("slalom at 3 m/s", slalom, 8.0, 3.0),
        ("brake in a turn at 6 m/s", brake_in_turn, 3.6, 6.0),
    ]
    for name, inputs, duration, speed in cases:
        run = commonroad.our_run(commonroad.our_car(), inputs, duration, speed)
        (track,) = bed.drive([run])
        paths = {
            model: commonroad.solve(model, inputs, duration, speed)
            for model in ("MB", "STD")
        }
        found.append(Trial(name, track, paths))
    (track,) = bed.drive([parking_run()])
    path = commonroad.solve("KS", parking, 20.0, 0.0)
    found.append(Trial("parking, two gear changes", track, {"KS": path}))
    return found


def between(trial: Trial, first: str, second: str) -> float:
    """Largest distance [m] of two reference models from each other."""
    apart = trial.paths[first].position - trial.paths[second].position
    return float(np.linalg.norm(apart, axis=1).max())
