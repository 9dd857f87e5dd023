"""Options of the environments that other libraries make by name."""

import dataclasses
import functools
from typing import TypedDict, TypeVar

from carpark_mj.config import (
    REWARDS,
    EnvConfig,
    LayoutChoice,
    PhysicsChoice,
    RewardConfig,
)
from carpark_mj.env import ParkingEnv
from carpark_mj.layouts import layout_config
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
        reward: weights, or the name of a set of them.
        physics: `EnvConfig.physics`.
    """

    config: EnvConfig | str
    layout: LayoutChoice
    agents: int
    parked_cars: int
    vehicle: str
    rule: str
    reward: RewardConfig | str
    physics: PhysicsChoice


Env = TypeVar("Env", bound=ParkingEnv)
OPTIONS = tuple(Options.__annotations__)
_FIELDS = {
    "layout": "layout",
    "agents": "num_agents",
    "parked_cars": "num_parked_cars",
    "vehicle": "vehicle",
    "physics": "physics",
}


def configure(options: Options, allowed: tuple[str, ...] = OPTIONS) -> EnvConfig:
    """The configuration from options.

    Raises:
        TypeError: unknown option.
        ValueError: impossible value.
    """
    for name in options:
        if name not in allowed:
            raise TypeError(f"unknown option {name!r}; choose from {sorted(allowed)}")
    config = options.get("config", EnvConfig())
    if isinstance(config, str):
        config = environment(config)
    if not isinstance(config, EnvConfig):  # pyright: ignore[reportUnnecessaryIsInstance]
        raise ValueError(f"config must be an EnvConfig or a name, not {config!r}")
    changes = {_FIELDS[name]: options[name] for name in _FIELDS if name in options}
    if "rule" in options:
        changes["episode"] = dataclasses.replace(
            config.episode, parked_rule=options["rule"]
        )
    if "reward" in options:
        reward = options["reward"]
        changes["reward"] = REWARDS[reward] if isinstance(reward, str) else reward
    config = dataclasses.replace(config, **changes)
    if isinstance(config.layout, str) and "." in config.layout:
        # Parameters instead of the name: environments are shared.
        config = dataclasses.replace(config, layout=layout_config(config.layout))
    return config


def shared_env(config: EnvConfig) -> ParkingEnv:
    """The environment of a configuration, made and compiled only once."""
    return share(ParkingEnv, config)


@functools.lru_cache(maxsize=32)
def share(kind: type[Env], config: EnvConfig) -> Env:
    """The environment of one kind for a configuration, made only once."""
    return kind(config)
