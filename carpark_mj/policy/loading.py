"""Loads policies from checkpoints of runs and of policies alone."""

import dataclasses
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial

from carpark_mj.config import EnvConfig
from carpark_mj.config.checks import require_kind
from carpark_mj.config.networks import NetworkConfig
from carpark_mj.mdp.actions import action_spec
from carpark_mj.observations import make_fields
from carpark_mj.observations.fields import ORDERED, Field
from carpark_mj.policy import checkpoints, runs
from carpark_mj.policy.networks import (
    Policy,
    init_normalizer,
    make_finish,
    make_networks,
    make_policy,
    network_inputs,
)
from carpark_mj.precision import require_float32

# Locations of a run, which a checkpoint of a policy alone does not store.
FOLDER_SETTINGS = ("name", "runs_dir", "resume", "warm_start")


@dataclasses.dataclass(frozen=True)
class LoadedPolicy:
    """A policy and the environment it drives in.

    Attributes:
        env: the environment it was trained in, unless another was requested.
        policy: acting function.
        steps: agent steps of its training.
        path: the checkpoint.
        networks: its networks, if it has such.
    """

    env: EnvConfig
    policy: Policy
    steps: int
    path: Path
    networks: NetworkConfig | None = None


def load_policy(
    run: str | Path, deterministic: bool = True, env: EnvConfig | None = None
) -> LoadedPolicy:
    """Loads a pretrained policy, or that of a run folder or checkpoint file.

    Args:
        run: name of a pretrained policy, or a path; a `Path` is never a name.
        deterministic: take a distribution's mode instead of samples.
        env: environment to drive in; None = the environment of its training. A set
            encoder takes any number of cars and other entities, none included.

    Raises:
        CheckpointError: missing, damaged or foreign checkpoint.
        ValueError: the policy does not fit `env`, or JAX computes in float64.
    """
    require_float32()
    require_kind("env", env, EnvConfig | None)
    path, header, own, parameters = read_policy(run)
    env = own if env is None else env
    config = network_config(header)
    _require_fit(run, config, own, env)
    if config is None:
        policy = runs.ALGORITHMS[header["algorithm"]].policy(parameters, header, env)
    else:
        fields, trained = make_fields(env), make_fields(own)
        if _kinds(fields) != _kinds(trained):
            fields = with_empty_sets(trained, fields)
        networks: Any = make_networks(config, fields, action_spec(env))
        normalizer, actor = parameters["normalizer"], parameters["average"]
        finish = make_finish(config, fields, action_spec(env))
        policy = make_policy(networks, normalizer, actor, deterministic, finish)
        policy = _drives_in(env, fields, policy)
    return LoadedPolicy(env, policy, header["env_steps"], path, config)


def save_policy(run: str | Path, out: Path, parameters: Any = None) -> None:
    """Writes a checkpoint of a policy without its training state.

    It holds the normalizer and the averaged actor, or another algorithm's parameters,
    and the run's settings less its folder. `parameters` take the place of the run's.
    """
    _, header, _, own = read_policy(run)
    parameters = own if parameters is None else parameters
    settings = header["config"]
    kept = {name: settings[name] for name in settings if name not in FOLDER_SETTINGS}
    checkpoints.save(out, parameters, header | {"config": kept})


def read_policy(run: str | Path) -> tuple[Path, dict[str, Any], EnvConfig, Any]:
    """Checkpoint of a policy, its header, its environment, its parameters by kind."""
    path = runs.latest_checkpoint(runs.find_policy(run))
    header = checkpoints.read_header(path, env_steps=int, config=dict)
    runs.check_version(header, path)
    with checkpoints.refused_as(f"{path} has an unusable config"):
        env = runs.from_dict(EnvConfig, header["config"]["env"])
        config = network_config(header)
        if config is None:
            template = runs.ALGORITHMS[header["algorithm"]].shapes(header, env)
        else:
            shapes = network_shapes(config, env)
            template = {"normalizer": shapes["normalizer"], "average": shapes["policy"]}
    parameters = checkpoints.load(path, template)
    checkpoints.require_finite(path, parameters)
    return path, header, env, parameters


def network_config(header: dict[str, Any]) -> NetworkConfig | None:
    """Networks of a checkpoint with this header; None if its algorithm has none."""
    if "algorithm" in header:
        return None
    return runs.from_dict(NetworkConfig, header["config"]["networks"])


