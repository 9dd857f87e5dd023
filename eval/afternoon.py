"""An engineer's afternoon with a parking function: prints the minutes of its steps.

    python eval/afternoon.py
    python eval/afternoon.py --repetitions 1000 --out runs/afternoon

From a map, a data sheet and the log of a test drive to a report: the commands of the
page "Test a parking function". The map is a part of San Jose's car park as Lanelet2,
the log that of a car in C MuJoCo whose steering and tyres are not those of its sheet.
"""

from carpark_mj.cli.process import enter

if __name__ == "__main__":  # before the imports, which take seconds
    enter("afternoon", "afternoon:main")

import dataclasses
import re
import shlex
import subprocess
import sys
import time
from pathlib import Path

import yaml

from carpark_mj.config.checks import CheckedConfig, Count
from carpark_mj.evaluation.tables import print_rows
from carpark_mj.files import require_writable, write_csv, write_text
from carpark_mj.identification.simulation import Sought
from carpark_mj.vehicle import preset
from shell import command
from vehicle_suite.logs import Drive, record

SHEET = """\
name: sheet
length: 4.28
width: 1.79
wheelbase: 2.64
front_overhang: 0.86
mass: 1420
front_axle_load: 830
tyre_size: 205/55 R16
drive: front
turning_circle: 10.9
"""
# What the test drive was driven with; the sheet does not have it.
TRUE = Sought(0.12, 0.15, 14.5, 0.0, 10.0, 2.0, 4.0, 0.012, 0.1, 0.5, 0.08)
# Bay 31 between two cars; a child steps out between two others beside the lane.
SCENARIO = """\
lot: lot.json
vehicle: car.yaml
start: [-21.0, -0.3, 0.0]
goal: 31
parked: [17, 22, 23, 4]
seconds: 60
spread: {place: 0.3, heading: 0.05}
movers:
  - {kind: person, between: [23, 4], speed: 1.5, ahead: 8.0,
     spread: {near: 1.0, speed: 0.3}}
"""
LIMITS = "'parked>=0.95' 'crashed<=0.01' 'hit_person<=0.01' 'final_distance<=0.2'"
STEPS = {
    "map": "layouts san_jose --crop -40 35 20 65 --save map.osm",
    "map to lot": "layouts import map.osm --out lot.json",
    "plot": "layouts lot.json --check 1 --paths 5 --plot lot.png",
    "data sheet": "vehicles sheet.yaml",
    "log to car": "identify log.csv --vehicle sheet.yaml --out car.yaml",
    "scenario": "scenario child.yaml anywhere --repetitions {} --videos 0 --out runs",
    "report": f"report runs --limits {LIMITS} --out report.html",
}


@dataclasses.dataclass(frozen=True)
class AfternoonConfig(CheckedConfig):
    """Settings of `python eval/afternoon.py`.

    Attributes:
        repetitions: of the scenario.
        out: folder of all files.
    """

    repetitions: Count = 1000
    out: str = "runs/afternoon"


def write_log(folder: Path) -> None:
    """Writes the log of the test drive."""
    log = record(Drive(TRUE, preset(str(folder / "sheet.yaml"))))
    names = ("time", *log.names, *log.measured)
    columns = (log.time, log.steering, log.pedal, *log.measured.values())
    rows = zip(*columns, strict=True)
    write_csv(folder / "log.csv", [dict(zip(names, row, strict=True)) for row in rows])


def write_scenario(folder: Path) -> None:
    """Writes the scenario, with the delays that the log's car file has in comments."""
    found = re.findall(r"# \w+ (\S+) .*: (sim\.\w+)", (folder / "car.yaml").read_text())
    settings = {name: round(float(value), 2) for value, name in found}  # of sim_dt
    text = SCENARIO + yaml.safe_dump({"settings": settings}, sort_keys=False)
    write_text(folder / "child.yaml", text)


def run(config: AfternoonConfig) -> None:
    """Runs the steps and prints their minutes."""
    folder = Path(config.out)
    require_writable(folder / "minutes.csv", new_folders=True)
    folder.mkdir(parents=True, exist_ok=True)
    write_text(folder / "sheet.yaml", SHEET)
    write_log(folder)
    rows = []
    for name, words in STEPS.items():
        begin = time.monotonic()
        if name == "scenario":
            write_scenario(folder)
        words = words.format(config.repetitions)
        print(f"$ carpark_mj {words}", flush=True)
        program = [sys.executable, "-m", "carpark_mj", *shlex.split(words)]
        if code := subprocess.run(program, cwd=folder, check=False).returncode:
            raise ValueError(f"carpark_mj {words}: exit code {code}")
        minutes = round((time.monotonic() - begin) / 60, 2)
        rows.append({"step": name, "minutes": minutes})
    rows.append({"step": "all", "minutes": sum(row["minutes"] for row in rows)})
    write_csv(folder / "minutes.csv", rows)
    print_rows(rows, "minutes")


main = command(AfternoonConfig, run, __doc__)
