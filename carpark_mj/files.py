"""Files written whole or not at all: to a temporary file, then renamed."""

import contextlib
import csv
import errno
import io
import json
import os
import re
import secrets
from collections.abc import Generator, Mapping, Sequence
from pathlib import Path
from typing import Any

_RANDOM = 16  # hexadecimal digits in the name of a temporary file


@contextlib.contextmanager
def _temporary(path: Path, folder: Path | None = None) -> Generator[Path]:
    """A new file beside `path`, or in `folder`; what is left at the end is removed.

    Nobody can have laid a link in its place: its name is random, and it is created only
    where nothing has that name.
    """
    name = f".{path.stem}.{secrets.token_hex(_RANDOM // 2)}{path.suffix}"
    temporary = (folder or path.parent) / name
    with naming(path, temporary):
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        try:
            yield temporary
        finally:
            temporary.unlink(missing_ok=True)


def is_temporary(path: Path) -> bool:
    """Whether it has the name of a temporary file of `write_atomically`."""
    return bool(re.fullmatch(rf"\..+\.[0-9a-f]{{{_RANDOM}}}(\.\w+)?", path.name))


def remove_temporary(folder: Path) -> None:
    """Removes the temporary files that killed processes have left in a folder."""
    for path in filter(is_temporary, folder.glob(".*")):
        path.unlink(missing_ok=True)


@contextlib.contextmanager
def naming(path: Path, temporary: Path | None = None) -> Generator[None]:
    """Makes errors of the system inside name a file; errors of writing name none.

    `temporary` is another name, which stands for `path`.
    """
    try:
        yield
    except OSError as error:
        if error.errno and error.filename in (None, str(temporary)):
            error.filename = str(path)
        raise


def require_suffix(name: str, file: str, *suffixes: str) -> None:
    """Refuses a file whose name ends otherwise; "" is no file. Raises `ValueError`."""
    if file and Path(file).suffix not in suffixes:
        raise ValueError(f"{name} must end in {' or '.join(suffixes)}, not {file!r}")


def require_writable(path: Path, new_folders: bool = False) -> None:
    """Refuses, before the work, a file that `write_atomically` cannot write after it.

    With `new_folders` missing folders of `path` are made after the work, so that
    refused work leaves no folder. Raises `OSError`.
    """
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    there = (folder for folder in path.parents if os.path.lexists(folder))
    with _temporary(path, next(there) if new_folders else None):
        pass


def write_atomically(path: Path, write: Any) -> None:
    """Calls `write(temporary_path)` and renames the result to `path`.

    The temporary file keeps the suffix and is removed on any failure. Raises `OSError`.
    """
    with _temporary(path) as temporary:
        write(temporary)
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        temporary.replace(path)


def write_text(path: Path, text: str) -> None:
    """Writes a text atomically."""
    write_atomically(path, lambda temporary: temporary.write_text(text))


def write_json(path: Path, data: Any) -> None:
    """Writes JSON atomically."""
    write_text(path, json.dumps(data, indent=2) + "\n")


@contextlib.contextmanager
def drawn_axes(
    path: Path, size: tuple[float, float], title: str, xlabel: str = "", **panels: Any
) -> Generator[list[Any]]:
    """Gives axes with a grid to draw in, the first with a title; then writes a PNG.

    `size` is in inches, `panels` are arguments of matplotlib's `Figure.subplots`.
    """
    from matplotlib.figure import Figure  # no window, no state

    figure = Figure(size, layout="constrained")
    axes = [*figure.subplots(squeeze=False, **panels).flat]
    axes[0].set_title(title)
    axes[-1].set_xlabel(xlabel)
    for each in axes:
        each.grid(alpha=0.3)
    yield axes
    write_atomically(path, lambda temporary: figure.savefig(temporary, dpi=120))


def write_csv(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Writes rows atomically, what one lacks as an empty cell; without rows nothing."""
    text = io.StringIO(newline="")
    if rows:
        writer = csv.DictWriter(text, dict.fromkeys(x for row in rows for x in row))
        writer.writeheader()
        writer.writerows(rows)
    write_text(path, text.getvalue())
