"""The code of the first pages of the site runs; guides have their form."""

import re
from pathlib import Path

import pytest

# Fewer lots, and a car that compiles faster.
CHEAPER = (("64", "2"), ("num_agents=2)", 'num_agents=2, physics="bicycle")'))
NEEDS = {"parallel_env": "pettingzoo", "sb3": "stable_baselines3"}
DOCS = Path(__file__).parents[1] / "docs"
SNIPPETS = [
    pytest.param(snippet, id=f"{page} {number}")
    for page in ("index", "quick_start", "own_policy", "sb3")
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
    for name, package in NEEDS.items():
        if name in snippet:
            pytest.importorskip(package)
    for old, new in CHEAPER:
        snippet = snippet.replace(old, new)
    exec(snippet, {})
