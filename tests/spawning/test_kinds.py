"""The kind of a car is carried, not guessed from its size."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from helpers.registering import restore_after
from helpers.sliding import SlidePhysics

from carpark_mj.config import EnvConfig, EpisodeConfig, FleetConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.observations import ContinuousObservation
from carpark_mj.spawning.fleet import Fleet
from carpark_mj.vehicle import COMPACT, VEHICLES, preset, register_vehicle


def test_presets_of_one_size_are_told_apart(monkeypatch):
    restore_after(monkeypatch, VEHICLES)
    heavy = register_vehicle("heavy", dataclasses.replace(COMPACT, mass=1900.0))
    names = ("compact", "heavy")
    config = EnvConfig(
        num_agents=6,
        num_parked_cars=8,
        fleet=FleetConfig(agents=names, parked_cars=names),
        observation=ContinuousObservation(own_car=True),
        episode=EpisodeConfig(max_steps=2),
    )
    env = ParkingEnv(config, SlidePhysics())
    state, _ = jax.jit(env.reset)(jax.random.key(0))
    mass, seen = np.array([COMPACT.mass, heavy.mass]), []
    for _ in range(6):  # three respawns
        np.testing.assert_allclose(state.physics.vehicle.mass, mass[state.kind])
        seen.append(np.asarray(state.kind))
        state, _ = jax.jit(env.step)(state, jnp.zeros((6, 2)))
    assert {*np.unique(seen)} == {0, 1}
    assert len(np.unique(seen, axis=0)) > 1
    parked = env.fleet.parked_vehicles(state.parked_cars)
    assert {car.mass for car in parked} == {COMPACT.mass, heavy.mass}


def test_a_car_without_a_name_is_called_a_custom_car():
    own = dataclasses.replace(COMPACT, length=4.2)
    config = EnvConfig(num_agents=1)
    assert Fleet(config, own).agent_names == ("custom car",)
    assert Fleet(config, preset("city")).agent_names == ("city",)
    assert Fleet(config, COMPACT).parked_names == ("compact",)
