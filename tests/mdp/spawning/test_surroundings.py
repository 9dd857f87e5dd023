"""What a start pose keeps away from: the judge of collisions is the oracle."""

import jax
import jax.numpy as jnp
import numpy as np
from helpers.scenes import cars, lot
from helpers.states import parked_at, parked_in, state_of

from carpark_mj.mdp.bays import BayFits
from carpark_mj.mdp.collisions import find_hits
from carpark_mj.mdp.spawning.placing import (
    SpawnInputs,
    Surroundings,
    start_placing,
    surroundings,
)


def test_what_would_be_touched_is_what_the_judge_of_collisions_says():
    rng = np.random.default_rng(2)
    layout = lot(
        [(0.0, 0.0, 0.0)],
        walls=[(4.0, 0.0, 0.3), (-6.0, 3.0, 0.0)],
        wall_size=(6.0, 0.4),
        discs=[(0.0, -5.0, 0.4)],
    )
    layout = layout.replace(wall_mask=jnp.array([True, False]))
    pose = rng.uniform((-9, -9, -3), (9, 9, 3), (600, 3)).astype(np.float32)
    size = jnp.array([4.6, 1.9])
    parked = parked_at([(2.0, 6.0, 0.7), (-5.0, -6.0, 2.0)], [(4.9, 1.9), (3.5, 1.6)])

    def judge(pose):
        motion = cars(pose[None], size=size)
        return find_hits(state_of(layout, motion, 0, parked_cars=parked)).any[0]

    expected = np.asarray(jax.jit(jax.vmap(judge))(pose))
    assert 100 < expected.sum() < 500
    around = Surroundings(
        xy=jnp.zeros((1, 2)),
        others=jnp.zeros(1, bool),
        layout=layout,
        size=size,
        parked_pose=parked.pose_w,
        parked_size=parked.size,
    )
    np.testing.assert_array_equal(around.touches(jnp.asarray(pose)), expected)
    # Cars of one kind have room wherever they can start.
    assert not around.replace(size=None).touches(jnp.asarray(pose)).any()


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
    np.testing.assert_array_equal(around.parked_pose, expected)
    touched = around.touches(jnp.concatenate([expected, row.bay_pose[:2]]))
    assert touched.tolist() == [True, True, False, False]
