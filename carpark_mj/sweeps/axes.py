"""The axes of a sweep: settings, and the values that each takes."""

import dataclasses
import difflib
import re
from collections.abc import Iterator, Sequence
from typing import Any

from carpark_mj.config import REWARD_TERMS, ExtraTerms, term_settings

MAX_VALUES = 10_000  # of a range; more are a slip of the keyboard
# What a sweep itself sets in every run.
OWN_FIELDS = ("preset", "name", "runs_dir", "resume", "time_limit")


@dataclasses.dataclass(frozen=True)
class Axis:
    """Settings that change together.

    Attributes:
        fields: dotted names of settings, `env.num_agents`.
        values: for every point of the axis the values of all fields, as words of the
            command line.
    """

    fields: tuple[str, ...]
    values: tuple[tuple[str, ...], ...]

    @property
    def is_swept(self) -> bool:
        """Whether it has several points."""
        return len(self.values) > 1


def read_axis(text: str, config: Any) -> Axis:
    """Reads `FIELD=VALUES`.

    VALUES are separated by commas, or by semicolons where a value has commas itself;
    `1..7` is a range of whole numbers, both ends included.

    Args:
        text: of the command line.
        config: dataclass whose settings are swept.

    Raises:
        ValueError: an unknown setting, no values, or an empty range.
    """
    name, equals, values = text.partition("=")
    if not equals:
        raise ValueError(
            f"set takes FIELD=VALUES, for example num_agents=1..7, not {text!r}"
        )
    field = find_field(name.strip(), config)
    separator = ";" if ";" in values else ","
    parts = [part.strip() for part in values.split(separator)]
    if separator == ";" and not parts[-1]:
        parts.pop()  # `a,b;` is one value
    if not all(parts):
        raise ValueError(f"{field} has an empty value in {text!r}")
    words = [word for part in parts for word in _expand(field, part)]
    if len({*words}) < len(words):
        raise ValueError(f"{field} has a value twice in {text!r}")
    return Axis((field,), tuple((word,) for word in words))


def find_field(name: str, config: Any) -> str:
    """The dotted name of a setting, given in full or by an unambiguous suffix.

    Raises:
        ValueError: no setting, several, or one that the sweep sets.
    """
    wanted = name.replace("-", "_")
    known = [*_leaves(config)]
    found = [path for path in known if f".{path}".endswith(f".{wanted}")]
    if wanted in known:
        found = [wanted]
    if len(found) > 1:
        raise ValueError(
            f"{name!r} is several settings: give one of {', '.join(found)}"
        )
    if not found:
        near = difflib.get_close_matches(
            wanted, [path.rpartition(".")[2] for path in known] + known, n=1
        )
        hint = "see carpark_mj train --help-all"
        if near:
            hint = f"perhaps you meant {near[0]}"
        raise ValueError(f"unknown setting {name!r}; {hint}")
    if found[0] in OWN_FIELDS:
        raise ValueError(f"{found[0]} is the sweep's to set, not a value to sweep")
    if found[0] == "seed":
        raise ValueError("seed is not swept: give --repeats, and --seed for the first")
    return found[0]


def flags(settings: dict[str, str], config: Any) -> list[str]:
    """Settings (dotted name to value) as flags of the trainer.

    Raises:
        ValueError: a switch that is neither true nor false, or flags in a value.
    """
    words: list[str] = []
    for field, value in settings.items():
        *groups, last = field.replace("_", "-").split(".")
        if isinstance(_value(field, config), bool):
            if value.lower() not in ("true", "false"):
                raise ValueError(f"{field} must be true or false, not {value!r}")
            last = last if value.lower() == "true" else f"no-{last}"
            words.append(f"--{'.'.join((*groups, last))}")
        else:
            parts = value.split()
            if any(re.match(r"-[^\d.]", part) for part in parts):
                raise ValueError(f"{field} takes values, not flags, as in {value!r}")
            words += [f"--{'.'.join((*groups, last))}", *parts]
    return words


def _expand(field: str, part: str) -> Sequence[str]:
    """The values of one part, several of a range."""
    ends = re.fullmatch(r"([^/]*)\.\.([^/]*)", part)
    if not ends:
        return (part,)
    try:
        first, last = int(ends[1]), int(ends[2])
    except ValueError:
        raise ValueError(
            f"range {part!r} of {field} needs two whole numbers, as in 1..7"
        ) from None
    if not 0 <= last - first < MAX_VALUES:
        size = "is empty" if last < first else f"has more than {MAX_VALUES} values"
        raise ValueError(f"range {part!r} of {field} {size}")
    return [str(number) for number in range(first, last + 1)]


def _leaves(config: Any, prefix: str = "") -> Iterator[str]:
    """Dotted names of all settings below a dataclass."""
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if dataclasses.is_dataclass(value):
            yield from _leaves(value, f"{prefix}{field.name}.")
        elif isinstance(value, ExtraTerms):
            for name in REWARD_TERMS:
                yield from (
                    f"{prefix}{field.name}.{key}" for key in term_settings(name)
                )
        else:
            yield f"{prefix}{field.name}"


def _value(field: str, config: Any) -> Any:
    for name in field.split("."):
        if isinstance(config, ExtraTerms):
            return None  # a number
        config = getattr(config, name)
    return config
