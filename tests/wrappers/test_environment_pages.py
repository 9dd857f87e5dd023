"""The pages of the Gymnasium environments: tables of the code, snippets that run."""

import inspect
import re
from pathlib import Path

import gymnasium
import pytest
from gymnasium import spaces
from helpers.registering import restore_after

from carpark_mj.config import PARKED_RULES, REWARDS, EnvConfig
from carpark_mj.mdp.rewards import TERMS
from carpark_mj.observations import make_fields, markdown_table
from carpark_mj.registration import ENTRY_POINTS
from carpark_mj.studies.pandita.environments import PANDITA
from carpark_mj.studies.pandita.slots_env import SLOTS_OPTIONS, SlotsEnv
from carpark_mj.tasks.goal_pose import POSE
from carpark_mj.wrappers.goal import GoalParking
from carpark_mj.wrappers.gymnasium_env import ONE_AGENT, ParkEnv
from carpark_mj.wrappers.gymnasium_goal import ParkGoalEnv, goal_config
from carpark_mj.wrappers.gymnasium_vector import ParkManyVectorEnv
from carpark_mj.wrappers.options import OPTIONS

FOLDER = Path(__file__).parents[2] / "docs" / "environments"
PAGES = {
    "carpark_mj/Park-v0": "park",
    "carpark_mj/ParkGoal-v0": "park_goal",
    "carpark_mj/Slots-v0": "slots",
    "carpark_mj/ParkMany-v0": "park_many",
}
TEXTS = {name: (FOLDER / f"{page}.md").read_text() for name, page in PAGES.items()}
# The class whose arguments a page lists, and which of the options it takes.
MADE_BY = {
    "carpark_mj/Park-v0": (ParkEnv, ONE_AGENT),
    "carpark_mj/ParkGoal-v0": (ParkGoalEnv, ONE_AGENT),
    "carpark_mj/Slots-v0": (SlotsEnv, SLOTS_OPTIONS),
    "carpark_mj/ParkMany-v0": (ParkManyVectorEnv, OPTIONS),
}
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
}
RULE = goal_config({}).episode.parked_rule
SLOTS = {
    "config": "pandita",
    "layout": PANDITA.layout,
    "parked_cars": PANDITA.num_parked_cars,
    "max_episode_steps": PANDITA.episode.max_steps,
}
CONTROLS = (
    ("steer", "target of the road-wheel angle over its limit, left positive"),
    ("pedal", "acceleration forwards; against the motion it brakes"),
)


def section(name, marker):
    """What stands on a page between two markers."""
    return (
        TEXTS[name].split(f"<!-- {marker} -->\n")[1].split(f"<!-- end of {marker}")[0]
    )


def table(head, rows):
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(map(str, line))} |\n" for line in lines)


def described(space):
    """A space in a line; bounds of its numbers are in the tables."""
    if isinstance(space, spaces.Dict):
        parts = ", ".join(f"{key}: {described(part)}" for key, part in space.items())
        return f"Dict({parts})"
    return f"Box({space.shape}, {space.dtype})"


def summary(name, env):
    many = ENTRY_POINTS[name][0].endswith(":refuse_single")
    make = f'make_vec("{name}", ...)' if many else f'make("{name}")'
    rows = [
        ("action space", f"`{env.single_action_space}`"),
        ("observation space", f"`{described(env.single_observation_space)}`"),
        ("creation", f"`gymnasium.{make}`"),
    ]
    return table(("", ""), rows)


def actions(name, env):
    box = env.single_action_space
    rows = [
        (number, f"`{part}`", f"{box.low[number]:g}", f"{box.high[number]:g}", meaning)
        for number, (part, meaning) in enumerate(CONTROLS)
    ]
    return table(("number", "control", "least", "most", "meaning"), rows)


def observation(name, env):
    lots = env._batch.env
    goal = isinstance(lots, GoalParking)
    fields = lots.fields if goal else make_fields(lots.config)
    return markdown_table(fields) + "\n"


def rewards(name, env):
    weights = [(f"`{term}`", f"{getattr(CONFIG.reward, term):g}") for term in TERMS]
    return table(("term", "weight"), [row for row in weights if row[1] != "0"])


def goal(name, env):
    return markdown_table(GoalParking.goal_fields) + "\n"


def pose(name, env):
    reward = env._batch.env.config.reward
    terms = {"crash": reward.crash, **reward.extra}
    terms |= {f"pose.{part}": value for part, value in POSE.parameters.items()}
    rows = [(f"`{part}`", f"{value:g}") for part, value in terms.items()]
    return table(("part of the reward", "default"), rows)


@pytest.mark.parametrize(
    ("name", "marker", "expected"),
    [
        *[(name, "summary", summary) for name in PAGES],
        *[(name, "actions", actions) for name in PAGES],
        *[(name, "observation", observation) for name in PAGES],
        ("carpark_mj/Park-v0", "rewards", rewards),
        ("carpark_mj/ParkGoal-v0", "goal", goal),
        ("carpark_mj/ParkGoal-v0", "rewards", pose),
        ("carpark_mj/Slots-v0", "rewards", pose),
    ],
)
def test_a_table_of_an_environment_is_the_generated_one(name, marker, expected):
    env = gymnasium.make_vec(name, num_envs=2)
    text = expected(name, env.unwrapped)
    assert section(name, marker) == text, f"paste this:\n{text}"


@pytest.mark.parametrize("name", PAGES)
def test_a_page_lists_all_arguments_with_their_defaults(name):
    kind, options = MADE_BY[name]
    found = re.findall(r"^\| `(\w+)` \| `([^|]+)` \|", section(name, "arguments"), re.M)
    own = {
        argument: repr(parameter.default)
        for argument, parameter in inspect.signature(kind).parameters.items()
        if argument not in ("options", "num_envs")
    }
    defaults = SLOTS if kind is SlotsEnv else DEFAULTS
    if kind is ParkGoalEnv:
        defaults = {**DEFAULTS, "reward": "pose", "rule": RULE}
    expected = own | {option: repr(defaults.get(option)) for option in options}
    if kind is not SlotsEnv:
        expected["config"] = "EnvConfig()"
    assert dict(found) == expected


@pytest.mark.parametrize("name", PAGES)
def test_the_example_of_an_environment_runs(name, monkeypatch):
    restore_after(monkeypatch, PARKED_RULES)
    [snippet] = re.findall(r"^```python\n(.*?)^```", TEXTS[name], re.M | re.S)
    exec(snippet.replace("64", "4"), {})


def test_every_environment_has_a_page():
    assert {*PAGES} == {*ENTRY_POINTS}
    assert {*PAGES.values()} == {path.stem for path in FOLDER.glob("*.md")}
