"""The catalogue: complete, in clean English, and the source of the page of metrics."""

import re
from pathlib import Path

import pytest

from carpark_mj.evaluation import catalogue
from carpark_mj.evaluation.catalogue import GOALS, POOLS, metrics
from carpark_mj.mdp.metrics import CONTEXTS, COUNTS

PAGE = Path(__file__).parents[2] / "docs" / "metrics.md"


def test_texts_have_no_doubled_punctuation_or_spaces():
    texts = [metric.meaning for metric in metrics()] + list(POOLS.values())
    for text in [*texts, PAGE.read_text()]:
        assert not re.search(r"[,;:]\s*[,;:.]|\S  +[^|\s]|\s,", text), text


def test_names_are_unique_and_every_pool_is_explained():
    names = [metric.name for metric in metrics()]
    assert len(set(names)) == len(names)
    assert {metric.pool for metric in metrics()} == set(POOLS)


def test_every_context_of_giving_way_has_a_conformity_of_its_own():
    conformities = [m for m in GOALS if m.name.startswith("conformity_")]
    assert [m.name.removeprefix("conformity_") for m in conformities] == [*CONTEXTS]
    for metric, name in zip(conformities, CONTEXTS, strict=True):
        assert metric.ratio == (f"gave_way_{name}", f"met_{name}")
    assert len({metric.meaning for metric in conformities}) == len(CONTEXTS)


def test_every_count_of_goals_is_a_metric_or_a_part_of_one():
    used = {metric.name for metric in GOALS}
    used |= {name for metric in GOALS for name in metric.ratio or ()}
    assert set(COUNTS) <= used


@pytest.mark.parametrize("part", ["pools", "outcome", "driving", "safety", "goals"])
def test_the_page_of_metrics_is_made_from_the_catalogue(part):
    if part == "pools":
        expected = "\n".join(f"- *{name}*: {text}" for name, text in POOLS.items())
    else:
        expected = catalogue.markdown_table(getattr(catalogue, part.upper()))
    pattern = rf"<!-- {part} -->\n(.*?)\n?<!-- end of {part} -->"
    found = re.search(pattern, PAGE.read_text(), re.DOTALL)
    assert found, f"paste this between the markers:\n{expected}"
    assert found[1].strip() == expected, f"paste this:\n{expected}"
