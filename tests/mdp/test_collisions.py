"""Collisions, clearance and times to collision: by hand, small steps and shapely."""

import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
import shapely
from helpers.scenes import CAR, cars, crossing, lot, polygons, random_lots
from helpers.states import any_hit, parked_at, state_of

from carpark_mj.config import EnvConfig, EpisodeConfig, ObstacleKind, SimConfig
from carpark_mj.geometry import (
    box_contact_time,
    box_corners,
    box_disc_contact_time,
    box_disc_distance,
    point_box_distance,
    rotate,
)
from carpark_mj.geometry.obstacles import NO_MOVERS, Discs, Movers, is_crowded
from carpark_mj.layouts import WallKind, build
from carpark_mj.mdp import collisions as clearance
from carpark_mj.mdp.collisions import (
    HORIZON,
    KERB_HEIGHT,
    RANGE,
    agent_clearance,
    clearances,
    collision_times,
    find_hits,
    find_hits_and_kerbs,
    kerb_stops,
    low_obstacles,
)
from carpark_mj.obstacles import lot_obstacles


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


# Clearance and time to collision


LOTS, AGENTS = 300, 4


def gaps_of(layout, motion, parked):
    return clearances(motion, lot_obstacles(layout, motion, parked))


def oracle(scene):
    """The same by shapely, of every pair at every instant."""
    layout, motion, parked = scene
    own = polygons(motion.trace_w, np.asarray(motion.size)[:, :, None])

    def gaps(shapes, counts, radius=0.0):  # shapes (lots, n, instants or 1)
        found = shapely.distance(own[:, :, None], shapes[:, None]) - radius
        return np.where(counts, found.min(axis=-1), np.inf).min(axis=-1)

    def still(pose, size, mask):
        return gaps(polygons(pose, size)[..., None], np.asarray(mask)[:, None])

    points = shapely.points(np.asarray(layout.disc_centre, np.float64))[..., None]
    radius = np.asarray(layout.disc_radius)[:, None, :, None]
    discs = gaps(points, np.asarray(layout.disc_mask)[:, None], radius)
    walls = still(layout.wall_pose, layout.wall_size, layout.wall_mask)
    found = {
        "agent": gaps(own, ~np.eye(AGENTS, dtype=bool)),
        "parked_car": still(parked.pose_w, parked.size, parked.present),
        "wall": np.minimum(walls, discs),
    }
    return {name: np.clip(gap, 0.0, RANGE) for name, gap in found.items()}


def test_clearance_is_shapely_s_and_0_where_cars_are_hit():
    # Dense lots and wide ones.
    scene = random_lots(LOTS, np.where(np.arange(LOTS) % 2, 12.0, 60.0))

    def find(layout, motion, parked):
        hits = find_hits(state_of(layout, motion, 0, parked_cars=parked))
        return gaps_of(layout, motion, parked), hits

    got, hits = jax.jit(jax.vmap(find))(*scene)
    expected = oracle(scene)
    for name, gap in expected.items():
        # Coordinates up to 60 m resolve 4e-6 m in float32.
        np.testing.assert_allclose(got[name], gap, atol=5e-5, err_msg=name)
        assert 0.05 < (gap == 0).mean() < 0.6  # all three kinds of answers
        assert 0.05 < (gap == RANGE).mean() < 0.9
    assert hits.keys() == got.keys()
    for kind, hit in hits.items():
        np.testing.assert_array_equal(hit, got[kind] == 0.0)


def test_an_agent_alone_in_an_empty_lot_is_far_from_everything():
    plan, alone = lot([(0, 0, 0)]), cars([(0, 0, 0)])
    gap = jax.jit(gaps_of)(plan, alone, parked_at())
    assert {*gap} == {"agent", "parked_car", "wall"}
    assert all(value.tolist() == [RANGE] for value in gap.values())
    assert agent_clearance(alone).tolist() == [np.inf]


@pytest.mark.parametrize("count", [5, 30])  # of all pairs, and of the near ones
def test_the_clearance_of_agents_as_they_stand_is_shapely_s(count):
    rng = np.random.default_rng(count)
    pose = rng.uniform((-15, -15, -3.1), (15, 15, 3.1), (count, 3))
    size = rng.uniform(0.5, 5.0, (count, 2))
    own = polygons(pose, size)
    gap = shapely.distance(own[:, None], own)
    expected = np.where(np.eye(count, dtype=bool), np.inf, gap).min(axis=1)
    assert is_crowded(count, count) == (count == 30)
    got = agent_clearance(cars(pose, size=size))
    np.testing.assert_allclose(got, expected, atol=5e-5)  # m, float32 at 15 m
    assert (expected > 0).any()


def test_in_a_crowd_gradients_are_those_of_all_pairs(monkeypatch):
    rng = np.random.default_rng(0)
    pose = np.float32(rng.uniform((-30, -30, -3), (30, 30, 3), (24, 3)))
    assert is_crowded(24, 24)

    def slope():
        return jax.grad(lambda pose: agent_clearance(cars(pose)).sum())(pose)

    crowded = slope()
    monkeypatch.setattr(clearance, "is_crowded", lambda *_: False)
    np.testing.assert_allclose(crowded, slope(), atol=1e-6)
    assert np.abs(crowded).max() > 0.5


