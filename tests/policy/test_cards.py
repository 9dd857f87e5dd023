"""Cards of the pretrained policies: what each must say; the page shows them."""

import re
from pathlib import Path

from carpark_mj.policy import checkpoints, runs
from carpark_mj.policy.runs import find_policy, pretrained_names

DOCS = Path(__file__).parents[2] / "docs"


def rows(card):
    """The rows of the two tables of a card: settings by name, and evaluations."""
    cells = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in card.splitlines()
        if line.startswith("|") and not line.startswith("|---") and line != "| | |"
    ]
    settings = {row[0]: row[1] for row in cells if len(row) == 2}
    return settings, [row for row in cells if len(row) == 5][1:]


def faults(name, card):
    """What is wrong with the card of a policy."""
    settings, evaluations = rows(card)
    header = checkpoints.read_header(find_policy(name))
    wanted = ("task", "training", "steps", "seed", "device")
    yield from (f"no {row}" for row in wanted if not settings.get(row))
    if not re.search(r"^Limits:\n\n(- \S.*\n( .*\n)*)+\Z", card, re.MULTILINE):
        yield "no limits"
    if card.splitlines()[0] != f"## {name}":
        yield "another name"
    if settings.get("steps") != f"{header['env_steps']:,}":
        yield f"steps are {header['env_steps']:,}"
    if settings.get("seed") != str(header["config"]["seed"]):
        yield f"the seed is {header['config']['seed']}"
    if not evaluations:
        yield "no evaluation"
    for command, episodes, *rates in evaluations:
        if f"`python eval/evaluate.py {name}" not in command:
            yield f"{command} is no evaluation of it"
        if int(episodes.replace(",", "")) < 1000:
            yield f"{episodes} episodes are too few"
        pattern = r"([\d.]+) % \(([\d.]+) … ([\d.]+)\)"
        numbers = [list(map(float, re.fullmatch(pattern, r).groups())) for r in rates]
        if not all(low <= rate <= high for rate, low, high in numbers):
            yield f"a rate is not in its interval: {rates}"
        if abs(sum(rate for rate, _, _ in numbers) - 100) > 0.2:  # diverged, rounding
            yield f"{rates} do not make 100 %"


def test_every_policy_has_a_card_with_its_figures(shipped):
    for name in pretrained_names():
        assert list(faults(name, (shipped / f"{name}.md").read_text())) == [], name
    cards = {path.stem for path in shipped.glob("*.md")}
    assert cards == {*pretrained_names()}


def test_the_page_of_the_policies_shows_all_cards():
    cards = [(runs.FOLDER / f"{name}.md").read_text() for name in pretrained_names()]
    page = (DOCS / "policies.md").read_text()
    shown = page.split("<!-- cards -->\n")[1].split("\n<!-- end of cards -->")[0]
    expected = "\n".join(cards).rstrip()
    assert shown == expected, f"paste this:\n{expected}"
