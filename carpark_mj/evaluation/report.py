"""An evaluation as tables on the screen and as files."""

import math
from pathlib import Path
from typing import Any

import jax
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from carpark_mj.evaluation.aggregation import HITS, contacts
from carpark_mj.evaluation.catalogue import DRIVING, GOALS, OUTCOME, SAFETY, metrics
from carpark_mj.evaluation.evaluator import Evaluation
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

    Of a mixture also `families.csv`, a row per family and one for all of them, and in
    the same way `agents_present.csv` of several numbers of agents, and `vehicles.csv`
    of a fleet.

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
        stem = _FILES[name]
        data[stem] = {key: groups[key] for key in groups if key != "all"}
        written.append(folder / f"{stem}.csv")
        write_csv(written[-1], _group_rows(name, groups))
    write_json(written[1], data)
    return written


_FILES = {
    "family": "families",
    "agents present": "agents_present",
    "vehicle": "vehicles",
}


def _groups(result: Evaluation) -> dict[str, dict[str, dict[str, Any]]]:
    """Summaries by family, number of agents and kind of car, if there are several."""
    counts = {str(count): part for count, part in result.agent_counts.items()}
    groups = {
        "family": result.families,
        "agents present": counts,
        "vehicle": result.vehicles,
    }
    return {
        name: {**parts, "all": result.summary}
        for name, parts in groups.items()
        if len(parts) > 1
    }


def _group_rows(column: str, groups: dict[str, dict[str, Any]]) -> list[dict[str, Any]]:
    """Episodes, counts, rates and intervals of every group."""
    rows: list[dict[str, Any]] = []
    for group, summary in groups.items():
        row: dict[str, Any] = {column.replace(" ", "_"): group}
        row["episodes"] = summary["episodes"]
        for outcome in ENDINGS:
            for name, value in summary[outcome].items():
                row[f"{outcome}_{name}"] = value
        rows.append(row)
    return rows


def print_groups(name: str, groups: dict[str, dict[str, Any]]) -> None:
    """Prints the outcomes of groups of lots, the last all, with 95 % intervals."""
    table = Table(title=f"by {name}: rate, and below it the 95 % interval [%]")
    table.add_column(name)
    for column in ("episodes", "parked", "crashed", "timed out"):
        table.add_column(column, justify="right")
    for group, summary in groups.items():
        rates = [summary[name] for name in OUTCOMES]
        table.add_row(
            escape(group),
            f"{summary['episodes']}",
            *(
                f"{r['rate']:.1%}\n{100 * r['low']:.1f} … {100 * r['high']:.1f}"
                for r in rates
            ),
            end_section=group == list(groups)[-2],
        )
    Console().print(table)


def print_table(summary: dict[str, Any], title: str) -> None:
    """Prints rates with 95 % intervals and means."""
    table = Table(title=f"{escape(title)}: {summary['episodes']} episodes")
    for column in ("outcome", "rate", "95 % interval", "episodes"):
        table.add_column(column, justify="left" if column == "outcome" else "right")
    hits = [name for name in HITS if name in summary]
    for name in (*ENDINGS, *hits):
        row = summary[name]
        label = name.replace("_", " ")
        table.add_row(
            f"  {label}" if name in hits else label,
            f"{row['rate']:.1%}",
            f"{row['low']:.1%} … {row['high']:.1%}",
            f"{row['count']:.0f}",
        )
    console = Console()
    console.print(table)
    touched = sum(summary[name]["count"] for name in hits)
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
    table = Table(
        title=f"contacts with people: {episodes} episodes in which cars moved"
    )
    for column in ("speed [m/s]", "per 10,000", "95 % interval", "contacts"):
        table.add_column(column, justify="right")
    for name, rate in found.items():
        mean, low, high = (1e4 * rate[key] for key in ("rate", "low", "high"))
        table.add_row(
            name,
            f"{mean:.2f}",
            f"{low:.2f} … {high:.2f}",
            f"{rate['count']:.0f}",
            end_section=name == "any",
        )
    Console().print(table)


def print_metrics(summary: dict[str, Any]) -> None:
    """Prints metrics of driving and safety."""
    table = Table(title="driving and safety (docs/metrics.md)")
    for column in ("metric", "unit", "mean", "median", "worst 5 %", "worst"):
        table.add_column(
            column, justify="left" if column in ("metric", "unit") else "right"
        )
    shown = [m for m in metrics() if m not in OUTCOME and m.name in summary]
    for metric in shown:
        value = summary[metric.name]
        numbers = ["", *value.values()] if isinstance(value, dict) else [value]
        table.add_row(
            metric.name.replace("_", " "),
            metric.unit,
            *(n if isinstance(n, str) else f"{n:.3g}" for n in numbers),
            end_section=metric in (DRIVING[-1], SAFETY[-1], GOALS[-1]),
        )
    Console().print(table)
