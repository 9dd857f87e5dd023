"""A run's settings, from flags, a preset or its folder, and that folder's lock."""

import contextlib
import dataclasses
import fcntl
import itertools
import platform
import re
import shutil
import sys
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any, TypeVar

import jax
from jax.errors import JaxRuntimeError

from carpark_mj.cli.process import USER_ERRORS
from carpark_mj.cli.settings.training import RunConfig
from carpark_mj.config.checks import require_name
from carpark_mj.extensions import table, unknown_name
from carpark_mj.files import is_temporary, remove_temporary, write_json
from carpark_mj.policy import checkpoints, runs
from carpark_mj.policy.checkpoints import CheckpointError, refused_as
from carpark_mj.reading import parse_yaml, read_object, read_text
from carpark_mj.training.hosts import take_flags
from carpark_mj.training.loggers import logger_names

LOCK = ".lock"
MAX_SEEDS = 1024
PACKAGES = ("carpark_mj", "mujoco", "mujoco-mjx", "jax", "brax", "numpy")
RESUME_FLAGS = ("--resume", "--time-limit")  # what may differ when a run is resumed


Config = TypeVar("Config", bound=RunConfig)


@contextlib.contextmanager
def open_run(config: RunConfig) -> Generator[Path]:
    """Opens and locks the folder of a run.

    The folder is new and has `config.json`, or belongs to the run to resume. A new
    folder is removed if an error ends the run before its first checkpoint, so that its
    name is free again.
    """
    logger_names(config.logger)  # refused before there is a folder
    folder = Path(config.resume) if config.resume else _new_folder(config)
    with (folder / LOCK).open("a") as lock:  # the lock of a killed process is released
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ValueError(
                f"another process trains in {folder}: stop it or wait for its end"
            ) from None
        for part in (folder, folder / "checkpoints"):
            remove_temporary(part)
        try:
            if not config.resume:
                write_json(folder / "config.json", describe(config))
            yield folder
        except (*USER_ERRORS, JaxRuntimeError):
            if not config.resume and not runs.checkpoint_files(folder):
                shutil.rmtree(folder, ignore_errors=True)
            raise


def require_new(config: RunConfig) -> None:
    """Refuses the name of another run, unless it was killed before its settings."""
    folder = Path(config.runs_dir, config.name)
    if config.resume or not config.name or not folder.exists():
        return
    paths = folder.iterdir() if folder.is_dir() else [folder]
    if not all(path.name == LOCK or is_temporary(path) for path in paths):
        raise ValueError(
            f"{folder} exists: choose another --name, or continue with --resume "
            f"{folder}"
        )


def _new_folder(config: RunConfig) -> Path:
    """Makes the folder; an unnamed run never touches an older one."""
    require_new(config)
    folder = first = Path(config.runs_dir, config.name or config.default_name)
    folder.parent.mkdir(parents=True, exist_ok=True)
    for number in itertools.count(2):
        with contextlib.suppress(FileExistsError):
            folder.mkdir(exist_ok=bool(config.name))
            break
        folder = first.with_name(f"{first.name}-{number}")
    return folder


def argument(folder: Path) -> str:
    """A run's folder as an argument; a bare name could be that of a policy."""
    return f"./{folder}" if folder.parent == Path() else str(folder)


def describe(config: RunConfig) -> dict[str, Any]:
    """Provenance of a run: settings, versions, device."""
    versions = dict.fromkeys(PACKAGES, "not installed")
    for name in PACKAGES:
        with contextlib.suppress(metadata.PackageNotFoundError):
            versions[name] = metadata.version(name)
    return {
        "config_version": runs.CONFIG_VERSION,
        "config": dataclasses.asdict(config),
        "versions": versions,
        "python": platform.python_version(),
        "device": jax.devices()[0].device_kind,
        "num_devices": jax.device_count(),
        "matmul_precision": "highest in the environment, default in the networks",
    }


def read_header(path: Path, kind: type[RunConfig], **kinds: type) -> dict[str, Any]:
    """The header of a checkpoint to resume from, with settings of a kind."""
    header = checkpoints.read_header(path, config=dict, **kinds)
    runs.check_version(header, path)
    with refused_as(f"{path} has an unusable config"):
        runs.from_dict(kind, header["config"])
    return header


def stored(folder: Path, name: str = "config.json") -> dict[str, Any]:
    """The settings of a run, as in a file of its folder."""
    path = folder / name
    if not path.exists():
        raise CheckpointError(f"no run at {folder} (no {path})")
    with refused_as(f"{path} is not the config of a run"):
        described = read_object(path, config=dict)
    runs.check_version(described, path)
    return described["config"]


def read_config(cls: type[Config], folder: Path, name: str = "config.json") -> Config:
    """Reads the settings of a run, see `stored`."""
    with refused_as(f"{folder / name} is not the config of a run"):
        return runs.from_dict(cls, stored(folder, name))


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


