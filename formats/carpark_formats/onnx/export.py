"""`carpark_mj export`: a policy as an ONNX model or a checkpoint."""

import dataclasses
import functools
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from carpark_formats.onnx import models
from carpark_formats.onnx.car import Rows, plain_values, rows_of
from carpark_formats.settings import COUNTS, OnnxConfig
from carpark_mj.cli.clock import COMPILING, doing
from carpark_mj.cli.driver import export, output_folder
from carpark_mj.config import EnvConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.evaluation.keys import evaluation_key
from carpark_mj.evaluation.tables import print_rows
from carpark_mj.files import require_writable, write_atomically
from carpark_mj.mdp.actions import action_spec
from carpark_mj.policy.acting import Carry, Step, acts, roll_out
from carpark_mj.policy.loading import LoadedPolicy, load_policy
from carpark_mj.types import State

# Most that numbers of an action of a model and of its policy may differ by. Where
# float32 itself is not as good as that, twice its error: both are computed in it.
TOLERANCE = 1e-5
ROUNDING = 2.0
CHECKED = 10_000  # observations that are compared
LOTS = 16  # of the roll-out


class Model(NamedTuple):
    """A model that acts like its policy."""

    proto: Any  # `onnx.ModelProto`
    found: list[str]  # what comparing the two has shown, in sentences
    inputs: list[tuple[str, tuple[int, ...], str]]  # name, shape and meaning
    batch: tuple[str, ...]  # dimensions before these shapes


def main(config: OnnxConfig) -> Path:
    """Exports, checks and writes; returns the file."""
    if config.out.endswith(".npz"):
        return export(config)
    loaded, out = load_policy(config.run), Path(config.out)
    if not config.out:
        name = "car.onnx" if config.from_state else "policy.onnx"
        out = output_folder(loaded.path) / name
    require_writable(out, new_folders=True)  # before the work
    make = _car_model if config.from_state else _model
    doing(COMPILING)
    model = make(loaded, config)
    out.parent.mkdir(parents=True, exist_ok=True)
    data = model.proto.SerializeToString()
    write_atomically(out, lambda temporary: temporary.write_bytes(data))
    print("\n".join(model.found))
    spec = action_spec(loaded.env)
    output = models.OUTPUT, (spec.size,), models.describe_action(spec)
    rows = [
        {"name": x, "shape": (*model.batch, *shape), "range and meaning": meaning}
        for x, shape, meaning in [*model.inputs, output]
    ]
    print_rows(rows, "inputs and output", ends={len(rows) - 2})
    print(f"wrote {out}: {out.stat().st_size / 1e6:.2f} MB")
    return out


def _model(loaded: LoadedPolicy, config: OnnxConfig) -> Model:
    """The model of a policy, for a batch of observations."""
    proto = models.make_model(loaded)
    seen = rollout(loaded, CHECKED, config.seed)["observation"]
    difference = models.model_differences(proto, loaded, seen)
    found = _require_alike(loaded, difference, models.rounding_error(loaded, seen))
    inputs = [(x.name, x.shape, x.meaning) for x in models.onnx_inputs(loaded.env)]
    return Model(proto, [found], inputs, ("batch",))


def _car_model(loaded: LoadedPolicy, config: OnnxConfig) -> Model:
    """The model of a policy and its observation, for a car outside the simulator."""
    counts = {name: getattr(config, name) for name in COUNTS}
    rows = environment_rows(loaded.env, counts)
    proto = models.make_car_model(loaded, rows)
    seen = rollout(loaded, CHECKED, config.seed, rows)
    session = models.make_session(proto)
    start = time.process_time()
    action = models.decisions(session, seen)
    spent = (time.process_time() - start) / CHECKED
    observation = seen["observation"]
    rounding = np.maximum(
        models.rounding_error(loaded, observation),
        models.sensitivity(loaded, rows, seen, config.seed),
    )
    expected = models.policy_actions(loaded, observation)
    difference = models.differences(action, expected)
    found = [_require_alike(loaded, difference, rounding)]
    found.append(f"{1e3 * spent:.2f} ms a decision on one core")
    taken, describe = models.inputs_of(proto), models.describe
    inputs = [(x.name, x.shape(rows), describe(x)) for x in taken]
    return Model(proto, found, inputs, ())


def _require_alike(
    loaded: LoadedPolicy, difference: np.ndarray, rounding: np.ndarray | float
) -> str:
    """What to print of a model that acts like its policy; refuses any other.

    The `difference` of actions is (count,), what `rounding` costs them that or ().
    """
    difference, rounding = np.broadcast_arrays(difference, rounding)
    most = np.maximum(TOLERANCE, ROUNDING * rounding)
    alike = difference <= most
    if (~alike).mean() > models.ties(loaded):
        k = np.argmax(difference / most)
        raise ValueError(
            f"the model differs from the policy by {difference.flat[k]:.2g} on "
            "observations of a roll-out, at most "
            f"{most.flat[k]:.2g} is allowed: not written"
        )
    text = (
        f"largest difference to the policy on {CHECKED:,} observations of a roll-out: "
        f"{difference[alike].max():.2g}; error of float32: {np.median(rounding):.2g}"
    )
    if not alike.all():
        text += f"; float32 decides between two values in {(~alike).sum()} more"
    return text


def environment_rows(env: EnvConfig, counts: Mapping[str, int | None]) -> Rows:
    """The rows of an environment's lots, or more if given; fewer are refused."""
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


def _known(config: EnvConfig, rows: Rows, state: State) -> dict[str, jax.Array]:
    return plain_values(rows, state, config.observation.known(config, state))


def rollout(
    loaded: LoadedPolicy, count: int, seed: int, rows: Rows | None = None
) -> dict[str, np.ndarray]:
    """What agents see in held-out lots that a policy drives in: `observation`.

    It is (count, size); with `rows` also what they know, (count, *shape) by input.
    """
    env = ParkingEnv(loaded.env)
    num_steps = -(-count // (LOTS * min(env.config.agent_counts)))

    def report(step: Step) -> dict[str, jax.Array]:
        known: dict[str, jax.Array] = {}
        if rows is not None:
            known = jax.vmap(functools.partial(_known, env.config, rows))(step.before)
        return known | {"observation": step.observation}

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
