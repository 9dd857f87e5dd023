"""The environment of an evaluation: that of the run with what flags change."""

import pytest

from carpark_mj.cli.driver import adapt
from carpark_mj.config import EnvConfig

RUN = EnvConfig(num_agents=5, min_agents=3)


@pytest.mark.parametrize(
    ("changes", "counts"),
    [
        ({}, [3, 4, 5]),
        ({"num_agents": 2}, [2]),
        ({"num_agents": 5}, [5]),
        ({"min_agents": 1}, [1, 2, 3, 4, 5]),
        ({"num_agents": 2, "min_agents": 1}, [1, 2]),
        ({"num_agents": None, "min_agents": None}, [3, 4, 5]),
    ],
)
def test_a_number_of_agents_is_that_of_every_lot_unless_the_least_is_given(
    changes, counts
):
    assert list(adapt(RUN, **changes).agent_counts) == counts
