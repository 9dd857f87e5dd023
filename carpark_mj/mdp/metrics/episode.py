"""Per-agent episode statistics, carried in the state and read when an episode ends."""

import dataclasses

import jax
import jax.numpy as jnp

from carpark_mj.config import EnvConfig
from carpark_mj.geometry import heading_error, norm
from carpark_mj.layouts.routes import has_lanes
from carpark_mj.layouts.types import Layout
from carpark_mj.mdp.metrics.tallies import first_tallies, fold_tallies, measure
from carpark_mj.mdp.progress import direction_of_travel
from carpark_mj.types import EpisodeStats, Events, Motion, Transition


def init_stats(config: EnvConfig, layout: Layout) -> EpisodeStats:
    """Statistics of all agents of a lot at the start of their episodes."""
    zero = jnp.zeros(config.num_agents, jnp.float32)
    return EpisodeStats(
        episode_return=zero,
        length=zero,
        path=zero,
        gear_changes=zero,
        direction=zero,
        invalid_actions=zero,
        wrong_way=zero if has_lanes(layout) else None,
        tallies=first_tallies(config),
    )


def update_stats(
    config: EnvConfig, transition: Transition, terms: dict[str, jax.Array]
) -> EpisodeStats:
    """Adds a step to the statistics of those who were active in it.

    Args:
        config: says what to measure.
        transition: the step.
        terms: (num_agents,) its reward by term.

    Raises:
        ValueError: numbers of the step do not match those of `init_stats`.
    """
    before, motion = transition.before, transition.after.motion
    old, path = before.stats, _path(before.motion, motion)
    wrong_way = None
    if old.wrong_way is not None and transition.wrong_way is not None:
        wrong_way = old.wrong_way + path * transition.wrong_way
    direction = direction_of_travel(motion)
    new = EpisodeStats(
        episode_return=old.episode_return + jnp.sum(jnp.stack([*terms.values()]), 0),
        length=old.length + 1.0,
        path=old.path + path,
        gear_changes=old.gear_changes + (direction * old.direction < 0),
        direction=jnp.where(direction != 0, direction, old.direction),
        invalid_actions=old.invalid_actions + transition.invalid_action,
        wrong_way=wrong_way,
        tallies=fold_tallies(old.tallies, measure(config, transition, terms)),
    )
    return jax.tree.map(lambda x, y: jnp.where(before.active, x, y), new, old)


def episode_metrics(
    transition: Transition, stats: EpisodeStats
) -> dict[str, jax.Array]:
    """Named metrics (num_agents,) float32 of episodes, valid where `events.done`.

    Args:
        transition: the step.
        stats: of the episodes, this step included.

    Raises:
        ValueError: two metrics have the same name.
    """
    pose_w, target = transition.after.motion.pose_w, transition.target_pose
    events = {
        field.name: value
        for field in dataclasses.fields(Events)
        if (value := getattr(transition.events, field.name)) is not None
    }
    metrics = {
        **events,
        "episode_return": stats.episode_return,
        "length": stats.length,
        "path": stats.path,
        "gear_changes": stats.gear_changes,
        "invalid_actions": stats.invalid_actions,
        "final_distance": norm(pose_w[..., :2] - target[..., :2]),
        "final_heading": heading_error(
            pose_w[..., 2] - target[..., 2], transition.one_way
        ),
        "final_speed": jnp.abs(transition.after.motion.speed),
    }
    if stats.wrong_way is not None:
        metrics["wrong_way"] = stats.wrong_way
    for name, tally in stats.tallies.items():
        if name in metrics:
            raise ValueError(f"there is a metric {name!r} already")
        if not name.startswith("last_"):
            metrics[name] = tally
    return {name: value.astype(jnp.float32) for name, value in metrics.items()}


def _path(before: Motion, after: Motion) -> jax.Array:
    """Length (num_agents,) [m] driven in a step, along the trace."""
    points = jnp.concatenate(
        [before.pose_w[..., None, :2], after.trace_w[..., :2]], axis=-2
    )
    return norm(jnp.diff(points, axis=-2)).sum(axis=-1)
