"""What a training takes from other policies: networks to begin with, a teacher.

*Warm starts.* The actor begins as the averaged policy of another run, the one that is
evaluated. A pretrained policy has no critic: a new one learns first. Agents may observe
more: weights of new fields begin at zero, so that the networks act as they did; their
running statistics begin at mean 0 and standard deviation 1, for observations are of
order 1. Entities of a new kind, and more features of the agent's own numbers, begin as
of a new run; what reads them begins at zero.

*Teachers.* As in DAgger (Ross et al. 2011) the learner drives, so that it learns what
to do where it gets to itself; as in kickstarting (Schmitt et al. 2018) the imitation is
a term of the loss that ends, while the reward is learned from all along.
"""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config import EnvConfig
from carpark_mj.config.networks import NetworkConfig
from carpark_mj.mdp.actions import action_spec
from carpark_mj.observations import make_fields, observe
from carpark_mj.observations.compose import OWN, observation_sets, part_name
from carpark_mj.observations.fields import ORDERED, Field
from carpark_mj.observations.ranges import RAYS, RAYS_NEAR
from carpark_mj.policy import checkpoints
from carpark_mj.policy.loading import (
    load_policy,
    network_config,
    network_shapes,
    require_actions,
)
from carpark_mj.policy.runs import find_policy
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
    alike = {"min_std": own.min_std, "max_std": own.max_std}  # no weight's shape
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
    if added := new_fields(config, run.env):
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
        found = widen(config, networks, run.env, found, vars(state))
    # A copy: an update takes over the memory of both.
    actor = jax.tree.map(jnp.copy, found["average"])
    return replace(state, policy=actor, **found)


HIDDEN = "hidden"  # of `hidden_0`, the first layer behind the encoder
_BY_BEARING = (RAYS, RAYS_NEAR)  # fields whose numbers have bearings


def new_fields(config: PPOConfig, env: EnvConfig) -> list[str]:
    """Fields of which agents of a training observe more than those in `env`."""
    # Of rays the numbers count, not how many there are.
    ours, theirs = (
        {
            (number, replace(field, size=0) if field.name in _BY_BEARING else field)
            for field in make_fields(each)
            if field.index == 0
            for number in _numbers(field)
        }
        for each in (config.env, env)
    )
    added, lost = (
        sorted({field.name for _, field in more})
        for more in (ours - theirs, theirs - ours)
    )
    if lost:
        raise ValueError(
            f"{config.warm_start} was trained on other observations: {', '.join(lost)}"
        )
    if added and config.networks.encoder != "set":
        raise ValueError(
            f"{config.warm_start} was trained without {', '.join(added)}; only a set "
            "encoder takes more observations"
        )
    return added


def widen(
    config: PPOConfig,
    networks: NetworkConfig,
    env: EnvConfig,
    taken: dict[str, Any],
    new: dict[str, Any],
) -> dict[str, Any]:
    """Normalizer and networks of a run in `env`, for larger ones of a training.

    Its agents may observe more, and have more `own_size` than the run's `networks`.
    `taken` are the `normalizer` and networks by name, and `new` the same of a training
    that takes nothing over.
    """
    ours, theirs = _places(config.networks, config.env), _places(networks, env)
    rows = {
        part: (len(ours[part]), np.array([ours[part].index(name) for name in names]))
        for part, names in theirs.items()
    }
    normalizer = new["normalizer"] | {
        part: _widen_statistics(state, *rows[part])
        for part, state in taken["normalizer"].items()
    }

    def widen_layer(path: Any, weights: jax.Array) -> jax.Array:
        layer, kind = (str(key.key) for key in path[-2:])
        part = layer.removesuffix("_0")  # the layer that reads the part
        if kind != "kernel" or part not in rows:
            return weights
        return _spread(weights, 0.0, *rows[part])

    found = {name: tree for name, tree in taken.items() if name != "normalizer"}
    found = jax.tree_util.tree_map_with_path(widen_layer, found)
    found = {name: _over(tree, new[name]) for name, tree in found.items()}
    return {"normalizer": normalizer, **found}


def _over(tree: Any, under: Any) -> Any:
    """A tree of dictionaries, and what only the other has: names, later columns."""
    if isinstance(tree, dict):
        return under | {name: _over(part, under[name]) for name, part in tree.items()}
    return jnp.asarray(under).at[..., : tree.shape[-1]].set(tree)


def _places(networks: NetworkConfig, env: EnvConfig) -> dict[str, list[str]]:
    """Names of the numbers that networks read as a part, in order, by part."""
    names: dict[str, list[str]] = {}
    fields = make_fields(env)
    for field in fields:
        if field.index == 0:
            names.setdefault(part_name(field), []).extend(_numbers(field))
    sizes, inputs = {OWN: networks.own_size}, observation_sets(fields)
    for part in inputs.sets:
        count = part.count if part.group in ORDERED else 1
        sizes[part.group] = count * networks.entity_size
    for part in inputs.pictures:
        sizes[part.name] = part.shape[0] * networks.picture_size
    behind = [f"{part} {k}" for part, size in sizes.items() for k in range(size)]
    return names | {HIDDEN: behind}


def _numbers(field: Field) -> list[str]:
    """Names of a field's numbers: of rays by bearing, so that 24 are among 72."""
    size = field.size
    if field.name in _BY_BEARING:
        return [f"{field.name} {Fraction(k, size)} of a turn" for k in range(size)]
    return [f"{field.name} {k}" for k in range(size)]


def _spread(values: jax.Array, fill: Any, size: int, rows: np.ndarray) -> jax.Array:
    """The values as `rows` of an array (size, ...), `fill` elsewhere."""
    whole = jnp.full((size, *values.shape[1:]), fill, values.dtype)
    return whole.at[rows].set(values)


def _widen_statistics(state: Any, size: int, rows: np.ndarray) -> Any:
    """Brax's running statistics of `size` numbers, mean 0 and variance 1 if new."""
    count = jnp.float32(state.count.hi) * 2.0**32 + jnp.float32(state.count.lo)
    return state.replace(
        mean=_spread(state.mean, 0.0, size, rows),
        std=_spread(state.std, 1.0, size, rows),
        summed_variance=_spread(state.summed_variance, count, size, rows),
    )


def make_teacher(config: PPOConfig) -> Teacher | None:
    """The teacher of a training; None without one."""
    name = config.curriculum.teacher
    if not name:
        return None
    if action_spec(config.env).choices:
        raise ValueError("curriculum.teacher needs actions of numbers, not of choices")
    seen = load_policy(name).env.observation
    env = replace(config.env, observation=seen)
    if seen.init_memory(env) is not None:
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
