"""Recorded drives as `.npz` files, to learn from and to replay."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np

from carpark_mj.config import EnvConfig
from carpark_mj.config.checks import require_seed
from carpark_mj.files import require_suffix, write_atomically
from carpark_mj.mdp.actions import action_spec
from carpark_mj.observations import observation_size
from carpark_mj.policy.runs import CONFIG_VERSION, from_dict
from carpark_mj.reading import TEXT, Archive, ArrayForm, parse_object


@dataclasses.dataclass(frozen=True)
class Demonstration:
    """`t` control steps of the agents of a lot; a hand drove the first of them."""

    config: EnvConfig
    seed: int  # of the lot, see `carpark_mj.evaluation.keys.evaluation_key`
    observations: np.ndarray  # (t, agents, observation_size) float32, before the steps
    next_observations: np.ndarray  # at the steps' ends, before respawns
    actions: np.ndarray  # (t, agents, size) float32
    rewards: np.ndarray  # (t, agents) float32
    terminated: np.ndarray  # (t, agents) bool, parked or crashed in the step
    truncated: np.ndarray  # (t, agents) bool, out of time in the step
    success: np.ndarray  # (t, agents) bool, parked in the step
    poses: np.ndarray  # (t, agents, 3) footprint centres in the world, before the steps
    next_poses: np.ndarray  # at the steps' ends, before respawns

    def __len__(self) -> int:
        """Control steps."""
        return len(self.actions)

    def save(self, path: Path) -> None:
        """Writes a `.npz` file, atomically; its suffix is required (`ValueError`)."""
        require_suffix("the file of a demonstration", path.name, ".npz")
        header = {
            "config_version": CONFIG_VERSION,
            "seed": self.seed,
            "config": dataclasses.asdict(self.config),
        }
        arrays: Any = {name: getattr(self, name) for name in STEPS}
        arrays["header"] = json.dumps(header)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, lambda file: np.savez_compressed(file, **arrays))


# The arrays, a row for each control step.
STEPS = tuple(field.name for field in dataclasses.fields(Demonstration))[2:]


def load_demonstration(path: Path) -> Demonstration:
    """Reads what `Demonstration.save` wrote; anything else is a `ValueError`."""
    archive = Archive(path)
    if "header" not in archive.names:
        raise ValueError(f"{path} is not a demonstration that `play` has saved")
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
    seen = observation_size(config)
    sizes = {"observations": seen, "next_observations": seen, "poses": 3}
    sizes |= {"next_poses": 3, "actions": action_spec(config).size}
    forms: dict[str, ArrayForm] = {}
    for name in STEPS:
        kind = (
            np.bool_ if name in ("terminated", "truncated", "success") else np.float32
        )
        size = (sizes[name],) if name in sizes else ()
        shape = ("steps", config.num_agents, *size)
        forms[name] = ArrayForm(np.dtype(kind), shape)
    arrays = archive.read(forms)
    if not len(arrays["actions"]):
        raise ValueError(f"{path} holds no step")
    for name, array in arrays.items():
        if not np.isfinite(array).all():
            raise ValueError(f"{path} holds {name} that are not finite")
    return Demonstration(config, header["seed"], **arrays)
