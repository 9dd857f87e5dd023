"""How an agent's episode ends: parked, crashed, timed out or diverged."""

import functools

import jax
import jax.numpy as jnp

from carpark_mj.config import PARKED_RULES, EpisodeConfig
from carpark_mj.geometry import axis_angle_error, box_inside, norm, rotate, wrap_angle
from carpark_mj.layouts.types import BayEnd
from carpark_mj.mdp.collisions import find_hits
from carpark_mj.types import NO_BAY, Events, Motion, State


def is_parked(
    rule: str,
    motion: Motion,
    bay_pose: jax.Array,
    bay_size: jax.Array,
    bay_end: jax.Array | None = None,
) -> jax.Array:
    """Whether cars (...) stand parked in bays under a named rule, `PARKED_RULES`.

    Args:
        rule: its name.
        motion: of the cars (...).
        bay_pose: (..., 3) each car's goal.
        bay_size: (..., 2) [m].
        bay_end: (...) int32, `BayEnd`: the wrong way round no rule holds; None = either
            end in all of them.
    """
    limits = PARKED_RULES[rule]
    parked = jnp.ones(motion.pose_w.shape[:-1], bool)
    offset = motion.xy - bay_pose[..., :2]
    if limits.offset is not None:
        # The study compares along its lot's axes. All its rows are axis-parallel, so
        # the bay's own axes give the same, and make the rule independent of the frame.
        along = jnp.abs(rotate(offset, -bay_pose[..., 2]))
        parked = parked & jnp.all(along < limits.offset, axis=-1)
    if limits.distance is not None:
        distance = norm(offset)
        parked = parked & (distance < limits.distance)
    if limits.from_end is not None:
        own = rotate(offset, -bay_pose[..., 2])
        along = jnp.abs(own[..., 0] + bay_size[..., 0] / 2)
        between = jnp.abs(own[..., 1]) <= bay_size[..., 1] / 2
        parked = parked & (along < limits.from_end) & between
    if limits.inside_lines:
        inside = box_inside(motion.pose_w, motion.size, bay_pose, bay_size)
        parked = parked & inside
    if limits.heading is not None:
        heading = axis_angle_error(motion.pose_w[..., 2] - bay_pose[..., 2])
        parked = parked & (heading < limits.heading)
    if bay_end is not None:
        nose_first = bay_end == BayEnd.NOSE_FIRST
        wanted = bay_pose[..., 2] + jnp.where(nose_first, jnp.pi, 0.0)
        off = jnp.abs(wrap_angle(motion.pose_w[..., 2] - wanted))
        parked = parked & ((bay_end == BayEnd.EITHER) | (off < jnp.pi / 2))
    if limits.speed is not None:
        speed = norm(motion.velocity_b)
        parked = parked & (speed < limits.speed)
    if limits.test is not None:
        parked = parked & limits.test(motion, bay_pose, bay_size, bay_end)
    return parked


def detect_events(config: EpisodeConfig, state: State) -> Events:
    """Evaluates whether each agent's episode has ended after a step, and how.

    Divergence takes precedence over all other outcomes, then comes a crash, parking and
    a timeout, unless the parked rule says otherwise (`ParkedRule.before_crash`,
    `before_timeout`). Parking requires a goal, and of two agents in a bay that is the
    goal of both only the first parks.

    Args:
        config: rules.
        state: at the end of the step, which its `step` counts.
    """
    layout, goal, motion = state.layout, state.goal, state.motion
    if config.kerb_speed:
        from carpark_mj.mdp.kerbs import find_hits_and_kerbs  # only they load it

        hits = find_hits_and_kerbs(config, state)
    else:
        hits = find_hits(state, config.hitbox_scale)
    hit = functools.reduce(jnp.logical_or, hits.values())
    diverged = state.active & ~motion.finite
    alive = state.active & motion.finite
    bay_pose, bay_size = layout.bay_pose[goal], layout.bay_size[goal]
    bay_end = None if layout.bay_end is None else layout.bay_end[goal]
    holds = {
        name: is_parked(name, motion, bay_pose, bay_size, bay_end)
        for name in config.parked_rule.split(",")
    }
    in_bay = functools.reduce(jnp.logical_or, holds.values())
    in_bay = in_bay & alive & (goal != NO_BAY)
    shared = jnp.tril(goal[:, None] == goal, k=-1)
    in_bay = in_bay & ~(shared & in_bay).any(axis=1)
    late = state.step >= config.max_steps
    parked = jnp.zeros_like(in_bay)
    for name, held in holds.items():
        rule = PARKED_RULES[name]
        held = held if rule.before_crash else held & ~hit
        held = held if rule.before_timeout else held & ~late
        parked = parked | (in_bay & held)
    crashed = alive & hit & ~parked
    timed_out = alive & late & ~parked & ~crashed
    return Events(
        parked=parked,
        crashed=crashed,
        timed_out=timed_out,
        diverged=diverged,
        **{f"hit_{kind}": crashed & touched for kind, touched in hits.items()},
    )
