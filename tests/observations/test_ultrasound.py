"""Ultrasound: exact distances in cones, with shapely as the judge."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from helpers.scenes import cars, fields_of, lot, polygons
from helpers.states import config_of, parked_at, state_of

from carpark_mj.config import RayConfig, RingConfig, UltrasoundConfig
from carpark_mj.observations import ContinuousObservation, ObservationInput, observe
from carpark_mj.observations.ranges import SENSORS, echo_distances

CONFIG = UltrasoundConfig(on=True)
echoes = jax.jit(lambda state: echo_distances(CONFIG, ObservationInput.of(state)))
observe_jit = jax.jit(observe, static_argnums=0)


def config(**settings):
    return config_of(
        ContinuousObservation(
            0,
            0,
            rings=RingConfig(),
            rays=RayConfig(),
            ultrasound=UltrasoundConfig(on=True, **settings),
        ),
        num_agents=1,
    )


def observed(distance, key=0, **settings):
    """What a car observes whose nose is some metres from a wide wall [m]."""
    layout = lot(
        [(0.0, 30.0, 0.0)],
        walls=[(2.0 + distance + 0.5, 0.0, 0.0)],
        wall_size=[(1.0, 60.0)],
    )
    state = state_of(layout, cars([(0.0, 0.0, 0.0)]), 0, key=jax.random.key(key))
    env = config(**settings)
    return fields_of(observe_jit(env, state), env)["ultrasound"][0] * CONFIG.reach


def test_the_front_hears_a_wall_and_the_rear_does_not():
    heard = observed(2.0, noise=0.0)
    # The outer sensors look aside by 40 degrees, and their cones of 60 degrees come
    # within 10 degrees of straight ahead.
    outer = 2.0 / math.cos(math.radians(10.0))
    np.testing.assert_allclose(heard[:4], [outer, 2.0, 2.0, outer], rtol=1e-5)
    np.testing.assert_allclose(heard[4:8], 5.0)


def test_echoes_end_at_the_reach_and_begin_at_the_dead_zone():
    assert observed(0.05, noise=0.0)[1] == pytest.approx(CONFIG.dead_zone)
    assert observed(5.5, noise=0.0)[1] == pytest.approx(CONFIG.reach)


def test_noise_is_of_the_size_asked_for_and_new_with_every_key():
    heard = np.array([observed(2.0, key, noise=0.1)[1] for key in range(40)])
    assert 0.05 < heard.std() < 0.15
    assert abs(heard.mean() - 2.0) < 0.06


def test_distances_agree_with_shapely():
    rng = np.random.default_rng(0)
    for _ in range(20):
        pose = rng.uniform([-8, -8, -3], [8, 8, 3], (10, 3))
        size = rng.uniform(0.3, 4.0, (4, 2))
        radius = rng.uniform(0.1, 1.5, 3)
        layout = lot(
            [(50.0, 50.0, 0.0)],
            walls=pose[:4],
            wall_size=size,
            discs=np.column_stack([pose[4:7, :2], radius]),
        )
        parked = parked_at(pose[7:9])
        motion = cars([(0.0, 0.0, 0.4), pose[9]])
        got = np.asarray(echoes(state_of(layout, motion, 0, parked_cars=parked)))[0]
        things = [
            *polygons(pose[:4], size),
            *polygons(pose[7:], (4.0, 2.0)),
            *shapely.buffer(shapely.points(pose[4:7, :2]), radius, quad_segs=256),
        ]
        for k, (x, y, yaw) in enumerate(SENSORS):
            apex = np.array([x * 2.0, y * 1.0]) @ [
                [math.cos(0.4), math.sin(0.4)],
                [-math.sin(0.4), math.cos(0.4)],
            ]
            angle = 0.4 + math.radians(yaw) + CONFIG.cone * np.linspace(-0.5, 0.5, 65)
            rim = apex + 40.0 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
            cone = shapely.Polygon([apex, *rim])
            parts = [cone.intersection(thing) for thing in things]
            gaps = [p.distance(shapely.Point(apex)) for p in parts if not p.is_empty]
            assert got[k] == pytest.approx(min([*gaps, CONFIG.reach]), abs=2e-3)


def test_a_lot_that_turns_changes_nothing():
    layout = lot([(50.0, 50.0, 0.0)], discs=[(4.0, 1.0, 0.5), (0.0, -3.0, 1.0)])
    here = echoes(state_of(layout, cars([(0.0, 0.0, 0.0)]), 0))
    turned = layout.replace(disc_centre=jnp.array([[-1.0, 4.0], [3.0, 0.0]]))
    there = echoes(state_of(turned, cars([(0.0, 0.0, math.pi / 2)]), 0))
    np.testing.assert_allclose(here, there, atol=1e-4)
