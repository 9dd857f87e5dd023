"""The folder of a run: its name, its lock and its `config.json`."""

import contextlib
import dataclasses
import fcntl
import os
import platform
import shutil
from collections.abc import Generator
from importlib import metadata
from pathlib import Path
from typing import Any

import jax
from jax.errors import JaxRuntimeError

from carpark_mj.cli.common import USER_ERRORS
from carpark_mj.config.checks import (
    CheckedConfig,
    NonNegative,
    Positive,
)
from carpark_mj.evaluation.keys import require_seed
from carpark_mj.files import remove_temporary, write_json
from carpark_mj.policy import checkpoints, runs
from carpark_mj.policy.checkpoints import CheckpointError

LOCK = ".lock"


@dataclasses.dataclass(frozen=True)
class RunConfig(CheckedConfig):
    """Settings of every trainer.

    Attributes:
        preset: settings the other flags start from.
        name: folder under `runs_dir`; empty = named by preset and seed.
        runs_dir: folder of all runs.
        resume: folder of a run to continue with its own settings.
        time_limit: time after which to save a checkpoint and stop [min]; 0 = no limit.
        seed: random seed.
        checkpoint_minutes: time between checkpoints [min].
    """

    preset: str = ""
    name: str = ""
    runs_dir: str = "runs"
    resume: str = ""
    time_limit: NonNegative = 0.0
    seed: int = 0
    checkpoint_minutes: Positive = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        require_seed(self.seed)
        if self.name and not _is_folder_name(self.name):
            raise ValueError(
                f"name must be the name of one folder in runs_dir, not {self.name!r}"
            )
        if not self.runs_dir.strip():
            raise ValueError(f"runs_dir must name a folder, not {self.runs_dir!r}")

    @property
    def default_name(self) -> str:
        """Of the run's folder."""
        return f"{self.preset}-{self.seed}"


def _is_folder_name(name: str) -> bool:
    return (
        bool(name.strip())
        and name.isprintable()
        and name not in (".", "..")
        and not {"/", "\\"} & {*name}
    )


@contextlib.contextmanager
def open_run(config: RunConfig) -> Generator[Path]:
    """Opens and locks the folder of a run.

    The folder is new and has `config.json`, or belongs to the run to resume. A new
    folder is removed if an error ends the run before its first checkpoint, so that its
    name is free again.

    Raises:
        ValueError: the given name is taken, or another process trains in the folder.
        OSError: the folder cannot be written.
    """
    folder = Path(config.resume) if config.resume else _new_folder(config)
    with _lock(folder):
        for part in (folder, folder / "checkpoints"):
            remove_temporary(part)
        try:
            if not config.resume:
                write_json(folder / "config.json", describe(config))
            yield folder
        except (*USER_ERRORS, CheckpointError, JaxRuntimeError):
            if not config.resume and not runs.checkpoint_files(folder):
                _remove(folder)
            raise


def argument(folder: Path) -> str:
    """A run's folder as an argument; a bare name could be that of a policy."""
    return f"./{folder}" if folder.parent == Path() else str(folder)


def _new_folder(config: RunConfig) -> Path:
    name = config.name or config.default_name
    folder = Path(config.runs_dir) / name
    folder.parent.mkdir(parents=True, exist_ok=True)
    number = 1
    while True:
        try:
            folder.mkdir()
        except FileExistsError:
            if config.name and _is_bare(folder):
                return folder
            if config.name:
                raise ValueError(
                    f"{folder} exists: choose another --name, or continue with "
                    f"--resume {folder}"
                ) from None
            number += 1  # an unnamed run never touches an older one
            folder = folder.with_name(f"{name}-{number}")
        else:
            return folder


def _is_bare(folder: Path) -> bool:
    """Whether a run was killed before it wrote its settings, or is about to.

    Its lock tells these apart.
    """
    return folder.is_dir() and all(p.name.startswith(".") for p in folder.iterdir())


def _remove(folder: Path) -> None:
    """Removes a locked folder; renames it first, so that no process opens the rest."""
    removed = folder.with_name(f".{folder.name}.{os.getpid()}")
    with contextlib.suppress(OSError):  # what ended the run is the error to report
        shutil.rmtree(folder.rename(removed))


@contextlib.contextmanager
def _lock(folder: Path) -> Generator[None]:
    """Locks the folder; the lock of a killed process is released."""
    with (folder / LOCK).open("a") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ValueError(
                f"another process trains in {folder}: stop it or wait for its end"
            ) from None
        if not os.fstat(file.fileno()).st_nlink:  # by the run that held the lock
            raise ValueError(f"{folder} was just removed: its run failed")
        yield


def read_header(path: Path, kind: type[RunConfig], **kinds: type) -> dict[str, Any]:
    """The header of a checkpoint to resume from; its settings are checked.

    Args:
        path: of the checkpoint.
        kind: of the settings.
        **kinds: further required entries, see `checkpoints.read_header`.

    Raises:
        CheckpointError: missing, damaged or foreign checkpoint.
    """
    header = checkpoints.read_header(path, config=dict, **kinds)
    runs.check_version(header, path)
    try:
        runs.from_dict(kind, header["config"])
    except (TypeError, ValueError) as error:
        raise CheckpointError(f"{path} has an unusable config: {error}") from None
    return header


def describe(config: RunConfig) -> dict[str, Any]:
    """Provenance of a run: settings, versions, device."""
    packages = ("carpark_mj", "mujoco", "mujoco-mjx", "jax", "brax", "numpy")
    return {
        "config_version": runs.CONFIG_VERSION,
        "config": dataclasses.asdict(config),
        "versions": {name: _version(name) for name in packages},
        "python": platform.python_version(),
        "device": jax.devices()[0].device_kind,
        "num_devices": jax.device_count(),
        "matmul_precision": "highest in the environment, default in the networks",
    }


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"
