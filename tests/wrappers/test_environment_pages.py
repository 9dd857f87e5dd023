"""The pages of the Gymnasium environments: tables of the code, snippets that run."""

import inspect
import re

import gymnasium
import pytest
from helpers import environment_pages as pages
from helpers.pages import markdown_table
from helpers.registering import restore_after

from carpark_mj.config import PARKED_RULES, REWARDS, EnvConfig
from carpark_mj.mdp.rewards import TERMS
from carpark_mj.observations import make_fields
from carpark_mj.registration import ENTRY_POINTS
from carpark_mj.registry import FIRST
from carpark_mj.tasks.goal_pose import FEATURES
from carpark_mj.wrappers.goal import ParkGoalEnv, goal_config
from carpark_mj.wrappers.gymnasium_env import ONE_AGENT, ParkEnv, ParkManyVectorEnv
from carpark_mj.wrappers.options import OPTIONS

# Page, the class whose arguments it lists, and which of the options that takes.
PAGES = {
    "carpark_mj/Park-v0": ("park", ParkEnv, ONE_AGENT),
    "carpark_mj/ParkGoal-v0": ("park_goal", ParkGoalEnv, ONE_AGENT),
    "carpark_mj/ParkMany-v0": ("park_many", ParkManyVectorEnv, OPTIONS),
    "carpark_mj/FirstPark-v0": ("first_park", ParkEnv, ONE_AGENT),
}
TEXTS = {name: pages.read(page) for name, (page, *_) in PAGES.items()}
CONFIG = EnvConfig()
DEFAULTS = {
    "layout": CONFIG.layout,
    "agents": CONFIG.num_agents,
    "parked_cars": CONFIG.num_parked_cars,
    "vehicle": CONFIG.vehicle,
    "rule": CONFIG.episode.parked_rule,
    "max_episode_steps": CONFIG.episode.max_steps,
    "reward": next(name for name, set_ in REWARDS.items() if set_ == CONFIG.reward),
    "physics": CONFIG.physics,
    **dict.fromkeys(("discrete", "details"), False),
}
RULE = goal_config({}).episode.parked_rule


def rewards(name, env):
    weights = [(f"`{term}`", f"{getattr(CONFIG.reward, term):g}") for term in TERMS]
    rows = [row for row in weights if row[1] != "0"]
    return pages.table(("term", "weight"), rows)


def goal(name, env):
    return markdown_table(FEATURES) + "\n"


@pytest.mark.parametrize(
    ("name", "marker", "expected"),
    [
        *[(name, "summary", pages.summary) for name in PAGES],
        ("carpark_mj/Park-v0", "actions", pages.actions),
        ("carpark_mj/Park-v0", "rewards", rewards),
        ("carpark_mj/FirstPark-v0", "observation", pages.observation),
        ("carpark_mj/ParkGoal-v0", "goal", goal),
        ("carpark_mj/ParkGoal-v0", "rewards", pages.pose),
    ],
)
def test_a_table_of_an_environment_is_the_generated_one(name, marker, expected):
    pages.assert_generated(name, TEXTS[name], marker, expected)


@pytest.mark.parametrize("name", ["carpark_mj/Park-v0", "carpark_mj/ParkMany-v0"])
def test_they_observe_the_fields_on_the_page_of_the_observation(name):
    env = gymnasium.make_vec(name, num_envs=2).unwrapped
    assert make_fields(env._batch.env.config) == make_fields(CONFIG)


def test_the_page_of_park_goal_names_the_fields_it_leaves_out():
    name = "carpark_mj/ParkGoal-v0"
    fields = gymnasium.make_vec(name, num_envs=2).unwrapped._batch.env.fields
    left = [field.name for field in make_fields(CONFIG) if field not in fields]
    listed = pages.section(TEXTS[name], "left out")
    assert left == re.findall(r"`(\w+)`", listed)
    assert len(left) + len(fields) == len(make_fields(CONFIG))


def test_the_page_of_park_lists_all_arguments_with_defaults():
    listed = {option: repr(DEFAULTS.get(option)) for option in ONE_AGENT}
    text = TEXTS["carpark_mj/Park-v0"]
    pages.assert_arguments(text, ParkEnv, listed | {"config": "EnvConfig()"})


@pytest.mark.parametrize("name", [name for name in PAGES if name[-8:] != "/Park-v0"])
def test_other_pages_list_the_arguments_that_differ(name):
    _, kind, options = PAGES[name]
    defaults = DEFAULTS
    if kind is ParkGoalEnv:
        defaults = {**DEFAULTS, "reward": "pose", "rule": RULE}
    if name == "carpark_mj/FirstPark-v0":
        steps, cars = FIRST.episode.max_steps, FIRST.num_parked_cars
        changed = {"parked_cars": cars, "max_episode_steps": steps}
        changed |= {"rule": FIRST.episode.parked_rule, "physics": FIRST.physics}
        defaults = {**DEFAULTS, **changed}
    differ = {
        option: repr(defaults[option])
        for option in options
        if option != "config"
        and (option not in ONE_AGENT or defaults[option] != DEFAULTS[option])
    }
    assert pages.arguments(TEXTS[name]) == differ
    own = inspect.signature(ParkEnv).parameters.keys() - {"options"}
    assert own <= inspect.signature(kind).parameters.keys()


@pytest.mark.parametrize("name", PAGES)
def test_the_example_of_an_environment_runs(name, monkeypatch):
    restore_after(monkeypatch, PARKED_RULES)
    pages.run_example(TEXTS[name])


def test_every_environment_has_a_page():
    ours = {name for name, homes in ENTRY_POINTS.items() if "carpark_mj." in homes[1]}
    assert {*PAGES} == ours
    others = {"slots"}  # of carpark_papers
    found = {path.stem for path in pages.FOLDER.glob("*.md")}
    assert {page for page, *_ in PAGES.values()} == found - others
