"""Loads policies from checkpoints of runs and of policies alone."""

import dataclasses
import math
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config import EnvConfig
from carpark_mj.config.checks import require_count, require_kind
from carpark_mj.mdp.actions import action_spec
from carpark_mj.observations import Field, cardinalities, make_fields, observation_size
from carpark_mj.observations.fields import ORDERED
from carpark_mj.policy import checkpoints
from carpark_mj.policy.checkpoints import CheckpointError
from carpark_mj.policy.networks import (
    NetworkConfig,
    Policy,
    make_networks,
    make_policy,
    network_inputs,
)
from carpark_mj.policy.normalizer import init_normalizer
from carpark_mj.policy.pretrained import find_policy
from carpark_mj.policy.q_table import make_table_policy
from carpark_mj.policy.runs import (
    Q_LEARNING,
    check_version,
    from_dict,
    latest_checkpoint,
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
    """

    env: EnvConfig
    policy: Policy
    steps: int
    path: Path


def load_policy(
    run: str | Path, deterministic: bool = True, env: EnvConfig | None = None
) -> LoadedPolicy:
    """Loads a pretrained policy, or that of a run folder or checkpoint file.

    For Q-learning it is the table with the highest return in the last episodes before
    the checkpoint; tables are always deterministic.

    Args:
        run: name of a pretrained policy, or a path; a `Path` is never a name.
        deterministic: take a distribution's mode instead of samples.
        env: environment to drive in; None = the environment of its training.

    Raises:
        CheckpointError: missing, damaged or foreign checkpoint.
        ValueError: the policy does not fit `env`, or JAX computes in float64.
        TypeError: `run` or `env` has another type.
    """
    require_float32()
    require_kind("env", env, EnvConfig | None)
    path = latest_checkpoint(find_policy(run))
    header = checkpoints.read_header(path, env_steps=int, config=dict)
    own, parameters = _read(path, header)
    env = own if env is None else env
    config = network_config(header)
    _require_fit(run, config, own, env)
    if config is None:
        table = jnp.asarray(parameters["table"][header["best"]])
        policy = make_table_policy(table, cardinalities(env), action_spec(env).choices)
    else:
        networks = make_networks(config, make_fields(env), action_spec(env))
        normalizer, actor = parameters["normalizer"], parameters["average"]
        policy = make_policy(networks, normalizer, actor, deterministic)
    return LoadedPolicy(env, policy, header["env_steps"], path)


def save_policy(run: str | Path, out: Path) -> None:
    """Writes a checkpoint of a policy without its training state.

    It holds the normalizer and the averaged actor (or the tables of Q-learning), and
    the settings of the run less its folder.

    Raises:
        CheckpointError: missing, damaged or foreign checkpoint.
        OSError: `out` cannot be written.
    """
    path = latest_checkpoint(find_policy(run))
    header = checkpoints.read_header(path, env_steps=int, config=dict)
    _, parameters = _read(path, header)
    settings = header["config"]
    kept = {name: settings[name] for name in settings if name not in FOLDER_SETTINGS}
    checkpoints.save(out, parameters, header | {"config": kept})


def _read(path: Path, header: dict[str, Any]) -> tuple[EnvConfig, Any]:
    """The environment a policy was trained in, and its parameters by kind.

    Raises:
        CheckpointError: damaged or foreign checkpoint.
    """
    check_version(header, path)
    try:
        env = from_dict(EnvConfig, header["config"]["env"])
        template = _template(header, env)
    except KeyError as error:
        raise CheckpointError(f"{path} has no setting {error}") from None
    except (TypeError, ValueError) as error:
        raise CheckpointError(f"{path} has an unusable config: {error}") from None
    parameters = checkpoints.load(path, template)
    checkpoints.require_finite(path, parameters)
    return env, parameters


def network_config(header: dict[str, Any]) -> NetworkConfig | None:
    """Networks of a checkpoint with this header; None for the tables of Q-learning."""
    if header.get("algorithm") == Q_LEARNING:
        return None
    return from_dict(NetworkConfig, header["config"]["networks"])


def _template(header: dict[str, Any], env: EnvConfig) -> dict[str, Any]:
    """Shapes of a policy's parameters by kind."""
    config = network_config(header)
    if config is None:
        states = math.prod(cardinalities(env))
        actions = math.prod(action_spec(env).choices)
        num_seeds = header["config"]["num_seeds"]
        require_count("num_seeds", num_seeds, 1)
        require_count("best", header["best"], 0)
        if header["best"] >= num_seeds:
            raise ValueError(f"best must be below {num_seeds}, not {header['best']}")
        shape = (num_seeds, states, actions)
        return {"table": jax.ShapeDtypeStruct(shape, np.float32)}
    fields = make_fields(env)
    networks = make_networks(config, fields, action_spec(env))
    return jax.eval_shape(
        lambda: {
            "normalizer": init_normalizer(network_inputs(config, fields)),
            "average": networks.policy_network.init(jax.random.key(0)),
        }
    )


def _require_fit(
    run: str | Path, config: NetworkConfig | None, own: EnvConfig, env: EnvConfig
) -> None:
    """Refuses an environment with other observations or actions.

    Raises:
        ValueError: actions differ, or observations do; a set encoder accepts other
            numbers of cars, a flat network or a table accepts no difference.
    """
    is_set = config is not None and config.encoder == "set"
    before, now = (
        [field for field in make_fields(each) if not is_set or _has_own_weights(field)]
        for each in (own, env)
    )
    if before != now:
        number = "" if is_set else "; only a set encoder takes other numbers of cars"
        raise ValueError(
            f"{run} was trained on other observations ({observation_size(own)} "
            f"numbers) than this environment's ({observation_size(env)}){number}"
        )
    if action_spec(env) != action_spec(own):
        raise ValueError(
            f"{run} was trained for other actions ({action_spec(own)}) than this "
            f"environment's ({action_spec(env)})"
        )


def _has_own_weights(field: Field) -> bool:
    """Whether a set encoder has weights for this field alone."""
    return field.index == 0 or field.group in ORDERED
