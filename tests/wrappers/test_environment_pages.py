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

CONFIG = EnvConfig()
# Page, the class whose arguments it lists, which options that takes, and the default.
PAGES = {
    "carpark_mj/Park-v0": ("park", ParkEnv, ONE_AGENT, CONFIG),
    "carpark_mj/ParkGoal-v0": ("park_goal", ParkGoalEnv, ONE_AGENT, goal_config({})),
    "carpark_mj/ParkMany-v0": ("park_many", ParkManyVectorEnv, OPTIONS, CONFIG),
    "carpark_mj/FirstPark-v0": ("first_park", ParkEnv, ONE_AGENT, FIRST),
}
TEXTS = {name: pages.read(page) for name, (page, *_) in PAGES.items()}


def defaults(config):
    """What options are where they are not given."""
    rewards = [name for name, reward in REWARDS.items() if reward == config.reward]
    return {
        "layout": config.layout,
        "agents": config.num_agents,
        "parked_cars": config.num_parked_cars,
        "vehicle": config.vehicle,
        "rule": config.episode.parked_rule,
        "max_episode_steps": config.episode.max_steps,
        "reward": rewards[0],
        "physics": config.physics,
        **dict.fromkeys(("discrete", "details"), False),
    }


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
        ("carpark_mj/Park-v0", "rewards", rewards),
        ("carpark_mj/FirstPark-v0", "observation", pages.observation),
        ("carpark_mj/ParkGoal-v0", "goal", goal),
        ("carpark_mj/ParkGoal-v0", "rewards", pages.pose),
    ],
)
def test_a_table_of_an_environment_is_the_generated_one(name, marker, expected):
    pages.assert_generated(name, TEXTS[name], marker, expected)


def test_the_page_of_park_goal_names_the_fields_it_leaves_out():
    name = "carpark_mj/ParkGoal-v0"
    fields = gymnasium.make_vec(name, num_envs=2).unwrapped._batch.env.fields
    left = [field.name for field in make_fields(CONFIG) if field not in fields]
    listed = pages.section(TEXTS[name], "left out")
    assert left == re.findall(r"`(\w+)`", listed)
    assert len(left) + len(fields) == len(make_fields(CONFIG))


def test_the_page_of_park_lists_all_arguments_with_defaults():
    listed = {option: repr(defaults(CONFIG).get(option)) for option in ONE_AGENT}
    text = TEXTS["carpark_mj/Park-v0"]
    pages.assert_arguments(text, ParkEnv, listed | {"config": "EnvConfig()"})


@pytest.mark.parametrize("name", [name for name in PAGES if name[-8:] != "/Park-v0"])
def test_other_pages_list_the_arguments_that_differ(name):
    _, kind, options, config = PAGES[name]
    differ = {
        option: repr(default)
        for option, default in defaults(config).items()
        if option in options
        and (option not in ONE_AGENT or default != defaults(CONFIG)[option])
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
