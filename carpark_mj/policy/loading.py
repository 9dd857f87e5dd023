"""Loads policies from checkpoints of runs and of policies alone."""

import dataclasses
from pathlib import Path
from typing import Any, Protocol

import jax

from carpark_mj.config import EnvConfig
from carpark_mj.config.checks import require_kind
from carpark_mj.mdp.actions import action_spec
from carpark_mj.observations import make_fields, observation_size
from carpark_mj.observations.fields import ORDERED
from carpark_mj.policy import checkpoints
from carpark_mj.policy.networks import (
    NetworkConfig,
    Policy,
    init_normalizer,
    make_networks,
    make_policy,
    network_inputs,
)
from carpark_mj.policy.runs import (
    ALGORITHMS,
    check_version,
    find_policy,
    from_dict,
    latest_checkpoint,
)
from carpark_mj.precision import require_float32

# Locations of a run, which a checkpoint of a policy alone does not store.
FOLDER_SETTINGS = ("name", "runs_dir", "resume", "warm_start")


class Algorithm(Protocol):
    """How checkpoints become policies whose header has this `algorithm`."""

    def shapes(self, header: dict[str, Any], env: EnvConfig) -> dict[str, Any]:
        """Shapes of a policy's parameters by kind."""
        ...

    def policy(self, parameters: Any, header: dict[str, Any], env: EnvConfig) -> Policy:
        """The policy of parameters, in an environment."""
        ...


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
    path, header, own, parameters = _read(run)
    env = own if env is None else env
    config = network_config(header)
    _require_fit(run, config, own, env)
    if config is None:
        algorithm: Algorithm = ALGORITHMS[header["algorithm"]]
        policy = algorithm.policy(parameters, header, env)
    else:
        networks = make_networks(config, make_fields(env), action_spec(env))
        normalizer, actor = parameters["normalizer"], parameters["average"]
        policy = make_policy(networks, normalizer, actor, deterministic)
    return LoadedPolicy(env, policy, header["env_steps"], path)


def save_policy(run: str | Path, out: Path) -> None:
    """Writes a checkpoint of a policy without its training state.

    It holds the normalizer and the averaged actor, or the parameters of another
    algorithm, and the settings of the run less its folder.

    Raises:
        CheckpointError: missing, damaged or foreign checkpoint.
        OSError: `out` cannot be written.
    """
    _, header, _, parameters = _read(run)
    settings = header["config"]
    kept = {name: settings[name] for name in settings if name not in FOLDER_SETTINGS}
    checkpoints.save(out, parameters, header | {"config": kept})


def _read(run: str | Path) -> tuple[Path, dict[str, Any], EnvConfig, Any]:
    """Checkpoint of a policy, its header, its environment, its parameters by kind."""
    path = latest_checkpoint(find_policy(run))
    header = checkpoints.read_header(path, env_steps=int, config=dict)
    check_version(header, path)
    with checkpoints.refused_as(f"{path} has an unusable config"):
        env = from_dict(EnvConfig, header["config"]["env"])
        config = network_config(header)
        if config is None:
            template = ALGORITHMS[header["algorithm"]].shapes(header, env)
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
    return from_dict(NetworkConfig, header["config"]["networks"])


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
    before, now = (
        [
            field
            for field in make_fields(each)
            # A set encoder has no weights of their own for the others of a kind.
            if not is_set or field.index == 0 or field.group in ORDERED
        ]
        for each in (own, env)
    )
    if before != now:
        number = "" if is_set else "; only a set encoder takes other numbers of cars"
        raise ValueError(
            f"{run} was trained on other observations ({observation_size(own)} "
            f"numbers) than this environment's ({observation_size(env)}){number}"
        )
    require_actions(run, own, env)


def require_actions(run: str | Path, own: EnvConfig, env: EnvConfig) -> None:
    """Refuses an environment with other actions than a run's `own` has."""
    if action_spec(env) != action_spec(own):
        raise ValueError(
            f"{run} was trained for other actions ({action_spec(own)}) than this "
            f"environment's ({action_spec(env)})"
        )
