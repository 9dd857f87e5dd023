"""The Q-learning environment of the study: what is seen, where it starts, what pays."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import cars, lot, moved, moved_lot
from helpers.states import config_of, parked_at, parked_in, state_of

from carpark_mj.config import WORLD_UNIT, RingConfig
from carpark_mj.layouts import make_layout
from carpark_mj.observations import make_fields, observation_size, observe
from carpark_mj.obstacles import lot_obstacles
from carpark_mj.spawning.placing import Surroundings
from carpark_mj.spawning.starts import draw_uniform, random_pose, spawn_shapes
from carpark_papers.tanner.environments import TANNER_QLEARNING, TANNER_QLEARNING_RINGS
from carpark_papers.tanner.indices import IndexObservation
from carpark_papers.tanner.observation import TannerObservation
from carpark_papers.tanner.q_learning.tables import cardinalities

BASIC, RINGS = TANNER_QLEARNING, TANNER_QLEARNING_RINGS
PER_LEVEL = WORLD_UNIT / 0.2  # m/s
NOBODY = parked_at()


def with_rings(**changes):
    rings = dataclasses.replace(RINGS.observation.rings, **changes)
    observation = dataclasses.replace(RINGS.observation, rings=rings)
    return dataclasses.replace(RINGS, observation=observation)


def indices(config, layout, motion, parked=NOBODY):
    state = state_of(layout, motion, 0, parked_cars=parked)
    return np.asarray(observe(config, state))


def test_level_and_bearing_by_hand():
    # The goal is at the origin; bearings count clockwise from ahead, in eighths.
    pose = [
        [-5.0, 0.0, 0.0],  # ahead
        [-5.0, 5.0, 0.0],  # ahead to the right
        [0.0, 5.0, 0.0],  # right
        [5.0, 0.0, 0.0],  # behind
        [0.0, -5.0, 0.0],  # left
        [0.0, -5.0, math.pi / 2],  # ahead again
        [-5.0, 1.9, 0.0],  # 20.8 deg, nearer to ahead
        [-5.0, 2.2, 0.0],  # 23.7 deg, nearer to an eighth
    ]
    speed = PER_LEVEL * jnp.array([-1.0, 0, 1, 1, 1, 1, 1, 1])
    seen = indices(BASIC, lot([[0.0, 0.0, 0.0]]), cars(pose, speed))
    np.testing.assert_array_equal(seen[:, 0], [0, 1, 2, 2, 2, 2, 2, 2])
    np.testing.assert_array_equal(seen[:, 1], [0, 1, 2, 4, 6, 0, 0, 1])


def test_rings_count_walls_discs_and_cars_by_hand():
    # Diameters 2 and 6: the car is at the origin, box ends at 0.9, 2.9, ... from it.
    layout = lot(
        [[50.0, 0.0, 0.0]],
        walls=[[1.4, 0.0, 0.0], [0.0, 3.6, 0.0]],  # 0.9 and 3.1 away
        discs=[[0.0, -3.0, 0.5]],  # 2.5 away
    )
    parked = parked_at([(-3.0, 0.0, 0.0)], 1.0)  # 2.5 away
    agents = cars([[0.0, 0.0, 0.0], [30.0, 0.0, 0.0], [0.0, 1.5, 0.0]], size=(1.0, 1.0))
    seen = indices(with_rings(diameters=(6.0, 2.0), cap=5), layout, agents, parked)
    np.testing.assert_array_equal(seen[0, 2:], [4, 1])  # the third agent is 1.0 away
    np.testing.assert_array_equal(seen[1, 2:], [0, 0])
    walls_only = with_rings(diameters=(6.0, 2.0), cap=5, cars=False)
    seen = indices(walls_only, layout, agents, parked)
    np.testing.assert_array_equal(seen[0, 2:], [2, 1])
    capped = with_rings(diameters=(6.0, 2.0), cap=1)
    seen = indices(capped, layout, agents, parked)
    np.testing.assert_array_equal(seen[0, 2:], [1, 1])


def test_a_motion_of_the_whole_lot_changes_nothing():
    layout = make_layout("square")
    key = jax.random.key(0)
    xy = jnp.round(jax.random.uniform(key, (200, 2), minval=-26, maxval=26))
    turn = jax.random.randint(key, (200, 1), 0, 8) * (math.pi / 4)
    pose = jnp.concatenate([xy * WORLD_UNIT, turn], axis=-1)
    parked = layout.bay_pose[10:]

    def everywhere(pose, layout, parked):
        def see(pose):
            cars_there = parked_at(parked, (4.44, 2.19375))
            motion = cars(pose[None], PER_LEVEL)
            return observe(RINGS, state_of(layout, motion, 3, parked_cars=cars_there))

        return np.asarray(jax.vmap(see)(pose))[:, 0]

    shift = (3.0, -7.0, 0.6)
    seen = everywhere(pose, layout, parked)
    again = everywhere(
        moved(pose, shift), moved_lot(layout, shift), moved(parked, shift)
    )
    np.testing.assert_array_equal(seen, again)
    assert len({tuple(row) for row in seen[:, 2:]}) > 4
    np.testing.assert_array_equal(np.unique(seen[:, 1]), np.arange(8))
    assert (seen < np.array(cardinalities(RINGS))).all()


@pytest.mark.parametrize(
    ("rings", "cap", "states"),
    [
        ((), 1, 24),  # 216 entries with 9 actions
        ((14, 11, 10, 6, 7), 1, 768),
        ((14, 11, 10, 6, 7), 2, 5832),
        ((14, 11, 10, 6, 7), 3, 24576),
        (range(7, 15), 1, 6144),
        (range(4, 16), 1, 98304),
    ],
)
def test_tables_are_as_large_as_those_of_the_study(rings, cap, states):
    config = with_rings(diameters=tuple(map(float, rings)), cap=cap)
    assert math.prod(cardinalities(config)) == states
    assert observation_size(config) == len(make_fields(config)) == 2 + len(rings)


def test_only_whole_numbers_have_cardinalities():
    with pytest.raises(ValueError, match=r"whole numbers, not the encoding 'tanner'"):
        cardinalities(config_of(TannerObservation()))


def test_random_starts_are_uniform_over_the_spawn_area():
    layout = make_layout("square")
    alone = Surroundings(
        pose_w=jnp.zeros((1, 3)),
        others=jnp.zeros(1, bool),
        outlines=None,
        agent=jnp.int32(0),
        size=None,
        obstacles=lot_obstacles(layout, None, NOBODY),
    )

    @jax.jit
    @jax.vmap
    def draw(key):
        draws = draw_uniform(spawn_shapes(TANNER_QLEARNING.spawn), key)
        return random_pose(TANNER_QLEARNING.spawn, layout, alone, draws)

    pose = np.asarray(draw(jax.random.split(jax.random.key(0), 5_000)))
    point = pose[:, :2] / WORLD_UNIT
    np.testing.assert_allclose(point, np.round(point), atol=1e-4)
    for axis in range(2):
        values, counts = np.unique(np.round(point[:, axis]), return_counts=True)
        np.testing.assert_array_equal(values, np.arange(-21, 22))
        # 5,000 / 43 = 116 on each point, the edges included; 5 standard deviations.
        assert np.abs(counts - 116).max() < 5 * math.sqrt(116)


def test_indices_are_whole_numbers_within_their_cardinalities():
    config = config_of(
        IndexObservation(RingConfig((4.0, 9.0), cars=True)), physics="grid"
    )
    rng = np.random.default_rng(0)
    motion = cars(
        rng.uniform([-15, -15, -3.1], [15, 15, 3.1], (6, 3)), rng.uniform(-2, 3, 6)
    )
    layout, bays = make_layout("square"), rng.permutation(36)
    parked_cars = parked_in(layout, bays[6:22])
    state = state_of(layout, motion, bays[:6], parked_cars=parked_cars)
    seen = np.asarray(jax.jit(observe, static_argnums=0)(config, state))
    np.testing.assert_array_equal(seen, np.round(seen))
    assert (seen[:, 1:] >= 0).all()
    assert (seen[:, 1:] < np.array(cardinalities(config))[1:]).all()
