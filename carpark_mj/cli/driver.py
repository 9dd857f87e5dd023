"""The policy of an evaluation, a video or a viewer, its environment, its checkpoint."""

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from carpark_mj import pretrained
from carpark_mj.cli.flags import as_flags, read_flags
from carpark_mj.cli.settings.driving import ExportConfig, LotSettings
from carpark_mj.config import EnvConfig, FleetConfig, RandomizationConfig, SensorConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.extensions import unknown_name
from carpark_mj.files import require_suffix, require_writable
from carpark_mj.layouts import layout_config
from carpark_mj.policy.acting import AnyPolicy
from carpark_mj.policy.checkpoints import CheckpointError
from carpark_mj.policy.loading import load_policy, save_policy
from carpark_mj.policy.named import POLICIES, find_named
from carpark_mj.policy.networks import Policy
from carpark_mj.registry import environment
from carpark_mj.spawning.checks import parked_cars_needed


@dataclasses.dataclass(frozen=True)
class Driver:
    """A policy and its environment."""

    env: EnvConfig  # for a trained policy, that of its training
    folder: Path  # of its output files
    policy: Callable[[ParkingEnv], AnyPolicy]  # `ValueError` if it does not fit


def find_driver(name: str, named: str = "", deterministic: bool = True) -> Driver:
    """Finds a policy by its name (`zero`, a pretrained one) or the path of its run.

    The environment is the `named` one, else that of the training, or the default one
    for `POLICIES`. A trained policy observes as in its training. If `deterministic` it
    takes a distribution's mode instead of samples.
    """
    if make := find_named(name):
        if not deterministic:
            raise ValueError(f"stochastic has no effect with {name}: leave it out")
        own = getattr(make, "env", None)  # of a `HostPolicy`
        own = environment(own) if isinstance(own, str) else own
        folder = Path("runs") / Path(name.partition(":")[2] or name).stem
        return Driver(_environment(own, named), folder, make)
    try:
        loaded = load_policy(name, deterministic)
    except CheckpointError as error:
        if Path(name).exists():
            raise
        untrained = ", ".join(POLICIES)
        raise CheckpointError(f"{error}; untrained ones: {untrained}") from error

    def make_policy(env: ParkingEnv) -> Policy:
        return load_policy(name, deterministic, env.config).policy

    env = _environment(loaded.env, named)
    return Driver(env, output_folder(loaded.path), make_policy)


def _environment(own: EnvConfig | None, named: str) -> EnvConfig:
    """The named environment, with a policy's own observation and reward, if any."""
    if not named:
        return own or EnvConfig()
    env = environment(named)
    if own is None:
        return env
    return dataclasses.replace(env, observation=own.observation, reward=own.reward)


def output_folder(checkpoint: Path) -> Path:
    """Folder of files about a checkpoint: its run's, or `runs/NAME` if pretrained."""
    folder = checkpoint.parent
    if folder.resolve() == pretrained.FOLDER:
        return Path("runs") / checkpoint.stem
    return folder.parent if folder.name == "checkpoints" else folder


def with_settings(env: EnvConfig, settings: Sequence[str]) -> EnvConfig:
    """The environment with settings `NAME=VALUE`, as the trainer's flags, replaced."""
    values: dict[str, str] = {}
    for setting in settings:
        name, equals, value = setting.partition("=")
        if not (name and equals and value):
            raise ValueError(
                f"set takes NAME=VALUE, as in sim.steering_delay=0.24, not {setting!r}"
            )
        values[name] = value
    return read_flags(EnvConfig, as_flags(values, env), env) if values else env


def adapted(settings: LotSettings, env: EnvConfig, **changes: Any) -> EnvConfig:
    """The environment with those of a command's settings that it has, see `adapt`."""
    given, known = vars(settings), (*vars(env), "rule", "nominal")
    env = with_settings(env, given.get("set", ()))
    own = {name: value for name, value in given.items() if name in known}
    return adapt(env, **own | changes)


def adapt(
    env: EnvConfig, rule: str | None = None, nominal: bool = False, **changes: Any
) -> EnvConfig:
    """The environment with the settings that are not None replaced.

    `nominal` turns the noise and delay of sensors and the randomization of cars off.

    A number of agents applies to every lot, unless `min_agents` is given too. A number
    of parked cars replaces an occupancy. In another layout an occupancy keeps its
    range, with as many parked cars as that needs. A `vehicle` replaces a fleet.
    """
    if rule is not None:
        changes["episode"] = dataclasses.replace(env.episode, parked_rule=rule)
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


def export(config: ExportConfig) -> Path:
    """Writes a policy as a checkpoint of its own; returns the file."""
    out = Path(config.out)
    if not config.out or out.suffix == ".onnx":
        raise ValueError(unknown_name("format to export", "onnx", ()))
    require_suffix("out", config.out, ".npz")
    load_policy(config.run)
    require_writable(out, new_folders=True)  # before the work
    out.parent.mkdir(parents=True, exist_ok=True)
    save_policy(config.run, out)
    print(f"wrote {out}: {out.stat().st_size / 1e6:.2f} MB")
    return out
