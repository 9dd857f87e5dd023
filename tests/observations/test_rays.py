"""Rays and ultrasound: exact distances, with shapely as the judge."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from helpers.scenes import (
    NOISE,
    cars,
    fields_of,
    lot,
    moved,
    moved_cars,
    moved_lot,
    polygons,
)
from helpers.states import config_of, parked_at, parked_in, state_of

from carpark_mj.config import RayConfig, RingConfig, UltrasoundConfig
from carpark_mj.geometry import obstacles as near
from carpark_mj.geometry import ray_box_distance, ray_disc_distance
from carpark_mj.observations import (
    ContinuousObservation,
    ObservationInput,
    make_fields,
    observe,
)
from carpark_mj.observations.ranges import SENSORS, cast_rays, echo_distances
from carpark_mj.obstacles import lot_obstacles
from carpark_mj.types import NO_BAY, ParkedCars

COUNT, REACH = 8, 10.0
AGENTS, PARKED, WALLS, DISCS = 3, 4, 3, 3
observe_jit = jax.jit(observe, static_argnums=0)
NOBODY = parked_at()


def cast(config, layout, motion, parked):
    return cast_rays(config, motion, lot_obstacles(layout, motion, parked))


cast_rays_jit = jax.jit(cast, static_argnums=0)


def ways(motion, layout, parked=NOBODY, count=4, reach=10.0):
    """Free ways [m] (agents, count)."""
    config = RayConfig(count, reach)
    return np.asarray(cast_rays_jit(config, layout, motion, parked)) * reach


def test_a_hand_worked_scene():
    # A car of 4 m x 2 m faces north: rays ahead, to the left, behind, to the right.
    layout = lot(
        [(50.0, 50.0, 0.0)],
        walls=[(0.0, 9.0, 0.0), (0.0, -12.0, 0.0)],
        wall_size=[(8.0, 2.0), (8.0, 2.0)],
        discs=[(-5.0, 0.0, 0.5), (-9.0, 0.0, 3.0)],
    )
    motion = cars([(0.0, 0.0, math.pi / 2), (0.0, -5.0, 0.0)])
    parked = parked_at([(6.0, 0.0, 0.0)])
    got = ways(motion, layout, parked)
    # Ahead a wall from y = 8; left a disc from x = -4.5; behind the other agent, whose
    # side is at y = -4; right a parked car from x = 4.
    np.testing.assert_allclose(got[0], [6.0, 3.5, 2.0, 3.0], atol=1e-5)
    # Left of the second stands the first, with its rear 2 m off; the wall right of it
    # begins at y = -11, and before and behind it there is nothing.
    np.testing.assert_allclose(got[1], [10.0, 2.0, 10.0, 5.0], atol=1e-5)


def test_a_car_alone_sees_nothing_not_even_itself_or_padding():
    layout = lot([(0.0, 0.0, 0.0)], walls=[(0.0, 0.0, 0.0)], discs=[(3.0, 0.0, 0.5)])
    motion = cars([(0.0, 0.0, 0.7)])
    parked = parked_at([(4.0, 0.0, 0.0)])
    assert ways(motion, layout, parked, 12).min() == 0.0
    masked = layout.replace(wall_mask=jnp.zeros(1, bool), disc_mask=jnp.zeros(1, bool))
    absent = parked_at([(4.0, 0.0, 0.0)], present=False)
    np.testing.assert_array_equal(ways(motion, masked, absent, 12), 10.0)


def test_rays_end_at_their_range_and_are_0_inside():
    motion = cars([(0.0, 0.0, 0.0)])
    for gap, seen in ((4.99, 4.99), (5.01, 5.0), (0.0, 0.0), (-1.0, 0.0)):
        layout = lot([(50.0, 0.0, 0.0)], walls=[(2.5 + gap, 0.0, 0.0)])
        got = ways(motion, layout, count=1, reach=5.0)
        assert got[0, 0] == pytest.approx(seen, abs=1e-5), gap


def test_rays_that_only_graze_do_not_hit():
    origin, ahead = jnp.zeros(2), jnp.array([1.0, 0.0])
    box = ray_box_distance(origin, ahead, jnp.array([5.0, 1.0, 0.0]), jnp.full(2, 2.0))
    disc = ray_disc_distance(origin, ahead, jnp.array([5.0, 1.0]), jnp.float32(1.0))
    assert (float(box), float(disc)) == (math.inf, math.inf)
    # And they see nothing behind them.
    behind = jnp.array([-5.0, 0.0, 0.0])
    assert ray_box_distance(origin, ahead, behind, jnp.ones(2)) == math.inf
    assert ray_disc_distance(origin, ahead, behind[:2], jnp.float32(1.0)) == math.inf


def scenes(count=60, seed=0):
    """Cars, parked cars and layouts of random lots in about 24 m."""
    rng = np.random.default_rng(seed)

    def poses(n):
        return np.float32(rng.uniform((-12, -12, -3.1), (12, 12, 3.1), (count, n, 3)))

    motion = cars(
        poses(AGENTS), size=rng.uniform((3.5, 1.6), (5, 2), (count, AGENTS, 2))
    )
    sizes = np.float32(rng.uniform((3.5, 1.6), (5, 2), (count, PARKED, 2)))
    present = rng.uniform(size=(count, PARKED)) < 0.8
    bay = np.where(present, np.arange(PARKED, dtype=np.int32), NO_BAY)
    parked = ParkedCars(bay=bay, pose_w=poses(PARKED), size=sizes)
    template = lot([(50.0, 0, 0)], walls=np.zeros((3, 3)), discs=np.zeros((3, 3)))
    layout = jax.tree.map(lambda x: jnp.repeat(x[None], count, axis=0), template)
    return (
        motion,
        parked,
        layout.replace(
            wall_pose=poses(WALLS),
            wall_size=np.float32(
                rng.uniform((0.2, 0.2), (12.0, 1.0), (count, WALLS, 2))
            ),
            wall_mask=rng.uniform(size=(count, WALLS)) < 0.8,
            disc_centre=poses(DISCS)[..., :2],
            disc_radius=np.float32(rng.uniform(0.1, 1.5, (count, DISCS))),
            disc_mask=rng.uniform(size=(count, DISCS)) < 0.8,
        ),
    )


@functools.cache
def compiled(crowded):
    """Rays (lots, agents, count) [m], by the broad phase or by testing every pair."""

    @jax.jit
    @jax.vmap
    def run(motion, parked, layout):
        return REACH * cast(RayConfig(COUNT, REACH), layout, motion, parked)

    def call(*scene):
        before = near.MANY_PAIRS
        near.MANY_PAIRS = 0 if crowded else 10**9
        try:
            return np.asarray(run(*scene))
        finally:
            near.MANY_PAIRS = before

    return call


def shapely_ways(motion, parked, layout, grown):
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

    meet(boxes(motion.pose_w, motion.size), ~np.eye(AGENTS, dtype=bool)[None])
    meet(boxes(parked.pose_w, parked.size), parked.present[:, None])
    meet(boxes(layout.wall_pose, layout.wall_size), layout.wall_mask[:, None])
    radius = np.asarray(layout.disc_radius, np.float64) + grown
    discs = shapely.buffer(shapely.points(layout.disc_centre), radius, quad_segs=128)
    meet(discs[:, None], layout.disc_mask[:, None])
    return np.clip(way - outline, 0.0, REACH)


def test_rays_agree_with_shapely():
    scene = scenes()
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
    scene = scenes(200, seed=1)
    every, near = compiled(False)(*scene), compiled(True)(*scene)
    np.testing.assert_allclose(near, every, atol=1e-5)  # float32, fused otherwise


def test_rays_do_not_change_when_the_whole_lot_is_moved():
    motion, parked, layout = scenes()
    shift = (9.0, -4.0, 1.9)
    there = (
        moved_cars(motion, shift),
        parked.replace(pose_w=moved(parked.pose_w, shift)),
        layout.replace(
            wall_pose=moved(layout.wall_pose, shift),
            disc_centre=moved(
                np.pad(layout.disc_centre, ((0, 0), (0, 0), (0, 1))), shift
            )[..., :2],
        ),
    )
    here, there = compiled(False)(motion, parked, layout), compiled(False)(*there)
    # Rays that graze a corner or a disc amplify rounding; all others keep their way.
    assert (np.abs(here - there) < 1e-3).mean() > 0.995
    assert np.median(np.abs(here - there)) < 5e-6


def test_rays_are_a_field_of_the_observation():
    observation = ContinuousObservation(
        0, 0, rings=RingConfig(), rays=RayConfig(4, reach=8.0)
    )
    config = config_of(observation)
    field = make_fields(config)[-1]
    assert (field.name, field.size, field.low, field.high) == ("rays", 4, 0.0, 1.0)
    layout = lot([(9.0, 0.0, 0.0), (0.0, 7.0, 0.0)], walls=[(0.0, -5.0, 0.0)])
    parked = parked_in(layout, [0, 1], 2.0)
    state = state_of(layout, cars([(0.0, 0.0, 0.0)]), 0, parked_cars=parked)
    seen = observe_jit(config, state)
    rays = fields_of(seen, config)["rays"]
    # 8 - 2 m ahead, 6 - 1 m left, nothing behind, 4.5 - 1 m to the wall on the right.
    np.testing.assert_allclose(rays, [[6 / 8, 5 / 8, 1.0, 3.5 / 8]], atol=1e-6)
    shift = (5.0, 3.0, 2.0)
    there = moved_lot(layout, shift)
    again = state.replace(
        layout=there,
        motion=moved_cars(state.motion, shift),
        parked_cars=parked_in(there, [0, 1], 2.0),
    )
    np.testing.assert_allclose(observe_jit(config, again), seen, atol=5e-6)


def test_near_rays_are_distances_over_the_near_range():
    observation = ContinuousObservation(
        0, 0, rings=RingConfig(), rays=RayConfig(4, reach=8.0, near=1.0)
    )
    config = config_of(observation)
    assert [field.name for field in make_fields(config)[-2:]] == ["rays", "rays_near"]
    # 0.05 m ahead, 3.5 m left and nothing behind: beyond a metre; 0.75 m right.
    layout = lot(
        [(50.0, 50.0, 0.0)],
        walls=[(3.05, 0.0, 0.0), (0.0, 5.5, 0.0), (0.0, -2.75, 0.0)],
        wall_size=[(2.0, 2.0), (2.0, 2.0), (2.0, 2.0)],
    )
    state = state_of(layout, cars([(0.0, 0.0, 0.0)]), 0)
    seen = fields_of(observe_jit(config, state), config)
    metres = [[0.05, 3.5, 8.0, 0.75]]
    np.testing.assert_allclose(seen["rays"], np.divide(metres, 8.0), atol=1e-6)
    np.testing.assert_allclose(seen["rays_near"], np.minimum(metres, 1.0), atol=1e-5)


CONFIG = UltrasoundConfig(on=True)
echoes = jax.jit(lambda state: echo_distances(CONFIG, ObservationInput.of(state)))
sense_jit = jax.jit(observe, static_argnums=0)


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
    return fields_of(sense_jit(env, state), env)["ultrasound"][0] * CONFIG.reach


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
