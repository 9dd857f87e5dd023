"""The policy of an evaluation, a video or a viewer, and its environment."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

from carpark_mj.config import (
    EnvConfig,
    FleetConfig,
    RandomizationConfig,
    SensorConfig,
)
from carpark_mj.env import ParkingEnv
from carpark_mj.fleet.checks import parked_cars_needed
from carpark_mj.layouts import layout_config
from carpark_mj.policy import pretrained
from carpark_mj.policy.acting import AnyPolicy
from carpark_mj.policy.loading import load_policy
from carpark_mj.policy.named import POLICIES
from carpark_mj.policy.networks import Policy
from carpark_mj.registry import environment


def command_help(text: str | None) -> str:
    """The head of a command's help, with the names of the pretrained policies."""
    return f"{text}\nPretrained policies: {pretrained.describe_names()}."


@dataclasses.dataclass(frozen=True)
class Driver:
    """A policy and its environment.

    Attributes:
        env: the environment; for a trained policy, the one it was trained in.
        folder: folder of its output files.
        policy: makes the acting function for an environment; ValueError if it does not
            fit.
    """

    env: EnvConfig
    folder: Path
    policy: Callable[[ParkingEnv], AnyPolicy]


def find_driver(name: str, named: str = "", deterministic: bool = True) -> Driver:
    """Finds a policy of `POLICIES`, a pretrained one or that of a run.

    Args:
        name: of a policy, as `zero`, `random` or `planner`, or of a pretrained one, or
            a run folder or checkpoint file.
        named: name of an environment. Policies by name drive in it, in the default one
            if empty; a trained policy has its task, observed as in training.
        deterministic: take a distribution's mode instead of samples.

    Raises:
        CheckpointError: the run cannot be read.
        ValueError: unknown environment, or one in which cars cannot be observed as the
            policy does; or a policy that has no distribution is to be sampled.
    """
    if name in POLICIES:
        if not deterministic:
            raise ValueError(f"stochastic has no effect with {name}: leave it out")
        env = environment(named) if named else EnvConfig()
        return Driver(env, Path("runs") / name, POLICIES[name])
    loaded = load_policy(name, deterministic)
    env = _observed_alike(loaded.env, environment(named)) if named else loaded.env

    def make_policy(env: ParkingEnv) -> Policy:
        return load_policy(name, deterministic, env.config).policy

    return Driver(env, output_folder(loaded.path), make_policy)


def _observed_alike(own: EnvConfig, task: EnvConfig) -> EnvConfig:
    """The environment of a task with what a policy observes, and is rewarded for."""
    return dataclasses.replace(task, observation=own.observation, reward=own.reward)


def output_folder(checkpoint: Path) -> Path:
    """Where commands put what they make of a checkpoint if told nothing else.

    In the folder of its run, or beside the file; `runs/NAME` for a pretrained policy.
    """
    folder = checkpoint.parent
    if folder.resolve() == pretrained.FOLDER:
        return Path("runs") / checkpoint.stem
    return folder.parent if folder.name == "checkpoints" else folder


def adapt(
    env: EnvConfig,
    rule: str | None = None,
    hitbox_scale: float | None = None,
    nominal: bool = False,
    **changes: Any,
) -> EnvConfig:
    """The environment with the settings that are not None replaced.

    `nominal` turns the noise and delay of sensors and the randomization of cars off.

    A number of agents is that of every lot, unless `min_agents` is given too, and so is
    one of parked cars, instead of an occupancy; in another layout an occupancy has as
    many parked cars as it takes there. A `vehicle` is that of all cars, instead of a
    fleet.
    """
    episode = {"parked_rule": rule, "hitbox_scale": hitbox_scale}
    episode = {name: value for name, value in episode.items() if value is not None}
    if episode:
        changes["episode"] = dataclasses.replace(env.episode, **episode)
    if nominal:
        changes |= {"sensors": SensorConfig(), "randomization": RandomizationConfig()}
    given = {name: value for name, value in changes.items() if value is not None}
    if "num_agents" in given:
        given.setdefault("min_agents", None)
    if "num_parked_cars" in given:
        given["occupancy"] = None
    elif "layout" in given and env.occupancy is not None:
        needed = parked_cars_needed(env.occupancy, layout_config(given["layout"]))
        given["num_parked_cars"] = max(env.num_parked_cars, needed)
    if "vehicle" in given:
        given["fleet"] = FleetConfig()
    return dataclasses.replace(env, **given)
