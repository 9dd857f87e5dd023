"""Terms and weights of the study's reward; sums of an episode, paid a share a step."""

from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp

from carpark_mj.config import REWARD_TERMS, REWARDS, EnvConfig, RewardConfig, RewardTerm

if TYPE_CHECKING:
    from carpark_mj.types import Transition


class Effort(NamedTuple):
    """Steering change and speed of a step, as shares of the most; (num_agents,) each.

    Attributes:
        turn: what `PhysicsConfig.turn` says, over the largest.
        speed: absolute speed at the end of the step over the higher of both limits.
    """

    turn: jax.Array
    speed: jax.Array


def effort(config: EnvConfig, transition: "Transition") -> Effort:
    """How hard agents steered in a step, and how fast they are."""
    before, after = transition.before.motion, transition.after.motion
    vehicle, ctrl_dt = transition.before.physics.vehicle, config.sim.ctrl_dt
    physics = config.physics_config
    turn = physics.turn(before, after, ctrl_dt)
    top = physics.top_speed(vehicle, ctrl_dt)
    return Effort(
        turn=turn / physics.largest_turn(vehicle, ctrl_dt),
        speed=jnp.abs(after.speed) / top,
    )


def approach(config: EnvConfig, transition: "Transition") -> jax.Array:
    """Reward per step that ends nearer to the goal, penalty per step that does not."""
    from carpark_mj.mdp.progress import is_nearer

    before, after = transition.before.motion, transition.after.motion
    nearer = is_nearer(before.xy, after.xy, transition.target_pose[:, :2])
    paid = jnp.where(nearer, 1.0, -1.0)
    goals = transition.goal_events
    return paid if goals is None else jnp.where(goals.exploring, 0.0, paid)


def smoothness(
    config: EnvConfig, transition: "Transition", by_speed: float = 0.0
) -> jax.Array:
    """Penalty per step, times the steering change as a share of the largest.

    On the grid it is the turn. With `by_speed` it is multiplied by the speed as a share
    of the top speed.
    """
    used = effort(config, transition)
    return used.turn * used.speed if by_speed else used.turn


def reverse(config: EnvConfig, transition: "Transition") -> jax.Array:
    """Penalty per step in reverse."""
    from carpark_mj.mdp.progress import direction_of_travel

    return direction_of_travel(transition.after.motion) < 0.0


REWARD_TERMS.register("approach", RewardTerm(approach, per_step=True))
REWARD_TERMS.register(
    "smoothness", RewardTerm(smoothness, -1, per_step=True, fixed=("by_speed",))
)
REWARD_TERMS.register("reverse", RewardTerm(reverse, -1, per_step=True))
# Table C.9; potential-based terms are off.
TANNER = RewardConfig(
    park=1.0,
    crash=1.0,
    time=0.2,
    progress=0.0,
    alignment=0.0,
    closeness=0.0,
    extra={"approach": 0.15, "smoothness": 0.05, "reverse": 0.1},
)
REWARDS.register("tanner", TANNER)
