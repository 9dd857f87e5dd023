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


def nav(part):
    """Pages of a part of the site, from `mkdocs.yml`."""
    text = (
        (DOCS.parent / "mkdocs.yml").read_text().split("\nnav:\n")[1].split("\n\n")[0]
    )
    [section] = [s for s in re.split(r"^  - ", text, flags=re.M) if s.startswith(part)]
    return [DOCS / page for page in re.findall(r"[\w/]+\.md", section)]


@pytest.mark.parametrize("page", nav("Guides"), ids=lambda page: page.stem)
def test_a_guide_begins_with_what_works_and_ends_with_what_to_read_next(page):
    first, second, *_, last = re.split(r"\n\n+", page.read_text().strip())
    assert first.startswith("# ")
    assert second.startswith("```")
    assert last.startswith("Read next: ")
