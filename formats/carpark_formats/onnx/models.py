"""Policies as ONNX models.

`make_model`: an input for every observation field, the action as output, for a batch of
any size. It computes what the deterministic policy computes, normalisation included.
Fields of repeated entities become one input with a row for each entity:
`agent_0_position`, `agent_1_position` ... are `agent_position` (batch, count, 2).

`make_car_model`: with the observation inside, for cars outside the simulator. Its
inputs are those of `carpark_formats.onnx.car.INPUTS` that the policy reads; it has no
batch.
"""

import dataclasses
import json
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from carpark_formats.onnx.car import INPUTS, PlainInput, Rows, sight_of
from carpark_formats.onnx.graph import BATCH
from carpark_formats.onnx.program import make_graph
from carpark_mj.config import EnvConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.mdp.actions import ActionSpec, action_spec
from carpark_mj.observations import ContinuousObservation, Field, make_fields
from carpark_mj.observations.compose import is_picture, join
from carpark_mj.policy.acting import as_argument
from carpark_mj.policy.host import Act, HostPolicy, reading_file
from carpark_mj.policy.loading import LoadedPolicy

OUTPUT = "action"
METADATA = "carpark_mj"  # key of a car model's metadata, as JSON
NUDGES = 32  # with 4, one of 10,000 states of `valet` seemed too certain


