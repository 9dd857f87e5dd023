"""Files written whole or not at all: to a temporary file, then renamed."""

import contextlib
import csv
import errno
import io
import json
import os
from collections.abc import Generator, Mapping, Sequence
from pathlib import Path
from typing import Any


@contextlib.contextmanager
def _temporary(path: Path) -> Generator[Path]:
    """A path beside `path` with its suffix; what lies there at the end is removed."""
    temporary = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    with naming(path, temporary):
        try:
            yield temporary
        finally:
            temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def naming(path: Path, temporary: Path | None = None) -> Generator[None]:
    """Errors of the system in it name a file: those of writing into one name none.

    Args:
        path: its name.
        temporary: another name, which stands for `path`.
    """
    try:
        yield
    except OSError as error:
        if error.errno and error.filename in (None, str(temporary)):
            error.filename = str(path)
        raise


def require_writable(path: Path) -> None:
    """Refuses, before the work, what `write_atomically` could not write after it.

    Raises:
        OSError: `path` cannot be written.
    """
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    with _temporary(path) as temporary:
        temporary.touch()


def write_atomically(path: Path, write: Any) -> None:
    """Calls `write(temporary_path)` and renames the result to `path`.

    The temporary file keeps the suffix of `path` and is removed on any failure.

    Raises:
        OSError: `path` cannot be written.
    """
    with _temporary(path) as temporary:
        write(temporary)
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        temporary.replace(path)


def write_json(path: Path, data: Any) -> None:
    """Writes JSON atomically."""
    text = json.dumps(data, indent=2) + "\n"
    write_atomically(path, lambda temporary: temporary.write_text(text))


def write_csv(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Writes rows of the same columns atomically; without rows an empty file."""
    text = io.StringIO(newline="")
    if rows:
        writer = csv.DictWriter(text, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    write_atomically(path, lambda temporary: temporary.write_text(text.getvalue()))
