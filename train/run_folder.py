"""Opening a run folder, what is written into it first, and stopping on request."""

import dataclasses
import platform
import signal
import sys
from importlib import metadata
from pathlib import Path
from typing import Any, ClassVar, Protocol

import jax

from carpark_mj.policy import runs


class RunConfig(Protocol):
    """What the settings of every trainer have; see `presets.PPOConfig`."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def preset(self) -> str:
        """Settings the other flags start from."""
        ...

    @property
    def name(self) -> str:
        """Folder under `runs_dir`; empty = preset and seed."""
        ...

    @property
    def runs_dir(self) -> str:
        """Where runs are kept."""
        ...

    @property
    def resume(self) -> str:
        """Folder of a run to continue."""
        ...

    @property
    def time_limit(self) -> float:
        """Minutes until it stops with a checkpoint; 0 = no limit."""
        ...

    @property
    def seed(self) -> int:
        """Of everything."""
        ...


def open_run(config: RunConfig) -> Path:
    """Creates the run folder with `config.json`, or finds the one to resume.

    Raises:
        ValueError: the given name is taken.
        OSError: the folder cannot be written.
    """
    if config.resume:
        return Path(config.resume)
    name = config.name or f"{config.preset}-{config.seed}"
    folder = Path(config.runs_dir) / name
    if config.name and folder.exists():
        raise ValueError(
            f"{folder} exists: choose another --name, or go on with --resume {folder}"
        )
    number = 2
    while folder.exists():  # an unnamed run never touches an older one
        folder = folder.with_name(f"{name}-{number}")
        number += 1
    folder.mkdir(parents=True)
    try:
        runs.write_json(folder / "config.json", describe(config))
    except OSError:
        folder.rmdir()
        raise
    return folder


def describe(config: RunConfig) -> dict[str, Any]:
    """Everything needed to know what ran: settings, versions, device."""
    packages = ("carpark_mj", "mujoco", "mujoco-mjx", "jax", "brax", "numpy")
    return {
        "config": dataclasses.asdict(config),
        "versions": {name: _version(name) for name in packages},
        "python": platform.python_version(),
        "device": jax.devices()[0].device_kind,
        "num_devices": jax.local_device_count(),
        "matmul_precision": "highest in the environment, default in the networks",
    }


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"


class StopRequest:
    """Turns the first Ctrl-C or SIGTERM into a request to stop after the update."""

    def __init__(self) -> None:
        """Installs the handlers."""
        self.requested = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._handle)

    def _handle(self, number: int, frame: object) -> None:
        del frame
        self.requested = True
        signal.signal(number, signal.default_int_handler)
        print("stopping after this update (again: at once)", file=sys.stderr)
