"""The folder of a training run, `runs/<name>/`.

config.json             every setting, versions, device
checkpoints/step_N.npz  the last two training states
metrics.csv             one row per update
tensorboard/            event files of these rows
learning_curve.png, evaluation.{csv,json}, video.mp4   at the end

Pretrained policies are files `pretrained/<name>.npz`, written by `carpark_mj export`,
each with its model card `<name>.md`.
"""

import contextlib
import dataclasses
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from carpark_mj import pretrained
from carpark_mj.config import ENCODERS, PHYSICS, ExtraTerms
from carpark_mj.config.checks import require_kind, require_name
from carpark_mj.extensions import Registry
from carpark_mj.layouts.base import FAMILIES
from carpark_mj.obstacles import MOVERS
from carpark_mj.policy import checkpoints
from carpark_mj.policy.checkpoints import CheckpointError

KEPT_CHECKPOINTS = 2
# Goes up whenever a field of a config is renamed, removed or means something else.
CONFIG_VERSION = 5
# Parts by name, which their settings have in this entry.
_NAMED: dict[str, Mapping[str, Any]] = {
    "mover": MOVERS,
    "family": FAMILIES,
    "encoding": ENCODERS,
    "back_end": PHYSICS,
}
# By `algorithm` in the header of checkpoints without networks: `shapes(header, env)` of
# the parameters by kind, and `policy(parameters, header, env)`, which acts on them.
ALGORITHMS: Registry[Any] = Registry("algorithm")


def from_dict(cls: Any, data: Any) -> Any:
    """Rebuilds a config, which checks itself, from a dictionary of its `asdict`."""
    if not isinstance(data, dict):
        raise ValueError(f"{cls.__name__} needs a dictionary, not {data!r}")
    hints, fields = typing.get_type_hints(cls), dataclasses.fields(cls)
    for name in map(str, data):  # YAML has numbers, too
        require_name(f"{cls.__name__} setting", name, {field.name for field in fields})
    unset = dataclasses.MISSING
    needed = [x.name for x in fields if x.default is x.default_factory is unset]
    if missing := [name for name in needed if name not in data]:
        raise ValueError(f"{cls.__name__} lacks {', '.join(missing)}")
    return cls(**{name: from_json(hints[name], value) for name, value in data.items()})


def from_json(hint: Any, value: Any) -> Any:
    """Rebuilds a value of a type from its JSON; a config stays what it is.

    Lists become tuples, and settings of parts that have a name their config.
    """
    if dataclasses.is_dataclass(value):
        return value
    for kind in (hint, *typing.get_args(hint)):  # of a union the one that is a config
        if dataclasses.is_dataclass(kind) and (kind is hint or isinstance(value, dict)):
            return from_dict(kind, value)
    if isinstance(value, list | tuple):
        return tuple(from_json(None, item) for item in value)
    if not isinstance(value, dict):
        return value
    if hint is ExtraTerms:
        return ExtraTerms(value)
    for tag, parts in _NAMED.items():
        if tag in value:
            part: Any = parts[value[tag]]
            return from_dict(part if isinstance(part, type) else type(part), value)
    return value


def check_version(header: Mapping[str, Any], path: Path) -> None:
    """Refuses a checkpoint or a `config.json` of another config version."""
    version = header.get("config_version")
    if version != CONFIG_VERSION:
        raise CheckpointError(
            f"{path} is of another carpark_mj (config version {version}, this one "
            f"reads {CONFIG_VERSION}): train again, or use the version that wrote it"
        )


def checkpoint_files(folder: Path) -> list[Path]:
    """Checkpoints of a run, oldest first."""
    return sorted((folder / "checkpoints").glob("step_*.npz"))


def latest_checkpoint(run: Path) -> Path:
    """The newest readable checkpoint of a run folder, or a checkpoint file itself."""
    if run.is_file():
        checkpoints.read_header(run)
        return run
    if not run.is_dir():
        raise CheckpointError(
            f"no run folder or checkpoint at {run}, and no pretrained policy of that "
            f"name (there are: {pretrained.describe_names()})"
        )
    files = checkpoint_files(run)
    if not files:
        raise CheckpointError(f"{run} holds no checkpoint (checkpoints/step_*.npz)")
    for file in reversed(files):
        with contextlib.suppress(CheckpointError):
            checkpoints.read_header(file)
            return file
    checkpoints.read_header(files[-1])  # raises what is wrong with the newest
    return files[-1]


def save_checkpoint(run: Path, tree: Any, header: dict[str, Any], step: int) -> Path:
    """Saves a training state and removes all but the last two.

    Checkpoints of later steps are removed too: the run resumed from an older one and
    must not be evaluated or resumed from the abandoned steps.
    """
    folder = run / "checkpoints"
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"step_{step:012d}.npz"
    checkpoints.save(path, tree, {"config_version": CONFIG_VERSION, **header})
    files = checkpoint_files(run)
    end = files.index(path) + 1
    for old in files[: max(0, end - KEPT_CHECKPOINTS)] + files[end:]:
        old.unlink(missing_ok=True)
    return path


def find_policy(run: str | Path) -> Path:
    """The file of a pretrained policy, or the path of a run, which may not exist.

    A `Path` is never a name.
    """
    require_kind("run", run, str | Path)
    if isinstance(run, Path) or run not in pretrained.pretrained_names():
        return Path(run)
    if Path(run).exists():
        raise CheckpointError(
            f"{run} is a pretrained policy and a path in this folder: write ./{run} "
            "for the path, or rename it"
        )
    return pretrained.FOLDER / f"{run}.npz"