PAIRS = 400
TIMES = np.arange(0.0, HORIZON, 0.02)


@pytest.fixture(scope="module")
def pairs():
    """Boxes, others, velocities; some are at rest, some are aligned."""
    rng = np.random.default_rng(0)

    def boxes():
        pose = rng.uniform((-8, -8, -3.1), (8, 8, 3.1), (PAIRS, 3))
        return np.float32(pose), np.float32(rng.uniform(0.5, 5.0, (PAIRS, 2)))

    pose_a, size_a = boxes()
    pose_b, size_b = boxes()
    pose_a[::4, 2] = pose_b[::4, 2] = 0.0
    velocity = np.float32(rng.uniform(-3, 3, (PAIRS, 2)))
    velocity[::8, 1] = 0.0
    velocity[5::40] = 0.0
    return pose_a, size_a, pose_b, size_b, velocity


def check(found, gap_at, moving):
    """Asserts first contacts (pairs,) [s] by the gaps at any times (pairs, times)."""
    hit = np.isfinite(found)
    assert 0.2 < hit.mean() < 0.8
    assert 0.02 < (found == 0).mean() < 0.4
    assert not (hit & ~moving & (found > 0)).any()
    at_contact = gap_at(np.where(hit, found, 0.0)[:, None])[:, 0]
    assert at_contact[hit].max() < 1e-4  # m, float32 at 30 m
    before = np.where(hit, found, np.inf)[:, None] - 1e-3 > TIMES
    early = (gap_at(np.broadcast_to(TIMES, before.shape)) == 0) & before
    assert not early.any()


def moved_boxes(pose, size, velocity, times):
    """Polygons (pairs, times) of boxes that have moved straight."""
    pose = np.repeat(np.float64(pose)[:, None], times.shape[1], axis=1)
    pose[..., :2] += np.float64(velocity)[:, None] * times[..., None]
    return polygons(pose, np.float64(size)[:, None])


def test_contact_times_of_boxes_match_small_steps(pairs):
    pose_a, size_a, pose_b, size_b, velocity = pairs
    other = polygons(pose_b, size_b)[:, None]

    def gap_at(times):
        return shapely.distance(moved_boxes(pose_a, size_a, velocity, times), other)

    found = np.asarray(box_contact_time(*pairs), np.float64)
    check(found, gap_at, velocity.any(axis=1))


def test_contact_times_of_discs_match_small_steps(pairs):
    pose, size, where, sizes, velocity = pairs
    centre, radius = where[:, :2], sizes[:, 0] / 2
    point = shapely.points(np.float64(centre))[:, None]

    def gap_at(times):
        boxes = moved_boxes(pose, size, velocity, times)
        return np.maximum(shapely.distance(boxes, point) - radius[:, None], 0.0)

    found = box_disc_contact_time(pose, size, centre, radius, velocity)
    check(np.asarray(found, np.float64), gap_at, velocity.any(axis=1))


def test_search_among_many_finds_what_all_pairs_give():
    lots = random_lots(1, 25.0, seed=1, agents=12, parked=30, walls=30, discs=20)
    layout, motion, parked = jax.tree.map(lambda x: x[0], lots)
    velocity = np.random.default_rng(1).uniform(-3, 3, (12, 2))
    motion = motion.replace(velocity_b=jnp.asarray(velocity, jnp.float32))

    @jax.jit
    def times(layout, motion, parked):
        found = collision_times(motion, lot_obstacles(layout, motion, parked))
        velocity = rotate(motion.velocity_b, motion.pose_w[:, 2])[:, None]
        own = motion.pose_w[:, None], motion.size[:, None]
        relative = velocity - jnp.swapaxes(velocity, 0, 1)
        to_agents = box_contact_time(*own, motion.pose_w, motion.size, relative)
        to_parked = box_contact_time(*own, parked.pose_w, parked.size, velocity)
        to_walls = box_contact_time(*own, layout.wall_pose, layout.wall_size, velocity)
        disc = layout.disc_centre, layout.disc_radius
        to_discs = box_disc_contact_time(*own, *disc, velocity)
        mask = jnp.concatenate([layout.wall_mask, layout.disc_mask])
        solid = jnp.concatenate([to_walls, to_discs], axis=1)
        return found, {
            "agent": jnp.where(jnp.eye(12, dtype=bool), jnp.inf, to_agents),
            "parked_car": jnp.where(parked.present, to_parked, jnp.inf),
            "wall": jnp.where(mask, solid, jnp.inf),
        }

    found, expected = times(layout, motion, parked)
    for kind, time in expected.items():
        nearest = jnp.minimum(jnp.min(time, axis=1), HORIZON)
        np.testing.assert_allclose(found[kind], nearest, rtol=1e-5, err_msg=kind)
        assert (nearest < HORIZON).mean() > 0.1
