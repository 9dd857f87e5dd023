"""Reads untrusted files: text, JSON, CSV and `.npz` archives.

Faults raise a `ValueError` that names the file; errors of the system raise `OSError`.
"""

import contextlib
import csv
import io
import json
import reprlib
import stat
from collections.abc import Generator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

MOST_BYTES = 2**30  # of an array that is inflated; or 100 times the file's
TEXT = "text"  # the dtype of strings of any length


def read_bytes(path: Path) -> bytes:
    """Reads a whole file; refuses pipes and devices, which may never end."""
    mode = path.stat().st_mode
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise ValueError(f"cannot read {path}: it is not a regular file")
    return path.read_bytes()


@contextlib.contextmanager
def naming_file(path: Path) -> Generator[None]:
    """Names the file in errors of reading it, which become `ValueError`."""
    try:
        yield
    except OSError as error:
        raise ValueError(f"cannot read {path}: {error.strerror}") from None
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def read_text(path: Path) -> str:
    """Reads a file of UTF-8, with a byte order mark or without."""
    try:
        return read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ValueError(f"cannot read {path}: it is not text") from None


def read_object(path: Path, **kinds: type) -> dict[str, Any]:
    """Reads the JSON object of a file, see `parse_object`."""
    return parse_object(read_text(path), str(path), **kinds)


def parse_object(text: str, what: str, **kinds: type) -> dict[str, Any]:
    """Parses a JSON object; `what` it is begins the message about a fault.

    `kinds` are names that it must have, with the types of their values.
    """
    try:
        found = json.loads(text)
    except RecursionError:
        raise ValueError(f"{what} is nested too deeply") from None
    except ValueError as error:
        raise ValueError(f"{what} is not JSON: {error}") from None
    if not isinstance(found, dict):
        kind = type(found).__name__
        raise ValueError(f"{what} is not a JSON object, but of type {kind}")
    require_entries(found, what, **kinds)
    return found


def parse_yaml(text: str, what: str) -> dict[str, Any]:
    """Parses a YAML mapping; `what` it is begins the message about a fault."""
    import yaml  # only for such files; Flax brings it

    try:
        found = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        told = " ".join(str(error).split())
        raise ValueError(f"{what}: not YAML ({told})") from None
    if not isinstance(found, dict):
        raise ValueError(f"{what} must have lines as 'name: value', not {text[:40]!r}")
    return found


def require_entries(found: Mapping[str, Any], what: str, **kinds: type) -> None:
    """Refuses an object, `what` it is, without entries of some types by name."""
    for name, kind in kinds.items():
        if type(found.get(name)) is not kind:
            raise ValueError(
                f"{what} has no {name!r} of {kind.__name__}, but "
                f"{reprlib.repr(found.get(name))}"
            )


class CsvRow(NamedTuple):
    """A row of a table."""

    place: str  # file and line, for messages
    cells: dict[str, str]  # text by column

    def number(self, name: str) -> float:
        """The number in a column; `ValueError` names file and line if there is none."""
        return self._parsed(name, float, "number")

    def whole(self, name: str) -> int:
        """The whole number in a column, see `number`."""
        return self._parsed(name, int, "whole number")

    def _parsed(self, name: str, kind: type, what: str) -> Any:
        try:
            return kind(self.cells[name])
        except ValueError:
            raise ValueError(
                f"{self.place}: {name} must be a {what}, not {self.cells[name]!r}"
            ) from None


def read_csv(path: Path, *columns: str, growing: bool = False) -> list[CsvRow]:
    """Reads a table whose first line names its columns; an empty file has no rows.

    It must have the columns. Of a `growing` one a killed process may have left half a
    line at the end, which is left out.
    """
    text = read_text(path)
    if growing:
        text = text[: text.rfind("\n") + 1]
    reader = csv.DictReader(io.StringIO(text, newline=""), strict=True)
    rows: list[CsvRow] = []
    try:
        names = [*(reader.fieldnames or columns)]
        if missing := sorted({*columns} - {*names}):
            raise ValueError(f"{path} lacks the columns {', '.join(missing)}")
        if len({*names}) < len(names):
            raise ValueError(f"{path} has a column twice")
        for cells in reader:
            place = f"{path}, line {reader.line_num}"
            if None in cells or None in cells.values():
                raise ValueError(f"{place}: not as many values as columns")
            rows.append(CsvRow(place, cells))
    except csv.Error as error:
        raise ValueError(f"{path}, line {reader.reader.line_num}: {error}") from None
    return rows


class ArrayForm(NamedTuple):
    """What an array of an archive must be.

    Attributes:
        dtype: its dtype, or `TEXT`.
        shape: its lengths; where it is a name any length, but the same in all arrays
            of an archive that are read together.
    """

    dtype: Any
    shape: tuple[int | str, ...]

    def __str__(self) -> str:
        return f"{self.dtype}[{', '.join(map(str, self.shape))}]"


class Archive:
    """The arrays of a `.npz` file, by `names`."""

    def __init__(self, path: Path) -> None:
        """Reads the file and compares its checksums."""
        data = read_bytes(path)  # a few MB, so that no handle stays open
        self.path = path
        try:
            self._arrays: Any = np.load(io.BytesIO(data), allow_pickle=False)
            self.names: list[str] = self._arrays.files
            members = self._arrays.zip.infolist()
            size = max((member.file_size for member in members), default=0)
            most = max(MOST_BYTES, 100 * len(data))
            wrong = self._arrays.zip.testzip() if size <= most else None
        except Exception:  # many kinds of errors, about the format of the file
            raise ValueError(f"{path} is truncated, or another kind of file") from None
        if size > most:
            raise ValueError(
                f"{path} inflates to an array of {size} bytes: at most {most} are read"
            )
        if wrong is not None:
            raise ValueError(f"{path} is damaged at {wrong.removesuffix('.npy')}")

    def read(self, forms: Mapping[str, ArrayForm]) -> dict[str, np.ndarray]:
        """Reads arrays by name; `ValueError` of one that is not of its form."""
        found: dict[str, np.ndarray] = {}
        lengths: dict[int | str, int] = {}
        for name, form in forms.items():
            if name not in self.names:
                raise ValueError(
                    f"{self.path} lacks {name}: it is another kind of file"
                )
            try:
                dtype, shape = self._header(name)
            except Exception as error:
                raise ValueError(f"{self.path} is damaged at {name}: {error}") from None
            same = dtype.kind == "U" if form.dtype == TEXT else dtype == form.dtype
            wanted = form
            if len(shape) == len(form.shape):
                for length, own in zip(form.shape, shape, strict=True):
                    lengths.setdefault(length, own)
                known = (lengths[n] if isinstance(n, str) else n for n in form.shape)
                wanted = ArrayForm(form.dtype, tuple(known))
            if not same or shape != wanted.shape:
                raise ValueError(
                    f"{self.path} holds {name} as {dtype}{list(shape)}, {wanted} is "
                    "needed"
                )
            try:
                found[name] = self._arrays[name]
            except Exception as error:
                raise ValueError(f"{self.path} is damaged at {name}: {error}") from None
        return found

    def _header(self, name: str) -> tuple[np.dtype, tuple[int, ...]]:
        """Dtype and shape of an array, which is not inflated."""
        with self._arrays.zip.open(f"{name}.npy") as stream:
            version = np.lib.format.read_magic(stream)
            first = np.lib.format.read_array_header_1_0
            read = first if version == (1, 0) else np.lib.format.read_array_header_2_0
            shape, _, dtype = read(stream)
        return dtype, shape
