"""Finished runs as records of their settings and metrics."""

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from carpark_mj.policy.checkpoints import CheckpointError
from carpark_mj.reading import read_csv, read_object, require_entries

# Settings that may differ between runs of the same training.
_INCIDENTAL = ("name", "runs_dir", "resume", "time_limit", "seed", "preset")


@dataclasses.dataclass(frozen=True)
class Record:
    """A run that was evaluated.

    Attributes:
        name: of its folder.
        settings: dotted name to value, of all settings of the trainer.
        metrics: name to number; a rate is one number, quantiles have their own names.
        seed: random seed.
        folder: of the run; None of a published one.
        versions: of the packages that trained it.
        device: what trained it.
    """

    name: str
    settings: Mapping[str, Any]
    metrics: Mapping[str, float]
    seed: int = 0
    folder: Path | None = None
    versions: Mapping[str, str] = dataclasses.field(default_factory=dict)
    device: str = ""


def read_run(folder: Path) -> Record:
    """Reads a run that `carpark_mj train` or a sweep has finished.

    Raises:
        CheckpointError: there is no run, or it has no evaluation.
    """
    config, evaluation = folder / "config.json", folder / "evaluation.json"
    described: dict[str, Any] = {"device": "", "versions": {}}
    described |= _read_json(config, config=dict)
    settings = {"seed": 0} | dict(_flatten(described["config"]))
    summary = _read_json(evaluation, summary=dict)["summary"]
    try:
        require_entries(described, str(config), device=str, versions=dict)
        require_entries(settings, str(config), seed=int)
    except ValueError as error:
        raise CheckpointError(str(error)) from None
    try:
        metrics = flat_metrics(summary)
    except (TypeError, ValueError, OverflowError) as error:
        raise CheckpointError(f"{evaluation} is damaged: {error}") from None
    return Record(
        name=folder.name,
        settings=settings,
        metrics=metrics,
        seed=settings["seed"],
        folder=folder,
        versions=described["versions"],
        device=described["device"],
    )


def run_folders(paths: Sequence[Path]) -> list[Path]:
    """The folders of runs and of the runs of sweeps, each once.

    Raises:
        CheckpointError: a path is neither.
    """
    folders: list[Path] = []
    for path in paths:
        if (path / "sweep.json").exists():
            folders += sorted(child.parent for child in path.glob("runs/*/config.json"))
        elif (path / "config.json").exists():
            folders.append(path)
        else:
            raise CheckpointError(f"{path} is neither a run nor a sweep")
    # One that is given twice, or with its sweep, is not two runs.
    first: dict[Path, Path] = {}
    for folder in folders:
        first.setdefault(folder.resolve(), folder)
    return [*first.values()]


def swept_settings(paths: Sequence[Path], records: Sequence[Record]) -> list[str]:
    """Settings in which the runs differ: those that sweeps vary, else all that vary.

    For runs of several presets it is the preset.
    """
    if len({record.settings.get("preset") for record in records}) > 1:
        return ["preset"]
    names: list[str] = []
    for path in paths:
        if (path / "sweep.json").exists():
            swept = _read_json(path / "sweep.json", swept=list)["swept"]
            if not all(isinstance(fields, list) and fields for fields in swept):
                raise CheckpointError(f"{path / 'sweep.json'} has no settings in swept")
            names += [str(fields[0]) for fields in swept]
    if names:
        return list(dict.fromkeys(names))
    known = dict.fromkeys(name for record in records for name in record.settings)
    return [
        name
        for name in known
        if name not in _INCIDENTAL
        and len({str(record.settings.get(name)) for record in records}) > 1
    ]


def read_curve(folder: Path, column: str) -> list[tuple[float, float]]:
    """`(agent steps, value)` of a column of a run's `metrics.csv`, finite ones.

    Raises:
        CheckpointError: the file is damaged.
    """
    path = folder / "metrics.csv"
    if not path.exists():
        return []
    points: list[tuple[float, float]] = []
    try:
        for row in read_csv(path, "env_steps", growing=True):
            value = row.number(column) if column in row.cells else math.nan
            counted = "episodes" not in row.cells or row.number("episodes") > 0
            if math.isfinite(value) and counted:
                points.append((row.number("env_steps"), value))
    except ValueError as error:
        raise CheckpointError(str(error)) from None
    return points


def flat_metrics(summary: Mapping[str, Any]) -> dict[str, float]:
    """The summary of an evaluation with one number per name."""
    metrics: dict[str, float] = {}
    for name, value in summary.items():
        if not isinstance(value, dict):
            metrics[name] = float(value)
        elif "rate" in value:
            metrics[name] = float(value["rate"])
        else:
            metrics |= {f"{name}_{part}": float(x) for part, x in value.items()}
    return metrics


def _flatten(config: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in config.items():
        if isinstance(value, dict):
            yield from _flatten(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def _read_json(path: Path, **kinds: type) -> dict[str, Any]:
    """Reads a JSON object that must have values of some types."""
    try:
        return read_object(path, **kinds)
    except (FileNotFoundError, NotADirectoryError):
        raise CheckpointError(f"no {path.name} in {path.parent}") from None
    except ValueError as error:
        raise CheckpointError(str(error)) from None
