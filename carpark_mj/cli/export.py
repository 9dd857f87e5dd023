"""`carpark_mj export`: a policy as an ONNX model or a checkpoint."""

import dataclasses
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any

import jax
import numpy as np
import tyro
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from carpark_mj.cli.driver import output_folder
from carpark_mj.config import EnvConfig
from carpark_mj.config.checks import require_unset
from carpark_mj.env import ParkingEnv
from carpark_mj.evaluation.keys import evaluation_key, require_seed
from carpark_mj.files import require_writable, write_atomically
from carpark_mj.mdp.actions import action_spec
from carpark_mj.policy.acting import Carry, Step, acts, roll_out
from carpark_mj.policy.loading import LoadedPolicy, load_policy, save_policy
from carpark_mj.policy.onnx_export import (
    OUTPUT,
    decisions,
    describe,
    describe_action,
    differences,
    inputs_of,
    largest_difference,
    make_car_model,
    make_model,
    make_session,
    onnx_inputs,
    policy_actions,
    random_observations,
    require_onnx,
    require_outside,
    rounding_error,
    sensitivity,
)
from carpark_mj.policy.outside import Rows, plain_values, rows_of

# Most that numbers of an action of a model and of its policy may differ by. Where
# float32 itself is not as good as that, twice its error: both are computed in it.
TOLERANCE = 1e-5
ROUNDING = 2.0
CHECKED = 10_000  # observations of each kind that are compared
LOTS = 16  # of the roll-out
COUNTS = ("others", "parked", "walls", "discs", "lanes")


@dataclasses.dataclass(frozen=True)
class ExportConfig:
    """Exports a policy as an ONNX model, or as a checkpoint without training state.

    carpark_mj export runs/cpu-0                      # runs/cpu-0/policy.onnx
    carpark_mj export runs/cpu-0 --from-state         # runs/cpu-0/car.onnx, for a car
    carpark_mj export runs/cpu-0 --out policy.npz     # as the pretrained policies are

    An ONNX model has an input for every observation field, with the normalisation
    inside. With --from-state the observation is inside too; inputs are poses of the
    car, the others and the walls. A model is written only if onnxruntime computes the
    policy's actions with it.

    Attributes:
        run: pretrained policy, run folder or checkpoint file.
        out: file to write: .onnx, or .npz for a checkpoint of the policy alone;
            default `policy.onnx` (`car.onnx` with --from-state) in the run folder, or
            in `runs/NAME` of a pretrained policy.
        seed: seed of the observations that the model is checked on.
        from_state: the inputs are poses of the car and its surroundings, and the model
            computes the observation.
        others: number of rows for other driving cars; default and least: as many as the
            environment has.
        parked: number of rows for parked cars, likewise.
        walls: number of rows for walls and other boxes, likewise.
        discs: number of rows for pillars and other discs, likewise.
        lanes: number of rows for lanes, likewise.
    """

    run: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
    out: str = ""
    seed: int = 0
    from_state: bool = False
    others: int | None = None
    parked: int | None = None
    walls: int | None = None
    discs: int | None = None
    lanes: int | None = None

    def __post_init__(self) -> None:
        if self.out and Path(self.out).suffix not in (".onnx", ".npz"):
            raise ValueError(f"out must end in .onnx or .npz, not {self.out!r}")
        if self.out.endswith(".npz"):
            reason = "on a checkpoint"
            require_unset(self, reason, "seed", "from_state")
        if not self.from_state:
            require_unset(self, "without --from-state", *COUNTS)
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
        name = "car.onnx" if config.from_state else "policy.onnx"
        out = output_folder(loaded.path) / name
    require_writable(out, new_folders=True)  # before the work
    if out.suffix == ".npz":
        out.parent.mkdir(parents=True, exist_ok=True)
        save_policy(config.run, out)
    elif config.from_state:
        _write_car(out, loaded, config)
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
    found = [
        _require_alike(
            kind,
            largest_difference(model, loaded, observation),
            rounding_error(loaded, observation),
        )
        for kind, observation in (("of a roll-out", seen), ("drawn at random", random))
    ]
    _write(out, model)
    print("\n".join(found))
    inputs = [(x.name, x.shape, x.meaning) for x in onnx_inputs(loaded.env)]
    Console().print(_table(loaded, inputs, ("batch",)))


