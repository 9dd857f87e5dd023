"""Policies as ONNX models: an input for every observation field, the action as output.

A model computes what the deterministic policy computes, normalisation included, for a
batch of any size. Fields of repeated entities become one input with a row for each
entity: `agent_0_position`, `agent_1_position` ... are `agent_position` (batch, count,
2).
"""

import dataclasses
import importlib.util
import logging
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config import EnvConfig
from carpark_mj.mdp.actions import ActionSpec, action_spec
from carpark_mj.observations import Field, make_fields
from carpark_mj.observations.compose import is_picture
from carpark_mj.policy.acting import as_argument
from carpark_mj.policy.loading import LoadedPolicy
from carpark_mj.policy.normalizer import MIN_STD

OUTPUT = "action"
MISSING = 'ONNX export needs jax2onnx and onnxruntime: pip install "carpark_mj[export]"'


@dataclasses.dataclass(frozen=True)
class OnnxInput:
    """An input of a model.

    Attributes:
        name: of the field; of a repeated one without its index.
        fields: the observation's fields that it holds, one for each entity.
    """

    name: str
    fields: tuple[Field, ...]

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape after the batch: (size,), or (count, size) of repeated entities."""
        first = self.fields[0]
        return (len(self.fields), first.size) if first.group else (first.size,)

    @property
    def meaning(self) -> str:
        """Range and meaning, as in docs/mdp.md."""
        first = self.fields[0]
        return f"{first.low:g} … {first.high:g}: {first.meaning}"


def onnx_inputs(config: EnvConfig) -> list[OnnxInput]:
    """Inputs of the models of policies that drive in an environment, in order."""
    found: dict[str, list[Field]] = {}
    for field in make_fields(config):
        name = field.name
        if field.group:
            part = name.removeprefix(f"{field.group}_{field.index}_")
            name = f"{field.group}_{part}"
        found.setdefault(name, []).append(field)
    return [OnnxInput(name, tuple(fields)) for name, fields in found.items()]


def split_observation(
    config: EnvConfig, observation: np.ndarray
) -> dict[str, np.ndarray]:
    """The inputs of a model by name, of observations (batch, size)."""
    fields = make_fields(config)
    ends = np.cumsum([field.size for field in fields])[:-1]
    pieces = np.split(observation.astype(np.float32), ends, axis=-1)
    values = dict(zip((field.name for field in fields), pieces, strict=True))
    return {
        entry.name: np.concatenate(
            [values[field.name] for field in entry.fields], axis=-1
        ).reshape(-1, *entry.shape)
        for entry in onnx_inputs(config)
    }


def join_inputs(config: EnvConfig, *arrays: jax.Array) -> jax.Array:
    """Observations (batch, size) of the inputs of a model, in order."""
    values: dict[str, jax.Array] = {}
    for entry, array in zip(onnx_inputs(config), arrays, strict=True):
        rows = [array[:, i] for i in range(entry.shape[0])]
        parts = rows if entry.fields[0].group else [array]
        names = [field.name for field in entry.fields]
        values |= zip(names, parts, strict=True)
    ordered = [values[field.name] for field in make_fields(config)]
    return jnp.concatenate(ordered, axis=-1)


def require_onnx() -> None:
    """Raises OSError unless the packages of the extra `export` are installed."""
    if not all(map(importlib.util.find_spec, ("jax2onnx", "onnxruntime"))):
        raise OSError(MISSING)


def make_model(loaded: LoadedPolicy) -> Any:
    """The ONNX model (`onnx.ModelProto`) of a deterministic policy.

    Raises:
        OSError: jax2onnx is not installed.
        ValueError: it observes pictures.
    """
    pictures = [field.name for field in make_fields(loaded.env) if is_picture(field)]
    if pictures:
        raise ValueError(
            f"only policies without pictures become ONNX models, not one that observes "
            f"{', '.join(pictures)}"
        )
    require_onnx()
    from jax2onnx import to_onnx

    # It warns that constants have no type, and writes them all the same.
    logging.getLogger("onnx_ir.serde").setLevel(logging.ERROR)
    inputs = onnx_inputs(loaded.env)

    def act(*arrays: jax.Array) -> jax.Array:
        return _act(loaded, join_inputs(loaded.env, *arrays))

    model: Any = to_onnx(
        act,
        inputs=[("batch", *entry.shape) for entry in inputs],
        input_names=[entry.name for entry in inputs],
        output_names=[OUTPUT],
        model_name="carpark_mj",
    )
    for value, entry in zip(model.graph.input, inputs, strict=True):
        value.doc_string = entry.meaning
    model.graph.output[0].doc_string = describe_action(action_spec(loaded.env))
    return model


def describe_action(spec: ActionSpec) -> str:
    """Meaning of the numbers of an action, see docs/mdp.md."""
    parts = ["steer and pedal in [-1, 1]"] if spec.continuous else []
    parts += [f"an index below {count}" for count in spec.choices]
    return ", ".join(parts)


def random_observations(
    config: EnvConfig, typical: np.ndarray, seed: int
) -> np.ndarray:
    """Observations with independent numbers, as many as the typical observations.

    They are uniform within the ranges of the fields and three standard deviations of
    the typical observations.

    Args:
        config: the environment.
        typical: (count, size) observations of a roll-out.
        seed: of the draws.

    Returns:
        (count, size) float32.
    """
    fields, random = make_fields(config), np.random.default_rng(seed)
    low, high = (
        np.concatenate([np.full(field.size, getattr(field, end)) for field in fields])
        for end in ("low", "high")
    )
    if all(field.is_whole for field in fields):
        return random.integers(low, high + 1, typical.shape).astype(np.float32)
    mean = np.clip(typical.mean(axis=0), low, high)
    reach = 3 * np.maximum(typical.std(axis=0), MIN_STD)
    low, high = np.maximum(low, mean - reach), np.minimum(high, mean + reach)
    return random.uniform(low, high, typical.shape).astype(np.float32)


def largest_difference(
    model: Any, loaded: LoadedPolicy, observation: np.ndarray
) -> float:
    """Largest difference between actions of a model in onnxruntime and of its policy.

    Args:
        model: `onnx.ModelProto`.
        loaded: its policy.
        observation: (batch, size).

    Returns:
        The largest difference of any number of an action; inf if one is not finite.
    """
    import onnxruntime

    session: Any = onnxruntime.InferenceSession(model.SerializeToString())
    [found] = session.run(None, split_observation(loaded.env, observation))
    return largest(found, policy_actions(loaded, observation))


def policy_actions(loaded: LoadedPolicy, observation: np.ndarray) -> np.ndarray:
    """Actions (batch, k) of the policy itself; observations (batch, size)."""
    with jax.default_matmul_precision("highest"):  # as onnxruntime, also on GPUs
        return np.asarray(_actions(as_argument(loaded.policy), observation))


def rounding_error(loaded: LoadedPolicy, observation: np.ndarray) -> float:
    """Error of a policy's actions in float32 against the same policy in float64.

    Args:
        loaded: the policy.
        observation: (batch, size).

    Returns:
        The largest difference of any number of an action; inf if one is not finite.
    """
    found, policy = policy_actions(loaded, observation), as_argument(loaded.policy)
    policy, observation = jax.tree.map(_in_float64, (policy, observation))
    with jax.enable_x64(True):
        return largest(found, np.asarray(_actions(policy, observation)))


@jax.jit
def _actions(policy: Any, observation: jax.Array) -> jax.Array:
    """Actions of a deterministic policy that is an argument, see `as_argument`."""
    return policy(observation, jax.random.key(0))[0]


def _in_float64(leaf: Any) -> Any:
    is_float = np.issubdtype(jnp.result_type(leaf), np.floating)
    return np.asarray(leaf, np.float64) if is_float else leaf


def largest(found: np.ndarray, expected: np.ndarray) -> float:
    """The largest difference of any number; inf if one is not finite."""
    return float(differences(found, expected).max())


def differences(found: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """The largest difference (batch,) of actions (batch, size); inf: not finite."""
    difference = np.abs(found.astype(np.float64) - expected)
    return np.where(np.isfinite(difference), difference, np.inf).max(axis=-1)


def _act(loaded: LoadedPolicy, observation: jax.Array) -> jax.Array:
    """Actions of a deterministic policy, whose key is not used."""
    return loaded.policy(observation, jax.random.key(0))[0]
