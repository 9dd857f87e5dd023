"""An analysis as one HTML page with embedded pictures and linked videos."""

import base64
import html
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

from carpark_mj.analysis.runs import Record
from carpark_mj.files import write_atomically

SHOWN_ROWS = 40  # of a table; a longer one is folded
_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto;
  padding: 0 1rem; color: #222; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.15rem; margin-top: 2rem; }
img, video { max-width: 100%; } .wide { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: .2rem .6rem; text-align: right; border-bottom: 1px solid #ddd; }
th:first-child, td:first-child { text-align: left; }
th { background: #f4f4f4; } .outlier { background: #fde0dc; }
"""


def write_page(
    path: Path, title: str, notes: Sequence[str], parts: Sequence[tuple[str, str]]
) -> None:
    """Writes a page.

    Args:
        path: HTML file.
        title: its heading.
        notes: paragraphs below it, plain text.
        parts: headings and the HTML below each.
    """
    body = "".join(f"<p>{html.escape(note)}</p>" for note in notes)
    for heading, content in parts:
        body += f"<h2>{html.escape(heading)}</h2>\n{content}\n"
    text = (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f"<title>{html.escape(title)}</title><style>{_STYLE}</style></head>\n"
        f"<body><h1>{html.escape(title)}</h1>\n{body}</body></html>\n"
    )
    write_atomically(path, lambda temporary: temporary.write_text(text))


def picture(path: Path) -> str:
    """A PNG embedded in HTML."""
    data = base64.b64encode(path.read_bytes()).decode()
    name = html.escape(path.stem.replace("_", " "))
    return f'<img alt="{name}" src="data:image/png;base64,{data}">'


def video_figure(path: Path, page: Path, caption: str) -> str:
    """A video that lies beside the page, or below it, as HTML with a caption."""
    return (
        f'<figure><video src="{_link(path, page)}" controls muted '
        'preload="metadata"></video>'
        f"<figcaption>{html.escape(caption)}</figcaption></figure>"
    )


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Rows of the same columns as an HTML table; outliers are marked."""
    if not rows:
        return "<p>none</p>"
    head = "".join(f"<th>{html.escape(str(name))}</th>" for name in rows[0])
    lines = [f"<tr>{head}</tr>"]
    for row in rows:
        far = str(row.get("outlier", "")).split()
        cells = [
            f'<td class="outlier">{html.escape(cell_text(value))}</td>'
            if name in far
            else f"<td>{html.escape(cell_text(value))}</td>"
            for name, value in row.items()
        ]
        lines.append(f"<tr>{''.join(cells)}</tr>")
    shown = " open" if len(rows) <= SHOWN_ROWS else ""
    return (
        f"<details{shown}><summary>{len(rows)} rows</summary>"
        f'<div class="wide"><table>{"".join(lines)}</table></div></details>'
    )


def videos(path: Path, records: Sequence[Record]) -> str:
    """Links to the videos of runs, as seen from the page at `path`."""
    links = [
        f'<li><a href="{_link(video, path)}">{html.escape(record.name)}</a></li>'
        for record in records
        if record.folder and (video := record.folder / "video.mp4").exists()
    ]
    return f"<ul>{''.join(links)}</ul>" if links else ""


def _link(path: Path, page: Path) -> str:
    """A file as seen from the page; sweeps' folders have `%` in their names."""
    return html.escape(quote(os.path.relpath(path, page.parent), safe="/=,+"))


def cell_text(value: Any) -> str:
    """A value as tables show it; a dash for NaN, such as the interval of one run."""
    if isinstance(value, float):
        return "–" if math.isnan(value) else f"{value:.4g}"
    return str(value)
