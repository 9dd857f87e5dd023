"""Warm starts: a training that begins with the networks of another run.

Its actor begins as the averaged policy, the one that is evaluated. A pretrained policy
has no critic: a new one learns first.
"""

import dataclasses
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

from carpark_mj.config import EnvConfig
from carpark_mj.mdp.actions import action_spec
from carpark_mj.observations import make_fields
from carpark_mj.policy import checkpoints
from carpark_mj.policy.loading import load_policy, network_config
from carpark_mj.policy.networks import make_networks, network_inputs
from carpark_mj.policy.normalizer import init_normalizer
from carpark_mj.policy.pretrained import describe_names, find_policy
from carpark_mj.training.ppo.config import PPOConfig
from carpark_mj.training.ppo.state import TrainingState
from carpark_mj.training.ppo.widening import new_fields, widen

# What a run takes over; optimizer, schedules, lots and counters are its own.
TAKEN = ("normalizer", "average", "value")
ALONE = ("normalizer", "average")  # what a policy without a critic has


def require_run(config: PPOConfig) -> None:
    """Refuses a warm start from what is no run, or has other networks.

    Raises:
        CheckpointError: the run has no checkpoint.
        ValueError: there is nothing of that name, or no critic in it while one is
            needed, or its networks are others.
    """
    if not config.warm_start:
        return
    if not find_policy(config.warm_start).exists():
        raise ValueError(
            "warm_start must be the folder or a checkpoint of a run, or a pretrained "
            f"policy ({describe_names()}), not {config.warm_start!r}"
        )
    path = load_policy(config.warm_start).path
    if not config.critic_steps and not _has_critic(path):
        raise ValueError(
            f"{config.warm_start} is a policy without a critic: give critic_steps, in "
            "which only a new critic learns, for example 5000000"
        )
    theirs = network_config(checkpoints.read_header(path))
    if theirs is None:
        raise ValueError(
            f"{config.warm_start} has tables of Q-learning: a warm start needs networks"
        )
    names = ["encoder", "policy_layers"]
    if config.networks.encoder == "set":
        names += ["own_size", "entity_size", "picture_size"]
    if _has_critic(path):
        names.append("value_layers")
    for name in names:
        own, other = getattr(config.networks, name), getattr(theirs, name)
        if own != other:
            raise ValueError(
                f"{config.warm_start} has networks.{name} {other}, not {own}: a warm "
                "start needs the same"
            )


def _has_critic(path: Path) -> bool:
    """Whether a checkpoint is a training's, not that of a policy alone."""
    return any(name.startswith("['value']") for name in checkpoints.names(path))


def warm_start(config: PPOConfig, state: TrainingState) -> TrainingState:
    """A state before the first update, with networks of the run `warm_start`.

    Where agents observe more than those of that run, see `widen`.

    Args:
        config: of the training.
        state: as it would begin otherwise.

    Raises:
        CheckpointError: the run has no checkpoint, or other networks.
        ValueError: its agents do something else, or observe what ours do not.
    """
    run = load_policy(config.warm_start)
    taken = TAKEN if _has_critic(run.path) else ALONE
    if not new_fields(config, run.env):
        path = load_policy(config.warm_start, env=config.env).path
        template = {name: getattr(state, name) for name in taken}
        return _replace(state, _load(path, template))
    if action_spec(run.env) != action_spec(config.env):
        raise ValueError(
            f"{config.warm_start} was trained for other actions "
            f"({action_spec(run.env)}) than this environment's "
            f"({action_spec(config.env)})"
        )
    template = _template(config, run.env)
    found = _load(run.path, {name: template[name] for name in taken})
    return _replace(state, widen(config, run.env, found, vars(state)))


def _load(path: Path, template: dict[str, Any]) -> dict[str, Any]:
    """The parameters of a checkpoint, all of them finite."""
    found = checkpoints.load(path, template)
    checkpoints.require_finite(path, found)
    return found


def _replace(state: TrainingState, found: dict[str, Any]) -> TrainingState:
    """The state with what was found, and the averaged policy as actor as well."""
    # A copy: an update takes over the memory of both.
    actor = jax.tree.map(jnp.copy, found["average"])
    return dataclasses.replace(state, policy=actor, **found)


def _template(config: PPOConfig, env: EnvConfig) -> dict[str, Any]:
    """Shapes of what is taken from a run in `env` with the networks of `config`."""
    fields = make_fields(env)
    networks = make_networks(config.networks, fields, action_spec(env))

    def init() -> dict[str, Any]:
        return {
            "normalizer": init_normalizer(network_inputs(config.networks, fields)),
            "average": networks.policy_network.init(jax.random.key(0)),
            "value": networks.value_network.init(jax.random.key(0)),
        }

    return jax.eval_shape(init)
