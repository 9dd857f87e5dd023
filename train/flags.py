"""The flags of a trainer: a preset gives their defaults, a resumed run all of them."""

import dataclasses
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeVar

import tyro

from carpark_mj.policy import runs
from carpark_mj.policy.checkpoints import CheckpointError
from run_folder import RunConfig

RESUME_FLAGS = ("resume", "time_limit")  # what may differ when a run is resumed

Config = TypeVar("Config", bound=RunConfig)


@dataclasses.dataclass(frozen=True)
class _Choice:
    preset: str


def read_flags(
    default: Config,
    presets: Mapping[str, Config],
    arguments: Sequence[str] | None,
    description: str | None,
) -> Config:
    """Reads the flags of a trainer.

    Args:
        default: preset taken if the flag `preset` names none of the presets.
        presets: by name.
        arguments: of the command line; None = those of the program.
        description: at the head of the help.

    Raises:
        ValueError: impossible settings.
        CheckpointError: `--resume` names no run.
    """
    # By itself first: settings that fit no other preset may fit the one named.
    choice, _ = tyro.cli(
        _Choice,
        args=arguments,
        default=_Choice(default.preset),
        return_unknown_args=True,
        add_help=False,
    )
    preset = presets.get(choice.preset, default)
    cls = type(default)
    config = tyro.cli(cls, args=arguments, default=preset, description=description)
    if not config.resume:
        return dataclasses.replace(config, preset=preset.preset)
    changed = [
        field.name
        for field in dataclasses.fields(config)
        if getattr(config, field.name) != getattr(preset, field.name)
        and field.name not in RESUME_FLAGS
    ]
    if changed:
        raise ValueError(
            f"a resumed run keeps its own settings: drop {', '.join(changed)} "
            f"(allowed with --resume: --time-limit)"
        )
    path = Path(config.resume) / "config.json"
    try:
        stored = runs.from_dict(cls, json.loads(path.read_text())["config"])
    except FileNotFoundError:
        raise CheckpointError(f"no run at {config.resume} (no {path})") from None
    except (KeyError, TypeError, ValueError) as error:
        raise CheckpointError(f"{path} is no config of a run: {error}") from None
    return dataclasses.replace(
        stored, resume=config.resume, time_limit=config.time_limit
    )
