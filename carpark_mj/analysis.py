"""Several runs together: records, intervals, plots.

Intervals are as Agarwal et al. 2021 recommend (arXiv 2108.13264): the interquartile
mean is the mean of the middle half; its interval comes from resampling runs within each
point of a sweep (a stratified bootstrap), so that points do not change their weight.
"""

import dataclasses
import html
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from carpark_mj.evaluation.catalogue import metrics as known_metrics
from carpark_mj.evaluation.tables import link
from carpark_mj.files import drawn_axes
from carpark_mj.policy.checkpoints import CheckpointError
from carpark_mj.reading import read_csv, read_object, require_entries

CONFIDENCE = 0.95
RESAMPLES = 2000
GRID = 200  # points of a mean curve
# Settings that may differ between runs of the same training.
_INCIDENTAL = "name", "runs_dir", "resume", "time_limit", "seed", "preset", "logger"


@dataclasses.dataclass(frozen=True)
class Record:
    """A run that was evaluated."""

    name: str  # of its folder
    settings: Mapping[str, Any]  # by dotted name, all settings of the trainer
    metrics: Mapping[str, float]  # by name; a rate is one number
    seed: int = 0
    folder: Path | None = None  # of the run; None of a published one
    versions: Mapping[str, str] = dataclasses.field(default_factory=dict)
    device: str = ""  # what trained it


# Whose runs, by name: ours, or published ones.
Sources = Mapping[str, Sequence[Record]]


def read_run(folder: Path) -> Record:
    """Reads a run that `carpark_mj train` or a sweep has finished.

    Raises:
        CheckpointError: there is no run, or it has no evaluation.
    """
    config = _read_json(folder / "config.json", config=dict)
    described: dict[str, Any] = {"device": "", "versions": {}} | config
    settings = {"seed": 0} | dict(_flatten(described["config"]))
    summary = _read_json(folder / "evaluation.json", summary=dict)["summary"]
    try:
        require_entries(described, str(folder), device=str, versions=dict)
        require_entries(settings, str(folder), seed=int)
        metrics = flat_metrics(summary)
    except (TypeError, ValueError, OverflowError) as error:
        raise CheckpointError(f"{folder} is damaged: {error}") from None
    return Record(
        name=folder.name,
        settings=settings,
        metrics=metrics,
        seed=settings["seed"],
        folder=folder,
        versions=described["versions"],
        device=described["device"],
    )


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
    try:
        return read_object(path, **kinds)
    except (FileNotFoundError, NotADirectoryError):
        raise CheckpointError(f"no {path.name} in {path.parent}") from None
    except ValueError as error:
        raise CheckpointError(str(error)) from None


def run_folders(paths: Sequence[Path]) -> list[Path]:
    """The folders of runs and of the runs of sweeps, each once.

    Raises:
        CheckpointError: a path is neither.
    """
    folders: dict[Path, Path] = {}
    for path in paths:
        if (path / "sweep.json").exists():
            found = sorted(child.parent for child in path.glob("runs/*/config.json"))
        elif (path / "config.json").exists():
            found = [path]
        else:
            raise CheckpointError(f"{path} is neither a run nor a sweep")
        for folder in found:
            folders.setdefault(folder.resolve(), folder)
    return [*folders.values()]


def swept_settings(paths: Sequence[Path], records: Sequence[Record]) -> list[str]:
    """Settings in which the runs differ: those that sweeps vary, else all that vary.

    For runs of several presets it is the preset.
    """
    if len({record.settings.get("preset") for record in records}) > 1:
        return ["preset"]
    names: dict[str, None] = {}
    for file in (path / "sweep.json" for path in paths):
        swept = _read_json(file, swept=list)["swept"] if file.exists() else []
        if not all(isinstance(fields, list) and fields for fields in swept):
            raise CheckpointError(f"{file} has no settings in swept")
        names |= dict.fromkeys(str(fields[0]) for fields in swept)
    if names:
        return [*names]
    known = dict.fromkeys(name for record in records for name in record.settings)
    values = {name: {str(x.settings.get(name)) for x in records} for name in known}
    return [n for n, found in values.items() if n not in _INCIDENTAL and len(found) > 1]


