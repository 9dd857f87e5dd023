"""`carpark_mj list`: names of layouts, environments, vehicles, policies and presets."""

import re
from collections.abc import Callable, Mapping
from typing import Any

from carpark_mj.cli.settings.tables import ListConfig
from carpark_mj.config.checks import counted
from carpark_mj.extensions import Entry, table
from carpark_mj.pretrained import FOLDER, pretrained_names

TASK = "| task | "  # the row of a model card


def _layout(config: Any) -> str:
    bays = counted(config.min_bays, "bay")
    return f"random, {bays} or more" if config.is_random else f"fixed, {bays}"


def describe_environment(config: Any) -> str:
    """An `EnvConfig` in a line."""
    agents = counted(config.num_agents, "agent")
    goals = "dynamic" if config.goals.dynamic else "fixed"
    lot = config.layout if isinstance(config.layout, str) else config.layout.family
    return f"{agents}, {goals} goals, {lot} lot, {config.physics} physics"


def _vehicle(car: Any) -> str:
    return f"{car.length:.2f} x {car.width:.2f} m, wheelbase {car.wheelbase:.2f} m"


def _plain(row: str) -> str:
    """The task in a row of a model card, without Markdown."""
    text = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", row[len(TASK) : -2])
    return text.replace("`", "")


def _policies() -> dict[str, str]:
    """Tasks of the pretrained policies, from their cards; without JAX."""
    cards = {name: FOLDER / f"{name}.md" for name in pretrained_names()}
    lines = {name: card.read_text().splitlines() for name, card in cards.items()}
    return {
        name: next((_plain(x) for x in card if x.startswith(TASK)), "")
        for name, card in lines.items()
    }


_REGISTERED: dict[str, tuple[str, Callable[[Any], str]]] = {
    "layouts": ("layouts.base:LAYOUTS", _layout),
    "environments": ("registry:ENVIRONMENTS", describe_environment),
    "vehicles": ("vehicle:VEHICLES", _vehicle),
}


def listed(kind: str) -> Mapping[str, str]:
    """Names of a kind with a line on each; what they are of is imported here."""
    if kind == "policies":
        return _policies()
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
