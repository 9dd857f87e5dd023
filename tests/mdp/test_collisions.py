"""Collisions by hand and by small steps; `test_safety.py` has shapely as oracle."""

import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from helpers.scenes import CAR, cars, crossing, lot
from helpers.states import any_hit, parked_at, state_of

from carpark_mj.config import EnvConfig, EpisodeConfig, ObstacleKind, SimConfig
from carpark_mj.geometry import box_corners, box_disc_distance, point_box_distance
from carpark_mj.geometry.obstacles import NO_MOVERS, Discs, Movers
from carpark_mj.layouts import WallKind, build
from carpark_mj.mdp.collisions import (
    KERB_HEIGHT,
    find_hits,
    find_hits_and_kerbs,
    kerb_stops,
    low_obstacles,
)


@jax.jit
def hits_of(layout, motion, parked_cars=None, hitbox_scale=1.0, movers=NO_MOVERS):
    """What agents touch; nobody is parked by default."""
    parked_cars = parked_at() if parked_cars is None else parked_cars
    state = state_of(layout, motion, 0, parked_cars=parked_cars, movers=movers)
    return find_hits(state, hitbox_scale)


FAR_LOT = lot([(30.0, 0.0, 0.0), (30.0, 10.0, 0.0), (30.0, 20.0, 0.0)])


def test_turning_cars_hit_thin_poles_wherever_in_a_step():
    """Poles about a corner's way; the oracle looks every millisecond."""
    rng, count = np.random.default_rng(4), 3000
    speed, curvature = rng.uniform((-3.0, -0.3), (3.0, 0.3), (count, 2)).T[..., None]
    time = np.linspace(0.0, 0.2, 201)
    yaw = speed * time * curvature  # of the rear axle, on an arc
    x = np.sin(yaw) / curvature + 1.3 * np.cos(yaw)
    y = (1.0 - np.cos(yaw)) / curvature + 1.3 * np.sin(yaw)
    pose = np.float32(np.stack([x, y, yaw], axis=-1))
    size = np.float32(CAR)
    corner = box_corners(pose[np.arange(count), rng.integers(201, size=count)], size)
    pole = corner[np.arange(count), rng.integers(4, size=count)]
    pole = pole + rng.uniform(-0.05, 0.05, (count, 2))
    radius = 0.025

    def deepest(pose):
        gap = box_disc_distance(pose, size, pole[:, None], radius).min(axis=1)
        inside = point_box_distance(pole[:, None], pose, size).min(axis=1)
        return np.asarray(gap), radius - np.asarray(inside)

    before = deepest(pose[:, :1])[0] == 0.0  # seen in the step before
    pose, pole, count = pose[~before], pole[~before], (~before).sum()
    gap, depth = deepest(pose)
    template = lot([(30.0, 0.0, 0.0)], discs=[(0.0, 0.0, radius)])

    def hit(trace, pole):
        motion = dataclasses.replace(cars(trace[-1:]), trace_w=trace[None])
        return hits_of(template.replace(disc_centre=pole[None]), motion)["wall"][0]

    trace = pose[:, 50::50]
    got = np.asarray(jax.vmap(hit)(trace, pole))
    assert got[depth > 0.002].all(), np.sort(depth[~got])[-5:]
    assert not got[gap > 0.002].any(), np.sort(gap[got])[-5:]
    unseen = (deepest(trace)[0] > 0.0) & (depth > 0.002)
    assert unseen.mean() > 0.02  # at the instants alone


def scaled_hits(scale, gap=1.0):
    """Who hits what with scaled hitboxes: pairs and single cars, all `gap` apart."""
    layout = lot([(100.0, 0.0, 0.0)], walls=[(0.0, 20.0, 0.0)], wall_size=(4.0, 1.0))
    length, width = CAR
    # Agent 1 is ahead of agent 0, agent 3 beside the wall.
    x, y = (0.0, length + gap, 30.0, 0.0), (0.0, 0.0, 0.0, 19.5 - gap - width / 2)
    motion = cars(np.stack([x, y, np.zeros(4)], axis=-1))
    parked = parked_at([(30.0, width + gap, 0.0)], CAR)  # beside agent 2
    scale = None if scale is None else jnp.float32(scale)
    return np.array([*hits_of(layout, motion, parked, scale).values()])


def test_hitbox_scale_scales_cars_and_no_walls():
    """A gap of 1 m: closed at 5 / 4 nose to tail, 3 / 2 side by side, 2 at a wall."""
    nothing = np.zeros((3, 4), bool)
    for scale, hit in ((1.24, ()), (1.26, (0, 1)), (1.49, (0, 1)), (1.51, (0, 1, 2))):
        expected = nothing.copy()
        expected[0, [i for i in hit if i < 2]] = True
        expected[1, [i for i in hit if i == 2]] = True
        np.testing.assert_array_equal(scaled_hits(scale), expected, err_msg=f"{scale}")
    assert not scaled_hits(1.99)[2].any()
    assert scaled_hits(2.01)[2].tolist() == [False, False, False, True]


def test_physics_with_contacts_says_itself_what_was_touched():
    touched = jnp.array([[True, False, False], [False, True, True]])
    motion = crossing(False).replace(touched=touched)
    for scale in (1.0, 9.0):
        hits = hits_of(FAR_LOT, motion, hitbox_scale=scale)
        np.testing.assert_array_equal(np.stack([*hits.values()], axis=-1), touched)
        assert any_hit(hits).tolist() == [True, True]
    # Contacts with movers count where the lot has such.
    touched = jnp.array([[False, False, False, True, False, True], [False] * 6])
    motion = crossing(False).replace(touched=touched)
    far = Discs(jnp.array([[90.0, 0.0]]), jnp.ones(1), kind=ObstacleKind.DRIVER)
    hits = hits_of(FAR_LOT, motion, movers=Movers((), ((far,),)))
    assert sorted(hits) == ["agent", "driver", "parked_car", "wall"]
    assert hits["driver"].tolist() == [True, False]
    assert any_hit(hits_of(FAR_LOT, motion)).tolist() == [False, False]


