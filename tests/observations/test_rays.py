"""Rays and ultrasound: exact distances, with shapely as the judge."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from helpers.observing import observe_jit
from helpers.scenes import NOISE, cars, fields_of, lot, polygons, random_lots
from helpers.states import config_of, parked_at, parked_in, state_of

from carpark_mj.config import RayConfig, RingConfig, UltrasoundConfig
from carpark_mj.geometry import obstacles as near
from carpark_mj.geometry import ray_box_distance, ray_disc_distance
from carpark_mj.observations import (
    ContinuousObservation,
    ObservationInput,
    make_fields,
)
from carpark_mj.observations.ranges import SENSORS, cast_rays, echo_distances
from carpark_mj.obstacles import lot_obstacles

COUNT, REACH = 8, 10.0


def test_rays_that_only_graze_do_not_hit():
    origin, ahead = jnp.zeros(2), jnp.array([1.0, 0.0])
    box = ray_box_distance(origin, ahead, jnp.array([5.0, 1.0, 0.0]), jnp.full(2, 2.0))
    disc = ray_disc_distance(origin, ahead, jnp.array([5.0, 1.0]), jnp.float32(1.0))
    assert (float(box), float(disc)) == (math.inf, math.inf)
    # And they see nothing behind them.
    behind = jnp.array([-5.0, 0.0, 0.0])
    assert ray_box_distance(origin, ahead, behind, jnp.ones(2)) == math.inf
    assert ray_disc_distance(origin, ahead, behind[:2], jnp.float32(1.0)) == math.inf


@functools.cache
def compiled(crowded):
    """Rays (lots, agents, count) [m], by the broad phase or by testing every pair."""

    @jax.jit
    @jax.vmap
    def run(layout, motion, parked):
        around = lot_obstacles(layout, motion, parked)
        return REACH * cast_rays(RayConfig(COUNT, REACH), motion, around)

    def call(*scene):
        before = near.MANY_PAIRS
        near.MANY_PAIRS = 0 if crowded else 10**9
        try:
            return np.asarray(run(*scene))
        finally:
            near.MANY_PAIRS = before

    return call


def shapely_ways(layout, motion, parked, grown):
    """The oracle's ways with obstacles larger by some metres."""
    pose = np.asarray(motion.pose_w, np.float64)
    yaw = pose[..., 2, None] + np.arange(COUNT) * 2 * np.pi / COUNT
    ahead = np.stack([np.cos(yaw), np.sin(yaw)], axis=-1) * 60.0
    start = np.broadcast_to(pose[..., None, :2], ahead.shape)
    rays = shapely.linestrings(np.stack([start, start + ahead], axis=-2))
    own = polygons(motion.pose_w, np.asarray(motion.size, np.float64))
    outline = shapely.length(shapely.intersection(rays, own[..., None]))
    centre = shapely.points(start)
    way = np.full(rays.shape, np.inf)

    def meet(obstacles, mask):
        """Obstacles (lots, 1 or agents, n), those that count."""
        met = shapely.intersection(rays[..., None], obstacles[:, :, None])
        gap = shapely.distance(centre[..., None], met)
        gap = np.where(np.isnan(gap) | ~mask[:, :, None], np.inf, gap)
        np.minimum(way, gap.min(axis=-1), out=way)

    def boxes(pose, size):
        size = np.asarray(size, np.float64) + 2 * grown
        return polygons(pose, size)[:, None]

    others = ~np.eye(pose.shape[1], dtype=bool)[None]
    meet(boxes(motion.pose_w, motion.size), others)
    meet(boxes(parked.pose_w, parked.size), parked.present[:, None])
    meet(boxes(layout.wall_pose, layout.wall_size), layout.wall_mask[:, None])
    radius = np.asarray(layout.disc_radius, np.float64) + grown
    discs = shapely.buffer(shapely.points(layout.disc_centre), radius, quad_segs=128)
    meet(discs[:, None], layout.disc_mask[:, None])
    return np.clip(way - outline, 0.0, REACH)


def test_rays_agree_with_shapely():
    scene = random_lots(60, 12.0)
    got = compiled(False)(*scene)
    # Between the ways to slightly larger and slightly smaller obstacles; a polygon of
    # 512 corners is 2e-5 of a disc's radius too small.
    low, high = (shapely_ways(*scene, grown) for grown in (NOISE, -NOISE))
    assert (got >= low - 1e-5).all()
    assert (got <= high + 1e-5).all()
    assert (high - low < 0.01).mean() > 0.98
    assert 0.1 < (got == REACH).mean() < 0.9
    assert (got == 0.0).any()


