"""The page of results, `suite.html`, and against limits that of `carpark_mj report`.

One self-contained, printable HTML page of folders that `suite` and `scenario` wrote:
what was tested on what, rates with intervals against limits, distributions, contacts,
the worst cases with their films, and what repeats the test.
"""

import base64
import datetime
import html
import io
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from carpark_mj.cli.settings.tables import WORST, ReportConfig
from carpark_mj.config.checks import require_name
from carpark_mj.evaluation.aggregation import Row, wilson_interval
from carpark_mj.evaluation.tables import print_rows, table, write_page
from carpark_mj.files import require_writable
from carpark_mj.suite import report, results
from carpark_mj.types import ENDINGS

# Shares of all repetitions.
RATES = "parked", "crashed", "timed_out", "hit_person", "hit_mover", "near_miss"
# Values of repetitions, with their unit; only of those that parked, or of all.
VALUES = {
    "final_distance": ("distance to the goal", "m", True),
    "final_heading": ("angle to the goal", "rad", True),
    "time_to_park": ("time", "s", True),
    "gear_changes": ("gear changes", "", True),
    "path": ("path", "m", True),
    "min_clearance": ("least clearance", "m", False),
    "least_gap": ("least gap to people and movers", "m", False),
    "contact_speed": ("speed of contacts with people and movers", "m/s", False),
    "peak_acceleration": ("largest acceleration", "m/s²", False),
}
BINS = 20
PRINT = """<style>
@page { size: A4 landscape; }
figure { display: inline-block; margin: .4rem; vertical-align: top; }
figure video { width: 18rem; }
@media print { h2 { break-after: avoid; } figure video { display: none; }
  table { font-size: .55rem; } th, td { padding: .1rem .2rem; } }
</style>"""


class Limit(NamedTuple):
    """A limit: a rate's, or one that each repetition keeps.

    Attributes:
        name: of `RATES` or `VALUES`.
        least: whether it is the least, not the largest allowed.
        value: of a rate a share, otherwise in the unit of the value.
    """

    name: str
    least: bool
    value: float

    def __str__(self) -> str:
        return f"{self.name} {'≥' if self.least else '≤'} {self.value:g}"


def parse_limit(text: str) -> Limit:
    """A limit as it is written, `parked>=0.99` or `final_distance<=0.1`.

    Raises:
        ValueError: another form, an unknown name, or a rate outside [0, 1].
    """
    found = re.fullmatch(r"(\w+)\s*(>=|<=)\s*([^\s]+)", text.strip())
    try:
        if found is None:
            raise ValueError
        limit = Limit(found[1], found[2] == ">=", float(found[3]))
    except ValueError:
        raise ValueError(
            f"a limit is NAME>=VALUE or NAME<=VALUE, as parked>=0.99, not {text!r}"
        ) from None
    require_name("limit", limit.name, {*RATES, *VALUES})
    if limit.name in RATES and not 0.0 <= limit.value <= 1.0:
        raise ValueError(f"{limit.name} must be a share in [0, 1], not {limit.value}")
    if not math.isfinite(limit.value):
        raise ValueError(f"the limit of {limit.name} must be finite, not {limit.value}")
    return limit


def judge(limit: Limit, rows: Sequence[Row]) -> dict[str, Any]:
    """How repetitions of one policy in one level keep a limit, a row of a table.

    Its share is that of the event, or of repetitions that keep the limit. A limit of a
    rate is passed or failed if Wilson's 95 % interval says so, otherwise open. One of a
    value is passed if every repetition that has it keeps it. Intervals are for the
    number of cases: the same case with another seed is not another case.
    """
    having = [row for row in rows if _has(row, limit.name)]
    if not having:
        return {"limit": str(limit), "found": "no repetition has it", "verdict": "open"}
    values = np.array([row[limit.name] for row in having], float)
    keeps = values
    if limit.name in VALUES:
        keeps = values >= limit.value if limit.least else values <= limit.value
    share, count = float(keeps.mean()), len({row["case"] for row in having})
    low, high = wilson_interval(share * count, count)
    verdict = "passed" if keeps.all() else "failed"
    if limit.name in RATES:
        inside = (low, high) if limit.least else (1.0 - high, 1.0 - low)
        bound = limit.value if limit.least else 1.0 - limit.value
        verdict = "open"
        if inside[0] >= bound:
            verdict = "passed"
        elif inside[1] < bound:
            verdict = "failed"
    interval = f"{100 * share:.1f} % ({100 * low:.1f} … {100 * high:.1f})"
    found = f"{interval} of {count}"
    if limit.name in VALUES:
        worst = float(np.min(values) if limit.least else np.max(values))
        found += f" keep it, worst {worst:.3g} {VALUES[limit.name][1]}".rstrip()
    return {"limit": str(limit), "found": found, "verdict": verdict}


