"""Commands: lots from maps, scenarios from and to files of other programs."""

import dataclasses
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from carpark_formats.commonroad import commonroad_text, read_commonroad, solution_text
from carpark_formats.maps.exporting import opendrive_text
from carpark_formats.maps.importing import import_map
from carpark_formats.openscenario import openscenario_text, read_openscenario
from carpark_formats.parkbench import read_parkbench
from carpark_formats.settings import (
    ImportConfig,
    ScenarioExportConfig,
    ScenarioImportConfig,
)
from carpark_mj.cli.layouts import save
from carpark_mj.config import EnvConfig
from carpark_mj.files import require_writable, write_text
from carpark_mj.layouts.files import layout_text
from carpark_mj.reading import naming_file
from carpark_mj.suite.results import key_of, read_runs
from carpark_mj.suite.scenario import Goal, Scenario, make_scenario, read_scenario

IN_BAY = 0.3  # m, or rad: a car that stands so near to a bay's pose parks in it


def import_layout(config: ImportConfig) -> None:
    """Reads the map, writes the layout file and says what was left out."""
    require_writable(Path(config.out))
    flags = {name: getattr(config, name) for name in ("level", "crs", "unit")}
    layout, report = import_map(Path(config.map), layers=config.layer, **flags)
    save(layout, config.crop, Path(config.out), report)


def read(config: ScenarioImportConfig) -> None:
    """Writes the scenario, and its lot if the file has one; says what was left out."""
    path, out = Path(config.file), Path(config.out)
    beside, layout = out.with_suffix(".lot.json"), None
    require_writable(out)
    with naming_file(path):
        if path.suffix == ".xosc":
            found, notes = read_openscenario(path)
        elif path.suffix == ".xml":
            found, layout, notes = read_commonroad(path)
        else:
            layout, notes = read_parkbench(path), list[str]()
            start = np.asarray(layout.spawn_pose)[0].tolist()
            found = {"start": start, "goal": 0, "movers": list[Any]()}
    found = {"lot": config.lot, "vehicle": config.vehicle} | found
    if config.goal is not None:
        found["goal"] = config.goal
    found = _plain(found)
    with naming_file(path), tempfile.TemporaryDirectory() as folder:
        if layout is not None:
            require_writable(beside)
            kept = Path(folder, beside.name)
            write_text(kept, layout_text(layout))
            found["lot"] = str(kept)
        scenario = make_scenario(found)  # refuses what cannot be, before it is written
    found = _in_bays(found, scenario)
    for note in notes:
        print(note)
    if layout is not None:
        found["lot"] = str(beside)
        write_text(beside, layout_text(layout))
        print(f"wrote {beside}")
    write_text(out, yaml.safe_dump(found, sort_keys=False, default_flow_style=None))
    print(f"wrote {out}: {len(found['movers'])} movers")


def _plain(value: Any) -> Any:
    """Nested values without NumPy's numbers, rounded to 1e-6."""
    if isinstance(value, dict):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    return round(float(value), 6) if isinstance(value, float) else value


def _in_bays(found: dict[str, Any], scenario: Scenario) -> dict[str, Any]:
    """Entries in order, with bays of the lot for a goal and cars that stand in them."""
    layout, movers, parked = scenario.layout, [], list(found.get("parked", []))
    bays, free = np.asarray(layout.parked_pose), np.array(layout.bay_mask)
    free[scenario.goal_bay] = False

    def bay_at(pose: Any) -> list[int]:
        off = np.abs(bays - np.array(pose))
        off[:, 2] = np.abs(np.sin(off[:, 2]))  # either end may have gone in first
        return np.flatnonzero(free & (off.max(axis=1) < IN_BAY))[:1].tolist()

    if isinstance(scenario.goal, Goal) and set(found["goal"]) == {"pose"}:
        for bay in bay_at(scenario.goal.pose):
            found["goal"] = bay
    for mover, script in zip(found["movers"], scenario.scripts, strict=True):
        stands = mover["kind"] == "car" and script.after is None
        if stands and (bays_there := bay_at(script.start)):
            free[bays_there] = False
            parked += bays_there
        else:
            movers.append(mover)
    found |= {"movers": movers, "parked": parked}
    names = [field.name for field in dataclasses.fields(Scenario)]
    return {name: found[name] for name in names if name in found}


def write(config: ScenarioExportConfig) -> None:
    """Writes OpenSCENARIO and its map, CommonRoad, or a run's drives as solutions."""
    scenario, out = read_scenario(Path(config.file)), Path(config.out)
    require_writable(out)
    if not config.run:
        if out.suffix == ".xml":
            text, notes = commonroad_text(scenario)
        else:
            lot = out.with_suffix(".xodr")
            write_text(lot, opendrive_text(scenario.layout))
            text, notes = openscenario_text(scenario, lot.name), [f"wrote {lot}"]
        write_text(out, text)
        print(*notes, f"wrote {out}", sep="\n")
        return
    episodes, drives = read_runs([Path(config.run)])
    lengths = {key_of(row): round(row["length"]) for row in episodes}
    for key, drive in drives.items():
        # The run may have had more repetitions.
        enough = dataclasses.replace(scenario, repetitions=key.case + 1)
        start = enough.pick(slice(key.case, None)).start
        assert start is not None
        place, steps = start.options, lengths[key]
        first = [*np.asarray(place.pose)[0, 0], 0.0, *np.asarray(place.speed)[0]]
        poses = drive.pose_w[0, :steps, 0, -1]  # at the ends of the steps
        turned, paces = drive.steering[0, :steps, :1], drive.speed[0, :steps, :1]
        track = np.vstack([first, np.hstack([poses, turned, paces])])
        time = EnvConfig().sim.ctrl_dt * np.arange(len(track))
        name = out.with_name(f"{out.stem}.{Path(key.policy).stem}.{key.case}.xml")
        with naming_file(path := Path(config.problem)):
            write_text(name, solution_text(path, time, track))
        print(f"wrote {name}")
