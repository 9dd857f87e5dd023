"""Per-agent episode statistics, carried in the state and read when an episode ends."""

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj.geometry import axis_angle_error
from carpark_mj.mdp.metrics.tallies import fold_tallies
from carpark_mj.types import Events, Motion


@struct.dataclass
class EpisodeStats:
    """Sums over the running episode; all (num_agents,) float32.

    Attributes:
        episode_return: undiscounted.
        length: control steps.
        path: driven length [m].
        gear_changes: times the direction of travel changed.
        direction: sign of the last motion, 0 before the first.
        invalid_actions: steps whose action was NaN or outside [-1, 1].
        wrong_way: part of the path driven against the lanes [m]; None in lots that
            never have lanes.
        tallies: all others by name, see `tallies`: the reward terms, what became of
            dynamic goals and who gave way, and what `MetricsConfig` asks for.
    """

    episode_return: jax.Array
    length: jax.Array
    path: jax.Array
    gear_changes: jax.Array
    direction: jax.Array
    invalid_actions: jax.Array
    wrong_way: jax.Array | None = None
    tallies: dict[str, jax.Array] = struct.field(default_factory=dict)


MOVING = 0.05  # m/s, slower cars have no direction of travel


def init_stats(
    num_agents: int, lanes: bool = False, tallies: dict[str, jax.Array] | None = None
) -> EpisodeStats:
    """Statistics at the start of an episode.

    Args:
        num_agents: in the lot.
        lanes: whether it has lanes.
        tallies: (num_agents,) float32 first values of the tallies by name.
    """
    zero = jnp.zeros(num_agents, jnp.float32)
    return EpisodeStats(
        episode_return=zero,
        length=zero,
        path=zero,
        gear_changes=zero,
        direction=zero,
        invalid_actions=zero,
        wrong_way=zero if lanes else None,
        tallies=tallies or {},
    )


def update_stats(
    stats: EpisodeStats,
    before: Motion,
    after: Motion,
    reward: jax.Array,
    invalid_action: jax.Array,
    wrong_way: jax.Array | None = None,
    measured: dict[str, jax.Array] | None = None,
) -> EpisodeStats:
    """Adds a step; states before and after it, the latter before any respawn.

    `wrong_way` (num_agents,) bool says who drove against the lanes; None without lanes.
    `measured` are the step's numbers for the tallies.
    """
    points = jnp.concatenate(
        [before.pose_w[..., None, :2], after.trace_w[..., :2]], axis=-2
    )
    path = jnp.linalg.norm(jnp.diff(points, axis=-2), axis=-1).sum(axis=-1)
    direction = jnp.sign(after.speed) * (jnp.abs(after.speed) > MOVING)
    changed = (direction * stats.direction) < 0
    wrong_path = stats.wrong_way
    if wrong_path is not None and wrong_way is not None:
        wrong_path = wrong_path + path * wrong_way
    return EpisodeStats(
        episode_return=stats.episode_return + reward,
        length=stats.length + 1.0,
        path=stats.path + path,
        gear_changes=stats.gear_changes + changed,
        direction=jnp.where(direction != 0, direction, stats.direction),
        invalid_actions=stats.invalid_actions + invalid_action,
        wrong_way=wrong_path,
        tallies=fold_tallies(stats.tallies, measured or {}),
    )


def step_metrics(
    stats: EpisodeStats,
    events: Events,
    after: Motion,
    goal_pose: jax.Array,
) -> dict[str, jax.Array]:
    """Named metrics (num_agents,) float32, meant to be read where `events.done`."""
    offset = after.pose_w[..., :2] - goal_pose[..., :2]
    heading = axis_angle_error(after.pose_w[..., 2] - goal_pose[..., 2])
    metrics = {
        "parked": events.parked,
        "crashed": events.crashed,
        "timed_out": events.timed_out,
        "diverged": events.diverged,
        "hit_agent": events.hit_agent,
        "hit_parked_car": events.hit_parked_car,
        "hit_wall": events.hit_wall,
        "episode_return": stats.episode_return,
        "length": stats.length,
        "path": stats.path,
        "gear_changes": stats.gear_changes,
        "invalid_actions": stats.invalid_actions,
        "final_distance": jnp.linalg.norm(offset, axis=-1),
        "final_heading": heading,
        "final_speed": jnp.abs(after.speed),
    }
    if stats.wrong_way is not None:
        metrics["wrong_way"] = stats.wrong_way
    metrics |= {
        name: tally
        for name, tally in stats.tallies.items()
        if not name.startswith("last_")
    }
    return {name: value.astype(jnp.float32) for name, value in metrics.items()}
