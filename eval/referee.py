"""Compares our car with the CommonRoad vehicle models; writes `referee.md` and a plot.

python eval/referee.py
python eval/referee.py --out runs/referee

Needs the package `commonroad-vehicle-models` (in the extra `test`).
"""

import dataclasses
import math
import sys
from pathlib import Path

import jax
import numpy as np
import tyro

from carpark_mj.policy.checkpoints import write_atomically
from vehicle_suite import commonroad, formulas
from vehicle_suite.commonroad import Inputs
from vehicle_suite.runs import Run
from vehicle_suite.testbed import BrushTestbed
from vehicle_suite.tracks import Track


@dataclasses.dataclass(frozen=True)
class RefereeConfig:
    """Settings of `python eval/referee.py`.

    Attributes:
        out: folder of the report.
    """

    out: str = "docs/physics"


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


TEXT = """# An independent referee

Written by `python eval/referee.py`; do not edit. Our car (brush tyres, MJX in float32
at 10 ms) configured with the published parameter set 2 (BMW 320i) of the CommonRoad
vehicle models (M. Althoff, G. Würsching, 2020; package `commonroad-vehicle-models`),
driven open loop beside their multi-body (MB), single-track drift (STD) and kinematic
single-track (KS) models. Positions are those of the centre of gravity, for KS of the
rear axle.

{table}

![Paths and differences](referee.png)

## What differs, and why

- *Slalom.* STD has no track width. MB and ours steer both front wheels by the same
  angle, so that the pair scrubs and the car slows down: ours falls behind STD along the
  path. With exact Ackermann angles in our car the distance to STD shrinks from 0.13 m
  to 0.02 m, and that to MB grows from 0.03 m to 0.08 m. MB and STD are
  {slalom_mb_std:.2f} m apart.
- *Brake in a turn.* The first 0.2 deg are our steering servos, which follow 14 ms late;
  the referees turn their wheels at once. The rest grows with side slip: the brush force
  bends from the start, the Magic Formula of the same initial slope stays straighter. A
  fifth more cornering stiffness in our car takes the distance to MB from 0.14 m to
  0.10 m; 20 % more friction, or a tenth of the relaxation, changes nothing. MB and STD
  are {brake_mb_std:.2f} m apart.
- *Parking.* KS has no slip and exactly the asked speed. Ours holds it on a controller
  and lags by up to 4 cm along the path while it drives; after two gear changes it
  stands 1 cm beside KS. MB and STD cannot reverse and are no referees here.
- Not carried over: MB's anti-roll bars, compliant joints, camber and unequal axle
  springs. Our tyres relax over 0.1 m where theirs answer at once.
"""


def table(found: list[Trial]) -> str:
    """Largest and final differences as markdown."""
    lines = [
        "| manoeuvre | referee | path [m] | largest distance [m] | final distance [m] "
        "| largest yaw difference [deg] | final yaw difference [deg] |",
        "|---|---|---|---|---|---|---|",
    ]
    for trial in found:
        for model, path in trial.paths.items():
            distance, yaw = commonroad.apart(trial.track, path, trial.rear_axle)
            steps = np.linalg.norm(np.diff(path.position, axis=0), axis=1)
            largest, final = np.degrees(np.abs(yaw).max()), math.degrees(yaw[-1])
            lines.append(
                f"| {trial.name} | {model} | {steps.sum():.1f} | {distance.max():.3f} "
                f"| {distance[-1]:.3f} | {largest:.2f} | {final:+.2f} |"
            )
    return "\n".join(lines)


def between(trial: Trial, first: str, second: str) -> float:
    """Largest distance [m] of two reference models from each other."""
    apart = trial.paths[first].position - trial.paths[second].position
    return float(np.linalg.norm(apart, axis=1).max())


def draw(path: Path, found: list[Trial]) -> None:
    """Paths above, distances over time below."""
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(
        2, len(found), figsize=(4.6 * len(found), 7.0), layout="constrained"
    )
    for column, trial in enumerate(found):
        above, below = axes[0, column], axes[1, column]
        track = trial.track
        ours = track.position if trial.rear_axle else (track.cg - track.cg[0])[:, :2]
        above.plot(*ours.T, "k", lw=2.5, alpha=0.4, label="ours")
        for model, referee in trial.paths.items():
            above.plot(*referee.position.T, "--", label=model)
            distance, yaw = commonroad.apart(track, referee, trial.rear_axle)
            (line,) = below.plot(referee.time, 100 * distance, label=f"{model}, cm")
            degrees = 10 * np.degrees(yaw)
            below.plot(
                referee.time,
                degrees,
                ":",
                color=line.get_color(),
                label=f"{model}, 0.1 deg",
            )
        above.set_title(trial.name)
        above.set_xlabel("x [m]")
        above.set_ylabel("y [m]")
        below.set_xlabel("time [s]")
        below.set_ylabel("distance [cm], yaw difference [0.1 deg]")
        if trial.rear_axle:
            above.set_aspect("equal", adjustable="datalim")
        for axis in (above, below):
            axis.grid(alpha=0.3)
            axis.legend(fontsize=8)
    write_atomically(path, lambda file: figure.savefig(file, format="png", dpi=110))
    plt.close(figure)


def main(config: RefereeConfig) -> None:
    """Drives the trials and writes the page and the plot.

    Raises:
        ImportError: the package of the reference models is not installed.
        OSError: the folder cannot be written.
    """
    jax.config.update("jax_platforms", "cpu")  # one car: no work for a GPU
    found = trials()
    folder = Path(config.out)
    folder.mkdir(parents=True, exist_ok=True)
    text = TEXT.format(
        table=table(found),
        slalom_mb_std=between(found[0], "MB", "STD"),
        brake_mb_std=between(found[1], "MB", "STD"),
    )
    write_atomically(folder / "referee.md", lambda file: file.write_text(text))
    draw(folder / "referee.png", found)
    print(f"{table(found)}\nwrote {folder}/referee.md and referee.png")


if __name__ == "__main__":
    try:
        main(tyro.cli(RefereeConfig, description=__doc__))
    except (ImportError, OSError) as error:
        print(f"referee: {error}", file=sys.stderr)
        sys.exit(2)
