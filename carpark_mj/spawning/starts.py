"""Where an agent starts: at random in the spawn regions, or close to its goal.

The random numbers of a start are drawn all at once, as one call of the generator is one
loop: a start lists the shapes of its uniform numbers in [0, 1) by name. Other kinds of
starts are in `special_starts`.
"""

import itertools
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.geometry import norm, rotate, wrap_angle
from carpark_mj.layouts.types import Layout
from carpark_mj.mdp.terminations import WORLD_UNIT
from carpark_mj.spawning.config import SpawnConfig
from carpark_mj.spawning.placing import Surroundings

Shapes = dict[str, tuple[int, ...]]
Draws = dict[str, jax.Array]


def draw_uniform(shapes: Shapes, key: jax.Array) -> Draws:
    """Independent uniform numbers in [0, 1) of these shapes; `key` is consumed."""
    ends = np.cumsum([math.prod(shape) for shape in shapes.values()])
    numbers = jnp.split(jax.random.uniform(key, (int(ends[-1]),)), ends[:-1])
    pairs = zip(shapes.items(), numbers, strict=True)
    return {name: x.reshape(shape) for (name, shape), x in pairs}


def pick(mask: jax.Array, scores: jax.Array) -> jax.Array:
    """A random index () int32 where a mask (n,) is true: the largest score wins."""
    return jnp.argmax(jnp.where(mask, scores, -1.0)).astype(jnp.int32)


def pick_weighted(weights: jax.Array, number: jax.Array) -> jax.Array:
    """Random indices (...) in proportion to weights (n,), by numbers in [0, 1)."""
    ends = jnp.cumsum(weights)
    # 1 - 2**-23 is the largest number drawn, so the product stays below the total.
    return jnp.argmax(number[..., None] * ends[-1] < ends, axis=-1)


def spawn_shapes(config: SpawnConfig) -> Shapes:
    """The numbers of a random or close start."""
    n = config.num_candidates
    return {
        "kind": (),  # see `draw_kind`
        "region": (n,),  # which spawn region
        "point": (n, 2),  # where in it
        "heading": (n,),  # see `draw_heading`
        "walk": (1 if config.spacing else n, walk_numbers(config)),  # `close_points`
    }


class SpawnKind(NamedTuple):
    """Kind of a start, (...) bool each; random if it is none of these."""

    close: jax.Array  # to a goal
    conflict: jax.Array  # on course for a collision, or about a bay
    reverse: jax.Array  # on a path out of the goal's bay
    misaligned: jax.Array  # in the goal's bay


def draw_kind(config: SpawnConfig, number: jax.Array) -> SpawnKind:
    """Kinds of starts (...), at most one each; `number` (...) decides."""
    ends = jnp.asarray(list(itertools.accumulate(config.ratios)), jnp.float32)
    kind = (number[..., None] >= ends).sum(-1)
    return SpawnKind(*(kind == k for k in range(len(config.ratios))))


def spawn_pose(
    config: SpawnConfig,
    layout: Layout,
    around: Surroundings,
    goal_pose: jax.Array,
    draws: Draws,
) -> jax.Array:
    """Draws a start pose (3,) for one agent, random or close to the goal's pose (3,).

    Headings are uniform within the spread of the spawn region. A random spawn is
    uniform over the spawn regions; a close one lies on a walk of up to `close_distance`
    from the region's point nearest to the goal, or is random if other agents leave no
    room there; with a spacing it has one walk only, as in the study. The first of
    `num_candidates` draws that keeps `min_distance` to every other agent is taken, else
    the one whose outline is farthest from theirs. Draws where the car would touch
    something are taken only if there is no other.
    """
    random_xy, random_region = _random_points(config, layout, draws)
    close_xy, nearest = close_points(config, layout, goal_pose[:2], draws["walk"])
    # Close to the goal only if no other agent is, as in the study.
    free = (around.distance(close_xy) > config.min_distance).any()
    close = draw_kind(config, draws["kind"]).close & free
    xy = jnp.where(close, close_xy, random_xy)
    region = jnp.where(close, nearest, random_region)
    yaw = draw_heading(layout, region, draws["heading"])
    pose = jnp.concatenate([xy, yaw[:, None]], axis=-1)
    return _best(config, around, pose)


def random_pose(
    config: SpawnConfig, layout: Layout, around: Surroundings, draws: Draws
) -> jax.Array:
    """Draws a start pose (3,) at random; see `spawn_pose`."""
    xy, region = _random_points(config, layout, draws)
    yaw = draw_heading(layout, region, draws["heading"])
    return _best(config, around, jnp.concatenate([xy, yaw[:, None]], axis=-1))


