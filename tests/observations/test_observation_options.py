"""Shared goals and speeds, chosen goals, rivals, rings' past and limits of the view."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import cars, fields_of, lot, moved, moved_cars, moved_lot

from carpark_mj.config import (
    TANNER_OBSERVATION,
    EnvConfig,
    GoalConfig,
    ObservationConfig,
)
from carpark_mj.env import ParkingEnv
from carpark_mj.layouts import make_layout
from carpark_mj.observations import make_fields, markdown_table, observe
from carpark_mj.observations.rings import forget, init_history, remember
from carpark_mj.observations.tracking import in_view, tracks
from carpark_mj.registry import TANNER_QLEARNING

BASE = ObservationConfig()
# Everything at once; two bays of four are tracked where goals are chosen.
RICH = ObservationConfig(
    tracked_agents=3,
    ring_cars=True,
    ring_history=2,
    global_information=True,
    field_of_view=250.0,
    tracking_diameter=24.0,
)

observe_jit = jax.jit(observe, static_argnums=0)


def observed(config, layout, vehicle, goal, parked=(), spaces=None, history=None):
    """Named fields of all agents; parked cars are poses."""
    parked = jnp.asarray(parked, jnp.float32).reshape(-1, 3)
    count = vehicle.size.shape[0]
    spaces = None if spaces is None else jnp.array(spaces, jnp.int32)
    observation = observe_jit(
        config,
        layout,
        vehicle,
        jnp.array(goal, jnp.int32),
        parked,
        jnp.full((parked.shape[0], 2), 2.0),
        jnp.full(count, 3.0),
        jnp.full(count, 0.6),
        spaces=spaces,
        ring_history=history,
    )
    return fields_of(observation, config, 0 if spaces is None else spaces.shape[1])


def check(named, agent, expected):
    for name, value in expected.items():
        np.testing.assert_allclose(named[name][agent], value, atol=1e-6, err_msg=name)


# Bays of 6 m x 3 m and cars of 4 m x 2 m. Agent 0 faces north, agent 1, 4 m ahead of
# it, west; agent 2 stands 5 m to the left of agent 0 and faces east.
BAYS = lot([(2.0, 9.0, math.pi / 2), (-4.0, 0.0, 0.0), (12.0, 1.0, math.pi), (2, 2, 0)])
NONE = 4  # no bay, exploring
THREE = cars(
    [(2.0, 1.0, math.pi / 2), (2.0, 5.0, math.pi), (-3.0, 1.0, 0.0)],
    speed=[1.5, -0.6, 3.0],
)


def test_what_is_not_shared_is_left_out_and_the_rest_stays():
    plan = (BAYS, THREE, [0, 1, 2], [(2.0, 2.0, 0.0)])
    everything = observed(BASE, *plan)
    for option, parts in (
        ("share_speeds", {"agent_0_speed", "agent_1_speed"}),
        ("share_goals", {"agent_0_goal", "agent_1_goal"}),
    ):
        named = observed(dataclasses.replace(BASE, **{option: False}), *plan)
        assert set(everything) - set(named) == parts
        for name, value in named.items():
            np.testing.assert_array_equal(value, everything[name], err_msg=name)


def test_fixed_goals_with_headings_and_rivals_by_hand():
    config = dataclasses.replace(BASE, share_goal_heading=True, global_information=True)
    named = observed(config, BAYS, THREE, [0, 1, 2])
    expected = {
        # Agent 1's goal faces east, agent 2's west; agent 0 looks north.
        "agent_0_goal_heading": [0.0, -1.0],
        "agent_1_goal_heading": [0.0, 1.0],
        # The goal 8 m ahead is 4 m from agent 1, whose goal it is not.
        "goal_nearest_agent": [4 / 20],
        "goal_claim": [1.0, 8 / 20],
    }
    check(named, 0, expected)


def test_chosen_goals_by_hand():
    config = dataclasses.replace(BASE, rings=(), global_information=True)
    spaces = [[2, 0], [1, NONE], [NONE, 2]]
    named = observed(config, BAYS, THREE, [0, 2, NONE], (), spaces)
    expected = {
        "goal_position": [8 / 20, 0.0],
        "goal_choice": [0.0, 0.0, 1.0],  # the second of its bays
        # 10 m to the right, facing left; agent 1 has it as goal and is the nearest
        # of those, sqrt(10^2 + 4^2) m away, but agent 0 is nearer.
        "space_0_present": [1.0],
        "space_0_position": [0.0, -10 / 20],
        "space_0_near_position": [0.0, -1.0],
        "space_0_heading": [0.0, 1.0],
        "space_0_size": [2 / 5, 1 / 5],
        "space_0_distance": [10 / 20],
        "space_0_nearest_agent": [10 / 20],
        "space_0_claim": [1.0, math.sqrt(116) / 20],
        "space_1_position": [8 / 20, 0.0],
        "space_1_nearest_agent": [4 / 20],
        "space_1_claim": [1.0, 8 / 20],
        # Agent 1, the nearest, heads for the first of agent 0's bays; 2 explores.
        "agent_0_goal": [0.0, 1.0, 0.0, 0.0],
        "agent_1_goal": [1.0, 0.0, 0.0, 0.0],
    }
    check(named, 0, expected)
    # Agent 1's goal is not among its bays; agent 0's neither, agent 2 explores.
    check(named, 1, {"goal_choice": [0.0, 0.0, 0.0], "space_0_claim": [0.0, 0.0]})
    check(named, 1, {"agent_0_goal": [0, 0, 0, 1], "agent_1_goal": [1, 0, 0, 0]})
    for name in named:  # an explorer has no goal; a bay that is not there is zeros
        own = name.split("_")[0] in ("goal", "in") and name != "goal_choice"
        if own or name.startswith("space_0"):
            np.testing.assert_array_equal(named[name][2], 0.0, err_msg=name)
    check(named, 2, {"goal_choice": [1.0, 0.0, 0.0]})


def test_rings_count_cars_if_asked_to():
    # Others' boxes begin 3 and 3 m from agent 0, a parked car 4 m, a wall 1.5 m away.
    layout = lot([(20.0, 0.0, 0.0)], [(0.0, 0.0, 0.0)])
    parked = [(2.0, -4.0, 0.0)]
    counts = {}
    for ring_cars in (False, True):
        config = ObservationConfig(
            rings=(5.9, 6.1, 8.1), ring_cap=5, ring_cars=ring_cars
        )
        named = observed(config, layout, THREE, [0, 0, 0], parked)
        counts[ring_cars] = [5 * named[f"ring_{d:g}m"][0, 0] for d in config.rings]
    np.testing.assert_allclose(counts[False], [1, 1, 1], atol=1e-6)
    np.testing.assert_allclose(counts[True], [1, 3, 4], atol=1e-6)


def test_the_past_of_the_rings_shifts_and_is_forgotten():
    config = dataclasses.replace(BASE, ring_history=2, rings=(5.0, 8.0))
    assert init_history(BASE, 3) is forget(None, jnp.ones(3, bool)) is None
    history = init_history(config, 3)
    assert history is not None
    for step in range(1, 4):
        history = remember(history, jnp.full((3, 2), step) + jnp.array([0, 10]))
    assert history.dtype == jnp.int32
    np.testing.assert_array_equal(history[0], [[2, 12], [3, 13]])  # the newest last
    left = forget(history, jnp.array([False, True, False]))
    assert left is not None
    np.testing.assert_array_equal(left[1], 0)
    np.testing.assert_array_equal(left[::2], history[::2])
    # In fields: now, two steps ago, one step ago, in units of the cap.
    named = observed(config, BAYS, THREE, [0, 1, 2], (), None, history)
    names = [field.name for field in make_fields(config)][-6:]
    assert names[2:4] == ["ring_5m_ago_2", "ring_8m_ago_2"]
    past = np.concatenate([named[name] for name in names[2:]], axis=1)
    np.testing.assert_array_equal(past, np.tile([1.0, 6.0, 1.5, 6.5], (3, 1)))
    unseen = observed(config, BAYS, THREE, [0, 1, 2])
    np.testing.assert_array_equal([unseen[name] for name in names[2:]], 0.0)


# Around (2, 1), facing north: ahead, left, right, behind, at 4, 5, 6, 3 m.
AROUND = jnp.array([(2.0, 5.0), (-3.0, 1.0), (8.0, 1.0), (2.0, -2.0)])


@pytest.mark.parametrize(
    ("field_of_view", "diameter", "expected"),
    [
        (360.0, None, [1, 1, 1, 1]),
        (360.0, 10.1, [1, 1, 0, 1]),
        (360.0, 7.9, [0, 0, 0, 1]),
        (359.0, None, [1, 1, 1, 0]),
        (181.0, None, [1, 1, 1, 0]),
        (179.0, None, [1, 0, 0, 0]),
        (181.0, 10.1, [1, 1, 0, 0]),
        (1.0, 7.9, [0, 0, 0, 0]),
    ],
)
def test_the_view_is_a_sector_about_the_heading(field_of_view, diameter, expected):
    config = ObservationConfig(field_of_view=field_of_view, tracking_diameter=diameter)
    own = jnp.array([(2.0, 1.0, math.pi / 2)])
    np.testing.assert_array_equal(in_view(config, own, AROUND)[0], expected)
    np.testing.assert_array_equal(in_view(config, own, AROUND[None])[0], expected)


def test_cars_and_bays_out_of_view_are_not_tracked():
    poses = [(2.0, 1.0, math.pi / 2), *((x, y, 0.0) for x, y in AROUND.tolist())]
    vehicle, layout = cars(poses), lot([(x, y, 0.0) for x, y in AROUND.tolist()])
    wide = ObservationConfig(tracked_agents=4, tracked_parked_cars=4)
    narrow = dataclasses.replace(wide, field_of_view=181.0, tracking_diameter=10.1)
    goal, spaces = [4, 0, 1, 2, 3], [[0, 1, 2, 3]] * 5
    sees = observed(wide, layout, vehicle, goal, poses[1:], spaces)
    cut = observed(narrow, layout, vehicle, goal, poses[1:], spaces)
    for kind in ("agent", "parked", "space"):
        seen = [sees[f"{kind}_{k}_present"][0, 0] for k in range(4)]
        left = [cut[f"{kind}_{k}_present"][0, 0] for k in range(4)]
        assert (seen, left) == ([1, 1, 1, 1], [1, 1, 0, 0]), kind
    # Nearest first: of the car behind at 3 m nothing is left, nor of its goal's place.
    np.testing.assert_allclose(sees["agent_0_position"][0], [-3 / 20, 0.0], atol=1e-6)
    np.testing.assert_allclose(cut["agent_0_position"][0], [4 / 20, 0.0], atol=1e-6)
    np.testing.assert_array_equal(cut["agent_1_goal"][0], [0, 0, 1, 0, 0, 0])
    matrix = tracks(narrow, vehicle.pose_w, jnp.zeros((0, 2)))
    np.testing.assert_array_equal(matrix[0], [0, 1, 1, 0, 0])


def test_who_tracks_whom_depends_on_the_encoding():
    xy = jnp.array([(0.0, 0.0, 0.0), (3.0, 0.0, 0.0), (9.0, 0.0, 0.0)])
    parked = jnp.array([(0.0, 2.0)])
    # With one list of one car agent 0 tracks the parked car, 1 and 2 an agent.
    one = tracks(TANNER_OBSERVATION, xy, parked)
    np.testing.assert_array_equal(one, [[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    gone = tracks(TANNER_OBSERVATION, xy, parked, jnp.array([False]))
    np.testing.assert_array_equal(gone, [[0, 1, 0], [1, 0, 0], [0, 1, 0]])
    agents = tracks(ObservationConfig(tracked_agents=1), xy, parked)
    np.testing.assert_array_equal(agents, gone)
    assert not tracks(TANNER_QLEARNING.observation, xy, parked).any()


def scene(count=6):
    """Cars anywhere in a `tanner` lot, and bays they track."""
    rng = np.random.default_rng(0)
    low, high = (-15, -15, -3.1), (15, 15, 3.1)
    vehicle = cars(rng.uniform(low, high, (count, 3)), rng.uniform(-1, 3, count))
    layout = make_layout("tanner")
    bays = rng.permutation(36)
    parked = np.asarray(layout.bay_pose)[bays[:10]]
    spaces = np.stack([rng.permutation(bays[10:14])[:2] for _ in range(count)])
    goal = np.array([bays[10], 36, *bays[10 : 10 + count - 2]])
    history = jnp.array(rng.integers(0, 3, (count, 2, 3)), jnp.int32)
    return layout, vehicle, goal, parked, spaces, history


@pytest.mark.parametrize("chosen", [False, True])
def test_motions_and_the_order_of_others_change_nothing(chosen):
    config = dataclasses.replace(RICH, share_goal_heading=not chosen)
    layout, vehicle, goal, parked, spaces, history = scene()
    if not chosen:
        spaces, goal = None, np.arange(6)
    here = observed(config, layout, vehicle, goal, parked, spaces, history)
    motion = (3.0, -7.0, 0.6)
    there = (moved_lot(layout, motion), moved_cars(vehicle, motion), goal)
    there = observed(config, *there, moved(parked, motion), spaces, history)
    order, mixed = (
        np.array([0, 4, 2, 5, 1, 3]),
        np.random.default_rng(1).permutation(10),
    )
    shuffled = jax.tree.map(lambda x: x[order], vehicle)
    bays = None if spaces is None else spaces[order]
    plan = (goal[order], parked[mixed], bays, history[order])
    other = observed(config, layout, shuffled, *plan)
    for name, value in here.items():
        # float32 at 30 m is 2e-6 m, and headings are sums of rounded angles.
        np.testing.assert_allclose(there[name], value, atol=5e-6, err_msg=name)
        np.testing.assert_array_equal(other[name], value[order], err_msg=name)
    present = [here[f"agent_{k}_present"] for k in range(3)]
    assert 0 < np.mean(present) < 1  # the limits of the view cut some


@pytest.mark.parametrize("num_spaces", [0, 2])
def test_fields_have_ranges_meanings_and_names_of_their_own(num_spaces):
    for config in (RICH, dataclasses.replace(TANNER_OBSERVATION, tracked_cars=3)):
        fields = make_fields(config, None, num_spaces)
        assert len({field.name for field in fields}) == len(fields)
        assert all(field.low < field.high and field.meaning for field in fields)
    rows = markdown_table(dataclasses.replace(TANNER_OBSERVATION, tracked_cars=3))
    assert "car_0_speed" in rows
    assert "car_1_speed" not in rows


def test_the_values_stay_within_the_declared_ranges():
    layout, vehicle, goal, parked, spaces, history = scene()
    named = observed(RICH, layout, vehicle, goal, parked, spaces, history)
    for field in make_fields(RICH, None, 2):
        assert named[field.name].min() >= field.low - 1e-5, field
        assert named[field.name].max() <= field.high + 1e-5, field


LISTED = {"encoding": "tanner", "tracked_agents": 0, "tracked_parked_cars": 0}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"ring_history": -1}, "ring_history must be at least 0, not -1"),
        ({"ring_history": 2, "rings": ()}, "ring_history 2 needs rings"),
        ({"rings": (4.0, -1.0)}, r"rings must be positive .* \(4.0, -1.0\)"),
        ({"field_of_view": 0.0}, r"field_of_view must lie in \(0, 360\] deg, not 0.0"),
        ({"field_of_view": 400.0}, r"field_of_view must lie .* not 400.0"),
        ({"field_of_view": math.nan}, r"field_of_view must lie .* not nan"),
        ({"tracking_diameter": 0.0}, "must be positive or None, not 0.0"),
        ({"tracking_diameter": math.inf}, "must be positive or None, not inf"),
        ({"tracked_cars": -1}, "tracked_cars must be at least 0, not -1"),
        ({"tracked_cars": 2}, "'continuous' has no tracked_cars: it must be 0, not 2"),
        ({"bay_parts": ("bearing",)}, "'continuous' has no bay_parts"),
        ({"share_goals": False, "share_goal_heading": True}, "needs share_goals"),
        ({"encoding": "tanner"}, r"tracks cars in one list: .* be 0, not 2 and 2"),
        (LISTED | {"bay_parts": ("size",)}, "unknown bay part 'size'"),
        (LISTED | {"bay_parts": ("bearing",) * 2}, "bay_parts must be different"),
        (LISTED | {"rays": 3}, "'tanner' has no rays: it must be 0, not 3"),
        (LISTED | {"encoding": "indices", "lane": True}, "'indices' has no lane"),
    ],
)
def test_settings_that_mean_nothing_are_refused_in_a_sentence(change, message):
    with pytest.raises(ValueError, match=message) as caught:
        ObservationConfig(**change)
    assert "\n" not in str(caught.value)


def test_chosen_goals_need_bays_and_an_encoding_that_has_them():
    chosen = GoalConfig(dynamic=True, num_spaces=21)
    with pytest.raises(ValueError, match=r"num_spaces must be at most 20 .* not 21"):
        ParkingEnv(EnvConfig(goals=chosen, num_parked_cars=16))
    heading = ObservationConfig(share_goal_heading=True)
    with pytest.raises(ValueError, match="share_goal_heading needs fixed goals"):
        EnvConfig(goals=chosen, observation=heading)
    with pytest.raises(ValueError, match="'indices' needs fixed goals"):
        dataclasses.replace(TANNER_QLEARNING, goals=chosen)
