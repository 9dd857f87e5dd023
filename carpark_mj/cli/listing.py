"""`carpark_mj list`: names of layouts, environments, vehicles, policies and presets."""

import re
from collections.abc import Callable, Mapping
from typing import Any

from carpark_mj.cli.settings.lots import ListConfig
from carpark_mj.config.checks import counted
from carpark_mj.extensions import Entry, table
from carpark_mj.pretrained import FOLDER, pretrained_names


def _layout(config: Any) -> str:
    bays = counted(config.min_bays, "bay")
    return f"random, {bays} or more" if config.is_random else f"fixed, {bays}"


def describe_environment(config: Any) -> str:
    """An `EnvConfig` in a line."""
    agents = counted(config.num_agents, "agent")
    goals = "dynamic" if config.goals.dynamic else "fixed"
    lot = config.layout if isinstance(config.layout, str) else config.layout.family
    lots = f"layout{'s' * (',' in lot)} {lot.replace(',', ', ')}"
    return f"{agents}, {goals} goals, {config.physics} physics, {lots}"


def _policy(name: str) -> str:
    """The task in a model card, without Markdown; it needs no JAX."""
    rows = (FOLDER / f"{name}.md").read_text().splitlines()
    task = next((row.split(" | ")[1][:-2] for row in rows if row[:7] == "| task "), "")
    return re.sub(r"\[([^]]*)\]\([^)]*\)|`", r"\1", task)


_REGISTERED: dict[str, tuple[str, Callable[[Any], str]]] = {
    "layouts": ("layouts.base:LAYOUTS", _layout),
    "environments": ("registry:ENVIRONMENTS", describe_environment),
    "vehicles": ("vehicle:VEHICLES", lambda x: f"{x.length:.2f} x {x.width:.2f} m"),
}


def listed(kind: str) -> Mapping[str, str]:
    """Names of a kind with a line on each; what they are of is imported here."""
    if kind == "policies":
        return {name: _policy(name) for name in pretrained_names()}
    if kind == "presets":
        return Entry("carpark_mj.training.ppo.parts:summaries").load()()
    home, describe = _REGISTERED[kind]
    return {n: describe(x) for n, x in Entry(f"carpark_mj.{home}").load().items()}


def main(config: ListConfig) -> None:
    """Prints the names, below a heading if they are of several kinds."""
    if config.kind != "all":
        print(table(listed(config.kind), indent=0))
        return
    for kind in ("policies", *_REGISTERED, "presets"):
        print(f"{kind}\n{table(listed(kind))}\n", flush=True)
