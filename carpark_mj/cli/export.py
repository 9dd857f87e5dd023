"""What `carpark_mj export` does: a policy as an ONNX model or a checkpoint."""

import dataclasses
from pathlib import Path
from typing import Annotated

import jax
import numpy as np
import tyro
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from carpark_mj.cli.driver import output_folder
from carpark_mj.config.checks import require_unset
from carpark_mj.env import ParkingEnv
from carpark_mj.evaluation.keys import evaluation_key, require_seed
from carpark_mj.files import require_writable, write_atomically
from carpark_mj.mdp.actions import action_spec
from carpark_mj.policy.loading import LoadedPolicy, load_policy, save_policy
from carpark_mj.policy.onnx_export import (
    OUTPUT,
    describe_action,
    largest_difference,
    make_model,
    onnx_inputs,
    random_observations,
    require_onnx,
    rounding_error,
)
from carpark_mj.policy.rollout import Carry, Step, acts, roll_out

# Most that numbers of an action of a model and of its policy may differ by. Where
# float32 itself is not as good as that, twice its error: both are computed in it.
TOLERANCE = 1e-5
ROUNDING = 2.0
CHECKED = 10_000  # observations of each kind that are compared
LOTS = 16  # of the roll-out


@dataclasses.dataclass(frozen=True)
class ExportConfig:
    """Settings of `carpark_mj export`.

    Attributes:
        run: pretrained policy, run folder or checkpoint file.
        out: file to write: .onnx, or .npz for a checkpoint of the policy alone;
            default `policy.onnx` in the run folder, or in `runs/NAME` of a pretrained
            policy.
        seed: seed of the observations that the model is checked on.
    """

    run: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
    out: str = ""
    seed: int = 0

    def __post_init__(self) -> None:
        if self.out and Path(self.out).suffix not in (".onnx", ".npz"):
            raise ValueError(f"out must end in .onnx or .npz, not {self.out!r}")
        if self.out.endswith(".npz"):
            require_unset(self, "on a checkpoint, of which no model is checked", "seed")
        require_seed(self.seed)


def main(config: ExportConfig) -> Path:
    """Exports, checks and writes; returns the file.

    Raises:
        CheckpointError: the run cannot be read.
        ValueError: the model differs from the policy.
        OSError: the file cannot be written, or a package is missing.
    """
    out = Path(config.out)
    if out.suffix != ".npz":
        require_onnx()
    loaded = load_policy(config.run)
    if not config.out:
        out = output_folder(loaded.path) / "policy.onnx"
    require_writable(out, new_folders=True)  # before the work
    if out.suffix == ".npz":
        out.parent.mkdir(parents=True, exist_ok=True)
        save_policy(config.run, out)
    else:
        _write_model(out, loaded, config.seed)
    print(f"wrote {out}: {out.stat().st_size / 1e6:.2f} MB")
    return out


def _write_model(out: Path, loaded: LoadedPolicy, seed: int) -> None:
    """Writes a model that acts like its policy, or none.

    Raises:
        ValueError: it acts otherwise.
    """
    model = make_model(loaded)
    seen = rollout_observations(loaded, CHECKED, seed)
    random = random_observations(loaded.env, seen, seed)
    found: list[str] = []
    for kind, observation in (("of a roll-out", seen), ("drawn at random", random)):
        difference = largest_difference(model, loaded, observation)
        rounding = rounding_error(loaded, observation)
        most = max(TOLERANCE, ROUNDING * rounding)
        found.append(
            f"largest difference to the policy on {len(observation):,} observations "
            f"{kind}: {difference:.2g}; of float32 to float64: {rounding:.2g}"
        )
        if not difference <= most:
            raise ValueError(
                f"the model differs from the policy by {difference:.2g} on "
                f"observations {kind}, at most {most:.2g} is allowed: not written"
            )
    out.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(
        out, lambda temporary: temporary.write_bytes(model.SerializeToString())
    )
    print("\n".join(found))
    Console().print(_table(loaded))


def rollout_observations(loaded: LoadedPolicy, count: int, seed: int) -> np.ndarray:
    """Observations (count, size) of agents that a policy drives in held-out lots."""
    env = ParkingEnv(loaded.env)
    num_steps = -(-count // (LOTS * min(env.config.agent_counts)))

    def run(key: jax.Array) -> jax.Array:
        reset = jax.vmap(lambda key: env.reset(key, "test"))
        start = Carry(*reset(jax.random.split(key, LOTS)))
        keys = jax.random.split(jax.random.key(0), num_steps)  # a model has none
        return roll_out(env, acts(loaded.policy), start, keys, _observation)[1]

    seen = np.asarray(jax.jit(run)(evaluation_key(seed)))
    seen = seen.reshape(-1, seen.shape[-1])
    seen = seen[seen.any(axis=-1)]  # absent agents observe zeros
    return seen[np.linspace(0, len(seen) - 1, count).astype(int)]


def _observation(step: Step) -> jax.Array:
    return step.observation


def _table(loaded: LoadedPolicy) -> Table:
    """Inputs and output of a model."""
    table = Table(title="inputs and output")
    for column in ("name", "shape", "range and meaning"):
        table.add_column(column)
    for entry in onnx_inputs(loaded.env):
        shape = str(("batch", *entry.shape))
        table.add_row(entry.name, shape, escape(entry.meaning))
    spec = action_spec(loaded.env)
    table.add_section()
    shape = str(("batch", spec.size))
    table.add_row(OUTPUT, shape, escape(describe_action(spec)))
    return table
