"""Checkouts of the project: this one, and another to compare it with."""

import contextlib
import dataclasses
import subprocess
import tempfile
from collections.abc import Generator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


class GitError(ValueError):
    """A git command failed; the message is git's."""


@dataclasses.dataclass(frozen=True)
class Checkout:
    """A checkout of the project.

    Attributes:
        name: in the table.
        path: its root.
        commit: short hash, with `-dirty` if files were changed; empty if unknown.
    """

    name: str
    path: Path
    commit: str


def here() -> Checkout:
    """The checkout that this file is part of."""
    return Checkout("here", ROOT, commit_of(ROOT))


@contextlib.contextmanager
def other_checkout(reference: str) -> Generator[Checkout]:
    """Another checkout; that of a commit is temporary.

    Args:
        reference: folder of a checkout, or a commit, branch or tag of this repository.

    Raises:
        ValueError: it is neither, or does not hold carpark_mj.
    """
    folder = Path(reference)
    if folder.is_dir():
        worker_of(folder)
        yield Checkout(reference, folder.resolve(), commit_of(folder))
        return
    commit = resolve(reference)
    with tempfile.TemporaryDirectory(prefix="carpark_mj_") as temporary:
        path = Path(temporary) / "checkout"
        try:
            git(ROOT, "worktree", "add", "--quiet", "--detach", str(path), commit)
            worker_of(path)
            yield Checkout(reference, path, commit_of(path))
        finally:
            with contextlib.suppress(GitError):  # it was never added
                git(ROOT, "worktree", "remove", "--force", str(path))


def worker_of(folder: Path) -> Path:
    """The script that measures a checkout, in the package or beside `eval`'s scripts.

    Raises:
        ValueError: the folder is not a checkout of the project.
    """
    for home in ("carpark_mj", "eval"):
        worker = folder / home / "benchmarking" / "worker.py"
        if worker.is_file():
            return worker
    raise ValueError(f"against must hold carpark_mj, but {str(folder)!r} does not")


def resolve(reference: str) -> str:
    """The full hash of a commit of this repository.

    Raises:
        ValueError: there is no such commit.
    """
    what = f"{reference}^{{commit}}"
    try:
        return git(ROOT, "rev-parse", "--verify", "--end-of-options", what)
    except GitError as error:
        raise ValueError(
            "against must be the folder of a checkout or a commit of this repository, "
            f"not {reference!r} ({error})"
        ) from None


def commit_of(folder: Path) -> str:
    """The commit of a checkout; empty if git does not know it."""
    if not (folder / ".git").exists():  # git would look in the folders above
        return ""
    try:
        return git(folder, "describe", "--always", "--dirty", "--exclude", "*")
    except GitError:
        return ""


def git(folder: Path, *arguments: str) -> str:
    """What git prints.

    Raises:
        GitError: it fails, or is not installed.
    """
    try:
        done = subprocess.run(
            ["git", "-C", str(folder), *arguments],
            capture_output=True,
            text=True,
            check=True,
        )
    except FileNotFoundError:
        raise GitError("git is not installed") from None
    except subprocess.CalledProcessError as error:
        said = error.stderr.strip().splitlines()[-1:] or ["git failed"]
        raise GitError(said[0]) from None
    return done.stdout.strip()
