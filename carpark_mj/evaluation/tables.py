"""Rows of results as Markdown, as HTML, on the terminal, and a page of them.

Rows are mappings of the same columns.
"""

import base64
import html
import math
import os
from collections.abc import Container, Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

from carpark_mj.config.checks import counted
from carpark_mj.files import write_text

Rows = Sequence[Mapping[str, Any]]
SHOWN_ROWS = 40  # of an HTML table; a longer one is folded
WIDTH = 160  # characters of a table where there is no terminal
_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto;
  padding: 0 1rem; color: #222; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.15rem; margin-top: 2rem; }
img, video { max-width: 100%; } .wide { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: .2rem .6rem; text-align: right; border-bottom: 1px solid #ddd; }
th:first-child, td:first-child { text-align: left; }
th { background: #f4f4f4; }
"""


def cell_text(value: Any) -> str:
    """A value as tables show it; a dash for NaN, such as the interval of one run."""
    if isinstance(value, float):
        return "–" if math.isnan(value) else f"{value:.4g}"
    return str(value)


def markdown(rows: Rows, left: int | None = None) -> str:
    """Rows as a Markdown table; columns beyond the first `left` are right-aligned."""
    columns = list(rows[0])
    rule = ["---" if left is None or k < left else "---:" for k in range(len(columns))]
    lines = [f"| {' | '.join(columns)} |", f"|{'|'.join(rule)}|"]
    lines += [f"| {' | '.join(map(cell_text, row.values()))} |" for row in rows]
    return "\n".join(lines)


def print_rows(
    rows: Rows, title: str = "", left: int | None = None, ends: Container[int] = ()
) -> None:
    """Prints a table on the terminal.

    Columns beyond the first `left` are right-aligned; lines follow the rows of `ends`.
    """
    # Here: only tables need rich.
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    shown = Table(title=escape(title) or None)
    for number, name in enumerate(rows[0] if rows else ()):
        is_left = left is None or number < left
        shown.add_column(name, justify="left" if is_left else "right", overflow="fold")
    for number, row in enumerate(rows):
        cells = (escape(cell_text(value)) for value in row.values())
        shown.add_row(*cells, end_section=number in ends)
    console = Console()
    if not console.is_terminal:
        console.width = WIDTH
    console.print(shown)


def table(rows: Rows) -> str:
    """Rows as an HTML table."""
    if not rows:
        return "<p>none</p>"
    cells = [[html.escape(cell_text(x)) for x in row.values()] for row in rows]
    lines = [f"<td>{'</td><td>'.join(row)}</td>" for row in cells]
    head = "".join(f"<th>{html.escape(str(name))}</th>" for name in rows[0])
    shown = " open" if len(rows) <= SHOWN_ROWS else ""
    return (
        f"<details{shown}><summary>{counted(len(rows), 'row')}</summary>"
        f'<div class="wide"><table><tr>{"</tr><tr>".join([head, *lines])}</tr></table>'
        "</div></details>"
    )


def write_page(
    path: Path, title: str, notes: Sequence[str], parts: Sequence[tuple[str, str]]
) -> None:
    """Writes an HTML page with notes of plain text, and parts: headings and HTML."""
    body = "".join(f"<p>{html.escape(note)}</p>" for note in notes)
    for heading, content in parts:
        body += f"<h2>{html.escape(heading)}</h2>\n{content}\n"
    text = (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f"<title>{html.escape(title)}</title><style>{_STYLE}</style></head>\n"
        f"<body><h1>{html.escape(title)}</h1>\n{body}</body></html>\n"
    )
    write_text(path, text)


def picture(path: Path) -> str:
    """A PNG embedded in HTML."""
    data = base64.b64encode(path.read_bytes()).decode()
    name = html.escape(path.stem.replace("_", " "))
    return f'<img alt="{name}" src="data:image/png;base64,{data}">'


def link(path: Path, page: Path) -> str:
    """A file as seen from the page; sweeps' folders have `%` in their names."""
    return html.escape(quote(os.path.relpath(path, page.parent), safe="/=,+"))