def _has(row: Row, name: str) -> bool:
    """Whether a repetition has a rate or a value: some only if it parked."""
    parked = name in VALUES and VALUES[name][2]
    there = row["parked"] or not parked
    return bool(there) and math.isfinite(row.get(name, math.nan))


def histograms(rows: Mapping[str, Sequence[Row]]) -> str:
    """Distributions of all values that vary, by policy and level, as SVG in HTML."""
    from matplotlib.figure import Figure  # no window, no state

    shown = ""
    for name, (title, unit, _) in VALUES.items():
        found = {
            which: np.array([row[name] for row in part if _has(row, name)], float)
            for which, part in rows.items()
        }
        found = {which: values for which, values in found.items() if len(values)}
        if not found or np.ptp(np.concatenate([*found.values()])) == 0.0:
            continue
        figure = Figure(figsize=(4.2, 2.6), layout="constrained")
        axes = figure.subplots()
        axes.hist([*found.values()], BINS, label=[*found], histtype="step")
        axes.set_xlabel(f"{title} [{unit}]" if unit else title)
        axes.set_ylabel("repetitions")
        if len(found) > 1:
            axes.legend(fontsize="x-small")
        file = io.BytesIO()
        figure.savefig(file, format="svg", metadata={"Date": None})
        data = base64.b64encode(file.getvalue()).decode()
        about = html.escape(title)
        shown += f'<img alt="{about}" src="data:image/svg+xml;base64,{data}">'
    return shown or "<p>no value varies</p>"


def main(config: ReportConfig) -> list[dict[str, Any]]:
    """Writes the page and prints the limits; returns their rows."""
    limits = list(map(parse_limit, config.limits))
    page, folders = Path(config.out), list(map(Path, config.runs))
    require_writable(page, new_folders=True)
    episodes, _ = results.read_runs(folders)
    films = {
        key: file
        for folder in reversed(folders)  # the first one's count
        for key in map(results.key_of, episodes)
        if (file := report.film_of(folder, key)).exists()
    }
    page.parent.mkdir(parents=True, exist_ok=True)
    judged = write_test_page(page, episodes, films, limits, config.title)
    if judged:
        print_rows(judged, config.title or report.header(episodes)[0], left=4)
    print(f"wrote {page}")
    return judged


def write_report(
    folder: Path,
    episodes: Sequence[Row],
    drives: Mapping[results.Key, results.Drives],
    num_videos: int,
) -> list[dict[str, Any]]:
    """Writes all files of the suite and prints the table; returns the table's rows.

    `drives` are of the worst episodes; of each policy and level `num_videos` are films.
    """
    folder.mkdir(parents=True, exist_ok=True)
    page = folder / "suite.html"
    rows, head = all_rows(episodes), report.header(episodes)
    written = [
        *results.write_run(folder, episodes, drives),
        results.write_submission(folder, episodes),
    ]
    written += [*report.write_tables(folder, head, rows), page]
    write_test_page(page, episodes, {})
    shown = [
        report.shown_cells(row) | {"level": report.short_level(row["level"])}
        for row in rows
    ]
    cells = [{k: x for k, x in row.items() if k in report.PRINTED} for row in shown]
    print_rows(cells, head[0], left=2)
    if len({row["level"] for row in rows}) > 1:
        print_rows(
            report.by_level(rows), "Parked [%] with Wilson's 95 % interval", left=1
        )
    parts = results.by_policy(episodes).values()
    worst = [row for part in parts for row in report.worst_first(part)[:num_videos]]
    if films := report.make_videos(folder, worst, drives):  # once more, with them
        write_test_page(page, episodes, films)
    print(f"wrote {', '.join(map(str, written))}")
    return rows


