"""Reads untrusted files: text, JSON, CSV and `.npz` archives.

Claims of a file are checked before use: an array is inflated only if its dtype, shape
and size are the expected ones. Faults raise a `ValueError` that names the file; errors
of the system raise `OSError`.
"""

import csv
import io
import json
import math
import reprlib
import stat
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

DEEPEST = 64  # brackets within each other; ours have a dozen
MOST_BYTES = 2**30  # of an array whose length the file may choose
TEXT = "text"  # the dtype of strings of any length
COMPRESSIONS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # what NumPy writes
_ENCRYPTED = 0x1  # a bit of a member's flags


def read_bytes(path: Path) -> bytes:
    """Reads a whole file.

    Raises:
        ValueError: a pipe or a device, which may never end.
        OSError: it cannot be read.
    """
    mode = path.stat().st_mode
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise ValueError(f"cannot read {path}: it is not a regular file")
    return path.read_bytes()


def read_text(path: Path) -> str:
    """Reads a file of UTF-8, with a byte order mark or without.

    Raises:
        ValueError: it is not text.
        OSError: it cannot be read.
    """
    try:
        return read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ValueError(f"cannot read {path}: it is not text") from None


def read_object(path: Path, **kinds: type) -> dict[str, Any]:
    """Reads the JSON object of a file, see `parse_object`.

    Raises:
        ValueError: it is not such an object.
        OSError: the file cannot be read.
    """
    return parse_object(read_text(path), str(path), **kinds)


def parse_object(text: str, what: str, **kinds: type) -> dict[str, Any]:
    """Parses a JSON object.

    Args:
        text: of the object.
        what: it is, to begin the message with.
        **kinds: names that it must have, with the types of their values.

    Raises:
        ValueError: not JSON, nested too deeply, not an object, or without such a value.
    """
    try:
        found = json.loads(text)
    except RecursionError:
        raise ValueError(f"{what} is nested too deeply") from None
    except ValueError as error:
        raise ValueError(f"{what} is damaged: {error}") from None
    level = [found]
    for _ in range(DEEPEST):
        level = [inner for outer in level for inner in _inside(outer)]
    if level:
        raise ValueError(f"{what} is nested too deeply")
    if not isinstance(found, dict):
        raise ValueError(f"{what} is not a JSON object")
    require_entries(found, what, **kinds)
    return found


def require_entries(found: Mapping[str, Any], what: str, **kinds: type) -> None:
    """Refuses an object without entries of some types.

    Args:
        found: the object.
        what: it is, to begin the message with.
        **kinds: names that it must have, with the types of their values.

    Raises:
        ValueError: one is missing, or of another type.
    """
    for name, kind in kinds.items():
        if type(found.get(name)) is not kind:
            raise ValueError(
                f"{what} has no {name!r} of {kind.__name__}, but "
                f"{reprlib.repr(found.get(name))}"
            )


def _inside(value: Any) -> Sequence[Any]:
    if isinstance(value, dict):
        return [*value.values()]
    return value if isinstance(value, list) else ()


class CsvRow(NamedTuple):
    """A row of a table.

    Attributes:
        place: file and line, for messages.
        cells: text by column.
    """

    place: str
    cells: dict[str, str]

    def number(self, name: str) -> float:
        """The number in a column.

        Raises:
            ValueError: there is none.
        """
        return self._parsed(name, float, "number")

    def whole(self, name: str) -> int:
        """The whole number in a column.

        Raises:
            ValueError: there is none.
        """
        return self._parsed(name, int, "whole number")

    def _parsed(self, name: str, kind: type, told: str) -> Any:
        try:
            return kind(self.cells[name])
        except ValueError:
            raise ValueError(
                f"{self.place}: {name} must be a {told}, not {self.cells[name]!r}"
            ) from None


def read_csv(path: Path, *columns: str, growing: bool = False) -> list[CsvRow]:
    """Reads a table whose first line names its columns; an empty file has no rows.

    Args:
        path: of the file.
        *columns: that it must have.
        growing: a process that was killed may have left half a line at the end, which
            is left out.

    Raises:
        ValueError: a column is missing or is there twice, or a row has not as many
            values as there are columns.
        OSError: the file cannot be read.
    """
    text = read_text(path)
    if growing:
        text = text[: text.rfind("\n") + 1]
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    rows: list[CsvRow] = []
    names: list[str] = []
    try:
        for cells in reader:
            if not names:
                names = cells
                _require_columns(path, names, columns)
            elif cells:
                place = f"{path}, line {reader.line_num}"
                if len(cells) != len(names):
                    raise ValueError(f"{place}: not as many values as columns")
                rows.append(CsvRow(place, dict(zip(names, cells, strict=True))))
    except csv.Error as error:
        raise ValueError(f"{path}, line {reader.line_num}: {error}") from None
    return rows


