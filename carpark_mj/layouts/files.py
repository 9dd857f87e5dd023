"""Layouts from files; as JSON, for car parks drawn by hand or by other programs.

    {"format": "carpark_mj layout 1",
     "bays": [{"pose": [x, y, yaw], "size": [length, width], "kind": "standard",
               "end": "either"}],
     "walls": [{"pose": ..., "size": ..., "kind": "wall"}],
     "discs": [{"centre": [x, y], "radius": r, "kind": "pillar"}],
     "lanes": [{"pose": ..., "size": ..., "one_way": true}],
     "spawns": [{"pose": ..., "size": ..., "spread": 0.1}],
     "extent": [half_x, half_y]}

Metres and radians; `Layout` explains the fields. Kinds are `standard`, `accessible`,
`family`, `reserved`, `exit`; `wall`, `kerb`, `island`, `gate`; `pillar`, `bollard`.
The end of a car that goes into a bay first is `either`, `nose_first` or `tail_first`.
`bays`, `spawns` and `extent` are needed; `kind` and `end` are by default the first of
their lists, `one_way` true and `spread`, 0 to π, 0.1. Files of another version and
invalid layouts (`layouts.checks`) are refused; messages name the row, as `bays[3]`.
"""

import dataclasses
import enum
import functools
import hashlib
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

from carpark_mj.config.checks import FARTHEST, require_name
from carpark_mj.layouts import build
from carpark_mj.layouts.base import (
    FAMILIES,
    LAYOUT_FORMATS,
    LAYOUT_WRITERS,
    layout_format,
)
from carpark_mj.layouts.checks import ANY_CAR, describe_faults
from carpark_mj.layouts.registry import FixedLayoutConfig
from carpark_mj.layouts.types import BayEnd, BayKind, DiscKind, Layout, WallKind
from carpark_mj.reading import naming_file, parse_object, read_bytes, read_text

FORMAT = "carpark_mj layout 1"

# Every list with the fields of its rows: how many numbers, a kind, or a truth value.
_SCHEMA: dict[str, dict[str, Any]] = {
    "bays": {"pose": 3, "size": 2, "kind": BayKind, "end": BayEnd},
    "walls": {"pose": 3, "size": 2, "kind": WallKind},
    "discs": {"centre": 2, "radius": 1, "kind": DiscKind},
    "lanes": {"pose": 3, "size": 2, "one_way": bool},
    "spawns": {"pose": 3, "size": 2, "spread": 1},
}
_DEFAULTS: dict[str, Any] = {"one_way": True, "spread": build.LANE_SPREAD}
_POSITIVE = ("size", "radius", "extent")
_HALF_TURN = float(np.float32(math.pi))  # as a layout has it
_NEEDED = ("format", "bays", "spawns", "extent")


def read_json(path: Path) -> Layout:
    """Reads a layout; `ValueError` with the row if it has a fault."""
    layout = read_unchecked(path)
    # Which cars there will be only an environment knows.
    if faults := describe_faults(layout, ANY_CAR):
        raise ValueError(f"{path} is not a valid layout: {'; '.join(faults)}")
    return layout


def read_unchecked(path: Path) -> Layout:
    """Reads a layout, which may have faults; `ValueError` if it is none."""
    with naming_file(path):
        return parse_layout(parse_object(read_text(path), "the layout"))


LAYOUT_FORMATS.register("json", read_json)


def layout_text(layout: Layout) -> str:
    """The file of one layout (no batch dimension), as text; padding is left out."""
    document: dict[str, Any] = {"extent": np.asarray(layout.extent).tolist()}
    for rows, schema in _SCHEMA.items():
        kind = rows.removesuffix("s")
        mask = np.asarray(getattr(layout, f"{kind}_mask"))
        document[rows] = [{} for _ in range(mask.sum())]
        for part, form in schema.items():
            if (column := getattr(layout, f"{kind}_{part}")) is not None:
                names, values = _names(form), np.asarray(column)[mask].tolist()
                for row, value in zip(document[rows], values, strict=True):
                    row[part] = names[value] if names else value
    return document_text(document)


LAYOUT_WRITERS.register("json", layout_text)


def document_text(document: Mapping[str, Any]) -> str:
    """The file of an object with rows and `extent`, as text with a row on each line."""
    entries = [f'"format": "{FORMAT}"']
    for rows in _SCHEMA:
        lines = ",".join(f"\n  {json.dumps(row)}" for row in document[rows])
        entries.append(f'"{rows}": [{lines}]')
    entries.append(f'"extent": {json.dumps(document["extent"])}')
    return "{" + ",\n ".join(entries) + "}\n"


def complete(document: Mapping[str, Any]) -> dict[str, Any]:
    """An object that `parse_layout` reads, with all lists and all fields of rows."""
    return dict(document) | {
        rows: [
            {part: row.get(part, _default(part, form)) for part, form in schema.items()}
            for row in document.get(rows, [])
        ]
        for rows, schema in _SCHEMA.items()
    }


