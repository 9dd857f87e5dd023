"""The page and the plot of the trials beside the CommonRoad vehicle models."""

import math
from pathlib import Path

import numpy as np

from carpark_mj.files import write_atomically
from vehicle_suite import commonroad
from vehicle_suite.referee import Trial, between

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


def write_report(folder: Path, found: list[Trial]) -> None:
    """Writes `referee.md` and `referee.png`.

    Raises:
        OSError: the folder cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    text = TEXT.format(
        table=table(found),
        slalom_mb_std=between(found[0], "MB", "STD"),
        brake_mb_std=between(found[1], "MB", "STD"),
    )
    write_atomically(folder / "referee.md", lambda file: file.write_text(text))
    draw(folder / "referee.png", found)
