"""What a start pose keeps away from."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import lot, polygons
from helpers.sliding import SlidePhysics
from helpers.spawning import surroundings_of
from helpers.states import any_hit, parked_in

from carpark_mj.config import EnvConfig, RayConfig, SpawnConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.mdp.collisions import find_hits
from carpark_mj.mdp.parked_cars import BayFits
from carpark_mj.observations import ContinuousObservation
from carpark_mj.spawning.placing import SpawnInputs, start_placing, surroundings
from carpark_mj.spawning.starts import draw_uniform, random_pose, spawn_shapes
from carpark_mj.vehicle import preset


def test_starts_keep_off_parked_cars_where_they_stand():
    row = lot([(10.0 * k, 0.0, 0.0) for k in range(4)])
    pushed = jnp.array([[0.0, 9.0, 0.3], [13.0, 9.0, 0.0]])
    parked = parked_in(row, [0, 1]).replace(pose_w=pushed)
    size = jnp.full((2, 2), 2.0)
    inputs = SpawnInputs(row, parked, size, size, BayFits())
    # The second has made way to bay 3.
    bay = jnp.array([0, 3], jnp.int32)
    nowhere = jnp.full((2, 3), 50.0)
    placing = start_placing(jnp.array([1, 2]), bay, nowhere, jnp.ones(2, bool))
    around = surroundings(inputs, placing, jnp.array(0))
    expected = jnp.stack([pushed[0], row.bay_pose[3]])
    np.testing.assert_array_equal(around.obstacles[0].pose_w, expected)
    touched = around.touches(jnp.concatenate([expected, row.bay_pose[:2]]))
    assert touched.tolist() == [True, True, False, False]


def test_in_a_crowded_lane_the_start_with_most_room_between_outlines_is_taken():
    # A lane of 12 m by 3 m with a long car across it: no start keeps 7 m. Cars whose
    # centres are far apart may still touch, so that centres do not count.
    lane = lot([(0.0, 20.0, 0.0)]).replace(
        spawn_pose=jnp.zeros((1, 3)),
        spawn_size=jnp.array([[12.0, 3.0]]),
        spawn_spread=jnp.full(1, 0.1),
        spawn_mask=jnp.ones(1, bool),
    )
    outlines = [[4.0, 2.0], [9.0, 1.0]]
    around = surroundings_of(
        lane, [[0.0, 0.0], [3.0, 1.0]], [False, True], outlines=outlines
    )
    config = SpawnConfig(close_ratio=0.0, min_distance=12.0, num_candidates=8)
    other = polygons(np.array([[3.0, 1.0, 0.0]]), np.array([outlines[1]]))[0]

    def start(key):
        draws = draw_uniform(spawn_shapes(config), key)
        each = [jax.tree.map(lambda x, k=k: x[k : k + 1], draws[1:]) for k in range(8)]
        alone = SpawnConfig(close_ratio=0.0, num_candidates=1)
        tried = [
            random_pose(
                alone,
                lane,
                around,
                draws._replace(**dict(zip(draws._fields[1:], one, strict=True))),
            )
            for one in each
        ]
        return random_pose(config, lane, around, draws), jnp.stack(tried)

    taken, tried = jax.jit(jax.vmap(start))(jax.random.split(jax.random.key(0), 200))
    for pose, candidates in zip(np.asarray(taken), np.asarray(tried), strict=True):
        room = [
            polygons(candidate[None], np.array([outlines[0]]))[0].distance(other)
            for candidate in candidates
        ]
        own = polygons(pose[None], np.array([outlines[0]]))[0].distance(other)
        np.testing.assert_allclose(own, max(room), atol=1e-4)


@pytest.mark.parametrize("vehicle", ["van", "compact"])
def test_a_car_larger_than_lots_are_made_for_starts_clear_of_them_too(vehicle):
    config = EnvConfig(
        layout="dead_end",
        vehicle=vehicle,
        num_agents=1,
        num_parked_cars=3,
        observation=ContinuousObservation(rays=RayConfig()),
    )
    env = ParkingEnv(config, SlidePhysics())

    def touches(key):
        state, _ = env.reset(key)
        return any_hit(find_hits(state))[0], state.motion.size[0]

    hit, size = jax.jit(jax.vmap(touches))(jax.random.split(jax.random.key(0), 500))
    assert not hit.any()
    params = preset(vehicle)
    np.testing.assert_allclose(size[0], [params.length, params.width])


@pytest.mark.parametrize("vehicle", ["van", "compact"])
def test_nobody_starts_on_people_or_on_what_stands_among_them(vehicle):
    """Lots have room for the compact car among what stands, but not for the van."""
    config = EnvConfig(
        layout="mixture",
        vehicle=vehicle,
        num_agents=2,
        num_parked_cars=8,
        spawn=SpawnConfig(min_distance=0.0, num_candidates=1),
        movers=("pedestrians:number=20",),
    )
    env = ParkingEnv(config, SlidePhysics())

    def hits(key):
        state, _ = env.reset(key)
        found = find_hits(state)
        return {kind: hit & state.present for kind, hit in found.items()}

    hit = jax.jit(jax.vmap(hits))(jax.random.split(jax.random.key(0), 200))
    assert "person" in hit
    assert not any(one.any() for one in hit.values())
