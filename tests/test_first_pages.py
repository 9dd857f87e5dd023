"""The code of the first pages of the site runs."""

import re
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[1] / "docs"
SNIPPETS = [
    pytest.param(snippet, id=f"{page} {number}")
    for page in ("index", "quick_start")
    for number, snippet in enumerate(
        re.findall(
            r"^```python\n(.*?)^```",
            (DOCS / f"{page}.md").read_text(),
            re.MULTILINE | re.DOTALL,
        )
    )
]


@pytest.mark.parametrize("snippet", SNIPPETS)
def test_a_snippet_of_the_first_pages_runs(snippet):
    if "parallel_env" in snippet:
        pytest.importorskip("pettingzoo")
    exec(snippet.replace("64", "2"), {})  # fewer lots
