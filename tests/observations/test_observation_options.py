"""Shared goals and speeds, dynamic goals, rivals, rings' past, limits of the view."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.observing import observe_jit
from helpers.scenes import cars, fields_of, lot, moved, moved_cars, moved_lot
from helpers.states import config_of, parked_at, state_of

from carpark_mj.config import EnvConfig, RayConfig, RingConfig, ShareConfig
from carpark_mj.layouts import build, make_layout
from carpark_mj.layouts.routes import make_routes
from carpark_mj.mdp.goals import tracks
from carpark_mj.mdp.parked_cars import tracks_parked_cars
from carpark_mj.observations import ContinuousObservation, make_fields
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
NONE = NO_BAY
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
    bays = [[2, 0], [1, NONE], [NONE, 2]]
    named = observed(config, BAYS, THREE, [0, 2, NONE], (), bays)
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
    assert BASE.init_memory(config_of(BASE, num_agents=3)) is None
    assert BASE.remember(state_of(BAYS, THREE, 0)) is None
    rings = RingConfig((5.0, 8.0), history=2)
    observation = dataclasses.replace(BASE, rings=rings)
    config = config_of(observation, num_agents=3)
    history = observation.init_memory(config)
    assert history is not None
    np.testing.assert_array_equal(history, np.zeros((3, 2, 2)))
    # A wall of 1 m that comes nearer to all cars: out of both rings, in one, in both.
    at_origin = cars([(0.0, 0.0, 0.0)] * 3)
    for x in (9.0, 4.0, 2.0):
        layout = lot([(20.0, 0.0, 0.0)], [(x, 0.0, 0.0)])
        state = state_of(layout, at_origin, 0, memory=history)
        history = observation.remember(state)
    assert history.dtype == jnp.int32
    np.testing.assert_array_equal(history[0], [[0, 1], [1, 1]])  # the newest last
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
    history = jnp.array(rng.integers(0, 3, (count, 2, 3)), jnp.int32)
    bays, goal = (tracked, goal) if chosen else (None, np.arange(6))
    here = observed(config, layout, motion, goal, parked, bays, history)
    shift = (3.0, -7.0, 0.6)
    there = (moved_lot(layout, shift), moved_cars(motion, shift), goal)
    there = observed(config, *there, moved(parked, shift), bays, history)
    rng = np.random.default_rng(1)
    order, mixed = np.array([0, 4, 2, 5, 1, 3]), rng.permutation(10)
    shuffled = jax.tree.map(lambda x: x[order], motion)
    bays = None if bays is None else bays[order]
    plan = (goal[order], parked[mixed], bays, history[order])
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
