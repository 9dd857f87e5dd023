"""README, docs and code agree: commands, links, tables, snippets, numbers, versions."""

import ast
import dataclasses
import importlib
import pkgutil
import re
import shlex
from operator import attrgetter
from pathlib import Path

import pytest
from helpers.cars import ROAD_CARS
from helpers.pages import (
    PAGES,
    PAPERS,
    ROOT,
    calls,
    cells,
    code,
    markdown_table,
    section,
)
from helpers.rules import LIMITS

import carpark_mj
from carpark_mj.cli.flags import read_flags
from carpark_mj.config import (
    LAYOUTS,
    REWARD_TERMS,
    REWARDS,
    EnvConfig,
    GivingWayConfig,
    RewardConfig,
)
from carpark_mj.extensions import FORMATS, Entry
from carpark_mj.layouts.files import _SCHEMA, read_json
from carpark_mj.mdp.goals import CONTEXTS
from carpark_mj.mdp.rewards import TERMS, goal_weights
from carpark_mj.observations import make_fields
from carpark_mj.programs import COMMANDS as PROGRAMS
from carpark_mj.registration import ENTRY_POINTS
from carpark_mj.registry import ENVIRONMENTS
from carpark_mj.training.hosts import read_hosts, take_flags
from carpark_mj.training.ppo.config import PPOConfig
from carpark_mj.training.ppo.parts import PRESETS as PPO_PRESETS
from carpark_mj.training.run_folder import named, read_runs
from carpark_mj.wrappers.options import OPTIONS
from vehicle_suite.report import excerpt

DOCS = ROOT / "docs"
README = (ROOT / "README.md").read_text()
TEXTS = {page.stem: page.read_text() for page in DOCS.glob("*.md")}
REPORT = ROOT / "docs" / "physics" / "report.csv"

# Scripts that are also commands of `carpark_mj`.
SCRIPTS = {
    **{f"eval/{name}.py": name for name in ("evaluate", "render")},
    **{f"train/{name}.py": name for name in ("export", "sweep")},
    "train/ppo.py": "train",
}


def commands(page):
    """Calls of programs in blocks and quotes of a page, without their starts."""
    found = [call for call in calls(page) if call[:7] == "python "]
    found = [call[7:].removeprefix("-m ") for call in found]
    own = [call for call in calls(page) if call.startswith("carpark_mj ")]
    return found + [x for x in own if x.split()[1] in PROGRAMS and " study" not in x]


def needs_formats(line):
    """Whether carpark_formats has the command, or its flags."""
    if line.startswith("carpark_mj export "):
        return ".npz" not in line
    return line.startswith(tuple(f"carpark_mj {name}" for name in FORMATS["command"]))


COMMAND_LINES = sorted(
    line
    for page in PAGES
    if page not in PAPERS
    for line in {*commands(page.read_text())}
    if not needs_formats(line)
)


def test_observations_are_those_of_the_code():
    expected = markdown_table(make_fields(EnvConfig()))
    assert section(TEXTS["observation"], "observation table") == expected, expected


def test_report_and_readme_have_rows_of_the_physics_table():
    assert excerpt(REPORT) in REPORT.with_suffix(".md").read_text()
    rows = section(README, "accuracy table").splitlines()
    table = excerpt(REPORT).splitlines()
    assert rows == [row for row in table if row in rows]
    assert len(rows) > 2


def test_the_parked_rules_are_those_in_force():
    def limit(value, unit, digits=3):
        return "any" if value is None else f"< {value:.{digits}g}{unit}"

    expected = []
    for name, rule in LIMITS.items():
        lines = ", between the lines" if rule.from_end else ""
        row = [limit(rule.offset, " m"), limit(rule.distance, " m")]
        row += [limit(rule.from_end, " m") + lines]
        row += ["within the lines" if rule.inside_lines else "any"]
        row += [limit(rule.heading and rule.heading * 57.29578, "°")]
        expected.append([name, *row, limit(rule.speed, " m/s")])
    assert sorted(cells(TEXTS["mdp"], "parked rules")) == expected


def test_the_reward_terms_and_those_of_goals_have_their_weights():
    weights = {name: getattr(REWARDS["shaped"], name) for name in TERMS}
    weights |= dict.fromkeys(sorted(REWARD_TERMS), 0) | REWARDS["shaped"].extra
    found = dict(row[:2] for row in cells(TEXTS["reward"], "reward terms"))
    del weights["pose"]  # of tasks with goal poses
    assert found == {name: f"{weight:g}" for name, weight in weights.items()}
    for field in dataclasses.fields(RewardConfig):
        assert f"`{field.name}`" in TEXTS["reward"] or field.name == "goals", field.name
    weights = goal_weights(EnvConfig()) | {"bad_goal": GivingWayConfig().bad_goal}
    found = [row[:2] for row in cells(TEXTS["dynamic_goals"], "goal terms")]
    assert found == [[name, f"{weight:g}"] for name, weight in weights.items()]