def _require_columns(path: Path, names: Sequence[str], needed: Sequence[str]) -> None:
    if missing := sorted({*needed} - {*names}):
        raise ValueError(f"{path} lacks the columns {', '.join(missing)}")
    if len({*names}) < len(names):
        raise ValueError(f"{path} has a column twice")


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
    """The arrays of a `.npz` file.

    Attributes:
        path: of the file.
        names: of the arrays.
    """

    def __init__(self, path: Path) -> None:
        """Reads the file, but inflates nothing.

        Raises:
            ValueError: it is not an archive.
            OSError: it cannot be read.
        """
        data = read_bytes(path)  # a few MB, so that no handle stays open
        try:
            self._zip = zipfile.ZipFile(io.BytesIO(data))
        except Exception:  # zipfile raises many kinds of errors, about its own format
            raise ValueError(f"{path} is truncated, or another kind of file") from None
        self.path = path
        self._members = {
            info.filename.removesuffix(".npy"): info for info in self._zip.infolist()
        }
        self.names = [*self._members]

    def read(
        self, forms: Mapping[str, ArrayForm], most: int = MOST_BYTES
    ) -> dict[str, np.ndarray]:
        """Reads arrays by name.

        Args:
            forms: what they must be.
            most: bytes of an array that has any length.

        Raises:
            ValueError: one is missing, damaged, or of another form.
        """
        lengths: dict[str, int] = {}
        for name, form in forms.items():
            self._check(name, form, lengths, most)
        return {name: self._read(name) for name in forms}

    def _check(
        self, name: str, form: ArrayForm, lengths: dict[str, int], most: int
    ) -> None:
        """Refuses an array of another form, by the headers of archive and array."""
        if name not in self._members:
            raise ValueError(f"{self.path} lacks {name}: it is another kind of file")
        info = self._members[name]
        if info.flag_bits & _ENCRYPTED or info.compress_type not in COMPRESSIONS:
            raise ValueError(f"{self.path} is damaged at {name}: not written by NumPy")
        try:
            with self._zip.open(info) as stream:
                shape, dtype = _read_header(stream)
                begin = stream.tell()
        except Exception:  # NumPy evaluates the header as Python
            raise ValueError(f"{self.path} is damaged at {name}") from None
        same = dtype.kind == "U" if form.dtype == TEXT else dtype == form.dtype
        wanted = ArrayForm(
            form.dtype,
            tuple(
                lengths.setdefault(length, found) if isinstance(length, str) else length
                for length, found in zip(form.shape, shape, strict=False)
            ),
        )
        if not same or shape != wanted.shape or len(shape) != len(form.shape):
            raise ValueError(
                f"{self.path} holds {name} as {dtype}{list(shape)}, "
                f"{wanted if len(shape) == len(form.shape) else form} is needed"
            )
        size = math.prod(shape) * dtype.itemsize
        free = form.dtype == TEXT or any(isinstance(n, str) for n in form.shape)
        if info.file_size != begin + size or (free and size > most):
            raise ValueError(f"{self.path} is damaged at {name}: it has another size")

    def _read(self, name: str) -> np.ndarray:
        try:
            with self._zip.open(self._members[name]) as stream:
                array = np.lib.format.read_array(stream, allow_pickle=False)
                stream.read(1)  # past the end, where the checksum is compared
        except MemoryError:
            raise
        except Exception as error:
            raise ValueError(f"{self.path} is damaged at {name}: {error}") from None
        return array


def _read_header(stream: Any) -> tuple[tuple[int, ...], np.dtype]:
    """Shape and dtype of the array in a stream, which is left at its first number."""
    version = np.lib.format.read_magic(stream)
    if version == (1, 0):
        shape, _, dtype = np.lib.format.read_array_header_1_0(stream)
    else:
        shape, _, dtype = np.lib.format.read_array_header_2_0(stream)
    return shape, dtype
