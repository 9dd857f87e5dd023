"""Lots that cannot hold what is asked of them."""

import pytest

from carpark_mj.config import EnvConfig, GoalConfig
from carpark_mj.env import ParkingEnv


@pytest.mark.parametrize(
    ("num_parked_cars", "num_tracked_bays", "message"),
    [
        (16, 21, r"num_tracked_bays must be at most 20 \(36 bays less 16 .*, not 21"),
        (36, 1, "num_tracked_bays must be at most 0 .*, not 1"),
        (40, 1, "num_tracked_bays must be at most 0 .*, not 1"),
    ],
)
def test_more_tracked_bays_than_the_lot_has_free_are_refused(
    num_parked_cars, num_tracked_bays, message
):
    config = EnvConfig(
        num_parked_cars=num_parked_cars, goals=GoalConfig(True, num_tracked_bays)
    )
    with pytest.raises(ValueError, match=message) as caught:
        ParkingEnv(config)
    assert "\n" not in str(caught.value)


def test_there_may_be_more_agents_than_free_bays():
    env = ParkingEnv(
        EnvConfig(num_agents=4, num_parked_cars=35, goals=GoalConfig(True, 1))
    )
    assert env.num_agents == 4
