"""Fixed goals: the environment draws one for each episode (Tanner 2022).

Goals are distinct, and no agent's goal holds a parked car once it has been drawn.
"""

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from carpark_mj.config import EnvConfig, SpawnConfig
from carpark_mj.geometry import norm, point_box_distance
from carpark_mj.geometry.obstacles import touches
from carpark_mj.layouts.types import BayKind, Layout
from carpark_mj.mdp.bays import marked
from carpark_mj.mdp.spawning.collision_course import (
    CourseDraws,
    Targets,
    course_pose,
    course_shapes,
)
from carpark_mj.mdp.spawning.draws import draw_uniform, pick
from carpark_mj.mdp.spawning.misaligned import (
    MisalignedDraws,
    misaligned_pose,
    misaligned_shapes,
)
from carpark_mj.mdp.spawning.placing import (
    Placing,
    SpawnInputs,
    Surroundings,
    surroundings,
)
from carpark_mj.mdp.spawning.poses import (
    SpawnDraws,
    at_random_after,
    draw_kind,
    redraw,
    spawn_pose,
    spawn_shapes,
    split_redraws,
)
from carpark_mj.mdp.spawning.reverse import ReverseDraws, reverse_pose, reverse_shapes
from carpark_mj.types import NO_BAY, Events, State


class PlaceDraws(NamedTuple):
    """Uniform numbers in [0, 1) for one start.

    Attributes:
        goal: (2, bays) see `FixedGoals.new_goal`.
        start: for a random or close start.
        course_goal: (attempts, 2, bays) the goals of attempts at a collision course.
        course: for the attempts.
        reverse: for a start on a path out of the goal's bay.
        misaligned: for a start in the goal's bay.
    """

    goal: Any
    start: SpawnDraws
    course_goal: Any
    course: CourseDraws
    reverse: ReverseDraws
    misaligned: MisalignedDraws


def place_shapes(config: SpawnConfig, num_agents: int, num_bays: int) -> PlaceDraws:
    """Shapes of the numbers of a start, for `draw_uniform`."""
    course, goal = course_shapes(config, num_agents), (2, num_bays)
    course_goal = (*course.target[:1], *goal)
    start, reverse = spawn_shapes(config), reverse_shapes(config)
    misaligned = misaligned_shapes(config)
    return PlaceDraws(goal, start, course_goal, course, reverse, misaligned)


