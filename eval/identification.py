"""Identifies cars from logs with known parameters; writes `identification.csv`.

python eval/identification.py
python eval/identification.py --seeds 10

Every seed has a compact car with other true parameters, another drive and other noise.
It drives in C MuJoCo (`full`), and as a single-track car in NumPy, which shares no code
with the library (`stops`, `rolling`).
"""

from carpark_mj.cli.process import enter

if __name__ == "__main__":  # before the imports, which take seconds
    enter("identification", "identification:main")

import dataclasses
import itertools
from pathlib import Path
from typing import Any

import numpy as np

from carpark_mj.config.checks import CheckedConfig, Count
from carpark_mj.evaluation.tables import print_rows
from carpark_mj.files import require_writable, write_csv
from carpark_mj.identification.fit import identify
from carpark_mj.identification.simulation import Sought
from carpark_mj.vehicle import COMPACT
from shell import command
from vehicle_suite.logs import SINGLE_TRACK, Drive, DriveName, record

KINDS: tuple[DriveName, ...] = ("stops", "rolling", "full")
# Least and largest true values; the compact car has a stiffness of 12, 2 and 4 m/s^2.
TRUE = Sought(
    steering_delay=(0.05, 0.3),
    pedal_delay=(0.05, 0.3),
    steering_ratio=(13.0, 18.0),
    steering_offset=(-0.02, 0.02),
    cornering_stiffness=(7.0, 14.0),
    max_acceleration=(1.5, 2.5),
    max_deceleration=(3.0, 5.0),
    rolling_resistance=(0.008, 0.02),
    drive_lag=(0.0, 0.2),
    lateral_relaxation=(0.3, 0.7),
    patch_radius=(0.06, 0.1),
)


@dataclasses.dataclass(frozen=True)
class IdentificationConfig(CheckedConfig):
    """Settings of `python eval/identification.py`.

    Attributes:
        seeds: number of seeds.
        sim_dt: substep of the simulation that is fitted [s]; 0.0025 takes four times
            as long, and its tyres seem a tenth stiffer.
        out: folder of the file.
    """

    seeds: Count = 2
    sim_dt: float = 0.01
    out: str = "runs/identification"


def truth(seed: int, kind: DriveName) -> Sought:
    """The true parameters of a seed; a single-track car has no scrub torque."""
    dice = np.random.default_rng([seed, 2])
    true = Sought(*(float(dice.uniform(*limits)) for limits in TRUE))
    return true._replace(patch_radius=0.0) if kind in SINGLE_TRACK else true


def run(config: IdentificationConfig) -> None:
    """Drives, identifies, writes the rows and prints them with the coverage."""
    path = Path(config.out) / "identification.csv"
    require_writable(path, new_folders=True)
    rows: list[dict[str, Any]] = []
    for kind, seed in itertools.product(KINDS, range(config.seeds)):
        true = truth(seed, kind)
        log = record(Drive(true, COMPACT, kind, seed))
        found = identify(log, COMPACT, 0.0, config.sim_dt).estimates
        for name, value in true._asdict().items():
            one, known = found[name], found[name].identifiable
            row = {"drive": kind, "seed": seed, "parameter": name, "true": value}
            row |= {"found": one.value, "half_interval": one.error, "identified": known}
            rows.append(row | {"covered": known and abs(one.value - value) < one.error})
    path.parent.mkdir(parents=True, exist_ok=True)
    write_csv(path, rows)
    for kind in KINDS:
        print_rows([row for row in rows if row["drive"] == kind], kind)
    known, covered = (
        sum(row[key] for row in rows) for key in ("identified", "covered")
    )
    print(f"{covered} of {known} intervals cover the true value; wrote {path}")


main = command(IdentificationConfig, run, __doc__, fused=True)
