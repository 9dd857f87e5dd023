"""Goals and start poses of agents that begin an episode, one agent at a time.

Fixed goals are distinct, and no agent's goal holds a parked car once it has been drawn
(Tanner 2022). Agents that choose their goals start exploring, at random, close to a bay
or in conflict; that follows the reference implementation of Tanner 2022, not its text.
Their start pose and first goal are two steps, because the bays that an agent tracks
follow from where it stands.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp

from carpark_mj.config.checks import is_off
from carpark_mj.geometry import norm, point_box_distance
from carpark_mj.geometry.obstacles import take, touches
from carpark_mj.layouts.types import BayKind, Layout
from carpark_mj.mdp.goals import track_bays
from carpark_mj.mdp.parked_cars import free_bays, marked
from carpark_mj.physics.base import where_cars
from carpark_mj.spawning import special_starts as special
from carpark_mj.spawning import starts
from carpark_mj.spawning.config import SpawnConfig
from carpark_mj.spawning.placing import Placing, SpawnInputs, Surroundings, surroundings
from carpark_mj.spawning.starts import Draws, Shapes, pick
from carpark_mj.types import NO_BAY, State

if TYPE_CHECKING:
    from carpark_mj.config import EnvConfig

TAKES_CLOSE_BAY = 0.5  # probability that a close start has the bay for its goal


def place_shapes(config: SpawnConfig, num_agents: int, num_bays: int) -> Shapes:
    """The numbers of a start with a fixed goal, none for starts whose share is 0."""
    goal = (2, num_bays)
    shapes = {"goal": goal, **starts.spawn_shapes(config)}  # see `new_goal`
    if not is_off(config.conflict_ratio):
        course = {"course_goal": goal, **special.course_shapes(num_agents)}
        shapes |= {name: (special.ATTEMPTS, *x) for name, x in course.items()}
    if not is_off(config.reverse_ratio):
        shapes |= special.REVERSE_SHAPES
    if not is_off(config.misaligned_ratio):
        shapes |= special.MISALIGNED_SHAPES
    return shapes


def _draw(
    config: SpawnConfig, shapes: Shapes, tries: jax.Array, key: jax.Array
) -> tuple[Draws, jax.Array]:
    """The numbers of a start, and a key to redraw its pose; `key` is consumed."""
    again = key
    if config.max_redraws:
        key, again = jax.random.split(key)
    draws = starts.draw_uniform(shapes, key)
    # After a rejected try it is random, which can be anywhere: above all ratios.
    return draws | {"kind": jnp.where(tries > 0, 2.0, draws["kind"])}, again


def place_agent(
    config: EnvConfig,
    inputs: SpawnInputs,
    placing: Placing,
    agent: jax.Array,
    key: jax.Array,
) -> Placing:
    """Draws goal and start pose of one agent () that begins; `key` is consumed.

    Before, `placing` has the agent where its last episode ended or, if the lot begins,
    its goal. A start pose may depend on the goal. An agent that starts on a collision
    course gets the goal that made it possible; where goals are given, attempts at one
    differ in their targets only.
    """
    if config.goals.dynamic:
        return place_exploring(config.spawn, inputs, placing, agent, key)
    spawn, layout, drive_out = config.spawn, inputs.layout, config.goals.drive_out
    shapes = place_shapes(spawn, placing.goal.shape[0], layout.num_bays)
    draws, again = _draw(spawn, shapes, placing.tries[agent], key)
    kind = starts.draw_kind(spawn, draws["kind"])
    keeps_goal = inputs.first or drive_out

    def with_goal(scores: jax.Array) -> tuple[Placing, Surroundings]:
        drawn = placing
        if not keeps_goal:
            drawn = new_goal(config, inputs, placing, agent, scores)
        return drawn, surroundings(inputs, drawn, agent, placed_only=keeps_goal)

    drawn, around = with_goal(draws["goal"])
    goal_pose = layout.bay_pose[drawn.goal[agent]]
    pose = starts.spawn_pose(spawn, layout, around, goal_pose, draws)
    if spawn.max_redraws:
        pose = starts.redraw(spawn, layout, around, pose, again)
    if not is_off(spawn.reverse_ratio):
        out, found = special.reverse_pose(inputs, drawn, around, agent, draws)
        pose = jnp.where(kind.reverse & found, out, pose)
    if not is_off(spawn.misaligned_ratio):
        askew, found = special.misaligned_pose(inputs, drawn, around, agent, draws)
        pose = jnp.where(kind.misaligned & found, askew, pose)
    drawn = drawn.set(agent, pose_w=pose)
    if drive_out:
        goal = goal_of_start(layout, drawn, agent, draws["goal"][0])
        return drawn.set(agent, goal=goal)
    if is_off(spawn.conflict_ratio):
        return drawn

    # Agents that are absent have no goal.
    drives = (placing.goal != NO_BAY) & ~placing.waiting

    def attempt(course: Draws) -> tuple[Placing, jax.Array]:
        drawn, around = with_goal(course["course_goal"])
        goal_xy = layout.bay_pose[drawn.goal, :2]
        aims = goal_xy[agent], special.Targets(placing.xy, goal_xy, drives)
        pose, good = special.course_pose(spawn, layout, around, *aims, course)
        return drawn.set(agent, pose_w=pose), good

    course = {name: draws[name] for name in ("course_goal", *special.course_shapes(0))}
    tried, good = jax.vmap(attempt)(course)
    conflict = kind.conflict & good.any()
    return where_cars(conflict, take(tried, jnp.argmax(good)), drawn)


def new_goal(
    config: EnvConfig,
    inputs: SpawnInputs,
    placing: Placing,
    agent: jax.Array,
    scores: jax.Array,
) -> Placing:
    """Draws a new goal for one agent ().

    The goal is uniform over `Layout.goal_mask` without the goals of other agents and,
    unless `GoalConfig.may_repeat`, without the agent's last one. A parked car in it
    moves to a vacant bay: one that is free, fits the car and is farther than
    `min_distance` from every other agent; the agent's last goal is preferred, the
    others are equally likely. Without a vacant bay only bays without parked cars can be
    the goal. No mover stands in a vacant bay. If no bay can be, the agent keeps its
    goal; a parked car relocated there moves to a free bay, if possible one that fits.

    Of `scores` (2, bays) in [0, 1) the largest first becomes the goal, the largest
    second takes its parked car.
    """
    layout, fits = inputs.layout, inputs.fits
    rows = jnp.arange(layout.num_bays)
    old = placing.goal[agent]
    is_goal = marked(layout, placing.goal)
    has_car = marked(layout, placing.parked_bay)
    other = jnp.arange(placing.goal.shape[0]) != agent
    gap = norm(layout.bay_pose[:, None, :2] - placing.xy)
    gap = jnp.where(other, gap, jnp.inf).min(axis=-1)

    others_goal = (is_goal & (rows != old)) | ~layout.bay_mask
    may_repeat = config.goals.may_repeat
    candidate = layout.goal_mask & ~(others_goal if may_repeat else is_goal)
    taken = touches(layout.bay_pose, layout.bay_size, inputs.movers.groups)
    far = gap > config.spawn.min_distance
    vacant = ~others_goal & ~has_car & far & ~taken
    # The new goal is never vacant, as it has a parked car.
    can_move = vacant.any()
    if fits.parked_cars is not None:
        able = (fits.parked_cars & vacant).any(axis=1)
        can_move = jnp.zeros(layout.num_bays, bool)
        can_move = can_move.at[placing.parked_bay].set(able, mode="drop")
    candidate = candidate & (can_move | ~has_car)
    if fits.agents is not None:
        candidate = candidate & fits.agents[agent]
        # An agent that waits has not driven there.
        own = (rows == old) & fits.agents[agent] & (placing.waited[agent] > 0)
        candidate = jnp.where(candidate.any(), candidate, own & ~has_car)
    found = candidate.any()
    goal = jnp.where(found, pick(candidate, scores[0]), old)
    score = jnp.where(rows == old, 2.0, scores[1])
    displaced = placing.parked_bay == goal
    free = layout.bay_mask & ~is_goal & ~has_car
    free = jnp.where((free & ~taken).any(), free & ~taken, free)
    if fits.parked_cars is None:
        vacant = jnp.where(vacant.any(), vacant, free)
    else:
        suits = (fits.parked_cars & displaced[:, None]).any(axis=0)
        last = jnp.where((free & suits).any(), free & suits, free)
        vacant = jnp.where(found, vacant & suits, last)
    parked_bay = jnp.where(displaced, pick(vacant, score), placing.parked_bay)
    placing = dataclasses.replace(placing, parked_bay=parked_bay)
    return placing.set(agent, goal=goal, found=found)


def goal_of_start(
    layout: Layout, placing: Placing, agent: jax.Array, scores: jax.Array
) -> jax.Array:
    """Draws the goal () int32 of an agent whose start pose has been drawn.

    Uniform over the exits if it starts in a bay, any number of agents to each;
    otherwise over the bays that no other agent drives to; agents that are about to
    leave may stand in them. Over the exits, too, if there is no such bay. As in
    MetaDrive's parking lot (Li et al. 2021), see `GoalConfig.drive_out`. Of `scores`
    (bays,) the largest wins.
    """
    is_exit = layout.bay_kind == BayKind.EXIT
    gap = point_box_distance(placing.xy[agent], layout.bay_pose, layout.bay_size)
    leaves = ((gap <= 0) & layout.bay_mask & ~is_exit).any()
    drives = ~placing.waiting & (jnp.arange(placing.goal.shape[0]) != agent)
    taken = marked(layout, jnp.where(drives, placing.goal, NO_BAY))
    free = layout.bay_mask & ~is_exit & ~taken
    leaves = leaves | ~free.any()
    return pick(jnp.where(leaves, layout.bay_mask & is_exit, free), scores)


def place_exploring(
    config: SpawnConfig,
    inputs: SpawnInputs,
    placing: Placing,
    agent: jax.Array,
    key: jax.Array,
) -> Placing:
    """Draws where an agent starts to explore; see `place_agent`.

    A close start draws one point, see `close_points`, for every free bay that is no
    agent's goal, and picks a random one of those that keep `min_distance` to every
    other agent and touch nothing. Without any, and for all other starts, it is random,
    as all are in a lot that begins, unless `SpawnConfig.kinds_at_reset`.
    """
    layout, only_random = inputs.layout, inputs.first and not config.kinds_at_reset
    placing = placing.set(agent, goal=NO_BAY)
    around = surroundings(inputs, placing, agent, placed_only=inputs.first)
    bays, no_walk = 0 if only_random else layout.num_bays, is_off(config.close_ratio)
    shapes = starts.spawn_shapes(config) | {
        # Of a point close to every bay.
        "bay_walk": (0 if no_walk else bays, starts.walk_numbers(config)),
        "bay_heading": (bays,),
        "order": (bays,),  # which bay
    }
    draws, again = _draw(config, shapes, placing.tries[agent], key)
    pose = starts.random_pose(config, layout, around, draws)
    if config.max_redraws:
        pose = starts.redraw(config, layout, around, pose, again)
    if only_random:
        return placing.set(agent, pose_w=pose)
    kind = starts.draw_kind(config, draws["kind"])
    bay = jnp.full((), NO_BAY, jnp.int32)
    if not is_off(config.close_ratio):
        others_goal = jnp.where(around.others, placing.goal, NO_BAY)
        taken = jnp.concatenate([placing.parked_bay, others_goal])
        free = free_bays(layout, taken)

        def beside(bay_pose: jax.Array, walk: jax.Array):
            xy, region = starts.close_points(config, layout, bay_pose[:2], walk[None])
            return xy[0], region

        xy, region = jax.vmap(beside)(layout.bay_pose, draws["bay_walk"])
        yaw = starts.draw_heading(layout, region, draws["bay_heading"])
        poses = jnp.concatenate([xy, yaw[:, None]], axis=-1)
        good = free & (around.distance(xy) > config.min_distance)
        good = good & ~around.touches(poses)
        close = kind.close & good.any()
        drawn = pick(good, draws["order"])
        pose = jnp.where(close, poses[drawn], pose)
        bay = jnp.where(close, drawn, bay)
    return placing.set(agent, pose_w=pose, close_bay=bay, conflict=kind.conflict)


def begin_goals(
    config: EnvConfig,
    state: State,
    placing: Placing,
    begun: jax.Array,
    key: jax.Array | None,
) -> State:
    """Tracked bays and first goals of agents that begin; key None = no first goals."""
    assert state.tracked_bays is not None
    tracked = jnp.where(begun[:, None], NO_BAY, state.tracked_bays)
    state = track_bays(config, dataclasses.replace(state, tracked_bays=tracked))
    if key is None:
        return state
    assert state.tracked_bays is not None
    goal = first_goals(placing, state.tracked_bays, state.goal, begun, key)
    return dataclasses.replace(state, goal=goal)


def first_goals(
    placing: Placing,
    tracked_bays: jax.Array,
    goal: jax.Array,
    begun: jax.Array,
    key: jax.Array,
) -> jax.Array:
    """The agents' goals (num_agents,) int32 once those that begin have their first.

    After a close start it is the bay next to it with a probability of one half, if the
    agent tracks it; in conflict a random one of the tracked bays that are another
    agent's goal, goals of close starts included. All others explore. `key` is consumed.
    """
    num_agents, num_slots = tracked_bays.shape
    draws = jax.random.uniform(key, (num_agents, 1 + num_slots))
    real, close_bay = tracked_bays != NO_BAY, placing.close_bay
    takes = begun & (draws[:, 0] < TAKES_CLOSE_BAY)
    takes = takes & (real & (tracked_bays == close_bay[:, None])).any(axis=1)
    goal = jnp.where(takes, close_bay, jnp.where(begun, NO_BAY, goal))

    def share(tracked: jax.Array, real: jax.Array, scores: jax.Array) -> jax.Array:
        wanted = real & (tracked[:, None] == goal).any(axis=1)
        return jnp.where(wanted.any(), tracked[pick(wanted, scores)], NO_BAY)

    shared = jax.vmap(share)(tracked_bays, real, draws[:, 1:])
    conflict = begun & placing.conflict & ~takes
    return jnp.where(conflict, shared, goal).astype(jnp.int32)
