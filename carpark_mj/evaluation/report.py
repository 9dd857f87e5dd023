"""An evaluation as tables on the screen and as files."""

import math
from pathlib import Path
from typing import Any

import jax
from rich.console import Console
from rich.table import Table

from carpark_mj.evaluation.aggregation import HITS, OUTCOMES
from carpark_mj.evaluation.catalogue import DRIVING, GOALS, SAFETY
from carpark_mj.evaluation.rollout import Evaluation
from carpark_mj.policy.runs import write_csv, write_json


def print_report(result: Evaluation, title: str) -> None:
    """Prints outcomes, metrics and, of a mixture, the families."""
    print_table(result.summary, title)
    print_metrics(result.summary)
    if len(result.families) > 1:
        print_families(result)


def write_evaluation(folder: Path, result: Evaluation, settings: Any) -> list[Path]:
    """Writes `evaluation.csv` (episodes) and `evaluation.json` (summaries).

    Of a mixture also `families.csv`, a row per family and one for all of them.

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
    if len(result.families) > 1:
        data["families"] = result.families
        written.append(folder / "families.csv")
        write_csv(written[2], _family_rows(result))
    write_json(written[1], data)
    return written


def _family_rows(result: Evaluation) -> list[dict[str, Any]]:
    """Episodes, counts, rates and intervals of every family, and of all together."""
    rows: list[dict[str, Any]] = []
    for family, summary in {**result.families, "all": result.summary}.items():
        row: dict[str, Any] = {"family": family, "episodes": summary["episodes"]}
        for outcome in OUTCOMES:
            for name, value in summary[outcome].items():
                row[f"{outcome}_{name}"] = value
        rows.append(row)
    return rows


def print_families(result: Evaluation) -> None:
    """Prints the outcomes of every family, with 95 % intervals."""
    table = Table(title="by family: rate, and below it the 95 % interval [%]")
    table.add_column("family")
    for column in ("episodes", "parked", "crashed", "timed out"):
        table.add_column(column, justify="right")
    for family, summary in {**result.families, "all": result.summary}.items():
        rates = [summary[name] for name in ("parked", "crashed", "timed_out")]
        table.add_row(
            family,
            f"{summary['episodes']}",
            *(
                f"{r['rate']:.1%}\n{100 * r['low']:.1f} … {100 * r['high']:.1f}"
                for r in rates
            ),
            end_section=family == list(result.families)[-1],
        )
    Console().print(table)


def print_table(summary: dict[str, Any], title: str) -> None:
    """Prints rates with 95 % intervals and means."""
    table = Table(title=f"{title}: {summary['episodes']} episodes")
    for column in ("outcome", "rate", "95 % interval", "episodes"):
        table.add_column(column, justify="left" if column == "outcome" else "right")
    for name in OUTCOMES + HITS:
        row = summary[name]
        label = name.replace("_", " ")
        table.add_row(
            f"  {label}" if name in HITS else label,
            f"{row['rate']:.1%}",
            f"{row['low']:.1%} … {row['high']:.1%}",
            f"{row['count']:.0f}",
        )
    console = Console()
    console.print(table)
    share = summary.get("wrong_way_share", math.nan)
    if not math.isnan(share):
        console.print(f"{share:.1%} of the way driven against the lanes")
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


def print_metrics(summary: dict[str, Any]) -> None:
    """Prints how the episodes were driven, and how safely."""
    table = Table(title="driving and safety (docs/metrics.md)")
    for column in ("metric", "unit", "mean", "median", "worst 5 %", "worst"):
        table.add_column(
            column, justify="left" if column in ("metric", "unit") else "right"
        )
    shown = [m for m in DRIVING + SAFETY + GOALS if m.name in summary]
    for metric in shown:
        value = summary[metric.name]
        numbers = ["", *value.values()] if isinstance(value, dict) else [value]
        table.add_row(
            metric.name.replace("_", " "),
            metric.unit,
            *(n if isinstance(n, str) else f"{n:.3g}" for n in numbers),
            end_section=metric in (DRIVING[-1], SAFETY[-1]),
        )
    Console().print(table)
