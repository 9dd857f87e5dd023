"""Settings of a trainer: a preset gives their defaults, a resumed run all of them."""

import dataclasses
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from carpark_mj.cli.flags import read_flags
from carpark_mj.config import EnvConfig
from carpark_mj.policy import runs
from carpark_mj.policy.checkpoints import CheckpointError
from carpark_mj.reading import read_object
from carpark_mj.training.run_folder import RunConfig

RESUME_FLAGS = ("resume", "time_limit")  # what may differ when a run is resumed

Config = TypeVar("Config", bound=RunConfig)


def read_settings(
    default: Config,
    presets: Mapping[str, Config],
    arguments: Sequence[str] | None,
    description: str | None,
    short: Sequence[str],
    summaries: Mapping[str, str],
) -> Config:
    """Reads the flags of a trainer.

    Args:
        default: preset taken if the flag `preset` names none of the presets.
        presets: by name.
        arguments: of the command line; None = those of the program.
        description: at the head of the help.
        short: settings that the short help lists.
        summaries: purpose of each preset, for the help.

    Raises:
        ValueError: impossible settings.
        CheckpointError: `--resume` does not name a run, or names one of an older
            version.
    """
    arguments = sys.argv[1:] if arguments is None else arguments
    # The preset is read first: settings may be valid only on top of the one named.
    preset = default
    if (name := named(arguments, "preset")) in presets:
        preset = presets[name]
    text = f"{description or ''}\nPresets:\n{_preset_table(presets, summaries)}\n"
    config = read_flags(type(default), arguments, preset, text, short)
    if config.preset not in ("", "auto", *presets):
        raise ValueError(
            f"unknown preset {config.preset!r}; choose from {', '.join(presets)}"
        )
    if not config.resume:
        if any(word.partition("=")[0] == "--resume" for word in arguments):
            raise ValueError("resume must name the folder of a run, not ''")
        return dataclasses.replace(config, preset=preset.preset)
    given = {
        word.partition("=")[0].removeprefix("--").partition(".")[0].replace("-", "_")
        for word in arguments
        if word.startswith("--")
    }
    changed = [
        field.name
        for field in dataclasses.fields(config)
        if getattr(config, field.name) != getattr(preset, field.name)
        or (field.name in given and field.name != "preset")
    ]
    changed = [name for name in changed if name not in RESUME_FLAGS]
    _refuse_changes(changed)
    stored = read_config(type(default), Path(config.resume))
    if named(arguments, "preset") not in ("", stored.preset):
        _refuse_changes(["preset"])
    return dataclasses.replace(
        stored, resume=config.resume, time_limit=config.time_limit
    )


def _refuse_changes(names: list[str]) -> None:
    """Refuses settings for a resumed run.

    Raises:
        ValueError: settings are given.
    """
    if names:
        raise ValueError(
            f"a resumed run keeps its own settings: drop {', '.join(names)} "
            f"(allowed with --resume: --time-limit)"
        )


def read_config(cls: type[Config], folder: Path) -> Config:
    """Reads the settings of a run.

    Raises:
        CheckpointError: the run does not exist, or another version wrote it.
    """
    path, settings = folder / "config.json", stored(folder)
    try:
        return runs.from_dict(cls, settings)
    except (TypeError, ValueError) as error:
        raise CheckpointError(f"{path} is not the config of a run: {error}") from None


def stored(folder: Path) -> dict[str, Any]:
    """The settings of a run, as in its `config.json`.

    Raises:
        CheckpointError: the run does not exist, or another version wrote it.
    """
    path = folder / "config.json"
    try:
        described = read_object(path, config=dict)
    except (FileNotFoundError, NotADirectoryError):
        raise CheckpointError(f"no run at {folder} (no {path})") from None
    except ValueError as error:
        raise CheckpointError(f"{path} is not the config of a run: {error}") from None
    runs.check_version(described, path)
    return described["config"]


def list_settings(config: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Names and values of all settings, nested ones by their path."""
    for field in dataclasses.fields(config):
        name, value = f"{prefix}{field.name}", getattr(config, field.name)
        if dataclasses.is_dataclass(value):
            yield from list_settings(value, f"{name}.")
        elif isinstance(value, Mapping):
            yield from ((f"{name}.{key}", number) for key, number in value.items())
        else:
            yield name, value


def named(arguments: Sequence[str], setting: str) -> str:
    """The value of a flag before the others are read; empty if it is not given."""
    name = ""
    for word, after in zip(arguments, [*arguments[1:], ""], strict=False):
        flag, equals, value = word.partition("=")
        if flag == f"--{setting}":
            name = value if equals else after
    return name


def _preset_table(presets: Mapping[str, Any], summaries: Mapping[str, str]) -> str:
    """A line per preset with its task."""
    width = max(map(len, presets))
    lines: list[str] = []
    for name, config in presets.items():
        env: EnvConfig | None = getattr(config, "env", None)
        if env is None:  # of no car park
            lines.append(f"    {name:{width}}  {summaries[name]}")
            continue
        goals = "dynamic" if env.goals.dynamic else "fixed"
        lines.append(
            f"    {name:{width}}  {summaries[name]}: {env.num_agents} "
            f"{'agent' if env.num_agents == 1 else 'agents'}, {goals} goals, "
            f"{env.layout} lot, {env.physics} physics"
        )
    return "\n".join(lines)
