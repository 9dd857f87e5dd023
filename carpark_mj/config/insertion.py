"""Configs with traced numbers: runs that differ in them share a program."""

import copy
import dataclasses
from collections.abc import Mapping
from typing import Any, TypeVar

from carpark_mj.extensions import unknown_name
from carpark_mj.mdp.rewards import ExtraTerms

Config = TypeVar("Config")


def is_data(config: Any, path: str) -> bool:
    """Whether a setting can have other values in one program.

    Args:
        config: a dataclass.
        path: of the setting, as in `reward.park`. It must be a number: None and truth
            values decide what is computed.

    Raises:
        ValueError: there is no such setting.
    """
    value = setting(config, path)
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    while not isinstance(config, ExtraTerms):
        name, _, rest = path.partition(".")
        if not rest:
            [field] = [x for x in dataclasses.fields(config) if x.name == name]
            return "data" in field.metadata
        config, path = getattr(config, name), rest
    return not config.is_fixed(path)


def setting(config: Any, path: str) -> Any:
    """The value of a setting by its path.

    Raises:
        ValueError: there is no such setting.
    """
    if isinstance(config, ExtraTerms):
        return config[_require_setting(config, path)]
    name, dot, rest = path.partition(".")
    value = getattr(config, _require_setting(config, name))
    return setting(value, rest) if dot else value


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
        if isinstance(new, ExtraTerms):
            new[_require_setting(new, path)] = value
            continue
        name, dot, rest = path.partition(".")
        _require_setting(new, name)
        value = insert(getattr(new, name), {rest: value}) if dot else value
        object.__setattr__(new, name, value)  # it is frozen
    return new


def _names(config: Any) -> list[str]:
    if isinstance(config, ExtraTerms):
        return list(config)
    is_config = dataclasses.is_dataclass(config)
    return [x.name for x in dataclasses.fields(config)] if is_config else []


def _require_setting(config: Any, name: str) -> str:
    """The name, which must be that of a setting of the config."""
    if name not in (names := _names(config)):
        raise ValueError(unknown_name(f"{type(config).__name__} setting", name, names))
    return name
