"""The environment of an evaluation: that of the run with what flags change."""

import dataclasses

import pytest

from carpark_mj.cli.driver import adapt, find_driver, with_settings
from carpark_mj.config import EnvConfig, FleetConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.observations import ContinuousObservation
from carpark_mj.registry import ANYWHERE
from carpark_mj.suite.metadrive import METADRIVE

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
def test_a_number_of_agents_is_that_of_every_lot(changes, counts):
    assert list(adapt(RUN, **changes).agent_counts) == counts


def test_any_setting_of_an_environment_can_be_given():
    given = ["sim.steering_delay=0.24", "occupancy=0.2 0.5", "episode.respawn=false"]
    changed = with_settings(RUN, given)
    sim = dataclasses.replace(RUN.sim, steering_delay=0.24)
    episode = dataclasses.replace(RUN.episode, respawn=False)
    changes = {"sim": sim, "episode": episode, "occupancy": (0.2, 0.5)}
    assert changed == dataclasses.replace(RUN, **changes)
    assert with_settings(RUN, []) is RUN


@pytest.mark.parametrize("setting", ["sim.steering_delay", "sim.steering_dely=0.2"])
def test_settings_that_are_none_are_refused(setting):
    with pytest.raises(ValueError, match="steering"):
        with_settings(RUN, [setting])


@pytest.mark.parametrize(
    ("layout", "count"), [("square", 28), ("garage_row", 20), ("lot", 20)]
)
def test_an_occupancy_parks_as_many_cars_as_it_takes(layout, count):
    run = adapt(ANYWHERE, layout=layout, num_agents=1)
    assert (run.occupancy, run.num_parked_cars) == ((0.2, 0.8), count)
    assert ParkingEnv(run).num_agents == 1  # which refuses too few
    assert adapt(ANYWHERE, layout=layout, num_parked_cars=5).num_parked_cars == 5


def test_flags_change_what_they_are_about_and_nothing_else():
    both = adapt(RUN, rule="precise", hitbox_scale=1.1).episode
    assert (both.parked_rule, both.hitbox_scale) == ("precise", 1.1)
    assert adapt(RUN, hitbox_scale=1.1).episode.parked_rule == RUN.episode.parked_rule
    assert adapt(RUN).episode == RUN.episode
    # A number of parked cars is that of every lot.
    run = EnvConfig(num_parked_cars=29, occupancy=(0.2, 0.8))
    assert adapt(run, num_parked_cars=10).occupancy is None
    assert adapt(run, num_agents=3).occupancy == (0.2, 0.8)
    # A vehicle is that of all cars instead of a fleet.
    fleet = FleetConfig(agents=("city", "van"), parked_cars=("suv",))
    run = EnvConfig(fleet=fleet, observation=ContinuousObservation(own_car=True))
    alike = adapt(run, vehicle="sedan")
    assert (alike.vehicle, alike.fleet.is_on) == ("sedan", False)
    assert adapt(run).fleet == run.fleet


def test_nominal_cars_are_observed_as_they_are():
    assert ANYWHERE.sensors.is_on
    nominal = adapt(ANYWHERE, nominal=True, physics="bicycle", vehicle="compact")
    assert not nominal.sensors.is_on
    assert not nominal.randomization.is_on
    assert adapt(ANYWHERE, num_agents=2).sensors == ANYWHERE.sensors


def test_a_trained_policy_observes_another_task_as_in_training():
    env, own = find_driver("anywhere", "metadrive").env, find_driver("anywhere").env
    assert (env.observation, env.reward) == (own.observation, own.reward)
    alike = {"observation": METADRIVE.observation, "reward": METADRIVE.reward}
    assert dataclasses.replace(env, **alike) == METADRIVE
    with pytest.raises(ValueError, match=r"reward\.route"):
        find_driver("anywhere", "dynamic")
