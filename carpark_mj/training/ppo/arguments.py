"""Which runs a command line asks for: one, several seeds, or those to resume."""

import argparse
import dataclasses
import re
from collections.abc import Callable, Sequence

from carpark_mj.training.ppo.config import PPOConfig

MAX_SEEDS = 1024

# Reads the settings of one run from arguments.
Read = Callable[[Sequence[str]], PPOConfig]


def read_runs(arguments: Sequence[str], read: Read) -> list[PPOConfig]:
    """The runs that are to be trained side by side.

    Args:
        arguments: with `--seeds`, or `--resume` and several folders.
        read: gets the other arguments, and `--resume` with one folder.

    Raises:
        ValueError: impossible settings.
        CheckpointError: `--resume` names no run, or one of an older version.
    """
    parser = argparse.ArgumentParser(
        add_help=False, allow_abbrev=False, exit_on_error=False
    )
    parser.add_argument("--seeds")
    parser.add_argument("--resume", nargs="+", default=[])
    try:
        ours, others = parser.parse_known_args(arguments)
    except argparse.ArgumentError as error:
        raise ValueError(str(error)) from None
    if ours.resume and ours.seeds is not None:
        raise ValueError("resumed runs keep their own seeds: drop seeds")
    if ours.resume:
        return [read([*others, "--resume", folder]) for folder in ours.resume]
    config = read(others)
    if ours.seeds is None:
        return [config]
    if config.seed:
        raise ValueError(f"give seed or seeds, not both: drop seed {config.seed}")
    return [
        dataclasses.replace(
            config, seed=seed, name=f"{config.name}-{seed}" if config.name else ""
        )
        for seed in parse_seeds(ours.seeds)
    ]


def parse_seeds(text: str) -> list[int]:
    """Seeds listed as `0..7` or `1,5,9..12`.

    Raises:
        ValueError: another form, a seed that comes twice, or too many.
    """
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
