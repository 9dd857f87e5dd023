"""Recorded drives as `.npz` files, to learn from and to replay."""

import dataclasses
import json
from pathlib import Path

import numpy as np

from carpark_mj.config import EnvConfig
from carpark_mj.files import write_atomically
from carpark_mj.policy.runs import CONFIG_VERSION, from_dict

# The arrays, a row for each control step.
STEPS = ("observations", "actions", "rewards", "terminated", "truncated", "poses")


@dataclasses.dataclass(frozen=True)
class Demonstration:
    """`t` control steps of the agents of a lot; the first agents were driven by hand.

    Attributes:
        config: the environment.
        seed: of the lot, see `carpark_mj.evaluation.keys.evaluation_key`.
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
    try:
        with np.load(path, allow_pickle=False) as file:
            header = json.loads(str(file["header"]))
            arrays = {name: file[name] for name in STEPS}
        config, seed = header["config"], int(header["seed"])
    except OSError:
        raise
    except Exception:  # zip, NumPy and JSON raise many kinds, none of them helpful
        raise ValueError(
            f"{path} is not a demonstration that carpark_mj.play has saved"
        ) from None
    version = header.get("config_version")
    if version != CONFIG_VERSION:
        raise ValueError(
            f"{path} was recorded by another carpark_mj (config version {version}, "
            f"this one reads {CONFIG_VERSION}): record it again"
        )
    return Demonstration(from_dict(EnvConfig, config), seed, **arrays)
