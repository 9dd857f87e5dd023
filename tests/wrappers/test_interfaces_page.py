"""The page of the interfaces: its snippets run, its tables name everything."""

import re
from pathlib import Path

import pytest

from carpark_mj.registration import ENTRY_POINTS
from carpark_mj.wrappers.options import OPTIONS

PAGE = (Path(__file__).parents[2] / "docs" / "interfaces.md").read_text()
SNIPPETS = re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
OPTIONAL = ("torch",)
OURS = [name for name, homes in ENTRY_POINTS.items() if "carpark_mj." in homes[1]]


@pytest.mark.parametrize("snippet", SNIPPETS)
def test_a_snippet_runs(snippet):
    for name in OPTIONAL:
        if re.search(rf"^(import|from) {name}\b", snippet, re.MULTILINE):
            pytest.importorskip(name, reason='pip install ".[sb3]"')
    exec(snippet.replace("64", "2"), {})  # fewer lots


@pytest.mark.parametrize(("table", "names"), [("ids", OURS), ("options", OPTIONS)])
def test_a_table_names_them_all(table, names):
    text = PAGE.split(f"<!-- {table} -->\n")[1].split(f"<!-- end of {table} -->")[0]
    rows = re.findall(r"^\| `([^`]+)`", text, re.MULTILINE)
    assert rows == list(names)
