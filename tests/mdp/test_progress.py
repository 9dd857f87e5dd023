"""Coming nearer, by whole numbers; and the direction of travel."""

import math

import jax.numpy as jnp
import numpy as np
from helpers.scenes import cars

from carpark_mj.config import WORLD_UNIT
from carpark_mj.mdp.progress import MOVING, NEARER, direction_of_travel, is_nearer

POINT = WORLD_UNIT / 16  # m, of the finer grid


def test_nearer_on_the_grid_is_exactly_what_whole_numbers_say():
    """Moves of up to 16 points; ties of x^2 + y^2 abound."""
    rng = np.random.default_rng(0)
    goal = rng.integers(-512, 513, (20_000, 2))
    reach = np.where(rng.random((20_000, 1)) < 0.5, 24, 1100)
    before = goal + rng.integers(-reach, reach + 1, (20_000, 2))
    after = before + rng.integers(-16, 17, (20_000, 2))
    # Some swap their coordinates about the goal: exactly as far as before.
    after[:3000] = goal[:3000] + (before[:3000] - goal[:3000])[:, ::-1]
    metres = [jnp.float32(points * POINT) for points in (before, after, goal)]
    far, near = ((before - goal) ** 2).sum(axis=1), ((after - goal) ** 2).sum(axis=1)
    assert (far == near).sum() > 3000
    np.testing.assert_array_equal(is_nearer(*metres), near < far)


def test_nearer_is_by_more_than_rounding():
    rng = np.random.default_rng(1)
    angle = rng.uniform(-math.pi, math.pi, (2, 5000))
    distance = rng.uniform(0.1, 30.0, 5000)
    gained = rng.choice([-1, 1], 5000) * 10 ** rng.uniform(-3, -1, 5000)  # m

    def place(angle, distance):
        xy = np.stack([np.cos(angle), np.sin(angle)], axis=-1) * distance[:, None]
        return jnp.float32(xy)

    target = jnp.zeros(2)
    before = place(angle[0], distance)
    after = place(angle[1], np.maximum(distance - gained, 0.0))
    np.testing.assert_array_equal(is_nearer(before, after, target), gained > 0)
    # Going round at the same distance, close enough for float32 to resolve it.
    round_it = is_nearer(before, place(angle[1], distance), target)
    assert np.finfo(np.float32).eps < NEARER
    assert not round_it[distance < 1.0].any()


def test_standing_still_is_not_coming_nearer_to_any_of_several_targets():
    before = jnp.array([[[1.0, 2.0]], [[3.0, 4.0]]])
    targets = jnp.array([[[1.0, 2.0], [9.0, 9.0]], [[0.0, 0.0], [3.0, 5.0]]])
    assert not is_nearer(before, before, targets).any()
    moved = is_nearer(before, before + jnp.array([0.0, 0.5]), targets)
    assert moved.tolist() == [[False, True], [False, True]]


def test_slow_cars_have_no_direction_of_travel():
    speeds = [2.0, 1.01 * MOVING, 0.99 * MOVING, 0.0, -0.99 * MOVING, -1.01 * MOVING]
    motion = cars(np.zeros((6, 3)), speed=speeds)
    assert direction_of_travel(motion).tolist() == [1, 1, 0, 0, 0, -1]
