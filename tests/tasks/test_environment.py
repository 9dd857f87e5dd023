"""Lots of all tasks are environments of one protocol."""

import pytest
from helpers.rolling import check_roll_out

from carpark_mj.config import EnvConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.tasks.environment import AgentsEnvironment, JointEnv
from carpark_mj.wrappers.goal import GoalParking, goal_config

SMALL = EnvConfig(num_parked_cars=2, physics="bicycle")
ENVIRONMENTS = {
    "lot": lambda: ParkingEnv(SMALL),
    "lot of one episode each": lambda: JointEnv(SMALL),
    "lot with a goal pose": lambda: GoalParking(goal_config({"physics": "bicycle"})),
}


@pytest.mark.parametrize("lots", [(), (3,)])
@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_a_roll_out_is_the_same_for_every_environment(name, lots):
    env = ENVIRONMENTS[name]()
    assert env.respawns == (name == "lot")
    check_roll_out(env, lots)


def test_agents_with_one_episode_each_have_names():
    env: AgentsEnvironment = ENVIRONMENTS["lot of one episode each"]()
    assert env.agents == [f"agent_{k}" for k in range(env.num_agents)]
