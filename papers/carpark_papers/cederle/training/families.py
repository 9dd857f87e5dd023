"""Which loop trains which algorithm."""

import importlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, get_args

from carpark_mj.training.run_folder import named, read_settings, stored
from carpark_papers.cederle.benchmarl.config import (
    BENCHMARL_SUMMARIES,
    benchmarl_presets,
)
from carpark_papers.cederle.dqn.config import DQN_SUMMARIES, dqn_presets
from carpark_papers.cederle.training.config import Algorithm, JunctionRunConfig

DQN: tuple[Algorithm, ...] = ("idqn", "double", "dueling", "double-dueling")
# Extras of a loop, and the name in the message if one is missing.
EXTRAS = {
    "dqn": (("rlax", "flashbax"), "junction"),
    "benchmarl": (("torch", "benchmarl", "torchrl", "tensordict"), "torchrl"),
}


def family(algorithm: str) -> str:
    """The package of this study with the loop."""
    return "dqn" if algorithm in DQN else "benchmarl"


def presets_of(algorithm: Any) -> Mapping[str, JunctionRunConfig]:
    """Presets of an algorithm by name."""
    return (dqn_presets if algorithm in DQN else benchmarl_presets)(algorithm)


def read_junction_settings(
    arguments: Sequence[str], description: str | None
) -> JunctionRunConfig:
    """Reads the flags, which depend on the algorithm."""
    algorithm = named(arguments, "algorithm") or DQN[-1]
    folder = named(arguments, "resume")
    if folder:
        algorithm = stored(Path(folder)).get("algorithm", algorithm)
    # An unknown one is refused by the flags.
    known = algorithm if algorithm in get_args(Algorithm) else DQN[-1]
    presets = presets_of(known)
    summaries = DQN_SUMMARIES if known in DQN else BENCHMARL_SUMMARIES
    given = presets["parallel"], presets, arguments, description, summaries
    return read_settings(*given, JunctionRunConfig)


def train_run(config: JunctionRunConfig) -> tuple[Path, bool]:
    """Trains a run; its folder, and whether it came to its end."""
    name = family(config.algorithm)
    libraries, extra = EXTRAS[name]
    try:
        loop = importlib.import_module(f"carpark_papers.cederle.{name}.train")
    except ModuleNotFoundError as error:
        if error.name not in libraries:
            raise
        raise ValueError(f'{error}: pip install "./papers[{extra}]"') from None
    return loop.train_run(config)