def test_contexts_environments_and_layouts_are_all_named():
    named = [row[0].split("`")[0] for row in cells(TEXTS["dynamic_goals"], "contexts")]
    assert tuple(named) == CONTEXTS
    ours = {row[0] for row in cells(TEXTS["environments"], "environments")}
    papers = {row[0] for row in cells(TEXTS["environments"], "environments of papers")}
    assert ours == {*ENVIRONMENTS} - papers


def test_the_vehicle_presets_are_those_of_the_code():
    drive = {1.0: "front", 0.0: "rear", 0.5: "all"}
    tables = [*cells(TEXTS["vehicle"], "presets"), *cells(TEXTS["vehicle"], "sheets")]
    found = [[row[0], *row[2:]] for row in tables]
    assert found == [
        [
            name,
            drive[car.front_drive],
            f"{car.length:g} × {car.width:g}",
            f"{car.wheelbase:g}",
            f"{car.mass:g}",
            f"{car.turning_circle:g}",
        ]
        for name, car in ROAD_CARS.items()
    ]


def test_the_test_command_and_the_image_are_those_of_the_readme():
    block = README.split("<!-- test command -->\n")[1].split("```")[1]
    assert block == 'bash\npip install -e ".[test]" && pytest\n'
    image = (ROOT / "Dockerfile").read_text()
    extras = re.search(r"pip install (?:-e )?(\"\.\[[\w,]+\]\")", README)[1]
    packages = re.search(r"apt install ((?:[\w-]+ ?)+)", README)[1].split()
    assert extras in image
    assert all(f" {package} " in image for package in packages)


@pytest.mark.parametrize("line", COMMAND_LINES)
def test_a_command_exists_and_takes_its_flags(line):
    check_command(line)


def check_command(line):
    line = re.sub(r"parkbench:\S+", "tpcap", line)  # files that users fetch
    words = shlex.split(re.sub(r"\[.*?\]|\.\.\.", "", line).replace("RUN", "runs/x"))
    program, *arguments = words[1:] if words[0] == "carpark_mj" else words
    if "/" in program:
        assert (ROOT / program).is_file()
    elif words[0].startswith("carpark_mj."):
        program = program.partition(".")[2]
    elif words[0] != "carpark_mj":
        return
    if not arguments or arguments[0] in ("--help", "--help-all", "scene.xml"):
        return
    if program.startswith("examples/"):  # what they import may be absent
        flags = {w[2:].replace("-", "_") for w in arguments if w.startswith("--")}
        assert flags <= settings_in(ROOT / program)
        return
    if (longer := f"{program} {arguments[0]}") in PROGRAMS:
        program, *arguments = longer, *arguments[1:]
        if not arguments:
            return
    program = SCRIPTS.get(program, program)
    if program == "train":
        read_runs(read_hosts(arguments)[1], read_training)
    elif program in PROGRAMS:
        config = Entry(PROGRAMS[program].settings).load()
        read_flags(config, arguments)
    else:
        read_flags(settings_of(program), arguments)


def read_training(words):
    """A trainer's settings, which start from its preset's; a file is not read."""
    words = take_flags(words, config={})[1]
    name = named(words, "preset")
    return read_flags(PPOConfig, words, PPO_PRESETS[name] if name else None)


def settings_of(program):
    """The config of a script of eval: the one whose name ends like that."""
    module = importlib.import_module(Path(program).stem)
    [config] = [
        value
        for name, value in vars(module).items()
        if name.endswith("Config") and value.__module__ == module.__name__
    ]
    return config


def settings_in(path):
    """Names of the settings of an example: the fields of its class `Settings`."""
    [settings] = [
        node
        for node in ast.parse(path.read_text()).body
        if isinstance(node, ast.ClassDef) and node.name == "Settings"
    ]
    return {node.target.id for node in settings.body if isinstance(node, ast.AnnAssign)}


def slugs(page):
    """Anchors of a page: of its headings, as GitHub makes them, and former ones."""
    text = page.read_text()
    heads = re.findall(r"^#+ (.*)", text, re.MULTILINE)
    own = {re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in heads}
    return own | {*re.findall(r'^<a id="([\w-]+)"></a>$', text, re.MULTILINE)}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_files_and_modules_exist(page):
    text = page.read_text()
    for target, anchor in re.findall(r"\]\(([^)#:\s]*)#?([\w-]*)\)", text):
        file = page.parent / target if target else page
        assert file.exists(), target
        assert not anchor or anchor in slugs(file), f"{target}#{anchor}"
    folders = "carpark_mj|papers|formats|train|eval|tests|docs|examples"
    path = rf"`((?:{folders})/[\w./]*)`(?! of commit)"
    for name in re.findall(path, text):
        assert (ROOT / name).exists(), name
    for name in re.findall(r"`(carpark_mj(?:\.\w+)+)", text):
        pkgutil.resolve_name(name)  # its error says what is missing


def test_the_page_of_commands_names_every_command():
    table = TEXTS["commands"].split("\n\n## ")[0]
    rows = [line.split(" | ")[0] for line in table.splitlines() if line[:3] == "| `"]
    named = {*re.findall(r"`([^`]+)`", " ".join(rows))}
    assert named == {*PROGRAMS, *FORMATS["command"]}


