"""What a start pose keeps away from."""

import jax.numpy as jnp
import numpy as np
from helpers.scenes import lot
from helpers.states import parked_in

from carpark_mj.mdp.bays import BayFits
from carpark_mj.mdp.spawning.placing import (
    SpawnInputs,
    start_placing,
    surroundings,
)


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
