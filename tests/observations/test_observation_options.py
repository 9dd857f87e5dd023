"""Options of the observation: sharing, dynamic goals, rings' past, rays, ultrasound."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from helpers.compiling import both_phases
from helpers.observing import observe_jit
from helpers.scenes import (
    NOISE,
    cars,
    fields_of,
    lot,
    moved,
    moved_cars,
    moved_lot,
    polygons,
    random_lots,
)
from helpers.states import config_of, parked_at, parked_in, state_of

from carpark_mj.config import (
    EnvConfig,
    RayConfig,
    RingConfig,
    ShareConfig,
    UltrasoundConfig,
)
from carpark_mj.geometry import ray_box_distance, ray_disc_distance
from carpark_mj.layouts import build, make_layout
from carpark_mj.layouts.routes import make_routes
from carpark_mj.mdp.goals import tracks
from carpark_mj.mdp.parked_cars import tracks_parked_cars
from carpark_mj.observations import ContinuousObservation, ObservationInput, make_fields
from carpark_mj.observations.ranges import SENSORS, cast_rays, echo_distances
from carpark_mj.obstacles import lot_obstacles
from carpark_mj.types import NO_BAY

BASE = ContinuousObservation()
# Everything at once; two bays of four are tracked where goals are chosen.
RICH = ContinuousObservation(
    tracked_agents=3,
    rings=RingConfig((5.0, 6.2, 8.0), cars=True, history=2),
    global_information=True,
)


def observed(config, layout, motion, goal, parked=(), bays=None, history=None):
    """Named fields of all agents; parked cars are poses."""
    count = 0 if bays is None else np.shape(bays)[1]
    config = config_of(config, count, num_agents=len(goal))
    if history is None:
        history = config.observation.init_memory(config)
    more = {"parked_cars": parked_at(parked, 2.0), "memory": history}
    state = state_of(layout, motion, goal, tracked_bays=bays, **more)
    return fields_of(observe_jit(config, state), config)


def check(named, agent, expected):
    for name, value in expected.items():
        np.testing.assert_allclose(named[name][agent], value, atol=1e-6, err_msg=name)


# Bays of 6 m x 3 m and cars of 4 m x 2 m. Agent 0 faces north, agent 1, 4 m ahead of
# it, west; agent 2 stands 5 m to the left of agent 0 and faces east.
BAYS = lot([(2.0, 9.0, math.pi / 2), (-4.0, 0.0, 0.0), (12.0, 1.0, math.pi), (2, 2, 0)])
THREE = cars(
    [(2.0, 1.0, math.pi / 2), (2.0, 5.0, math.pi), (-3.0, 1.0, 0.0)],
    speed=[1.5, -0.6, 3.0],
)


def test_what_is_not_shared_is_left_out_and_the_rest_stays():
    plan = (BAYS, THREE, [0, 1, 2], [(2.0, 2.0, 0.0)])
    everything = observed(BASE, *plan)
    for share, parts in (
        (ShareConfig(speeds=False), {"agent_0_speed", "agent_1_speed"}),
        (ShareConfig(goals=False), {"agent_0_goal", "agent_1_goal"}),
    ):
        named = observed(dataclasses.replace(BASE, share=share), *plan)
        assert set(everything) - set(named) == parts
        for name, value in named.items():
            np.testing.assert_array_equal(value, everything[name], err_msg=name)


def test_rivals_for_fixed_goals_by_hand():
    config = ContinuousObservation(global_information=True)
    named = observed(config, BAYS, THREE, [0, 1, 2])
    expected = {
        # The goal 8 m ahead is 4 m from agent 1, whose goal it is not.
        "goal_nearest_agent": [4 / 20],
        "goal_claim": [1.0, 8 / 20],
    }
    check(named, 0, expected)


def test_steering_and_order_of_others_by_hand():
    config = ContinuousObservation(share=ShareConfig(steering=True, priority=True))
    motion = dataclasses.replace(THREE, steering=jnp.array([0.1, -0.2, 0.3]))
    named = observed(config, BAYS, motion, [0, 1, 2])
    limit = 0.3 / named["steering"][2]
    # The middle one tracks the others, nearest first.
    order = [int(named[f"agent_{k}_priority"][1, 0]) for k in range(2)]
    steering = [float(named[f"agent_{k}_steering"][1, 0] * limit[0]) for k in range(2)]
    pairs = sorted(zip(order, np.round(steering, 5), strict=True))
    assert pairs == [(0, 0.3), (1, 0.1)]
    for k in range(2):  # nobody comes before the first, all before the last
        assert named[f"agent_{k}_priority"][0] == 0.0
        assert named[f"agent_{k}_priority"][2] == 1.0
    alone = observed(config, BAYS, jax.tree.map(lambda x: x[:1], motion), [0])
    assert not alone["agent_0_priority"].any()
    assert not alone["agent_0_steering"].any()


def test_dynamic_goals_by_hand():
    config = ContinuousObservation(rings=RingConfig(), global_information=True)
    bays = [[2, 0], [1, NO_BAY], [NO_BAY, 2]]
    named = observed(config, BAYS, THREE, [0, 2, NO_BAY], (), bays)
    expected = {
        "goal_position": [8 / 20, 0.0],
        "goal_choice": [0.0, 0.0, 1.0],  # the second of its bays
        # 10 m to the right, facing left; agent 1 has it as goal and is the nearest
        # of those, sqrt(10^2 + 4^2) m away, but agent 0 is nearer.
        "bay_0_present": [1.0],
        "bay_0_position": [0.0, -10 / 20],
        "bay_0_near_position": [0.0, -1.0],
        "bay_0_heading": [0.0, 1.0],
        "bay_0_size": [2 / 5, 1 / 5],
        "bay_0_distance": [10 / 20],
        "bay_0_nearest_agent": [10 / 20],
        "bay_0_claim": [1.0, math.sqrt(116) / 20],
        "bay_1_position": [8 / 20, 0.0],
        "bay_1_nearest_agent": [4 / 20],
        "bay_1_claim": [1.0, 8 / 20],
        # Agent 1, the nearest, heads for the first of agent 0's bays; 2 explores.
        "agent_0_goal": [0.0, 1.0, 0.0, 0.0],
        "agent_1_goal": [1.0, 0.0, 0.0, 0.0],
    }
    check(named, 0, expected)
    # Agent 1's goal is not among its bays; agent 0's neither, agent 2 explores.
    check(named, 1, {"goal_choice": [0.0, 0.0, 0.0], "bay_0_claim": [0.0, 0.0]})
    check(named, 1, {"agent_0_goal": [0, 0, 0, 1], "agent_1_goal": [1, 0, 0, 0]})
    for name in named:  # an explorer has no goal; a bay that is not there is zeros
        own = name.split("_")[0] in ("goal", "in") and name != "goal_choice"
        if own or name.startswith("bay_0"):
            np.testing.assert_array_equal(named[name][2], 0.0, err_msg=name)
    check(named, 2, {"goal_choice": [1.0, 0.0, 0.0]})


def test_rings_count_cars_if_asked_to():
    # Others' boxes begin 3 and 3 m from agent 0, a parked car 4 m, a wall 1.5 m away.
    layout = lot([(20.0, 0.0, 0.0)], [(0.0, 0.0, 0.0)])
    parked = [(2.0, -4.0, 0.0)]
    counts = {}
    for with_cars in (False, True):
        rings = RingConfig((5.9, 6.1, 8.1), cap=5, cars=with_cars)
        config = ContinuousObservation(rings=rings, rays=RayConfig())
        named = observed(config, layout, THREE, [0, 0, 0], parked)
        counts[with_cars] = [5 * named[f"ring_{d:g}m"][0, 0] for d in rings.diameters]
    np.testing.assert_allclose(counts[False], [1, 1, 1], atol=1e-6)
    np.testing.assert_allclose(counts[True], [1, 3, 4], atol=1e-6)


def test_the_past_of_the_rings_shifts():
    assert not BASE.init_memory(config_of(BASE, num_agents=3))
    assert not BASE.remember(state_of(BAYS, THREE, 0))
    rings = RingConfig((5.0, 8.0), history=2)
    observation = dataclasses.replace(BASE, rings=rings)
    config = config_of(observation, num_agents=3)
    history = observation.init_memory(config)
    np.testing.assert_array_equal(history["rings"], np.zeros((3, 2, 2)))
    # A wall of 1 m that comes nearer to all cars: out of both rings, in one, in both.
    at_origin = cars([(0.0, 0.0, 0.0)] * 3)
    for x in (9.0, 4.0, 2.0):
        layout = lot([(20.0, 0.0, 0.0)], [(x, 0.0, 0.0)])
        state = state_of(layout, at_origin, 0, memory=history)
        history = observation.remember(state)
    assert history["rings"].dtype == jnp.int32
    np.testing.assert_array_equal(
        history["rings"][0], [[0, 1], [1, 1]]
    )  # the newest last
    # In fields: now, two steps ago, one step ago, in units of the cap.
    named = observed(observation, BAYS, THREE, [0, 1, 2], history=history)
    names = [f.name for f in make_fields(config) if f.name.startswith("ring_")]
    assert names[2:4] == ["ring_5m_ago_2", "ring_8m_ago_2"]
    past = np.concatenate([named[name] for name in names[2:]], axis=1)
    np.testing.assert_array_equal(past, np.tile([0.0, 0.5, 0.5, 0.5], (3, 1)))
    unseen = observed(observation, BAYS, THREE, [0, 1, 2])
    np.testing.assert_array_equal([unseen[name] for name in names[2:]], 0.0)


def test_nearest_agents_and_parked_cars_are_tracked():
    motion = cars([(0.0, 0.0, 0.0), (3.0, 0.0, 0.0), (9.0, 0.0, 0.0)])

    def matrices(observation, present=True):
        parked = parked_at([(0.0, 2.0, 0.0), (50.0, 0.0, 0.0)], present=[present, True])
        state = state_of(BAYS, motion, 0, parked_cars=parked)
        config = config_of(observation)
        return tracks(config, state), tracks_parked_cars(config, state)

    agents, parked = matrices(ContinuousObservation(1, 1))
    np.testing.assert_array_equal(agents, [[0, 1, 0], [1, 0, 0], [0, 1, 0]])
    np.testing.assert_array_equal(parked, [[1, 0]] * 3)
    _, parked = matrices(ContinuousObservation(1, 1), present=False)
    np.testing.assert_array_equal(parked, [[0, 1]] * 3)
    assert not any(matrix.any() for matrix in matrices(ContinuousObservation(0, 0)))


@pytest.mark.parametrize("chosen", [False, True])
def test_motions_and_the_order_of_others_change_nothing(chosen):
    config = dataclasses.replace(RICH, share=ShareConfig(steering=True))
    # Cars anywhere in a `square` lot, and bays they track.
    rng, count = np.random.default_rng(0), 6
    low, high = (-15, -15, -3.1), (15, 15, 3.1)
    motion = cars(rng.uniform(low, high, (count, 3)), rng.uniform(-1, 3, count))
    layout = make_layout("square")
    bays = rng.permutation(36)
    parked = np.asarray(layout.bay_pose)[bays[:10]]
    tracked = np.stack([rng.permutation(bays[10:14])[:2] for _ in range(count)])
    goal = np.array([bays[10], NO_BAY, *bays[10 : 10 + count - 2]])
    counts = jnp.array(rng.integers(0, 3, (count, 2, 3)), jnp.int32)
    history = {"rings": counts}
    bays, goal = (tracked, goal) if chosen else (None, np.arange(6))
    here = observed(config, layout, motion, goal, parked, bays, history)
    shift = (3.0, -7.0, 0.6)
    there = (moved_lot(layout, shift), moved_cars(motion, shift), goal)
    there = observed(config, *there, moved(parked, shift), bays, history)
    rng = np.random.default_rng(1)
    order, mixed = np.array([0, 4, 2, 5, 1, 3]), rng.permutation(10)
    shuffled = jax.tree.map(lambda x: x[order], motion)
    bays = None if bays is None else bays[order]
    plan = (goal[order], parked[mixed], bays, {"rings": counts[order]})
    other = observed(config, layout, shuffled, *plan)
    for name, value in here.items():
        # float32 at 30 m is 2e-6 m, and headings are sums of rounded angles.
        np.testing.assert_allclose(there[name], value, atol=5e-6, err_msg=name)
        np.testing.assert_array_equal(other[name], value[order], err_msg=name)


def test_the_way_along_the_lanes_by_hand():
    """North along a lane to where it meets the aisle of the goal, then east."""
    lanes = build.lanes(
        [(0.0, 0.0, math.pi / 2), (10.0, 10.0, 0.0)], [(24.0, 4.0), (24.0, 4.0)]
    )
    bay = build.bays([(12.0, 14.5, -math.pi / 2)], (5.0, 2.5))
    layout = build.assemble((30.0, 30.0), lanes, bay)
    config = EnvConfig(observation=ContinuousObservation(route=True))
    motion = cars([(0.0, -4.0, math.pi / 2), (8.0, 10.0, math.pi)])
    state = state_of(layout, motion, [0, 0], routes=make_routes(layout))
    named = fields_of(observe_jit(config, state), config)
    onward, direct = math.hypot(12, 4.5), math.hypot(4, 4.5)
    first = {"route_next": [14 / 20, 0.0], "route_length": [(14 + onward) / 20]}
    second = {"route_next": [-4 / 20, -4.5 / 20], "route_length": [direct / 20]}
    check(named, 0, first)
    check(named, 1, second)


# Rays and ultrasound


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


def metres(layout, motion, parked):
    """Rays (agents, count) [m]."""
    around = lot_obstacles(layout, motion, parked)
    return REACH * cast_rays(RayConfig(COUNT, REACH), motion, around)


rays_of, near_rays_of = both_phases(metres)


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
    got = rays_of(*scene)
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
    every, near = rays_of(*scene), near_rays_of(*scene)
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