@dataclasses.dataclass(frozen=True)
class OnnxInput:
    """An input of a model."""

    name: str  # of the field; of a repeated one without its index
    fields: tuple[Field, ...]  # that it holds, one for each entity

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape after the batch: (size,), or (count, size) of repeated entities."""
        first = self.fields[0]
        return (len(self.fields), first.size) if first.group else (first.size,)

    @property
    def meaning(self) -> str:
        """Range and meaning of the first."""
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
    found: dict[str, np.ndarray] = {}
    for entry in onnx_inputs(config):
        parts = [values[field.name] for field in entry.fields]
        found[entry.name] = np.concatenate(parts, -1).reshape(-1, *entry.shape)
    return found


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


def make_model(loaded: LoadedPolicy) -> Any:
    """The ONNX model (`onnx.ModelProto`) of a deterministic policy without pictures."""
    pictures = [field.name for field in make_fields(loaded.env) if is_picture(field)]
    if pictures:
        raise ValueError(
            f"only policies without pictures become ONNX models, not one that observes "
            f"{', '.join(pictures)}"
        )
    inputs = {entry.name: entry for entry in onnx_inputs(loaded.env)}

    def act(*arrays: jax.Array) -> dict[str, jax.Array]:
        observation = join_inputs(loaded.env, *arrays)
        return {OUTPUT: loaded.policy(observation, jax.random.key(0))[0]}

    form, number = jax.ShapeDtypeStruct, jnp.float32
    forms = {name: form((BATCH, *x.shape), number) for name, x in inputs.items()}
    model = make_graph(act, forms)
    for value in model.graph.input:
        value.doc_string = inputs[value.name].meaning
    model.graph.output[0].doc_string = describe_action(action_spec(loaded.env))
    return model


def describe_action(spec: ActionSpec) -> str:
    """Meaning of the numbers of an action."""
    parts = ["steer and pedal in [-1, 1]"] if spec.continuous else []
    parts += [f"an index below {count}" for count in spec.choices]
    return ", ".join(parts)


def model_differences(
    model: Any, loaded: LoadedPolicy, observation: np.ndarray
) -> np.ndarray:
    """Differences (batch,) between actions of a model in onnxruntime and its policy's.

    The largest of any number of an action; inf if one is not finite.
    """
    inputs = split_observation(loaded.env, observation)
    [found] = make_session(model).run(None, inputs)
    return differences(found, policy_actions(loaded, observation))


def policy_actions(loaded: LoadedPolicy, observation: np.ndarray) -> np.ndarray:
    """Actions (batch, k) of the policy itself; observations (batch, size)."""
    with jax.default_matmul_precision("highest"):  # as onnxruntime, also on GPUs
        return np.asarray(_actions(as_argument(loaded.policy), observation))


HALF_ULP = 2.0**-24  # of float32, relative
MOVES = 4  # of each observation


def rounding_error(loaded: LoadedPolicy, observation: np.ndarray) -> float:
    """What float32 costs a policy's actions: against the same policy in float64.

    The largest difference of any number of an action, but in `ties`; inf if one is not
    finite. It is the error of the actions, or what moving observations by half of
    float32's spacing changes in them: where that is much, another order of sums gives
    another error. Whole numbers (flags, indices) are exact and are not moved.
    """

    def in_float64(leaf: Any) -> Any:
        is_float = np.issubdtype(jnp.result_type(leaf), np.floating)
        return np.asarray(leaf, np.float64) if is_float else leaf

    found, policy = policy_actions(loaded, observation), as_argument(loaded.policy)
    policy, observation = jax.tree.map(in_float64, (policy, observation))
    sign = np.random.default_rng(0).choice([-1.0, 1.0], (MOVES, *observation.shape))
    sign *= observation != np.round(observation)
    with jax.enable_x64(True):
        exact = np.asarray(_actions(policy, observation))
        moved = [_actions(policy, observation * (1.0 + x * HALF_ULP)) for x in sign]
    actions, share = (found, *moved), 1.0 - ties(loaded)
    lost = [differences(np.asarray(x), exact) for x in actions]
    return max(np.quantile(x, share, method="lower") for x in lost)


TIES = 0.002  # share of observations


def ties(loaded: LoadedPolicy) -> float:
    """Share of observations in which float32 may decide between two of `bins`."""
    return TIES if loaded.networks and loaded.networks.bins else 0.0


@jax.jit
def _actions(policy: Any, observation: jax.Array) -> jax.Array:
    """Actions of a deterministic policy that is an argument, see `as_argument`."""
    return policy(observation, jax.random.key(0))[0]


def differences(found: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """The largest difference (batch,) of actions (batch, size); inf: not finite."""
    difference = np.abs(found.astype(np.float64) - expected)
    return np.where(np.isfinite(difference), difference, np.inf).max(axis=-1)


def require_outside(config: EnvConfig) -> None:
    """Refuses observations that a car outside cannot make, by name."""
    encoder = config.observation
    if not isinstance(encoder, ContinuousObservation):
        raise ValueError(
            f"the encoding {encoder.encoding!r} reads the whole state of the lot, "
            "and a car outside knows only a part: export without --from-state"
        )
    pictures = [field.name for field in encoder.fields(config) if field.shape]
    noise = encoder.ultrasound.noise if encoder.ultrasound.on else 0.0
    for given, what in (
        ("rings" in encoder.init_memory(config), "past counts (rings.history)"),
        (pictures, f"pictures ({', '.join(pictures)})"),
        (noise, f"ultrasound with noise (ultrasound.noise {noise})"),
    ):
        if given:
            raise ValueError(
                f"the policy observes {what}, which is no input of a car outside: "
                "export without --from-state"
            )


def make_car_model(loaded: LoadedPolicy, rows: Rows) -> Any:
    """The ONNX model (`onnx.ModelProto`) of a policy and its observation."""
    require_outside(loaded.env)
    inputs = {x.name: jax.ShapeDtypeStruct(x.shape(rows), x.dtype) for x in INPUTS}

    def act(*arrays: jax.Array) -> dict[str, jax.Array]:
        given = dict(zip(inputs, arrays, strict=True))
        return {OUTPUT: decide(loaded, rows, given)[0]}

    model = make_graph(act, inputs)
    read = inputs_of(model)
    for value, entry in zip(model.graph.input, read, strict=True):
        value.doc_string = describe(entry)
    spec = action_spec(loaded.env)
    meaning = model.graph.output[0].doc_string = describe_action(spec)
    taken = [dataclasses.asdict(x) | {"dims": x.shape(rows)} for x in read]
    about = {
        "inputs": taken,
        "output": {"name": OUTPUT, "dims": [spec.size], "meaning": meaning},
        "frame": "world, counter-clockwise yaw from +x",
        "decision_time": loaded.env.sim.ctrl_dt,
    }
    model.metadata_props.add(key=METADATA, value=json.dumps(about))
    return model


def decide(
    loaded: LoadedPolicy, rows: Rows, given: dict[str, jax.Array]
) -> tuple[jax.Array, jax.Array]:
    """Action and observation of a car that gives all of `INPUTS`."""
    sight, encoder = sight_of(rows, given), loaded.env.observation
    assert isinstance(encoder, ContinuousObservation)
    observation = join(loaded.env, encoder.see(loaded.env, sight), 1)
    return loaded.policy(observation, jax.random.key(0))[0][0], observation[0]


def sensitivity(
    loaded: LoadedPolicy, rows: Rows, known: dict[str, np.ndarray], seed: int
) -> np.ndarray:
    """What float32 may cost the actions of a model in each state (count,).

    The observation is computed by cancelling sums, so that it depends on the order of
    operations by more than its own last place. Hence the most that an action changes,
    of `NUDGES` times in which each input is off by one unit in its last place. Inputs
    `known` are (count, *shape) by name; those that are missing are 0.
    """
    count = len(next(iter(known.values())))
    given = {
        x.name: known.get(x.name, np.zeros((count, *x.shape(rows)), x.dtype))
        for x in INPUTS
    }
    act = jax.jit(jax.vmap(lambda values: decide(loaded, rows, values)[0]))
    expected, random = np.asarray(act(given)), np.random.default_rng(seed)

    def nudged(value: np.ndarray) -> np.ndarray:
        if value.dtype != np.float32:
            return value
        way = random.choice(np.array([-np.inf, np.inf], np.float32), value.shape)
        return np.nextafter(value, way)

    actions = (np.asarray(act(jax.tree.map(nudged, given))) for _ in range(NUDGES))
    return np.max([differences(x, expected) for x in actions], axis=0)


def inputs_of(model: Any) -> list[PlainInput]:
    """Entries of `INPUTS` that a model takes, in order."""
    names = {value.name for value in model.graph.input}
    return [entry for entry in INPUTS if entry.name in names]


def describe(entry: PlainInput) -> str:
    """Unit and meaning of an input."""
    return f"{entry.meaning} [{entry.unit}]" if entry.unit else entry.meaning


def make_session(model: Any) -> Any:
    """Runs a model, or one in a file, on one core (`onnxruntime.InferenceSession`)."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    model = model if isinstance(model, str) else model.SerializeToString()
    return onnxruntime.InferenceSession(model, options)


def decisions(session: Any, values: dict[str, np.ndarray]) -> np.ndarray:
    """Actions (count, size) of a model for inputs (count, *shape) by name."""
    names = [value.name for value in session.get_inputs()]
    count = len(values[names[0]])
    rows = ({name: values[name][k, ...] for name in names} for k in range(count))
    return np.stack([session.run(None, row)[0] for row in rows])


def from_onnx(path: str | Path, env: EnvConfig | str | None = None) -> HostPolicy:
    """A policy from an ONNX model, whose first output is the action.

    Its inputs are those of `carpark_mj export`, an input for every field, or one with
    whole observations (batch, size).

    Raises:
        ValueError: onnxruntime cannot read it.
    """
    with reading_file(path) as file:
        session = make_session(file)
    names = [entry.name for entry in session.get_inputs()]

    def bind(env: ParkingEnv) -> Act:
        def act(observation: Any) -> np.ndarray:
            parts = {names[0]: observation}
            if len(names) > 1:
                parts = split_observation(env.config, observation)
            return session.run(None, {name: parts[name] for name in names})[0]

        return act

    return HostPolicy(Path(path).stem, bind, env)