def write_test_page(
    page: Path,
    episodes: Sequence[Row],
    films: Mapping[results.Key, Path],
    limits: Sequence[Limit] = (),
    title: str = "",
) -> list[dict[str, Any]]:
    """Writes the page with films, embedded; returns the limits' rows."""
    names = report.shown_levels(row["level"] for row in episodes)
    parts = {
        f"{policy}, {names[level]}": part
        for (policy, level), part in results.by_policy(episodes).items()
    }
    judged = [
        {"policy and level": which} | judge(limit, part)
        for which, part in parts.items()
        for limit in limits
    ]
    own, *about = report.header(episodes)
    sections = [("Limits", PRINT + table(judged))] if judged else [("", PRINT)]
    found = report.tables_of(all_rows(episodes))
    sections += [(heading, table(_filled(cells))) for heading, cells in found.items()]
    sections.append(("Distributions", histograms(parts)))
    contacts = [x for x in episodes if x["crashed"] or x.get("near_miss")]
    sections.append(("Contacts and near misses", table(list(map(_contact, contacts)))))
    for which, part in parts.items():
        worst = report.worst_first(part)[:WORST]
        shown = "".join(_film(row, films) for row in worst)
        sections.append((f"Worst of {which}", table(list(map(_worst, worst))) + shown))
    sections.append(("To repeat", table(list(map(_repeat, parts.values())))))
    today = datetime.datetime.now(datetime.UTC).date().isoformat()
    write_page(page, title or own, [f"{own}. {today}.", *about], sections)
    return judged


def all_rows(episodes: Sequence[Row]) -> list[Row]:
    """The table: the planner first, as others are compared with its paths."""
    names = sorted(
        {row["policy"] for row in episodes}, key=lambda n: (n != report.PLANNER, n)
    )
    return report.same_columns(
        [row for name in names for row in report.table_rows(name, episodes)]
    )


def _filled(cells: Sequence[Mapping[str, str]]) -> list[dict[str, str]]:
    """Cells without the columns that are empty in all rows: paper is narrow."""
    names = [name for name in cells[0] if any(row[name] != "–" for row in cells)]
    return [{name: row[name] for name in names} for row in cells]


def _contact(row: Row) -> dict[str, Any]:
    level = report.short_level(row["level"])
    which = {"policy": row["policy"], "level": level}
    which |= {name: row[name] for name in ("case", "seed")}
    hit = [x.removeprefix("hit_") for x in row if x.startswith("hit_") and row[x]]
    speed = row.get("contact_speed", math.nan)
    return which | {
        "with": ", ".join(hit).replace("_", " ") or "near miss",
        "steps": row["length"],
        "speed [m/s]": speed if hit else math.nan,
        "least gap [m]": row.get("least_gap", row.get("min_clearance", math.nan)),
    }


def _worst(row: Row) -> dict[str, Any]:
    outcome = next(name for name in ENDINGS if row[name]).replace("_", " ")
    names = ("case", "seed", "kind", "length", "path", "gear_changes")
    names += ("final_distance", "final_heading")
    return {"outcome": outcome} | {name: row[name] for name in names}


def _repeat(rows: Sequence[Row]) -> dict[str, Any]:
    """What repeats the test of one policy in one level."""
    first = rows[0]
    seeds = sorted({row["seed"] for row in rows})
    cases = sorted({row["case"] for row in rows})
    return {
        "policy": first["policy"],
        "level": first["level"],
        "cases": f"{cases[0]} to {cases[-1]}",
        "seeds": ", ".join(map(str, seeds)),
        "rule": first["rule"],
        "SHA-256 of the cases": first["held_out"],
        "made with": first["made_with"],
    }


def _film(row: Row, films: Mapping[results.Key, Path]) -> str:
    """The film of an episode, embedded, if there is one."""
    if (file := films.get(results.key_of(row))) is None:
        return ""
    data = base64.b64encode(file.read_bytes()).decode()
    return (
        f'<figure><video controls muted src="data:video/mp4;base64,{data}"></video>'
        f"<figcaption>case {row['case']}, seed {row['seed']}</figcaption></figure>"
    )