def network_shapes(config: NetworkConfig, env: EnvConfig) -> dict[str, Any]:
    """Shapes of a run's parameters in an environment: normalizer, policy, value."""
    fields = make_fields(env)
    networks = make_networks(config, fields, action_spec(env))
    return jax.eval_shape(
        lambda: {
            "normalizer": init_normalizer(network_inputs(config, fields)),
            "policy": networks.policy_network.init(jax.random.key(0)),
            "value": networks.value_network.init(jax.random.key(0)),
        }
    )


def _require_fit(
    run: str | Path, config: NetworkConfig | None, own: EnvConfig, env: EnvConfig
) -> None:
    """Refuses an environment with other observations or actions."""
    is_set = config is not None and config.encoder == "set"
    before, now = trained, _ = make_fields(own), make_fields(env)
    if is_set:
        # It has no weights of their own for the others of a kind.
        before, now = (
            [
                x
                for x in with_empty_sets(trained, fields)
                if not x.index or x.group in ORDERED
            ]
            for fields in (before, now)
        )
    if before != now:
        number = "" if is_set else "; only a set encoder takes other numbers of cars"
        raise ValueError(
            f"{run} was trained on other observations than this environment's: "
            f"{_difference(before, now)}{number}"
        )
    require_actions(run, own, env)


def with_empty_sets(before: Sequence[Field], now: Sequence[Field]) -> list[Field]:
    """The fields that a set encoder, trained on some, reads in an environment.

    A kind of entities that the fields `now` lack has one slot, left empty. Kinds come
    in the order of the training's fields, `before`.
    """
    kinds = _kinds((*before, *now))
    slots = {field.group for field in before if field.is_mask} - {*ORDERED}
    found: list[Field] = []
    for kind in kinds:
        own = [field for field in now if field.group == kind]
        if not own and kind in slots:
            own = [field for field in before if field.group == kind and not field.index]
        found += own
    return found


def _kinds(fields: Iterable[Field]) -> list[str]:
    """Kinds of entities in order, "" for fields of none."""
    return list(dict.fromkeys(field.group for field in fields))


def _difference(before: Sequence[Field], now: Sequence[Field]) -> str:
    """What differs between the fields of a training and of an environment."""
    shared = {*_kinds(before)} & {*_kinds(now)}
    trained, here = (
        _counts(fields)
        | {x.name: x.size for x in fields if not x.index and x.group in shared}
        for fields in (before, now)
    )
    found = [
        f"{name} {trained.get(name, 'none')}, here {here.get(name, 'none')}"
        for name in trained | here
        if trained.get(name) != here.get(name)
    ]
    return "; ".join(found) or "fields of other meanings or in another order"


def _counts(fields: Sequence[Field]) -> dict[str, int]:
    """Numbers of entities by kind."""
    return {
        kind: len({field.index for field in fields if field.group == kind})
        for kind in filter(None, _kinds(fields))
    }


def _drives_in(env: EnvConfig, fields: Sequence[Field], policy: Policy) -> Policy:
    """A policy over `fields` for observations of an environment that may lack some."""
    seen = make_fields(env)
    size, names = sum(field.size for field in seen), [field.name for field in seen]
    ends = np.cumsum([field.size for field in seen])
    slots = dict(zip(names, zip([0, *ends], ends, strict=False), strict=True))
    kinds = "".join(f", {count} of {kind}" for kind, count in _counts(seen).items())

    def act(policy: Policy, observation: jax.Array, key: jax.Array) -> Any:
        if observation.shape[-1] != size:
            raise ValueError(
                f"the policy reads {size} numbers{kinds}, not an observation of "
                f"{observation.shape[-1]}: load it with `env`, the environment's config"
            )
        if [field.name for field in fields] != names:
            lead = observation.shape[:-1]
            parts = [
                observation[..., slice(*slots[field.name])]
                if field.name in slots
                else jnp.zeros((*lead, field.size), observation.dtype)
                for field in fields
            ]
            observation = jnp.concatenate(parts, axis=-1)
        return policy(observation, key)

    return Partial(act, policy)


def require_actions(run: str | Path, own: EnvConfig, env: EnvConfig) -> None:
    """Refuses an environment with other actions than a run's `own` has."""
    if action_spec(env) != action_spec(own):
        raise ValueError(
            f"{run} was trained for other actions ({action_spec(own)}) than this "
            f"environment's ({action_spec(env)})"
        )
