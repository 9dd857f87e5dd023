"""Configs with traced numbers: runs that differ in them share a program."""

import copy
import dataclasses
from collections.abc import Mapping
from typing import Any, TypeVar

Config = TypeVar("Config")


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
        is_config = dataclasses.is_dataclass(new)
        settings = [x.name for x in dataclasses.fields(new)] if is_config else []
        if name not in settings:
            raise ValueError(
                f"{type(config).__name__} has no setting {name!r}: it has "
                f"{', '.join(settings) or 'none'}"
            )
        value = insert(getattr(new, name), {rest: value}) if dot else value
        object.__setattr__(new, name, value)  # it is frozen
    return new