def _write_car(out: Path, loaded: LoadedPolicy, config: ExportConfig) -> None:
    """Writes a model that acts in lots like its policy, or none.

    Raises:
        ValueError: it acts otherwise, a car outside cannot make the policy's
            observation, or the lots have more rows than the counts.
    """
    require_outside(loaded.env)
    counts = {name: getattr(config, name) for name in COUNTS}
    rows = environment_rows(loaded.env, counts)
    model = make_car_model(loaded, rows)
    seen = rollout_states(loaded, rows, CHECKED, config.seed)
    session = make_session(model)
    start = time.process_time()
    action = decisions(session, seen)
    spent = (time.process_time() - start) / CHECKED
    observation = seen["observation"]
    difference = differences(action, policy_actions(loaded, observation))
    rounding = np.maximum(
        rounding_error(loaded, observation),
        sensitivity(loaded, rows, seen, config.seed),
    )
    found = _require_alike("of a roll-out", difference, rounding)
    _write(out, model)
    print(f"{found}\n{1e3 * spent:.2f} ms a decision on one core")
    inputs = [(x.name, x.shape(rows), describe(x)) for x in inputs_of(model)]
    Console().print(_table(loaded, inputs, ()))


def _require_alike(
    kind: str, difference: np.ndarray | float, rounding: np.ndarray | float
) -> str:
    """What to print of a model that acts like its policy.

    Args:
        kind: of the observations.
        difference: of actions, the largest or (count,).
        rounding: what float32 costs them, likewise.

    Raises:
        ValueError: it does not.
    """
    difference, rounding = np.broadcast_arrays(difference, rounding)
    most = np.maximum(TOLERANCE, ROUNDING * rounding)
    if not (difference <= most).all():
        k = np.argmax(difference / most)
        raise ValueError(
            f"the model differs from the policy by {difference.flat[k]:.2g} on "
            f"observations {kind}, at most {most.flat[k]:.2g} is allowed: not written"
        )
    return (
        f"largest difference to the policy on {CHECKED:,} observations {kind}: "
        f"{difference.max():.2g}; error of float32: {np.median(rounding):.2g}"
    )


def _write(out: Path, model: Any) -> None:
    out.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(
        out, lambda temporary: temporary.write_bytes(model.SerializeToString())
    )


def environment_rows(env: EnvConfig, counts: Mapping[str, int | None]) -> Rows:
    """The rows of an environment's lots, or more if given.

    Raises:
        ValueError: a lot has more.
    """
    state, _ = jax.eval_shape(ParkingEnv(env).reset, jax.random.key(0))
    least = rows_of(state)
    given = {name: count for name, count in counts.items() if count is not None}
    for name, count in given.items():
        if count < (needed := getattr(least, name)):
            raise ValueError(
                f"{name} must be at least {needed}, as many as the lots of the "
                f"environment have, not {count}"
            )
    return dataclasses.replace(least, **given)


def rollout_states(
    loaded: LoadedPolicy, rows: Rows, count: int, seed: int
) -> dict[str, np.ndarray]:
    """What agents know in held-out lots, (count, *shape) by name of the input.

    With it what they observe, `observation` (count, size).
    """

    def report(step: Step) -> dict[str, jax.Array]:
        known = jax.vmap(lambda state: plain_values(rows, state))(step.before)
        return {**known, **_observation(step)}

    return _drive(loaded, count, seed, report)


def rollout_observations(loaded: LoadedPolicy, count: int, seed: int) -> np.ndarray:
    """Observations (count, size) of agents that a policy drives in held-out lots."""
    return _drive(loaded, count, seed, _observation)["observation"]


def _drive(
    loaded: LoadedPolicy,
    count: int,
    seed: int,
    report: Callable[[Step], dict[str, jax.Array]],
) -> dict[str, np.ndarray]:
    """Reports (LOTS, num_agents, ...) of steps, as (count, ...)."""
    env = ParkingEnv(loaded.env)
    num_steps = -(-count // (LOTS * min(env.config.agent_counts)))

    def run(key: jax.Array) -> dict[str, jax.Array]:
        reset = jax.vmap(lambda key: env.reset(key, "test"))
        start = Carry(*reset(jax.random.split(key, LOTS)))
        keys = jax.random.split(jax.random.key(0), num_steps)  # a model has none
        return roll_out(env, acts(loaded.policy), start, keys, report)[1]

    found = jax.device_get(jax.jit(run)(evaluation_key(seed)))
    seen = {name: x.reshape(-1, *x.shape[3:]) for name, x in found.items()}
    there = np.flatnonzero(seen["observation"].any(axis=-1))  # absent ones see zeros
    chosen = there[np.linspace(0, len(there) - 1, count).astype(int)]
    return {name: x[chosen] for name, x in seen.items()}


def _observation(step: Step) -> dict[str, jax.Array]:
    return {"observation": step.observation}


def _table(
    loaded: LoadedPolicy,
    inputs: Iterable[tuple[str, tuple[int, ...], str]],
    batch: tuple[str, ...],
) -> Table:
    """Inputs (name, shape, meaning) and output of a model."""
    table = Table(title="inputs and output")
    for column in ("name", "shape", "range and meaning"):
        table.add_column(column)
    for name, shape, meaning in inputs:
        table.add_row(name, str((*batch, *shape)), escape(meaning))
    spec = action_spec(loaded.env)
    table.add_section()
    shape = str((*batch, spec.size))
    table.add_row(OUTPUT, shape, escape(describe_action(spec)))
    return table
