"""The named environments, and what any environment of the library has."""

import dataclasses

import pytest
from helpers.rolling import check_roll_out

from carpark_mj.config import LAYOUTS, EnvConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.policy.loading import load_policy
from carpark_mj.registry import environment
from carpark_mj.suite.environments import HOPE
from carpark_mj.suite.evaluation import suite_env
from carpark_mj.tasks.environment import JointEnv
from carpark_mj.wrappers.goal import GoalParking, goal_config


def test_hope_is_the_task_of_the_suite():
    names = [name for name in LAYOUTS if name.startswith("hope")]
    assert sorted(HOPE.layout.split(",")) == names
    suite = suite_env(HOPE, "strict")
    assert HOPE.episode.max_steps == suite.episode.max_steps
    same = dataclasses.replace(suite, layout=HOPE.layout, episode=HOPE.episode)
    assert same == HOPE


@pytest.mark.parametrize("name", ["anywhere", "considerate", "hope", "sees"])
def test_shipped_policies_have_the_environments_of_their_names(name):
    assert load_policy(name).env == environment(name)


# Any environment


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
