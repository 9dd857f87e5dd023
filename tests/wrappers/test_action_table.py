"""All actions in one list."""

import numpy as np

from carpark_mj.mdp.actions import ActionSpec
from carpark_mj.wrappers.options import action_table


def test_numbers_come_in_equal_steps_with_a_zero():
    table = action_table(ActionSpec(2))
    assert table.shape == (77, 2)
    assert table.dtype == np.float32
    assert len(np.unique(table, axis=0)) == 77
    for column, count in ((0, 11), (1, 7)):
        values = np.unique(table[:, column])
        np.testing.assert_allclose(values, np.linspace(-1, 1, count), atol=1e-7)
    assert (table == 0).all(axis=1).sum() == 1  # standing still is an action


def test_indices_come_with_every_number():
    table = action_table(ActionSpec(2, (3,)))
    assert table.shape == (231, 3)
    np.testing.assert_array_equal(table[:3, 2], [0, 1, 2])
    grid = action_table(ActionSpec(0, (3, 2)))
    assert grid.dtype == np.int32
    np.testing.assert_array_equal(
        grid, [[0, 0], [0, 1], [1, 0], [1, 1], [2, 0], [2, 1]]
    )
