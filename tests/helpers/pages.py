"""What pages say: tables between markers, blocks of code, commands, names."""

import itertools
import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted((ROOT / "docs").rglob("*.md")),
]
# Pages of carpark_papers, whose commands need it.
PAPERS = [
    ROOT / "docs" / f"{name}.md"
    for name in ("study", "q_learning", "slots", "junction", "environments/slots")
]


def section(page, name):
    """What stands between two markers."""
    return page.split(f"<!-- {name} -->\n")[1].split(f"\n<!-- end of {name} -->")[0]


def cells(page, name):
    """The rows of a table between markers, less its two head lines."""
    rows = section(page, name).splitlines()[2:]
    return [[cell.strip().strip("`") for cell in row[1:-1].split("|")] for row in rows]


def markdown_table(fields):
    """Fields as a markdown table; of repeated entities the first.

    Neighbours that differ in nothing but their names share a row.
    """
    rows = ["| field | size | range | meaning [unit] |", "|---|---|---|---|"]
    first = [field for field in fields if field.index == 0]
    for row, alike in itertools.groupby(
        first, lambda x: f"{x.size} | {x.low:g} … {x.high:g} | {x.meaning} |"
    ):
        names = ", ".join(f"`{field.name}`" for field in alike)
        rows.append(f"| {names} | {row}")
    return "\n".join(rows)


def code(page, language):
    """The blocks of code of a page in a language."""
    return re.findall(rf"^```{language}\n(.*?)^```", page, re.MULTILINE | re.DOTALL)


def calls(page):
    """Lines of blocks, without comments, and quotes of a page: commands, if any."""
    blocks = "\n".join(re.findall(r"^```\w*\n(.*?)^```", page, re.M | re.S))
    text = re.sub(r"^```\w*\n.*?^```", "", page, flags=re.MULTILINE | re.DOTALL)
    quoted = [" ".join(q.split()) for q in re.findall(r"`([^`]+)`", text)]
    return [line.split("#")[0].strip() for line in blocks.splitlines()] + quoted