class FixedGoals:
    """Goals behind the `Goals` interface that last as long as an episode."""

    def __init__(self, config: EnvConfig) -> None:
        """Takes the rules of spawning."""
        self._config = config.spawn
        self._may_repeat = config.goals.may_repeat
        self._drive_out = config.goals.drive_out

    def place_first(
        self, inputs: SpawnInputs, placing: Placing, agent: jax.Array, key: jax.Array
    ) -> Placing:
        """A start of any kind for the given goal; with `drive_out` also the goal."""
        config, layout = self._config, inputs.layout
        if self._drive_out:
            return self.place(inputs, placing, agent, key)
        around = surroundings(inputs, placing, agent)
        around = dataclasses.replace(around, others=~placing.waiting)
        goal_pose = layout.bay_pose[placing.goal]
        draws, key = self._draw(inputs, placing, agent, key)
        pose = self._pose(inputs, placing, around, draws, key)
        if not config.conflict_ratio:
            return placing.set(agent, pose_w=pose)
        # The goal is given: attempts differ in their targets only.
        drives = (placing.goal != NO_BAY) & ~placing.waiting
        targets = Targets(placing.xy, goal_pose[:, :2], drives)
        own_xy = goal_pose[agent, :2]
        tried, good = jax.vmap(
            lambda draws: course_pose(config, layout, around, own_xy, targets, draws)
        )(draws.course)
        conflict = draw_kind(config, draws.start.kind).conflict & good.any()
        pose = jnp.where(conflict, tried[jnp.argmax(good)], pose)
        return placing.set(agent, pose_w=pose)

    def place(
        self, inputs: SpawnInputs, placing: Placing, agent: jax.Array, key: jax.Array
    ) -> Placing:
        """A new goal, and a start pose that may depend on it.

        An agent that starts on a collision course gets the goal that made it possible.
        """
        config, layout = self._config, inputs.layout
        draws, key = self._draw(inputs, placing, agent, key)
        if self._drive_out:
            around = surroundings(inputs, placing, agent)
            around = dataclasses.replace(around, others=~placing.waiting)
            pose = self._pose(inputs, placing, around, draws, key)
            placed = placing.set(agent, pose_w=pose)
            goal = goal_of_start(layout, placed, agent, draws.goal[0])
            return placed.set(agent, goal=goal)
        drawn = self.new_goal(inputs, placing, agent, draws.goal)
        around = surroundings(inputs, drawn, agent)
        pose = self._pose(inputs, drawn, around, draws, key)
        drawn = drawn.set(agent, pose_w=pose)
        if not config.conflict_ratio:
            return drawn

        has_goal = placing.goal != NO_BAY  # agents that are absent have none

        def attempt(
            scores: jax.Array, course: CourseDraws
        ) -> tuple[Placing, jax.Array]:
            drawn = self.new_goal(inputs, placing, agent, scores)
            around = surroundings(inputs, drawn, agent)
            goal_xy = layout.bay_pose[drawn.goal, :2]
            targets = Targets(placing.xy, goal_xy, has_goal & ~placing.waiting)
            own_xy = goal_xy[agent]
            pose, good = course_pose(config, layout, around, own_xy, targets, course)
            return drawn.set(agent, pose_w=pose), good

        tried, good = jax.vmap(attempt)(draws.course_goal, draws.course)
        conflict = draw_kind(config, draws.start.kind).conflict & good.any()
        return jax.tree.map(
            lambda new, old: jnp.where(conflict, new[jnp.argmax(good)], old),
            tried,
            drawn,
        )

    def _pose(
        self,
        inputs: SpawnInputs,
        placing: Placing,
        around: Surroundings,
        draws: PlaceDraws,
        key: jax.Array,
    ) -> jax.Array:
        """A start pose (3,) of any kind but a collision course."""
        config, layout, agent = self._config, inputs.layout, around.agent
        goal_pose = layout.bay_pose[placing.goal[agent]]
        pose = spawn_pose(config, layout, around, goal_pose, draws.start)
        pose = redraw(config, layout, around, pose, key)
        kind = draw_kind(config, draws.start.kind)
        if config.reverse_ratio:
            out, found = reverse_pose(inputs, placing, around, agent, draws.reverse)
            pose = jnp.where(kind.reverse & found, out, pose)
        if config.misaligned_ratio:
            near, found = misaligned_pose(
                inputs, placing, around, agent, draws.misaligned
            )
            pose = jnp.where(kind.misaligned & found, near, pose)
        return pose

    def new_goal(
        self,
        inputs: SpawnInputs,
        placing: Placing,
        agent: jax.Array,
        scores: jax.Array,
    ) -> Placing:
        """Draws a new goal for one agent.

        The goal is uniform over `Layout.goal_mask` without the goals of other agents
        and, unless `GoalConfig.may_repeat`, without the agent's last one. A parked car
        in it moves to a vacant bay: one that is free, fits the car and is farther than
        `min_distance` from every other agent; the agent's last goal is preferred, the
        others are equally likely. Without a vacant bay only bays without parked cars
        can be the goal. No mover stands in a vacant bay. If no bay can be, the agent
        keeps its goal; a parked car that was relocated there moves to any free bay, one
        that fits it if possible.

        Args:
            inputs: the lot and who fits where.
            placing: before the draw.
            agent: () int32 index.
            scores: (2, bays) uniform numbers in [0, 1): the bay with the largest first
                becomes the goal, that with the largest second takes its parked car.
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
        candidate = layout.goal_mask & ~(others_goal if self._may_repeat else is_goal)
        taken = touches(layout.bay_pose, layout.bay_size, inputs.movers.groups)
        vacant = ~others_goal & ~has_car & (gap > self._config.min_distance) & ~taken
        # The new goal is never vacant, as it has a parked car.
        can_move = vacant.any()
        if fits.parked_cars is not None:
            able = (fits.parked_cars & vacant).any(axis=1)
            can_move = jnp.zeros(layout.num_bays, bool)
            can_move = can_move.at[placing.parked_bay].set(able, mode="drop")
        candidate = candidate & (can_move | ~has_car)
        if fits.agents is not None:
            candidate = candidate & fits.agents[agent]
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
        new_bay = pick(vacant, score)
        parked_bay = jnp.where(displaced, new_bay, placing.parked_bay)
        placing = dataclasses.replace(placing, parked_bay=parked_bay)
        return placing.set(agent, goal=goal, found=found)

    def _draw(
        self, inputs: SpawnInputs, placing: Placing, agent: jax.Array, key: jax.Array
    ) -> tuple[PlaceDraws, jax.Array]:
        """The numbers of a start, and a key to draw again; `key` is consumed."""
        key, again = split_redraws(self._config, key)
        num_agents, num_bays = placing.goal.shape[0], inputs.layout.num_bays
        shapes = place_shapes(self._config, num_agents, num_bays)
        draws = draw_uniform(shapes, key)
        start = at_random_after(placing.tries[agent], draws.start)
        return draws._replace(start=start), again

    def init_tracked_bays(self) -> None:
        """Agents track no bays."""

    def track(self, state: State) -> State:
        """Nothing is tracked."""
        return state

    def choose(self, state: State, choice: jax.Array | None) -> State:
        """Goals stay as they are."""
        del choice
        return state

    def target_bay(self, state: State) -> jax.Array:
        """The goals (num_agents,)."""
        return state.goal

    def update(self, before: State, after: State, events: Events) -> tuple[State, None]:
        """Goals stay as they are."""
        del before, events
        return after, None

    def begin(
        self, state: State, placing: Placing, begun: jax.Array, key: jax.Array | None
    ) -> State:
        """Everything is decided when agents are placed."""
        del placing, begun, key
        return state


def goal_of_start(
    layout: Layout, placing: Placing, agent: jax.Array, scores: jax.Array
) -> jax.Array:
    """Draws the goal () int32 of an agent whose start pose has been drawn.

    Uniform over the exits if it starts in a bay, any number of agents to each;
    otherwise over the bays that no other agent drives to; agents that are about to
    leave may stand in them. Over the exits, too, if there is no such bay. As in
    MetaDrive's parking lot (Li et al. 2021), see `GoalConfig.drive_out`.

    Args:
        layout: with exits.
        placing: all agents, this one at its start.
        agent: () int32 index.
        scores: (bays,) uniform numbers in [0, 1).
    """
    is_exit = layout.bay_kind == BayKind.EXIT
    gap = point_box_distance(placing.xy[agent], layout.bay_pose, layout.bay_size)
    leaves = ((gap <= 0) & layout.bay_mask & ~is_exit).any()
    drives = ~placing.waiting & (jnp.arange(placing.goal.shape[0]) != agent)
    taken = marked(layout, jnp.where(drives, placing.goal, NO_BAY))
    free = layout.bay_mask & ~is_exit & ~taken
    leaves = leaves | ~free.any()
    return pick(jnp.where(leaves, layout.bay_mask & is_exit, free), scores)