def read_curve(folder: Path, column: str) -> list[tuple[float, float]]:
    """`(agent steps, value)` of a column of a run's `metrics.csv`, finite ones."""
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


@dataclasses.dataclass(frozen=True)
class Point:
    """The runs of one combination of settings."""

    source: str  # whose runs
    values: tuple[Any, ...]  # of the settings that differ
    records: tuple[Record, ...]  # the runs

    def numbers(self, metric: str) -> list[float]:
        """A metric of every run; NaN of a run without it."""
        return [record.metrics.get(metric, math.nan) for record in self.records]


def group(sources: Sources, by: Sequence[str]) -> list[Point]:
    """Runs grouped by settings, sources after each other, ordered by value."""
    points: list[Point] = []
    for source, records in sources.items():
        groups: dict[tuple[Any, ...], list[Record]] = {}
        for record in sorted(records, key=lambda record: record.seed):
            values = tuple(plain(record.settings.get(name)) for name in by)
            groups.setdefault(values, []).append(record)
        # Numbers before text, each in its order.
        order = sorted(groups, key=lambda v: [(not isinstance(x, float), x) for x in v])
        points += [Point(source, values, tuple(groups[values])) for values in order]
    return points


def plain(value: Any) -> Any:
    """A setting for comparison: numbers as floats, everything else as in flags."""
    if isinstance(value, bool):
        return str(value).lower()
    try:
        return float(value)
    except (TypeError, ValueError):
        return ",".join(map(str, value)) if isinstance(value, list) else str(value)


def show(value: Any) -> str:
    """A setting as text for tables."""
    return f"{value:g}" if isinstance(value, float) else str(value)


@dataclasses.dataclass(frozen=True)
class Spread:
    """Several numbers of the same kind."""

    runs: int  # how many
    median: float  # their median
    iqm: float  # mean of the middle half; of three or fewer the mean
    low: float  # lower end of the interval of `iqm`; NaN of a single run
    high: float  # upper end of the interval


def spread(strata: Sequence[Sequence[float]]) -> Spread:
    """Describes numbers by strata, one for each point of a sweep; NaNs are left out."""
    from scipy import stats

    found = [np.array(stratum, float) for stratum in strata]
    found = [
        values[~np.isnan(values)] for values in found if not np.isnan(values).all()
    ]
    if not found:
        return Spread(0, math.nan, math.nan, math.nan, math.nan)

    def statistic(*parts: np.ndarray, axis: int = -1) -> np.ndarray:
        drawn = np.concatenate(parts, axis)  # axis is the last one
        same = np.broadcast_to(single, (*drawn.shape[:-1], len(single)))
        return stats.trim_mean(np.concatenate((drawn, same), axis), 0.25, axis=axis)

    repeated = [values for values in found if len(values) > 1]
    single = np.array([values[0] for values in found if len(values) == 1])
    low = high = math.nan
    if repeated:
        low, high = stats.bootstrap(
            repeated,
            statistic,
            n_resamples=RESAMPLES,
            confidence_level=CONFIDENCE,
            method="percentile",
            rng=np.random.default_rng(0),
        ).confidence_interval
    together = np.concatenate(found)
    numbers = np.median(together), stats.trim_mean(together, 0.25), low, high
    return Spread(len(together), *map(float, numbers))


def spread_rows(
    points: Sequence[Point], by: Sequence[str], metrics: Sequence[str]
) -> list[dict[str, Any]]:
    """A row per point and metric, then one of all points of a source."""
    rows: list[dict[str, Any]] = []
    for source in dict.fromkeys(point.source for point in points):
        own = [point for point in points if point.source == source]
        parts = [(point.values, [point]) for point in own]
        if len(own) > 1:
            parts.append((("all",) * len(by), own))
        for values, members in parts:
            where = dict(zip(by, map(show, values), strict=True))
            for metric in metrics:
                found = spread([point.numbers(metric) for point in members])
                if found.runs:
                    row = {"source": source, **where, "metric": metric}
                    rows.append(row | dataclasses.asdict(found))
    return rows


def run_rows(
    points: Sequence[Point], by: Sequence[str], metrics: Sequence[str]
) -> list[dict[str, Any]]:
    """A row per run: settings, seed and metrics."""
    return [
        {
            "source": point.source,
            "run": record.name,
            **dict(zip(by, map(show, point.values), strict=True)),
            "seed": record.seed,
            **{metric: record.metrics.get(metric, "") for metric in metrics},
        }
        for point in points
        for record in point.records
    ]


