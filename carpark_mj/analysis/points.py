"""Runs grouped by settings, and tables of them."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from carpark_mj.analysis.runs import Record
from carpark_mj.analysis.statistics import Spread, outliers, spread

# Whose runs, by name: ours, or published ones.
Sources = Mapping[str, Sequence[Record]]


@dataclasses.dataclass(frozen=True)
class Point:
    """The runs of one combination of settings.

    Attributes:
        source: whose runs.
        values: of the settings that differ.
        records: the runs.
    """

    source: str
    values: tuple[Any, ...]
    records: tuple[Record, ...]

    def numbers(self, metric: str) -> list[float]:
        """A metric of every run; NaN of a run without it."""
        return [record.metrics.get(metric, float("nan")) for record in self.records]


def group(sources: Sources, by: Sequence[str]) -> list[Point]:
    """Runs grouped by settings, sources after each other, ordered by value."""
    points: list[Point] = []
    for source, records in sources.items():
        groups: dict[tuple[Any, ...], list[Record]] = {}
        for record in sorted(records, key=lambda record: record.seed):
            values = tuple(plain(record.settings.get(name)) for name in by)
            groups.setdefault(values, []).append(record)
        points += [
            Point(source, values, tuple(groups[values]))
            for values in sorted(groups, key=lambda values: [*map(_order, values)])
        ]
    return points


def plain(value: Any) -> Any:
    """A setting for comparison: numbers as floats, everything else as text.

    Truth values are spelt as in flags and tables of published runs.
    """
    if isinstance(value, bool):
        return str(value).lower()
    if value is None:
        return str(value)
    if isinstance(value, int | float):
        return float(value)
    try:
        return float(value)
    except (TypeError, ValueError):
        return ",".join(map(str, value)) if isinstance(value, list) else str(value)


def show(value: Any) -> str:
    """A setting as text for tables."""
    return f"{value:g}" if isinstance(value, float) else str(value)


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
            for metric in metrics:
                found = spread([point.numbers(metric) for point in members])
                if found.runs:
                    where = dict(zip(by, map(show, values), strict=True))
                    rows.append(_spread_row(source, where, metric, found))
    return rows


def run_rows(
    points: Sequence[Point], by: Sequence[str], metrics: Sequence[str]
) -> list[dict[str, Any]]:
    """A row per run: settings, seed, metrics, and which of these are outliers."""
    marks = {metric: marked(points, metric) for metric in metrics}
    return [
        {
            "source": point.source,
            "run": record.name,
            **dict(zip(by, map(show, point.values), strict=True)),
            "seed": record.seed,
            **{metric: record.metrics.get(metric, "") for metric in metrics},
            "outlier": " ".join(m for m in metrics if marks[m][index][number]),
        }
        for index, point in enumerate(points)
        for number, record in enumerate(point.records)
    ]


def marked(points: Sequence[Point], metric: str) -> list[list[bool]]:
    """Which runs of each point are outliers of a metric, among those of a source."""
    found: dict[int, list[bool]] = {}
    for source in {point.source for point in points}:
        own = [i for i, point in enumerate(points) if point.source == source]
        marks = outliers([points[i].numbers(metric) for i in own])
        found |= dict(zip(own, marks, strict=True))
    return [found[index] for index in range(len(points))]


def _spread_row(
    source: str, where: Mapping[str, str], metric: str, found: Spread
) -> dict[str, Any]:
    return {"source": source, **where, "metric": metric, **dataclasses.asdict(found)}


def _order(value: Any) -> tuple[bool, Any]:
    """Numbers before text, each in its order."""
    return not isinstance(value, float), value
