"""Observations at the junction: vectors and images."""

import dataclasses

import jax
import jax.numpy as jnp
import junctions
import numpy as np
import pytest
import shapely

from carpark_mj.geometry import box_corners
from carpark_papers.cederle.junction import RasterConfig
from carpark_papers.cederle.junction.observations import (
    ASPHALT,
    FAR,
    GRASS,
    OTHER_CAR,
    OWN_CAR,
    PAINT,
    draw,
    observe,
    pixel_centres,
)
from carpark_papers.cederle.junction.roads import CORNER, CORNER_CENTRES, MARKINGS, ROAD

ENV = junctions.env(scenario="2av-hd")
seen_in = jax.jit(observe)


def test_numbers_are_those_of_the_study_and_who_has_left_is_far_away():
    """Agent 1 at (-20, -1.65), 8.54 m on, to (38.22, -1.65), others 5 and 10 m away."""
    poses = [[-17.0, 2.35, np.pi], [-20.0, -1.65, 0.5], [-12.0, -7.65, 0.0]]
    state = junctions.with_poses(junctions.begin(ENV), poses)
    state = dataclasses.replace(state, along=jnp.array([0.0, 18.54, 0.0]))
    expected = [-58.22, 0.0, 58.22, -3.0, -4.0, -8.0, 6.0, 5.0, 10.0]
    expected += [13.89, 0.0, np.cos(0.5), np.sin(0.5), 8.54]
    np.testing.assert_allclose(seen_in(state)[1], expected, atol=1e-4)
    state = junctions.begin(ENV)
    state = dataclasses.replace(state, present=jnp.array([True, True, False]))
    seen = seen_in(state)[0]
    np.testing.assert_allclose(seen[5:7], FAR)
    assert float(seen[8]) == pytest.approx(FAR * 2**0.5)
    assert abs(float(seen[3])) < 80


@pytest.mark.parametrize(
    ("name", "size"), [("2av", 11), ("2av-hd", 14), ("3av", 14), ("3av-hd", 17)]
)
def test_sizes_are_those_of_the_study(name, size):
    assert junctions.env(scenario=name).observation_shape == (size,)


CONFIG = RasterConfig()
SMALL = {"observation": "image", "raster": RasterConfig(pixels=20)}
drawn = jax.jit(draw, static_argnums=0)


def polygon(box):
    (x, y), (length, width) = box
    return shapely.box(x - length / 2, y - width / 2, x + length / 2, y + width / 2)


def exact(state, agent):
    """The image by areas of polygons, things painted over each other."""
    cars = shapely.polygons(
        np.asarray(box_corners(state.motion.pose_w, state.motion.size), float)
    )
    own = cars[agent]
    others = shapely.union_all([c for k, c in enumerate(cars) if k != agent])
    discs = [shapely.Point(c).buffer(CORNER, quad_segs=64) for c in CORNER_CENTRES]
    road = shapely.union_all([polygon(box) for box in ROAD]) - shapely.union_all(discs)
    lines = shapely.union_all([polygon(box) for box in MARKINGS])
    layers = [(own, OWN_CAR), (others, OTHER_CAR), (lines, PAINT), (road, ASPHALT)]

    pose = np.asarray(state.motion.pose_w[agent : agent + 1])
    xy = np.asarray(pixel_centres(CONFIG, jnp.array(pose)))[0].reshape(-1, 2)
    side = CONFIG.extent / CONFIG.pixels
    corners = box_corners(
        np.concatenate([xy, np.full((len(xy), 1), pose[0, 2])], 1), np.full(2, side)
    )
    pixels = shapely.polygons(np.asarray(corners, float))
    grey, free = np.zeros(len(xy)), np.ones(len(xy))
    hidden = shapely.Polygon()
    for shape, level in layers:
        shape = shape - hidden
        hidden = hidden.union(shape)
        share = shapely.area(shapely.intersection(pixels, shape)) / side**2
        grey, free = grey + share * level, free - share
    return (grey + free * GRASS).reshape(CONFIG.pixels, CONFIG.pixels)


def test_images_are_areas_where_edges_lie_along_the_pixels():
    state = junctions.begin(ENV)
    image = np.asarray(drawn(CONFIG, state), float)
    assert image.shape == (2, 84, 84)
    for agent in range(2):
        error = np.abs(image[agent] - exact(state, agent))
        assert error.mean() < 0.1  # of 255
        assert np.quantile(error, 0.995) <= 1.0  # all but the rounded corners
        assert error[36:48, 36:48].max() <= 1.0  # around the own car


def test_images_of_cars_in_a_curve_are_those_of_areas_but_for_edges():
    poses = [[0.5, 0.2, -2.2], [-9.0, -1.65, 0.0], [1.0, -5.0, 1.8]]
    state = junctions.with_poses(junctions.begin(ENV), poses)
    image = np.asarray(drawn(CONFIG, state), float)
    for agent in range(2):
        error = np.abs(image[agent] - exact(state, agent))
        assert error.mean() < 0.6
        assert error.max() < 60.0


def test_the_car_heads_up_and_who_has_left_is_not_drawn():
    """Seen from the west, the car from the east is ahead on the left."""
    poses = [[8.0, 1.65, np.pi], [-7.0, -1.65, 0.0], [1.65, -30.0, np.pi / 2]]
    state = junctions.with_poses(junctions.begin(ENV), poses)
    image = np.asarray(drawn(CONFIG, state))[1]
    rows, columns = np.nonzero(image > 240)
    side = 50 / 84
    assert abs((41.5 - rows.mean()) * side - 15.0) < 0.5
    assert abs((41.5 - columns.mean()) * side - 3.3) < 0.5
    assert image[41, 41] == image[42, 42] == OWN_CAR
    poses = [[8.0, 1.65, np.pi], [-7.0, -1.65, 0.0], [1.65, -9.0, np.pi / 2]]
    state = junctions.with_poses(junctions.begin(ENV), poses)
    alone = dataclasses.replace(state, present=jnp.array([False, True, False]))
    assert (drawn(CONFIG, state)[1] == OTHER_CAR).any()
    assert not (drawn(CONFIG, alone)[1] > PAINT).any()


def test_an_episode_begins_with_the_image_of_its_own_start():
    for env in (junctions.env(**SMALL), junctions.env(**SMALL, jitter=5.0)):
        for seed in (0, 1):
            state = junctions.begin(env, seed)
            expected = drawn(env.config.raster, state)
            np.testing.assert_array_equal(state.frames[..., 2], expected)


def test_agents_see_the_images_of_their_last_steps():
    env = junctions.env(**SMALL)
    state = junctions.begin(env)
    first = np.asarray(state.frames)
    assert first.shape == (2, 20, 20, 3) == (2, *env.observation_shape)
    assert first.dtype == np.uint8
    for k in (0, 1):  # at reset the first is repeated
        np.testing.assert_array_equal(first[..., k], first[..., 2])
    (state, step), *_ = junctions.drive(env, state, lambda _: [0, 0], 1)
    np.testing.assert_array_equal(step.observation[..., :2], first[..., 1:])
    now = drawn(env.config.raster, state)
    np.testing.assert_array_equal(step.observation[..., 2], now)
    assert (now != first[..., 2]).any()