def choices() -> dict[str, dict[str, list[str]]]:
    """Names of kinds and ends, by lists of rows and fields."""
    return {
        rows: {part: names for part in schema if (names := _names(schema[part]))}
        for rows, schema in _SCHEMA.items()
    }


def _names(form: Any) -> list[str]:
    """The names of an enumeration's members; of other forms of a field none."""
    kinds: Any = form if isinstance(form, enum.EnumType) else ()
    return [kind.name.lower() for kind in kinds]


def _default(part: str, form: Any) -> Any:
    return (_names(form) or [_DEFAULTS.get(part)])[0]


def parse_layout(data: Mapping[str, Any]) -> Layout:
    """The layout of a file's object, see `read_unchecked`."""
    if data.get("format") != FORMAT:
        raise ValueError(f"format must be {FORMAT!r}, not {data.get('format')!r}")
    if missing := [name for name in _NEEDED if name not in data]:
        raise ValueError(f"{', '.join(missing)} missing")
    for name in data:
        require_name("list", name, {*_SCHEMA, *_NEEDED})
    groups: dict[str, dict[str, np.ndarray]] = {}
    for name, schema in _SCHEMA.items():
        rows = data.get(name, [])
        if not isinstance(rows, list):
            raise ValueError(f"{name} must be a list of objects, not {rows!r}")
        if rows:
            groups[name] = _columns(name, schema, rows)
            if name == "bays" and not groups[name]["end"].any():
                del groups[name]["end"]
    return build.from_columns(np.array(_number("extent", data["extent"], 2)), groups)


def _columns(
    name: str, schema: dict[str, Any], rows: list[Any]
) -> dict[str, np.ndarray]:
    columns: dict[str, list[Any]] = {part: [] for part in schema}
    for index, row in enumerate(rows):
        what = f"{name}[{index}]"
        if not isinstance(row, dict):
            raise ValueError(f"{what} must be an object, not {row!r}")
        for part in row:
            require_name(f"entry of {what}", part, schema)
        for part, form in schema.items():
            given = row.get(part, _default(part, form))
            columns[part].append(_value(f"{what}.{part}", form, given))
    return {part: np.array(values) for part, values in columns.items()}


def _value(what: str, form: Any, value: Any) -> Any:
    """The value of a field of a row: numbers, a flag, or the number of a kind."""
    if value is None:
        raise ValueError(f"{what} is missing")
    if isinstance(form, int):
        return _number(what, value, form)
    if form is not bool:
        require_name(what, value, _names(form))
        return _names(form).index(value)
    if not isinstance(value, bool):
        raise ValueError(f"{what} must be true or false, not {value!r}")
    return value


def _number(what: str, value: Any, count: int) -> Any:
    """A number within bounds, or a list of that length."""
    values = [value] if count == 1 else value
    if (
        not (isinstance(values, list) and len(values) == count)
        or {type(x) for x in values} - {int, float}
        or any(x != x for x in values)
    ):
        wanted = "a number" if count == 1 else f"{count} numbers"
        raise ValueError(f"{what} must be {wanted}, not {value!r}")
    part, least, most = what.rsplit(".", 1)[-1], min(values), max(values)
    if max(most, -least) > FARTHEST:
        raise ValueError(f"{what} must be at most {FARTHEST:g}, not {value!r}")
    if part == "pose" and abs(values[2]) > 2 * math.pi + 1e-3:
        raise ValueError(
            f"{what} must have a heading within [-2 pi, 2 pi] rad, not {values[2]}: "
            "headings are in radians"
        )
    if part in _POSITIVE and least <= 0:
        raise ValueError(f"{what} must be positive, not {value!r}")
    if part == "spread" and not 0 <= value <= _HALF_TURN:
        raise ValueError(f"{what} must lie in [0, {math.pi:.4g}], not {value!r}")
    return value


@dataclasses.dataclass(frozen=True, eq=False)
class FromFileConfig(FixedLayoutConfig):
    """A layout file, read when the config is made.

    Configs are equal if paths and contents are: a changed file gives another config.

    Attributes:
        path: of the file; its suffix says the format: `.json`, in which a car park can
            be drawn by hand (`carpark_mj.layouts.files`), or that of an extension.
    """

    path: str = ""
    family: str = "from_file"

    def __post_init__(self) -> None:
        super().__post_init__()
        _read(self.path, self._content)  # refuses a bad file

    def __eq__(self, other: object) -> bool:
        return isinstance(other, FromFileConfig) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    @property
    def _key(self) -> tuple[str, str]:
        return self.path, self._content

    @functools.cached_property
    def _content(self) -> str:
        """A hash of what is in the file; empty if it cannot be read."""
        try:
            return hashlib.sha256(read_bytes(Path(self.path))).hexdigest()
        except (OSError, ValueError):  # the reader says what is wrong
            return ""

    @property
    def layout(self) -> Layout:
        """As the file had it when the config was made."""
        return _read(self.path, self._content)


@functools.cache
def _read(path: str, content: str) -> Layout:
    """The layout of a file as numpy arrays, read once for each content."""
    del content
    return jax.device_get(LAYOUT_FORMATS[layout_format(path)](Path(path)))


FAMILIES.register("from_file", FromFileConfig)
