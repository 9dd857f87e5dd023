"""Configs with traced numbers: runs that differ in them share a program."""

import copy
import dataclasses
from collections.abc import Mapping
from typing import Any, TypeVar

Config = TypeVar("Config")

# Settings of an `EnvConfig`, or beginnings of their paths, whose numbers only enter
# into the arithmetic of `ParkingEnv.step`. A test traces every one.
_ARITHMETIC = ("reward.", "episode.hitbox_scale", "giving_way.bad_goal")


def is_data(path: str, value: object) -> bool:
    """Whether a setting of an `EnvConfig` can have other values in one program.

    Args:
        path: of the setting, as in `reward.park`.
        value: that it has: None and truth values decide what is computed.
    """
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return is_number and path.startswith(_ARITHMETIC)


def setting(config: Any, path: str) -> Any:
    """The value of a setting by its path.

    Raises:
        ValueError: there is no such setting.
    """
    for name in path.split("."):
        config = getattr(_require_setting(config, name), name)
    return config


def insert(config: Config, values: Mapping[str, Any]) -> Config:
    """A config with other values of some settings, which may be traced.

    Args:
        config: a dataclass; its checks are not made.
        values: by the path of the setting, as in `env.reward.park`.

    Raises:
        ValueError: there is no such setting.
    """
    new = copy.copy(config)
    for path, value in values.items():
        name, dot, rest = path.partition(".")
        _require_setting(new, name)
        value = insert(getattr(new, name), {rest: value}) if dot else value
        object.__setattr__(new, name, value)  # it is frozen
    return new


def _require_setting(config: Config, name: str) -> Config:
    """The config, which must have a setting of that name."""
    is_config = dataclasses.is_dataclass(config)
    settings = [x.name for x in dataclasses.fields(config)] if is_config else []
    if name not in settings:
        raise ValueError(
            f"{type(config).__name__} has no setting {name!r}: it has "
            f"{', '.join(settings) or 'none'}"
        )
    return config