def read_settings(
    default: Config,
    presets: Mapping[str, Config],
    arguments: Sequence[str] | None,
    description: str | None,
    summaries: Mapping[str, str],
    common: type | None = None,
) -> Config:
    """Reads the flags of a trainer, `--config FILE` among them.

    Args:
        default: preset taken if the flag `preset` names none of the presets.
        presets: by name.
        arguments: the command line; None = that of the process.
        description: at the head of the help.
        summaries: purpose of each preset, for the help.
        common: base of the settings that `--help` lists; None = all.
    """
    from carpark_mj.cli.flags import read_flags  # tyro is of an extra
    from carpark_mj.cli.listing import describe_environment

    arguments = sys.argv[1:] if arguments is None else arguments
    # These are read first: settings may be valid only on top of them.
    file, arguments = take_flags(arguments, config={"default": ""})
    name = named(arguments, "preset")
    preset = default
    if name in presets:
        preset = presets[name]
    if file["config"]:
        preset = _read_file(Path(file["config"]), preset, presets, name)
    lines: dict[str, str] = {}
    for key, known in presets.items():
        env = getattr(known, "env", None)  # None: no car park
        lines[key] = summaries[key] + (f": {describe_environment(env)}" if env else "")
    text = f"{description or ''}\nPresets:\n{table(lines, indent=4)}\n"
    if common and {"-h", "--help"} & {*arguments}:
        values = {x.name: getattr(preset, x.name) for x in dataclasses.fields(common)}
        read_flags(common, ["--help"], common(**values), text)
    config = read_flags(type(default), arguments, preset, text)
    if config.preset not in ("", "auto", *presets):
        raise ValueError(unknown_name("preset", config.preset, presets))
    words = [word.partition("=")[0] for word in arguments if word.startswith("--")]
    flags = [word.replace("_", "-") for word in words]  # tyro takes both
    if "--resume" not in flags:
        return dataclasses.replace(config, preset=preset.preset)
    changed = [flag for flag in flags if flag not in (*RESUME_FLAGS, "--preset")]
    changed += ["--config"] * bool(file["config"])
    kept = config if changed else read_config(type(default), Path(config.resume))
    if name not in ("", kept.preset):
        changed.append("--preset")
    if changed:
        raise ValueError(
            f"a resumed run keeps its own settings: drop {', '.join(changed)} "
            f"(allowed with --resume: --time-limit)"
        )
    return dataclasses.replace(kept, resume=config.resume, time_limit=config.time_limit)


def named(arguments: Sequence[str], setting: str) -> str:
    """The value of a flag before the others are read; empty if it is not given."""
    return take_flags(arguments, **{setting: {"default": ""}})[0][setting]


def _read_file(
    path: Path, default: Config, presets: Mapping[str, Config], named: str
) -> Config:
    """The settings of a run's `config.json`, or of YAML, the others a preset's."""
    from carpark_mj.cli.flags import as_flags, read_flags

    text = read_text(path)
    if '"config_version"' in text:
        if named:
            raise ValueError(f"{path} holds all settings of a run: drop --preset")
        kept = read_config(type(default), path.parent, path.name)
        return dataclasses.replace(kept, name="", resume="")
    found = _words(parse_yaml(text, str(path)))
    name = found.pop("preset", "")
    try:
        if "resume" in found:
            raise ValueError("resume is a flag: a resumed run has its own settings")
        if name and not named:
            require_name("preset", name, presets)
            default = presets[name]
        return read_flags(type(default), as_flags(found, default), default)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def _words(settings: Mapping[Any, Any]) -> dict[str, str]:
    """Nested settings as words of a command line by dotted name."""
    words: dict[str, str] = {}
    for key, value in settings.items():
        if isinstance(value, Mapping):
            words |= {f"{key}.{inner}": x for inner, x in _words(value).items()}
        else:
            values = value if isinstance(value, list) else [value]
            words[key] = " ".join(map(str, values))
    return words


def read_runs(
    arguments: Sequence[str], read: Callable[[Sequence[str]], Config]
) -> list[Config]:
    """The runs to train side by side, by `--seeds`, or `--resume` and several folders.

    `read` gives the settings of one run, from the other arguments.
    """
    ours, others = take_flags(arguments, seeds={}, resume={"nargs": "+", "default": []})
    seeds, resumed = ours["seeds"], ours["resume"]
    if resumed and seeds is not None:
        raise ValueError("resumed runs keep their own seeds: drop seeds")
    if resumed:
        return [read([*others, "--resume", folder]) for folder in resumed]
    config = read(others)
    if seeds is None:
        return [config]
    if config.seed:
        raise ValueError(f"give seed or seeds, not both: drop seed {config.seed}")
    name = f"{config.name}-" if config.name else ""
    return [
        dataclasses.replace(config, seed=seed, name=name and f"{name}{seed}")
        for seed in parse_seeds(seeds)
    ]


def parse_seeds(text: str) -> list[int]:
    """Seeds listed as `0..7` or `1,5,9..12`."""
    seeds: list[int] = []
    for part in text.split(","):
        match = re.fullmatch(r"(\d+)(?:\.\.(\d+))?", part.strip())
        if match is None:
            raise ValueError(f"seeds must be like 0..7 or 1,5,9, not {text!r}")
        first, last = int(match[1]), int(match[2] or match[1])
        if not first <= last < first + MAX_SEEDS:
            raise ValueError(
                f"a range of seeds must rise, by less than {MAX_SEEDS}, not {part}"
            )
        seeds += range(first, last + 1)
    if len({*seeds}) < len(seeds):
        raise ValueError(f"seeds must differ, in {text!r} they do not")
    return seeds
