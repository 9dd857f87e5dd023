"""Options of the environments that other libraries make by name."""

import dataclasses
import functools
import typing
from collections.abc import Iterable, Mapping
from typing import Any, TypedDict, TypeVar

from carpark_mj.config import (
    REWARDS,
    EnvConfig,
    LayoutChoice,
    PhysicsChoice,
    RewardConfig,
)
from carpark_mj.env import ParkingEnv
from carpark_mj.layouts import layout_config
from carpark_mj.policy.runs import from_json
from carpark_mj.registry import environment


class Options(TypedDict, total=False):
    """Options of an environment, by keyword.

    Attributes:
        config: everything, an `EnvConfig` or the name of an environment of
            `carpark_mj.registry`; the other options change it.
        layout: `EnvConfig.layout`.
        agents: `EnvConfig.num_agents`.
        parked_cars: `EnvConfig.num_parked_cars`.
        vehicle: `EnvConfig.vehicle`.
        rule: `EpisodeConfig.parked_rule`.
        max_episode_steps: `EpisodeConfig.max_steps`.
        reward: weights, or the name of a set of them.
        physics: `EnvConfig.physics`.
    """

    config: EnvConfig | str
    layout: LayoutChoice
    agents: int
    parked_cars: int
    vehicle: str
    rule: str
    max_episode_steps: int
    reward: RewardConfig | str
    physics: PhysicsChoice


Env = TypeVar("Env", bound=ParkingEnv)
OPTIONS = tuple(Options.__annotations__)
_KINDS = typing.get_type_hints(Options)
_FIELDS = {
    "layout": "layout",
    "agents": "num_agents",
    "parked_cars": "num_parked_cars",
    "vehicle": "vehicle",
    "physics": "physics",
}
_EPISODE = {"rule": "parked_rule", "max_episode_steps": "max_steps"}


def configure(options: Options, allowed: tuple[str, ...] = OPTIONS) -> EnvConfig:
    """The configuration from options.

    Configs may be dictionaries of their fields, as in the JSON of a Gymnasium spec.

    Raises:
        TypeError: unknown option.
        ValueError: impossible value.
    """
    require_options(options, allowed)
    given = {name: from_json(name, _KINDS[name], x) for name, x in options.items()}
    config = given.get("config", EnvConfig())
    if isinstance(config, str):
        config = environment(config)
    if not isinstance(config, EnvConfig):  # pyright: ignore[reportUnnecessaryIsInstance]
        raise ValueError(f"config must be an EnvConfig or a name, not {config!r}")
    changes, episode = (
        {fields[name]: given[name] for name in fields if name in given}
        for fields in (_FIELDS, _EPISODE)
    )
    if episode:
        changes["episode"] = dataclasses.replace(config.episode, **episode)
    if "reward" in given:
        reward = given["reward"]
        changes["reward"] = REWARDS[reward] if isinstance(reward, str) else reward
    config = dataclasses.replace(config, **changes)
    if isinstance(config.layout, str) and "." in config.layout:
        # Parameters instead of the name: environments are shared.
        config = dataclasses.replace(config, layout=layout_config(config.layout))
    return config


def require_options(options: Mapping[str, Any], allowed: Iterable[str]) -> None:
    """Refuses unknown options in Python's words, which TorchRL's `GymEnv` looks for.

    Raises:
        TypeError: naming the first, and what is allowed.
    """
    for name in options:
        if name not in allowed:
            raise TypeError(
                f"got an unexpected keyword argument {name!r}; choose from "
                f"{sorted(allowed)}"
            )


def shared_env(config: EnvConfig) -> ParkingEnv:
    """The environment of a configuration, made and compiled only once."""
    return share(ParkingEnv, config)


@functools.lru_cache(maxsize=32)
def share(kind: type[Env], config: EnvConfig) -> Env:
    """The environment of one kind for a configuration, made only once."""
    return kind(config)