def redraw(
    config: SpawnConfig,
    layout: Layout,
    around: Surroundings,
    pose: jax.Array,
    key: jax.Array,
) -> jax.Array:
    """Draws a pose (3,) anew, `max_redraws` times at most; `key` is consumed."""
    shapes = spawn_shapes(config) | {"walk": (0, 0)}

    def goes_on(carry: tuple[jax.Array, jax.Array]) -> jax.Array:
        count, pose = carry[0], carry[1][None]
        far = around.distance(pose[:, :2]) > config.min_distance
        keeps = ~around.touches(pose) & far
        return (count < config.max_redraws) & ~keeps[0]

    def again(carry: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        count, _ = carry
        draws = draw_uniform(shapes, jax.random.fold_in(key, count))
        return count + 1, random_pose(config, layout, around, draws)

    return jax.lax.while_loop(goes_on, again, (jnp.int32(0), pose))[1]


def _random_points(
    config: SpawnConfig, layout: Layout, draws: Draws
) -> tuple[jax.Array, jax.Array]:
    """Points (num_candidates, 2) uniform over the spawn regions, and which region."""
    area = layout.spawn_size[:, 0] * layout.spawn_size[:, 1]
    region = pick_weighted(jnp.where(layout.spawn_mask, area, 0.0), draws["region"])
    pose, size = layout.spawn_pose[region], layout.spawn_size[region]
    # local = U(-size / 2, size / 2) in the region's frame; with a spacing half of it
    # more on each side: points on the edge count fully.
    local = (draws["point"] - 0.5) * (size + config.spacing)
    local = on_grid(config, local, size)
    return pose[:, :2] + rotate(local, pose[:, 2]), region


def _best(config: SpawnConfig, around: Surroundings, pose: jax.Array) -> jax.Array:
    """The first of poses (n, 3) that keeps its distance, else the one of most room."""
    touches = around.touches(pose)
    keeps = ~touches & (around.distance(pose[:, :2]) > config.min_distance)
    room = jnp.where(touches, -1.0, around.room(pose))
    return pose[jnp.where(keeps.any(), jnp.argmax(keeps), jnp.argmax(room))]


def draw_heading(layout: Layout, region: jax.Array, number: jax.Array) -> jax.Array:
    """Headings (...) within the spreads of regions, by numbers (...) in [0, 1)."""
    stray = (2.0 * number - 1.0) * layout.spawn_spread[region]
    return wrap_angle(layout.spawn_pose[region, 2] + stray)


def on_grid(config: SpawnConfig, local: jax.Array, size: jax.Array) -> jax.Array:
    """Moves points (..., 2), in the frames of regions, to their grid if spaced."""
    if not config.spacing:
        return local
    edge = _edge(config, size)
    return jnp.clip(jnp.round(local / config.spacing), -edge, edge) * config.spacing


def _edge(config: SpawnConfig, size: jax.Array) -> jax.Array:
    return jnp.floor(0.5 * size / config.spacing + 1e-4)


def walk_numbers(config: SpawnConfig) -> int:
    """Random numbers that a walk of `close_points` takes."""
    return _most_steps(config) if config.spacing else 2


def close_points(
    config: SpawnConfig, layout: Layout, goal_xy: jax.Array, walk: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Points (n, 2) near the goal within the spawn region closest to it, and which.

    Without a spacing each is one straight step from the region's point nearest to the
    goal, its direction and length uniform, clipped to the region. With one it is the
    study's walk: fewer than `close_distance` unit steps along the region's axes, their
    number uniform; steps out of the region are redrawn. The study's starts lie nearer
    to the goal: the root mean square of ten units' walk is 2.1 units, of the step 5.8.
    The numbers (n, walk_numbers) are uniform in [0, 1).
    """
    local = rotate(goal_xy - layout.spawn_pose[:, :2], -layout.spawn_pose[:, 2])
    half = layout.spawn_size / 2
    nearest = jnp.clip(local, -half, half)
    gap = norm(local - nearest)
    region = jnp.argmin(jnp.where(layout.spawn_mask, gap, jnp.inf))
    pose, size = layout.spawn_pose[region], layout.spawn_size[region]
    if config.spacing:
        point = _walk(config, nearest[region], size, walk)
    else:
        angle, reach = 2 * jnp.pi * walk[:, 0], config.close_distance * walk[:, 1]
        step = jnp.stack([jnp.cos(angle), jnp.sin(angle)], axis=-1) * reach[:, None]
        point = jnp.clip(nearest[region] + step, -half[region], half[region])
    return pose[:2] + rotate(point, pose[2]), region


def _stride(config: SpawnConfig) -> int:
    """Grid points per unit step of a walk."""
    return max(1, round(WORLD_UNIT / config.spacing))


def _most_steps(config: SpawnConfig) -> int:
    """Steps of a walk are fewer than this."""
    return max(1, round(config.close_distance / (_stride(config) * config.spacing)))


def _walk(
    config: SpawnConfig, start: jax.Array, size: jax.Array, numbers: jax.Array
) -> jax.Array:
    """Ends (n, 2) of random walks in a region's frame, on its grid points."""
    edge = _edge(config, size)
    steps = jnp.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    steps = steps * _stride(config)
    length = jnp.floor(numbers[:, 0] * _most_steps(config))

    def step(point: jax.Array, draw: tuple[jax.Array, jax.Array]):
        index, number = draw
        ends = point[:, None] + steps
        within = jnp.all(jnp.abs(ends) <= edge, axis=-1)
        direction = jax.vmap(pick_weighted)(within.astype(number.dtype), number)
        moves = (index < length) & within.any(axis=-1)
        end = jnp.take_along_axis(ends, direction[:, None, None], axis=1)[:, 0]
        return jnp.where(moves[:, None], end, point), None

    first = jnp.broadcast_to(
        on_grid(config, start, size) / config.spacing, (numbers.shape[0], 2)
    )
    draws = jnp.arange(_most_steps(config) - 1), numbers[:, 1:].T
    end, _ = jax.lax.scan(step, jnp.round(first), draws)
    return end * config.spacing
