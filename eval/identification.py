"""Identifies cars from logs with known parameters; writes `identification.csv`.

python eval/identification.py
python eval/identification.py --kinds stops rolling
python eval/identification.py --kinds full --seeds 10 --first 10 --measured rates

Every seed has a compact car with other true parameters, another drive and other noise.
The kinds `stops` and `rolling` drive a single-track car in NumPy, which shares no code
with the library, the others a car in C MuJoCo.
"""

from carpark_mj.cli.process import enter

if __name__ == "__main__":  # before the imports, which take seconds
    enter("identification", "identification:main")

import dataclasses
import itertools
import math
from pathlib import Path
from typing import Any, Literal

import numpy as np

from carpark_mj.config.checks import CheckedConfig, Count, Natural
from carpark_mj.evaluation.tables import print_rows
from carpark_mj.files import require_writable, write_csv
from carpark_mj.identification.fit import identify
from carpark_mj.identification.log import POSE, RATES
from carpark_mj.identification.simulation import SIM_DT, Sought
from carpark_mj.vehicle import COMPACT
from shell import command
from vehicle_suite.logs import SINGLE_TRACK, Drive, DriveName, record

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
        kinds: drives of every seed.
        seeds: number of seeds.
        first: first seed.
        measured: columns of the logs besides time, steering wheel and pedal.
        noise: factor on the noise of the sensors.
        sim_dt: substep of the simulation that is fitted [s]; 0.01 takes a quarter of
            the time, and its tyres seem a tenth softer.
        out: folder of the file.
    """

    kinds: tuple[DriveName, ...] = ("full",)
    seeds: Count = 10
    first: Natural = 0
    measured: Literal["pose", "rates"] = "pose"
    noise: float = 1.0
    sim_dt: float = SIM_DT
    out: str = "runs/identification"


def truth(seed: int, kind: DriveName) -> Sought:
    """The true parameters of a seed; a single-track car has no scrub torque."""
    dice = np.random.default_rng([seed, 2])
    true = Sought(*(dice.uniform(*limits) for limits in TRUE))
    return true._replace(patch_radius=0.0) if kind in SINGLE_TRACK else true


def run(config: IdentificationConfig) -> None:
    """Drives, identifies, writes the rows and prints them with the coverage."""
    path = Path(config.out) / "identification.csv"
    require_writable(path, new_folders=True)
    seeds = range(config.first, config.first + config.seeds)
    measured = POSE if config.measured == "pose" else RATES
    rows = []
    for kind, seed in itertools.product(config.kinds, seeds):
        true = truth(seed, kind)
        log = record(Drive(true, COMPACT, kind, seed), measured, config.noise)
        found = identify(log, COMPACT, 0.0, config.sim_dt).estimates
        for name, value in true._asdict().items():
            row: dict[str, Any] = {"drive": kind, "seed": seed}
            row |= {"parameter": name, "true": float(value)}
            row |= {"found": found[name].value, "half_interval": found[name].error}
            rows.append(row | {"identified": found[name].identifiable})
    path.parent.mkdir(parents=True, exist_ok=True)
    write_csv(path, rows)
    for kind in config.kinds:
        _print([row for row in rows if row["drive"] == kind], kind)


def _print(rows: list[dict], kind: str) -> None:
    """Prints the first seed's numbers and how many intervals cover the truth."""
    shown = []
    for name in Sought._fields:
        mine = [row for row in rows if row["parameter"] == name]
        found = [row for row in mine if row["identified"]]
        covered = sum(abs(r["found"] - r["true"]) <= r["half_interval"] for r in found)
        first, known = mine[0], mine[0]["identified"]
        ends = (first["found"] + s * first["half_interval"] for s in (-1, 1))
        row = {"parameter": name, "true": first["true"]}
        row["found"] = first["found"] if known else math.nan
        row["95 % interval"] = " … ".join(f"{x:.4g}" for x in ends) if known else "–"
        row["identified"] = f"{len(found)} of {len(mine)}"
        shown.append(row | {"covered": f"{covered} of {len(found)}"})
    print_rows(shown, f"{kind}: the first seed and all")


main = command(IdentificationConfig, run, __doc__, fused=True)