def test_the_broad_phase_changes_nothing():
    scene = random_lots(200, 12.0, seed=1)
    every, near = compiled(False)(*scene), compiled(True)(*scene)
    np.testing.assert_allclose(near, every, atol=1e-5)  # float32, fused otherwise


def test_rays_and_near_rays_are_fields_of_the_observation():
    rays = RayConfig(4, reach=8.0, near=1.0)
    config = config_of(ContinuousObservation(0, 0, rings=RingConfig(), rays=rays))
    fields = [(f.name, f.size, f.low, f.high) for f in make_fields(config)[-2:]]
    assert fields == [("rays", 4, 0.0, 1.0), ("rays_near", 4, 0.0, 1.0)]
    # 0.05 m ahead a wall, 3.5 m left a parked car, nothing behind, a disc 0.75 m right.
    layout = lot(
        [(0.0, 5.5, 0.0)],
        walls=[(3.05, 0.0, 0.0)],
        wall_size=[(2.0, 2.0)],
        discs=[(0.0, -2.75, 1.0)],
    )
    parked = parked_in(layout, [0], 2.0)
    state = state_of(layout, cars([(0.0, 0.0, 0.0)]), 0, parked_cars=parked)
    seen = fields_of(observe_jit(config, state), config)
    metres = [[0.05, 3.5, 8.0, 0.75]]
    np.testing.assert_allclose(seen["rays"], np.divide(metres, 8.0), atol=1e-6)
    np.testing.assert_allclose(seen["rays_near"], np.minimum(metres, 1.0), atol=1e-5)


CONFIG = UltrasoundConfig(on=True)
echoes = jax.jit(lambda state: echo_distances(CONFIG, ObservationInput.of(state)))


def heard(distance, key=0, **settings):
    """What a car hears whose nose is some metres from a wide wall [m]."""
    wall = {"walls": [(2.5 + distance, 0.0, 0.0)], "wall_size": [(1.0, 60.0)]}
    layout, motion = lot([(0.0, 30.0, 0.0)], **wall), cars([(0.0, 0.0, 0.0)])
    state = state_of(layout, motion, 0, key=jax.random.key(key))
    sight = {"rings": RingConfig(), "rays": RayConfig()}
    sight["ultrasound"] = UltrasoundConfig(on=True, **settings)
    config = config_of(ContinuousObservation(0, 0, **sight), num_agents=1)
    return fields_of(observe_jit(config, state), config)["ultrasound"][0] * CONFIG.reach


def test_echoes_end_at_the_reach_and_begin_at_the_dead_zone():
    assert heard(0.05, noise=0.0)[1] == pytest.approx(CONFIG.dead_zone)
    assert heard(5.5, noise=0.0)[1] == pytest.approx(CONFIG.reach)


def test_noise_is_of_the_size_asked_for_and_new_with_every_key():
    echo = np.array([heard(2.0, key, noise=0.1)[1] for key in range(40)])
    assert 0.05 < echo.std() < 0.15
    assert abs(echo.mean() - 2.0) < 0.06


def test_distances_agree_with_shapely():
    rng = np.random.default_rng(0)
    for _ in range(20):
        pose = rng.uniform([-8, -8, -3], [8, 8, 3], (10, 3))
        heading = rng.uniform(-3, 3)
        size = rng.uniform(0.3, 4.0, (4, 2))
        radius = rng.uniform(0.1, 1.5, 3)
        layout = lot(
            [(50.0, 50.0, 0.0)],
            walls=pose[:4],
            wall_size=size,
            discs=np.column_stack([pose[4:7, :2], radius]),
        )
        parked = parked_at(pose[7:9])
        motion = cars([(0.0, 0.0, heading), pose[9]])
        cos, sin = math.cos(heading), math.sin(heading)
        got = np.asarray(echoes(state_of(layout, motion, 0, parked_cars=parked)))[0]
        things = [
            *polygons(pose[:4], size),
            *polygons(pose[7:], (4.0, 2.0)),
            *shapely.buffer(shapely.points(pose[4:7, :2]), radius, quad_segs=256),
        ]
        for k, (x, y, yaw) in enumerate(SENSORS):
            apex = np.array([x * 2.0, y * 1.0]) @ [[cos, sin], [-sin, cos]]
            cone = CONFIG.cone * np.linspace(-0.5, 0.5, 65)
            angle = heading + math.radians(yaw) + cone
            rim = apex + 40.0 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
            cone = shapely.Polygon([apex, *rim])
            parts = [cone.intersection(thing) for thing in things]
            gaps = [p.distance(shapely.Point(apex)) for p in parts if not p.is_empty]
            assert got[k] == pytest.approx(min([*gaps, CONFIG.reach]), abs=2e-3)
