"""Environment of jobs: import path and GPUs."""

import contextlib
import os
import sys
from collections.abc import Generator
from pathlib import Path


@contextlib.contextmanager
def import_path() -> Generator[None]:
    """Lets jobs import what this process can: they inherit the environment."""
    before = os.environ.get("PYTHONPATH")
    paths = [
        str(Path(path).resolve()) for path in sys.path if Path(path or ".").is_dir()
    ]
    os.environ["PYTHONPATH"] = os.pathsep.join(paths)
    try:
        yield
    finally:
        if before is None:
            del os.environ["PYTHONPATH"]
        else:
            os.environ["PYTHONPATH"] = before


def visible_gpus(slot: int, jobs: int) -> tuple[str, ...]:
    """GPUs of a local job: of several at a time each has its own, if possible."""
    given = os.environ.get("CUDA_VISIBLE_DEVICES")
    if given is not None:
        devices = given.split(",")
    else:
        nodes = Path("/dev").glob("nvidia[0-9]*")
        devices = sorted(node.name.removeprefix("nvidia") for node in nodes)
    if jobs > 1 and devices:
        return (devices[slot % len(devices)],)
    return tuple(devices)
