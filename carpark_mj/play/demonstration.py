"""Recorded drives as `.npz` files, to learn from and to replay."""

import dataclasses
import json
from pathlib import Path

import numpy as np

from carpark_mj.config import EnvConfig
from carpark_mj.config.checks import require_seed
from carpark_mj.files import write_atomically
from carpark_mj.mdp.actions import action_spec
from carpark_mj.observations import observation_size
from carpark_mj.policy.runs import CONFIG_VERSION, from_dict
from carpark_mj.reading import TEXT, Archive, ArrayForm, parse_object

# The arrays, a row for each control step.
STEPS = ("observations", "actions", "rewards", "terminated", "truncated", "poses")


@dataclasses.dataclass(frozen=True)
class Demonstration:
    """`t` control steps of the agents of a lot; the first agents were driven by hand.

    Attributes:
        config: the environment.
        seed: seed of the lot, see `carpark_mj.evaluation.keys.evaluation_key`.
        observations: (t, agents, observation_size) float32, before the steps.
        actions: (t, agents, size) float32.
        rewards: (t, agents) float32.
        terminated: (t, agents) bool, parked or crashed in the step.
        truncated: (t, agents) bool, out of time in the step.
        poses: (t, agents, 3) footprint centres in the world at the steps' ends, before
            any respawn.
    """

    config: EnvConfig
    seed: int
    observations: np.ndarray
    actions: np.ndarray
    rewards: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    poses: np.ndarray

    def __len__(self) -> int:
        """Control steps."""
        return len(self.actions)

    def save(self, path: Path) -> None:
        """Writes a `.npz` file, atomically.

        Raises:
            ValueError: another suffix.
            OSError: the file cannot be written.
        """
        if path.suffix != ".npz":
            raise ValueError(f"a demonstration ends in .npz, not {path.name!r}")
        header = {
            "config_version": CONFIG_VERSION,
            "seed": self.seed,
            "config": dataclasses.asdict(self.config),
        }
        arrays = {name: getattr(self, name) for name in STEPS}
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(
            path,
            lambda temporary: np.savez_compressed(
                temporary, header=json.dumps(header), **arrays
            ),
        )


def load_demonstration(path: Path) -> Demonstration:
    """Reads what `Demonstration.save` wrote.

    Raises:
        ValueError: the file is no demonstration, or one of another version.
        OSError: it cannot be read.
    """
    archive = Archive(path)
    if "header" not in archive.names:
        raise ValueError(
            f"{path} is not a demonstration that carpark_mj.play has saved"
        )
    text = str(archive.read({"header": ArrayForm(TEXT, ())})["header"])
    what = f"the header of {path}"
    header = parse_object(text, what, config=dict, seed=int, config_version=int)
    version = header["config_version"]
    if version != CONFIG_VERSION:
        raise ValueError(
            f"{path} was recorded by another carpark_mj (config version {version}, "
            f"this one reads {CONFIG_VERSION}): record it again"
        )
    require_seed(header["seed"])
    config = from_dict(EnvConfig, header["config"])
    arrays = archive.read(_forms(config))
    if not len(arrays["actions"]):
        raise ValueError(f"{path} holds no step")
    for name, array in arrays.items():
        if not np.isfinite(array).all():
            raise ValueError(f"{path} holds {name} that are not finite")
    return Demonstration(config, header["seed"], **arrays)


def _forms(config: EnvConfig) -> dict[str, ArrayForm]:
    """What the arrays of an environment's drive are like."""
    number, truth = np.dtype(np.float32), np.dtype(np.bool_)
    by_agent = ("steps", config.num_agents)
    return {
        "observations": ArrayForm(number, (*by_agent, observation_size(config))),
        "actions": ArrayForm(number, (*by_agent, action_spec(config).size)),
        "rewards": ArrayForm(number, by_agent),
        "terminated": ArrayForm(truth, by_agent),
        "truncated": ArrayForm(truth, by_agent),
        "poses": ArrayForm(number, (*by_agent, 3)),
    }