def plot_metric(
    path: Path, points: Sequence[Point], by: Sequence[str], metric: str, title: str = ""
) -> None:
    """Draws a metric against the first of the settings `by`, a line for each rest.

    Dots are runs, lines interquartile means, bands their 95 % intervals. Lines of the
    first source are solid, those of the others dashed.
    """
    values = list(dict.fromkeys(point.values[0] for point in points))
    numeric = all(isinstance(value, float) for value in values)
    place = {value: value if numeric else i for i, value in enumerate(values)}
    sources = list(dict.fromkeys(point.source for point in points))
    series = list(dict.fromkeys((p.source, p.values[1:]) for p in points))
    shades = list(dict.fromkeys(rest for _, rest in series))
    with drawn_axes(path, (8, 4.5), title) as (axes,):
        for source, rest in series:
            own = [p for p in points if (p.source, p.values[1:]) == (source, rest)]
            colour = _colour(shades.index(rest), len(shades))
            names = [source] * (len(sources) > 1) + [show(value) for value in rest]
            x = [place[point.values[0]] for point in own]
            found = [spread([point.numbers(metric)]) for point in own]
            dash = "-" if source == sources[0] else "--"
            label = ", ".join(names) or None
            means = [one.iqm for one in found]
            axes.plot(x, means, color=colour, linestyle=dash, label=label)
            ends = [one.low for one in found], [one.high for one in found]
            axes.fill_between(x, *ends, color=colour, alpha=0.15, lw=0)
            for at, point in zip(x, own, strict=True):
                numbers = point.numbers(metric)
                axes.scatter([at] * len(numbers), numbers, 16, [colour], alpha=0.6)
        unit = {known.name: known.unit for known in known_metrics()}.get(metric)
        name = metric.replace("_", " ")
        axes.set(xlabel=by[0], ylabel=f"{name} [{unit}]" if unit else name)
        if not numeric:
            axes.set_xticks([*place.values()], [show(value) for value in place])
        if axes.get_legend_handles_labels()[1]:
            axes.legend(title=", ".join(by[1:]) or None, fontsize="small")


def plot_curves(
    path: Path, points: Sequence[Point], column: str, title: str = ""
) -> bool:
    """Draws medians and quartiles of a column of `metrics.csv`; False without any."""
    curves: list[tuple[Point, list[Any]]] = []
    for point in points:
        folders = [record.folder for record in point.records if record.folder]
        if found := list(filter(None, (read_curve(x, column) for x in folders))):
            curves.append((point, found))
    if not curves:
        return False
    with drawn_axes(path, (8, 4.5), title) as (axes,):
        for number, (point, found) in enumerate(curves):
            colour = _colour(number, len(curves))
            end = min(curve[-1][0] for curve in found)
            start = max(curve[0][0] for curve in found)
            steps = np.linspace(start, max(start, end), GRID)
            each = [np.interp(steps, *np.array(curve).T) for curve in found]
            low, middle, high = np.quantile(each, (0.25, 0.5, 0.75), axis=0)
            label = ", ".join(map(show, point.values)) or point.source
            axes.fill_between(steps / 1e6, low, high, color=colour, alpha=0.2, lw=0)
            axes.plot(steps / 1e6, middle, color=colour, label=label)
        name = column.rpartition("/")[2].replace("_", " ")
        axes.set(xlabel="agent steps [million]", ylabel=f"{name} (training)")
        if len(curves) > 1:
            axes.legend(fontsize="small", ncols=1 + len(curves) // 12)
    return True


def _colour(number: int, count: int) -> Any:
    from matplotlib import colormaps

    return f"C{number}" if count <= 10 else colormaps["viridis"](number / (count - 1))


def videos(path: Path, records: Sequence[Record]) -> str:
    """Links to the videos of runs, as seen from the page at `path`."""
    links = [
        f'<li><a href="{link(video, path)}">{html.escape(record.name)}</a></li>'
        for record in records
        if record.folder and (video := record.folder / "video.mp4").exists()
    ]
    return f"<ul>{''.join(links)}</ul>" if links else ""