# A hand's car has its rear axle 1.25 m behind the middle of 4 m x 2 m, wheels of radius
# 0.3 m: the rear tyres reach a kerb this far behind the middle.
TYRE = 1.25 + np.sqrt(2 * 0.3 * KERB_HEIGHT - KERB_HEIGHT**2)
SLOW = EnvConfig(episode=EpisodeConfig(kerb_speed=0.5), sim=SimConfig(trace_dt=0.05))


def kerb_lot(*poses, size=(0.2, 3.0), kind=WallKind.KERB):
    """Walls of a kind across the x axis, and bays far away."""
    pose = jnp.array([(x, 0.0, 0.0) for x in poses])
    walls = build.walls(pose, jnp.array(size), kind)
    return build.assemble((50.0, 50.0), build.bays([(30.0, 0, 0)], (6.0, 3.0)), walls)


def reversing(speed, end=0.0, count=4, heading=0.0):
    """The state before and the motion of a step [0.2 s] backwards to `end`."""
    way = np.linspace(speed * 0.2, 0.0, count + 1) + end
    poses = np.stack([way, 0 * way, 0 * way + heading], axis=-1).astype(np.float32)
    before = cars(poses[:1])
    return before, cars(poses[-1:], trace=poses[None, 1:])


def test_a_kerb_touches_a_wheel_where_mujoco_says():
    """Wheels are cylinders, a kerb a box: the distance between both is MuJoCo's."""
    spec = mujoco.MjSpec()
    kinds = mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_BOX
    wheel = {"size": [0.3, 0.1, 0], "quat": [0.5**0.5, 0.5**0.5, 0, 0]}
    spec.worldbody.add_geom(type=kinds[0], pos=[0, 0, 0.3], **wheel)
    for gap in (0.01, -0.01):  # m, of the tyre's edge from the kerb's face
        x = -(TYRE - 1.25) - 0.1 - gap
        place = {"pos": [x, 0, KERB_HEIGHT / 2], "size": [0.1, 0.4, KERB_HEIGHT / 2]}
        kerb = spec.worldbody.add_geom(type=kinds[1], **place)
        model = spec.compile()
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        apart = mujoco.mj_geomDistance(model, data, 0, 1, 1.0, None)
        spec.delete(kerb)
        assert (apart > 1e-4) == (gap > 0)
        layout = kerb_lot(-TYRE - 0.1 - gap)
        _, motion = reversing(0.1)
        state = state_of(layout, motion, 0)
        assert find_hits_and_kerbs(SLOW.episode, state)["wall"] == (gap < 0)


def test_kerb_stops_a_slow_car_and_a_fast_one_crashes():
    # The face lies where the tyre is a third of the way through the step's last 50 ms.
    for speed, slow in ((0.4, True), (0.49, True), (0.52, False), (2.0, False)):
        face = TYRE - 0.3 * speed * 0.05
        before, motion = reversing(speed)
        layout = kerb_lot(-face - 0.1)
        state = state_of(layout, before, 0)
        stopped, trace = kerb_stops(SLOW, state, motion)
        assert stopped == slow
        np.testing.assert_array_equal(trace[0, :3], motion.trace_w[0, :3])
        np.testing.assert_array_equal(trace[0, 3], motion.trace_w[0, 2])
        held = dataclasses.replace(motion, trace_w=trace, pose_w=trace[:, -1])
        after = state_of(layout, held if slow else motion, 0)
        assert find_hits_and_kerbs(SLOW.episode, after)["wall"] == (not slow)
    # Nor is what it does not touch stopped, and walls are walls.
    before, motion = reversing(0.4)
    assert not kerb_stops(SLOW, state_of(kerb_lot(-TYRE - 0.2), before, 0), motion)[0]
    wall = kerb_lot(-TYRE, kind=WallKind.WALL)
    assert not kerb_stops(SLOW, state_of(wall, before, 0), motion)[0]
    assert find_hits_and_kerbs(SLOW.episode, state_of(wall, motion, 0))["wall"]
    # Between tyre and bumper, 2 m behind the middle, the body passes over one.
    state = state_of(kerb_lot(-1.8), reversing(0.1)[1], 0)
    assert find_hits(state)["wall"]
    assert not find_hits_and_kerbs(SLOW.episode, state)["wall"]


def test_wheel_stops_stand_in_bays_across_at_their_far_ends():
    config = EpisodeConfig(kerb_speed=0.5, wheel_stops=0.9)
    layout = lot([(10.0, 0.0, np.pi / 2), (20.0, 0.0, 0.0)], bay_size=(5.0, 2.5))
    found = low_obstacles(config, layout)
    # The far end is behind a car; its stop's middle 7.5 cm farther back than the face.
    expected = [(10.0, -2.5 + 0.9 - 0.075), (20.0 - 2.5 + 0.9 - 0.075, 0.0)]
    np.testing.assert_allclose(found.pose_w[:, :2], expected, atol=1e-6)
    np.testing.assert_allclose(found.size, [(0.15, 1.9)] * 2, atol=1e-6)
    assert np.asarray(found.mask).all()
    parallel = lot([(10.0, 0.0, 0.0)], bay_size=(6.0, 2.3))
    assert not np.asarray(low_obstacles(config, parallel).mask).any()
