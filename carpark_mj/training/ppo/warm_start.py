"""What a training takes from other policies: networks to begin with, a teacher.

*Warm starts.* The actor begins as the averaged policy of another run, the one that is
evaluated. A pretrained policy has no critic: a new one learns first. Agents may observe
more, see `carpark_mj.policy.widening`.

*Teachers.* As in DAgger (Ross et al. 2011) the learner drives, so that it learns what
to do where it gets to itself; as in kickstarting (Schmitt et al. 2018) the imitation is
a term of the loss that ends, while the reward is learned from all along.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

from carpark_mj.mdp.actions import action_spec
from carpark_mj.observations import observe
from carpark_mj.policy import checkpoints
from carpark_mj.policy.loading import (
    load_policy,
    network_config,
    network_shapes,
    require_actions,
)
from carpark_mj.policy.runs import find_policy
from carpark_mj.policy.widening import Trained, new_fields, widen
from carpark_mj.pretrained import describe_names
from carpark_mj.training.ppo.collect import Teacher, TrainingState
from carpark_mj.training.ppo.config import PPOConfig


def require_run(config: PPOConfig) -> None:
    """Refuses a warm start from what is no run, or has other networks."""
    if not config.warm_start:
        return
    if not find_policy(config.warm_start).exists():
        raise ValueError(
            "warm_start must be the folder or a checkpoint of a run, or a pretrained "
            f"policy ({describe_names()}), not {config.warm_start!r}"
        )
    path, own = load_policy(config.warm_start).path, config.networks
    has_critic = _has_critic(path)
    if not config.critic_steps and not has_critic:
        raise ValueError(
            f"{config.warm_start} is a policy without a critic: give critic_steps, in "
            "which only a new critic learns, for example 5000000"
        )
    theirs = network_config(checkpoints.read_header(path))
    if theirs is None:
        raise ValueError(f"{config.warm_start} has no networks for a warm start")
    # No weight's shape.
    alike: dict[str, Any] = {
        x: getattr(own, x) for x in ("min_std", "max_std", "dither", "mirrored")
    }
    alike |= {} if has_critic else {"value_layers": own.value_layers}
    alike["own_size"] = max(theirs.own_size, own.own_size)
    if replace(theirs, **alike) != own:
        raise ValueError(
            f"{config.warm_start} has {theirs}: a warm start needs the same networks, "
            f"or a larger own_size, not {own}"
        )


def _has_critic(path: Path) -> bool:
    """Whether a checkpoint is a training's, not that of a policy alone."""
    return any(name.startswith("['value']") for name in checkpoints.names(path))


def warm_start(config: PPOConfig, state: TrainingState) -> TrainingState:
    """A state before the first update, with networks of the run `warm_start`.

    `state` is as it would begin otherwise. Where agents observe more than those of the
    run, see `widen`.
    """
    run = load_policy(config.warm_start)
    header = checkpoints.read_header(run.path)
    theirs = network_config(header) or config.networks
    grows = theirs.own_size < config.networks.own_size
    trained = Trained(config.warm_start, theirs, run.env)
    if added := new_fields(config.env, trained):
        require_actions(config.warm_start, run.env, config.env)
    else:
        load_policy(config.warm_start, env=config.env)  # refuses what does not fit
    networks = replace(config.networks, own_size=theirs.own_size)
    shapes = network_shapes(networks, run.env)
    # Optimizer, schedules, lots and counters are the run's own.
    template = {"normalizer": shapes["normalizer"], "average": shapes["policy"]}
    if _has_critic(run.path):
        template["value"] = shapes["value"]
    found = checkpoints.load(run.path, template)
    checkpoints.require_finite(run.path, found)
    if added or grows:
        found = widen(config.networks, config.env, trained, found, vars(state))
    # A copy: an update takes over the memory of both.
    actor = jax.tree.map(jnp.copy, found["average"])
    return replace(state, policy=actor, **found)


def make_teacher(config: PPOConfig) -> Teacher | None:
    """The teacher of a training; None without one."""
    name = config.curriculum.teacher
    if not name:
        return None
    if action_spec(config.env).choices or config.networks.bins:
        raise ValueError("curriculum.teacher takes neither choices nor networks.bins")
    seen = load_policy(name).env.observation
    env = replace(config.env, observation=seen)
    if jax.tree.leaves(seen.init_memory(env)):
        raise ValueError(f"curriculum.teacher {name} must not observe its past")
    if env.follows_routes and not config.env.follows_routes:
        raise ValueError(
            f"curriculum.teacher {name} observes routes: env.reward.route must be True"
        )
    policy = load_policy(name, env=env).policy

    def advise(lots: Any) -> jax.Array:
        seen = jax.vmap(lambda state: observe(env, state))(lots)
        action, _ = policy(seen.reshape(-1, seen.shape[-1]), jax.random.key(0))
        return action

    return advise
