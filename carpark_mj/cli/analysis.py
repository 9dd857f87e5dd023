"""`carpark_mj analysis`: several runs as tables, plots and a page."""

from collections.abc import Sequence
from pathlib import Path

from carpark_mj import analysis
from carpark_mj.cli.settings.tables import AnalysisConfig
from carpark_mj.config.checks import counted
from carpark_mj.evaluation.tables import picture, print_rows, table, write_page
from carpark_mj.files import require_writable, write_csv
from carpark_mj.policy.checkpoints import CheckpointError

MAX_ROWS = 50  # of a table on the terminal; the files have all
CURVES = ("episode/parked", "episode/crashed")
METHOD = (
    "Interquartile means (iqm) with 95 % intervals from a bootstrap of runs within "
    "each point; of three runs or fewer the iqm is the mean."
)


def main(config: AnalysisConfig) -> Path:
    """Reads, draws and writes; returns the page."""
    if not config.runs:
        raise ValueError("give at least one run folder or sweep")
    paths = [Path(name) for name in config.runs]
    records, missing = read_records(analysis.run_folders(paths))
    if not records:
        raise ValueError(f"no evaluated run in {', '.join(config.runs)}")
    by = list(config.by) or analysis.swept_settings(paths, records)
    for name in by:
        if not any(name in record.settings for record in records):
            raise ValueError(f"no run has a setting {name!r}")
    for name in config.metrics:
        if not any(name in record.metrics for record in records):
            known = sorted({metric for record in records for metric in record.metrics})
            raise ValueError(f"no run has a metric {name!r}; there are {known}")
    is_sweep = len(paths) == 1 and (paths[0] / "sweep.json").exists()
    out = Path(config.out or (paths[0] if is_sweep else "runs/analysis"))
    title = ", ".join(path.name or str(path) for path in paths)
    return analyse({"runs": records}, by, config.metrics, out, title, missing)


def read_records(folders: Sequence[Path]) -> tuple[list[analysis.Record], list[str]]:
    """The evaluated runs, and reasons why others are left out."""
    records: list[analysis.Record] = []
    missing: list[str] = []
    for folder in folders:
        try:
            records.append(analysis.read_run(folder))
        except CheckpointError as error:
            missing.append(str(error))
    return records, missing


def analyse(
    sources: analysis.Sources,
    by: Sequence[str],
    metrics: Sequence[str],
    out: Path,
    title: str,
    notes: Sequence[str] = (),
) -> Path:
    """Writes tables, plots and `report.html` of runs; returns the page.

    The first source of runs is ours; settings `by` group them. Notes are sentences at
    the top of the page, for example about missing runs.
    """
    out.mkdir(parents=True, exist_ok=True)
    page = out / "report.html"
    require_writable(page)
    points = analysis.group(sources, by)
    spreads = analysis.spread_rows(points, by, metrics)
    each = analysis.run_rows(points, by, metrics)
    write_csv(out / "spread.csv", spreads)
    write_csv(out / "runs.csv", each)
    plots = _plots(out, points, by, metrics, title)
    parts = [(heading, picture(path)) for path, heading in plots]
    parts += [("Points", table(spreads)), ("Runs", table(each))]
    ours = [record for records in sources.values() for record in records]
    if links := analysis.videos(page, ours):
        parts.append(("Videos", links))
    write_page(page, title, [*notes, METHOD, *_provenance(ours)], parts)
    if len(spreads) <= MAX_ROWS:
        print_rows(spreads, title)
    for note in notes:
        print(note)
    print(f"wrote {page}, {out / 'spread.csv'}, {out / 'runs.csv'}")
    return page


def _plots(
    out: Path,
    points: Sequence[analysis.Point],
    by: Sequence[str],
    metrics: Sequence[str],
    title: str,
) -> list[tuple[Path, str]]:
    """Draws; returns the pictures and their headings."""
    drawn: list[tuple[Path, str]] = []
    for metric in metrics if by else ():
        path = out / f"{metric}.png"
        analysis.plot_metric(path, points, by, metric, title)
        drawn.append((path, f"{metric.replace('_', ' ')} against {by[0]}"))
    for column in CURVES:
        path = out / f"curve_{column.rpartition('/')[2]}.png"
        if analysis.plot_curves(path, points, column, title):
            drawn.append((path, f"learning curves, {column.rpartition('/')[2]}"))
    return drawn


def _provenance(records: Sequence[analysis.Record]) -> list[str]:
    """Devices and versions of the trainings, if known."""
    trained = [record for record in records if record.folder]
    devices = sorted({record.device for record in trained})
    versions = {f"{name} {v}" for x in trained for name, v in x.versions.items()}
    made = f"{counted(len(trained), 'run')} on {', '.join(devices)}"
    return [f"{made}; {', '.join(sorted(versions))}."] if trained else []
