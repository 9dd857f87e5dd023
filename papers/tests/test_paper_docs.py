"""What the pages of the papers say is what the code declares."""

import pkgutil
import re
import shlex
from statistics import fmean

import pytest
from helpers.pages import PAGES, PAPERS, ROOT, calls, cells, markdown_table, section
from helpers.programs import rows_of
from test_docs import check_command, commands

from carpark_mj.cli.flags import read_flags
from carpark_mj.config import LAYOUTS, REWARDS
from carpark_mj.observations import make_fields
from carpark_mj.programs import STUDY_PROGRAMS
from carpark_mj.registry import ENVIRONMENTS
from carpark_mj.training.run_folder import named
from carpark_papers.cederle.experiments.program import JunctionStudyConfig
from carpark_papers.cederle.scene import JunctionSceneConfig
from carpark_papers.cederle.speed import JunctionSpeedConfig
from carpark_papers.cederle.training.families import presets_of
from carpark_papers.pandita.experiments.program import SlotsStudyConfig
from carpark_papers.pandita.sac.config import SAC_PRESETS, SACConfig
from carpark_papers.tanner.environments import TANNER_FIXED
from carpark_papers.tanner.experiments.program import StudyConfig
from carpark_papers.tanner.q_learning.config import Q_PRESETS, QLearningConfig

START = "carpark_mj study "
PAGES = [*PAGES, ROOT / "papers" / "README.md"]
CONFIGS = {
    "junction_scene": JunctionSceneConfig,
    "junction_speed": JunctionSpeedConfig,
    "junction_tables": JunctionStudyConfig,
    "q_learning": QLearningConfig,
    "sac": SACConfig,
    "slots": SlotsStudyConfig,
    "tanner": StudyConfig,
}
PRESETS = {"q_learning": Q_PRESETS, "sac": SAC_PRESETS}
LINES = sorted(
    {
        line.removeprefix(START)
        for page in PAGES
        for line in calls(page.read_text())
        if line.startswith(START)
    }
)


@pytest.mark.parametrize("line", LINES)
def test_a_command_of_a_paper_exists_and_takes_its_flags(line):
    name, *words = shlex.split(
        re.sub(r"\[.*?\]|\.\.\.", "", line).replace("RUN", "runs/x")
    )
    if name == "NAME":
        return
    assert name in STUDY_PROGRAMS
    if words and words[0] in ("--help", "--help-all"):
        return
    if name == "junction":  # its flags depend on the algorithm
        presets = presets_of(named(words, "algorithm") or "double-dueling")
        start = presets[named(words, "preset") or "parallel"]
        read_flags(type(start), words, start)
        return
    preset = named(words, "preset")
    read_flags(CONFIGS[name], words, PRESETS.get(name, {}).get(preset))


@pytest.mark.parametrize("page", PAPERS, ids=lambda page: page.name)
def test_core_commands_on_these_pages_take_their_flags(page):
    for line in commands(page.read_text()):
        check_command(line)


def test_the_environments_of_papers_are_all_named():
    page = (ROOT / "docs" / "environments.md").read_text()
    ours, papers = (
        {row[0] for row in cells(page, name)}
        for name in ("environments", "environments of papers")
    )
    assert papers == {*ENVIRONMENTS} - ours


def test_tables_of_the_papers_are_those_of_the_code():
    page = (ROOT / "docs" / "environments" / "slots.md").read_text()
    rows = cells(page, "layouts of papers")
    assert {row[0]: row[1:3] for row in rows} == {
        name: [type(config).__name__, str(config.min_bays)]
        for name, config in LAYOUTS.items()
        if name.startswith("slots")
    }
    page = (ROOT / "docs" / "environments.md").read_text()
    expected = markdown_table(make_fields(TANNER_FIXED))
    assert section(page, "tanner observation table") == expected, expected
    page = (ROOT / "docs" / "reward.md").read_text()
    found = {row[0]: row[2] for row in cells(page, "reward terms")}
    weights = {name: getattr(REWARDS["tanner"], name, 0) for name in found}
    weights |= REWARDS["tanner"].extra
    assert found == {name: f"{weight:g}" for name, weight in weights.items()}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_names_of_the_papers_package_exist(page):
    for name in re.findall(r"`(carpark_papers(?:\.\w+)+)", page.read_text()):
        pkgutil.resolve_name(name)  # its error says what is missing


# Figures of Tanner 2022 in the study's table: what varies, the columns of a setting.
FIGURES = {
    "5.5": ("agents", ["env.num_agents"]),
    "5.14": ("agents that choose goals", ["env.num_agents"]),
}


def runs_of(figure, columns, source):
    groups = {}
    for run in rows_of(ROOT / "docs" / "study" / f"figure-{figure}.csv"):
        if run["source"] == source:
            groups.setdefault(tuple(int(run[c]) for c in columns), []).append(run)
    return dict(sorted(groups.items()))


def study_table():
    """The table of the study's page, from the recorded runs."""
    lines = [
        "| figure | varied | | published [%] | ours [%] |",
        "|---|---|---|---|---|",
    ]
    for figure, (name, columns) in FIGURES.items():
        sources = [runs_of(figure, columns, x) for x in ("Tanner 2022", "ours")]
        assert sources[0].keys() == sources[1].keys()
        values = ", ".join(str(value) for (value,) in sources[0])
        for metric in ("parked", "crashed"):
            means = [
                [f"{100 * fmean(float(run[metric]) for run in x):.1f}" for x in y]
                for y in (source.values() for source in sources)
            ]
            theirs, ours = map(", ".join, means)
            what = f"| {figure} | {name}: {values} | {metric} "
            lines.append(f"{what}| {theirs} | {ours} |")
    return "\n".join(lines)


def test_the_study_s_table_is_that_of_its_recorded_runs():
    expected = study_table()
    found = section((ROOT / "docs" / "study.md").read_text(), "figures")
    assert found == expected, f"paste this:\n{expected}"
