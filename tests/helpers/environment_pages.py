"""The tables of a page of a Gymnasium environment, as the code has them."""

import inspect
import re

import gymnasium
from gymnasium import spaces
from helpers.pages import ROOT, code, markdown_table, section

from carpark_mj.observations import make_fields
from carpark_mj.registration import ENTRY_POINTS
from carpark_mj.tasks.goal_pose import POSE
from carpark_mj.wrappers.goal import GoalParking

FOLDER = ROOT / "docs" / "environments"


def read(page):
    """The text of a page."""
    return (FOLDER / f"{page}.md").read_text()


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


def observation(name, env):
    lots = env._batch.env
    goal = isinstance(lots, GoalParking)
    fields = lots.fields if goal else make_fields(lots.config)
    return markdown_table(fields) + "\n"


def pose(name, env):
    reward = env._batch.env.config.reward
    terms = {"crash": reward.crash, **reward.extra}
    terms |= {f"pose.{part}": value for part, value in POSE.parameters.items()}
    rows = [(f"`{part}`", f"{value:g}") for part, value in terms.items()]
    return table(("part of the reward", "default"), rows)


def assert_generated(name, text, marker, expected):
    """Asserts that a table of a page is what `expected` makes of the environment."""
    wanted = expected(name, gymnasium.make_vec(name, num_envs=2).unwrapped)
    assert section(text, marker) + "\n" == wanted, f"paste this:\n{wanted}"


def arguments(text):
    """The arguments on a page with their defaults."""
    table = section(text, "arguments")
    return dict(re.findall(r"^\| `(\w+)` \| `([^|]+)` \|", table, re.M))


def assert_arguments(text, kind, defaults):
    """Asserts that a page lists a class's arguments and the options with defaults."""
    own = {
        argument: repr(parameter.default)
        for argument, parameter in inspect.signature(kind).parameters.items()
        if argument not in ("options", "num_envs")
    }
    assert arguments(text) == own | defaults


def run_example(text):
    """Runs the snippet of a page with fewer lots."""
    [snippet] = code(text, "python")
    exec(snippet.replace("64", "4"), {})
