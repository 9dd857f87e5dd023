"""Policies as ONNX models with the observation inside, for cars outside the simulator.

The inputs are those of `INPUTS` that the policy reads, the output is the action. The
observation is the environment's own program, translated by `onnx_program`.
"""

import dataclasses
import json
from typing import Any

import jax
import numpy as np

from carpark_mj.config import EnvConfig
from carpark_mj.mdp.actions import action_spec
from carpark_mj.observations import ContinuousObservation
from carpark_mj.observations.compose import join
from carpark_mj.policy.loading import LoadedPolicy
from carpark_mj.policy.onnx_export import OUTPUT, describe_action, differences
from carpark_mj.policy.onnx_program import make_graph
from carpark_mj.policy.outside import sight_of
from carpark_mj.policy.plain_inputs import INPUTS, PlainInput, Rows

METADATA = "carpark_mj"  # key of the model's metadata, as JSON
NUDGES = 4


def require_outside(config: EnvConfig) -> None:
    """Refuses observations that a car outside cannot make.

    Raises:
        ValueError: naming the observation.
    """
    encoder = config.observation
    if not isinstance(encoder, ContinuousObservation):
        raise ValueError(
            f"the encoding {encoder.encoding!r} reads the whole state of the lot, "
            "and a car outside knows only a part: export without --from-state"
        )
    if encoder.init_memory(config) is not None:
        raise ValueError(
            "the policy observes the past (rings.history), but a model has no memory: "
            "export without --from-state"
        )
    if encoder.tracked_movers:
        raise ValueError(
            "the policy observes people and other movers with their velocities "
            f"(tracked_movers {encoder.tracked_movers}), which are no inputs of a car "
            "outside: export without --from-state"
        )
    if pictures := [field.name for field in encoder.fields(config) if field.shape]:
        raise ValueError(
            f"the policy observes pictures ({', '.join(pictures)}), which a car "
            "outside takes with its cameras: export without --from-state"
        )
    if encoder.ultrasound.on and encoder.ultrasound.noise:
        raise ValueError(
            "the policy observes ultrasound with noise (ultrasound.noise "
            f"{encoder.ultrasound.noise}), which a model does not draw: export without "
            "--from-state"
        )


def make_car_model(loaded: LoadedPolicy, rows: Rows) -> Any:
    """The ONNX model (`onnx.ModelProto`) of a policy and its observation.

    Raises:
        ValueError: a car outside cannot make the observation.
    """
    require_outside(loaded.env)
    inputs = {x.name: jax.ShapeDtypeStruct(x.shape(rows), x.dtype) for x in INPUTS}

    def act(*arrays: jax.Array) -> dict[str, jax.Array]:
        given = dict(zip(inputs, arrays, strict=True))
        return {OUTPUT: decide(loaded, rows, given)[0]}

    model = make_graph(act, inputs)
    read = inputs_of(model)
    for value, entry in zip(model.graph.input, read, strict=True):
        value.doc_string = describe(entry)
    model.graph.output[0].doc_string = describe_action(action_spec(loaded.env))
    entry = model.metadata_props.add()
    entry.key, entry.value = METADATA, json.dumps(_about(loaded, rows, read))
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
    """What float32 may cost the actions of a model in each of `count` states.

    The observation is computed by cancelling sums, so that it depends on the order of
    operations by more than its own last place.

    Args:
        loaded: the policy.
        rows: of the model.
        known: inputs (count, *shape) by name; those that are missing are 0.
        seed: of the directions in which the inputs are off.

    Returns:
        (count,) the most that an action changes, of `NUDGES` times in which each input
        is off by one unit in its last place.
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

    return np.max(
        [
            differences(np.asarray(act(jax.tree.map(nudged, given))), expected)
            for _ in range(NUDGES)
        ],
        axis=0,
    )


def inputs_of(model: Any) -> list[PlainInput]:
    """Those of `INPUTS` that a model takes, in order."""
    names = {value.name for value in model.graph.input}
    return [entry for entry in INPUTS if entry.name in names]


def describe(entry: PlainInput) -> str:
    """Unit and meaning of an input."""
    return f"{entry.meaning} [{entry.unit}]" if entry.unit else entry.meaning


def _about(loaded: LoadedPolicy, rows: Rows, read: list[PlainInput]) -> dict[str, Any]:
    """The metadata of a model."""
    spec = action_spec(loaded.env)
    return {
        "inputs": [
            {**dataclasses.asdict(entry), "dims": entry.shape(rows)} for entry in read
        ],
        "output": {
            "name": OUTPUT,
            "dims": [spec.size],
            "meaning": describe_action(spec),
        },
        "frame": "world, counter-clockwise yaw from +x",
        "decision_time": loaded.env.sim.ctrl_dt,
    }


def make_session(model: Any) -> Any:
    """Runs a model on one core (`onnxruntime.InferenceSession`)."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    return onnxruntime.InferenceSession(model.SerializeToString(), options)


def decisions(session: Any, values: dict[str, np.ndarray]) -> np.ndarray:
    """Actions (count, size) of a model for inputs (count, *shape) by name."""
    names = [value.name for value in session.get_inputs()]
    count = len(values[names[0]])
    return np.stack(
        [
            session.run(None, {n: values[n][k, ...] for n in names})[0]
            for k in range(count)
        ]
    )
