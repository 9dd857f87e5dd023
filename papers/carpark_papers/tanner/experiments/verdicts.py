"""Our runs beside the published ones, point by point, with a verdict."""

import math
from collections.abc import Sequence
from pathlib import Path

from carpark_mj.analysis.points import Point, show
from carpark_mj.analysis.statistics import Spread, spread
from carpark_mj.files import write_atomically

ENOUGH = 3  # runs for an interval


def verdict(ours: Sequence[float], theirs: Sequence[float]) -> str:
    """Whether runs agree: intervals of the interquartile mean overlap.

    Fewer than three published runs are not decided; the verdict says whether they lie
    among ours.
    """
    ours, theirs = ([x for x in xs if not math.isnan(x)] for xs in (ours, theirs))
    if not ours or not theirs:
        return "not decided: not run" if not ours else "not published"
    if len(ours) < ENOUGH:
        return f"not decided: {len(ours)} of ours"
    if len(theirs) < ENOUGH:
        inside = all(min(ours) <= x <= max(ours) for x in theirs)
        where = "within ours" if inside else "outside ours"
        return f"not decided: {len(theirs)} published, {where}"
    mine, other = spread([ours]), spread([theirs])
    if mine.low <= other.high and other.low <= mine.high:
        return "agrees"
    return f"differs: {'more' if mine.iqm > other.iqm else 'less'}"


def write_verdicts(
    path: Path,
    points: Sequence[Point],
    by: Sequence[str],
    metrics: Sequence[str],
) -> None:
    """Writes a markdown table: a row per metric and point, ours, published, verdict.

    Args:
        path: file.
        points: of two sources, ours first.
        by: settings that the points differ in.
        metrics: to compare.
    """
    sources = list(dict.fromkeys(point.source for point in points))
    found = {(point.source, point.values): point for point in points}
    lines = [
        f"| metric | {' | '.join(by)} | {' | '.join(sources)} | verdict |",
        "|" + "---|" * (2 + len(by) + len(sources)),
    ]
    for metric in metrics:
        for values in dict.fromkeys(point.values for point in points):
            numbers = [
                found[source, values].numbers(metric)
                if (source, values) in found
                else []
                for source in sources
            ]
            cells = [metric, *map(show, values)]
            cells += [_cell(spread([each])) for each in numbers]
            cells.append(verdict(*numbers) if len(numbers) == 2 else "")
            lines.append(f"| {' | '.join(cells)} |")
    text = "\n".join(lines) + "\n"
    write_atomically(path, lambda temporary: temporary.write_text(text))


def _cell(found: Spread) -> str:
    if not found.runs:
        return ""
    if math.isnan(found.low):
        return f"{found.iqm:.4g}"
    return f"{found.iqm:.4g} ({found.low:.4g} to {found.high:.4g}, {found.runs} runs)"
