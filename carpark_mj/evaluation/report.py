"""An evaluation as tables on the screen and as files."""

import math
from pathlib import Path
from typing import Any

import jax
from rich.console import Console

from carpark_mj.config.checks import counted
from carpark_mj.evaluation.aggregation import HITS, contacts
from carpark_mj.evaluation.catalogue import DRIVING, GOALS, OUTCOME, SAFETY, metrics
from carpark_mj.evaluation.evaluator import Evaluation
from carpark_mj.evaluation.tables import print_rows
from carpark_mj.files import write_csv, write_json
from carpark_mj.types import ENDINGS, OUTCOMES


def print_report(result: Evaluation, title: str) -> None:
    """Prints outcomes and metrics, then the outcomes by what lots differ in."""
    print_table(result.summary, title)
    print_metrics(result.summary)
    print_contacts(result)
    for name, groups in _groups(result).items():
        print_groups(name, groups)


def write_evaluation(folder: Path, result: Evaluation, settings: Any) -> list[Path]:
    """Writes `evaluation.csv` (episodes) and `evaluation.json` (summaries).

    The latter has the summaries of families, numbers of agents and vehicles, too, where
    there are several.

    Returns:
        The files.
    """
    written = [folder / "evaluation.csv", folder / "evaluation.json"]
    write_csv(written[0], result.episodes)
    data = {
        "settings": settings,
        "device": jax.devices()[0].device_kind,
        "summary": result.summary,
    }
    if found := contacts(result.episodes):
        data["contacts"] = found
    for name, groups in _groups(result).items():
        stem = {"family": "families", "vehicle": "vehicles"}.get(name, "agents_present")
        data[stem] = {key: groups[key] for key in groups if key != "all"}
    write_json(written[1], data)
    return written


def _groups(result: Evaluation) -> dict[str, dict[str, dict[str, Any]]]:
    """Summaries by family, number of agents and kind of car, if there are several."""
    counts = {str(count): part for count, part in result.agent_counts.items()}
    groups = {"family": result.families, "agents present": counts}
    groups["vehicle"] = result.vehicles
    several = {name: parts for name, parts in groups.items() if len(parts) > 1}
    return {name: {**parts, "all": result.summary} for name, parts in several.items()}


def print_groups(name: str, groups: dict[str, dict[str, Any]]) -> None:
    """Prints the outcomes of groups of lots, the last all, with 95 % intervals."""
    rows: list[dict[str, Any]] = []
    for group, summary in groups.items():
        row: dict[str, Any] = {name: group, "episodes": summary["episodes"]}
        for outcome in OUTCOMES:
            r = summary[outcome]
            interval = f"{100 * r['low']:.1f} … {100 * r['high']:.1f}"
            row[outcome.replace("_", " ")] = f"{r['rate']:.1%}\n{interval}"
        rows.append(row)
    title = f"by {name}: rate, and below it the 95 % interval [%]"
    print_rows(rows, title, left=1, ends=(len(rows) - 2,))


def print_table(summary: dict[str, Any], title: str) -> None:
    """Prints rates with 95 % intervals and means."""
    hits = [name for name in HITS if name in summary]
    rows: list[dict[str, str]] = []
    for name in (*ENDINGS, *hits):
        rate, label = summary[name], name.replace("_", " ")
        row = {"outcome": f"{'  ' * (name in hits)}{label}"}
        row |= {"rate": f"{rate['rate']:.1%}"}
        row |= {"95 % interval": f"{rate['low']:.1%} … {rate['high']:.1%}"}
        rows.append(row | {"episodes": f"{rate['count']:.0f}"})
    print_rows(rows, f"{title}: {counted(summary['episodes'], 'episode')}", left=1)
    touched = sum(summary[name]["count"] for name in hits)
    console = Console()
    if more := touched - summary["crashed"]["count"]:
        console.print(f"{more:.0f} more hits: several obstacles in the same step")
    share = summary.get("wrong_way_share", math.nan)
    if not math.isnan(share):
        console.print(f"{share:.1%} of the distance driven against the lanes")
    if not summary["parked"]["count"]:
        console.print("no parked episode to describe")
        return
    console.print(
        f"parked episodes: {summary['time_to_park']:.1f} s, "
        f"{summary['path']:.1f} m driven, "
        f"{summary['gear_changes']:.1f} gear changes; off by "
        f"{summary['final_distance']:.2f} m, "
        f"{math.degrees(summary['final_heading']):.1f} deg at "
        f"{summary['final_speed']:.2f} m/s"
    )


def print_contacts(result: Evaluation) -> None:
    """Prints rates of contacts with people by the car's speed, if there are people."""
    found = contacts(result.episodes)
    if found is None:
        return
    episodes = found.pop("episodes")
    rows: list[dict[str, str]] = []
    for name, rate in found.items():
        mean, low, high = (1e4 * rate[key] for key in ("rate", "low", "high"))
        row = {"speed [m/s]": name, "per 10,000": f"{mean:.2f}"}
        row |= {"95 % interval": f"{low:.2f} … {high:.2f}"}
        rows.append(row | {"contacts": f"{rate['count']:.0f}"})
    title = f"contacts with people: {episodes} episodes in which cars moved"
    print_rows(rows, title, left=0, ends=(0,))


def print_metrics(summary: dict[str, Any]) -> None:
    """Prints metrics of driving and safety."""
    shown = [m for m in metrics() if m not in OUTCOME and m.name in summary]
    columns = ("mean", "median", "worst 5 %", "worst")
    rows: list[dict[str, str]] = []
    for metric in shown:
        value = summary[metric.name]
        first = 1 if isinstance(value, dict) else 0
        numbers = value.values() if isinstance(value, dict) else [value]
        row = {"metric": metric.name.replace("_", " "), "unit": metric.unit}
        row |= dict.fromkeys(columns, "")
        cells = zip(columns[first:], numbers, strict=False)
        rows.append(row | {column: f"{x:.3g}" for column, x in cells})
    lasts = (DRIVING[-1], SAFETY[-1], GOALS[-1])
    ends = [number for number, metric in enumerate(shown) if metric in lasts]
    print_rows(rows, "driving and safety", left=2, ends=ends)