def test_settings_named_in_the_docs_exist():
    config = EnvConfig()
    groups = {f.name for f in dataclasses.fields(config)} - {"metrics"}  # .csv
    pattern = rf"`((?:{'|'.join(groups)})(?:\.[a-z]\w*)+)"
    names = {n for page in PAGES for n in re.findall(pattern, page.read_text())}
    assert len(names) > 20
    for name in names:
        attrgetter(name)(config)  # AttributeError names what is missing


def test_public_names_are_all_on_their_page():
    page = (ROOT / "docs" / "api" / "public.md").read_text()
    found = [
        re.search(r"`carpark_mj\.(\w+)`", row[0])[1] for row in cells(page, "names")
    ]
    assert {*found, "__version__"} == {*carpark_mj.__all__}


# Fewer lots and agents, cars that compile faster, a small update of BenchMARL.
LESS = (
    ("1024", "2"),
    ("64", "2"),
    ("num_agents=2)", 'num_agents=2, physics="bicycle")'),
    ("max_episode_steps=20", 'max_episode_steps=20, physics="bicycle"'),
    ("agents=4", 'agents=2, parked_cars=2, physics="bicycle"'),
    ('{"agents": 4}', '{"agents": 2, "parked_cars": 2, "physics": "bicycle"}'),
    ("rates = ", "config.on_policy_n_minibatch_iters = 1\nrates = "),
    ("rates = ", "config.on_policy_collected_frames_per_batch = 400\nrates = "),
)
NEEDS = {  # words of snippets, and what they need
    "parallel_env": "pettingzoo",
    "sb3": "stable_baselines3",
    "import torch": "torch",
    "torchrl": "torchrl",
    "benchmarl": "benchmarl",
    "jaxmarl": "jaxmarl",
    "RecordVideo": "moviepy",
}
RUN = ("index", "troubleshooting", "sb3", "vehicle", "interfaces", "data")
SNIPPETS = [
    pytest.param(snippet, id=f"{page.stem} {number}")
    for page in (ROOT / "README.md", *(DOCS / f"{n}.md" for n in (*RUN, "multi_agent")))
    for number, snippet in enumerate(code(page.read_text(), "python"))
]
[POLICY] = code(
    TEXTS["extending"].split("\n## A policy\n")[1].split("\n## ")[0], "python"
)
SNIPPETS.append(pytest.param(POLICY, id="a policy"))  # others: `test_extending`


@pytest.mark.filterwarnings("ignore")  # of libraries
@pytest.mark.parametrize("snippet", SNIPPETS)
def test_a_snippet_runs(snippet, tmp_path, monkeypatch):
    for word, package in NEEDS.items():
        if word in snippet:
            pytest.importorskip(package)
    monkeypatch.chdir(tmp_path)
    for old, new in LESS:
        snippet = snippet.replace(old, new)
    exec(snippet, {})


OURS = [name for name, homes in ENTRY_POINTS.items() if "carpark_mj." in homes[1]]


@pytest.mark.parametrize(
    ("text", "names"),
    [(section(TEXTS["interfaces"], "ids"), OURS), (TEXTS["multi_agent"], OPTIONS)],
)
def test_a_table_names_them_all(text, names):
    assert re.findall(r"^\| `([^`]+)` \|", text, re.MULTILINE) == list(names)


def test_the_table_of_layouts_is_that_of_the_code():
    table = section(TEXTS["layouts"], "layouts")
    rows = re.findall(r"^\| `(\w+)` \| `(\w+)` \| (\d+) \| (\w+) \|", table, re.M)
    assert {row[0]: row[1:] for row in rows} == {
        name: (
            type(config).__name__,
            str(config.min_bays),
            "yes" if config.is_random else "no",
        )
        for name, config in LAYOUTS.items()
        if not name.startswith(("tpcap_", "slots"))  # of carpark_papers
    }


def test_the_layout_file_is_valid(tmp_path):
    path = tmp_path / "my_lot.json"
    [text] = code(TEXTS["own_lot"], "json")
    path.write_text(text)
    assert read_json(path).num_bays == 3


def test_the_schema_of_the_guide_is_that_of_the_reader():
    table = section(TEXTS["own_lot"], "schema")
    rows = [row.split("|")[1:3] for row in table.splitlines()[2:]]
    assert {
        name.strip(" `"): re.findall(r"`(\w+)`", fields) for name, fields in rows
    } == {name: list(fields) for name, fields in _SCHEMA.items()}


def test_the_examples_of_the_guide_run():
    families, car = code(TEXTS["own_lot"], "python")
    names = {}
    exec(families, names)
    configs = [names[name] for name in ("back_in", "deck", "often_deck")]
    assert names["env"].layout_config == configs[2]
    assert configs[2].members[:2] == (configs[0], configs[1])
    exec(car, names)
    assert names["env"].vehicle.mass == 1500.0
