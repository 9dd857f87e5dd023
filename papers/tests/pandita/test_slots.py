"""The lots of Pandita 2022 against positions worked by hand from the thesis."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from helpers.scenes import polygons

from carpark_mj.config import LAYOUTS, EnvConfig, FleetConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.layouts import BayKind, layout_config, make_layout, mixture
from carpark_mj.layouts.checks import describe_faults
from carpark_mj.layouts.files import layout_text
from carpark_mj.observations import ContinuousObservation
from carpark_mj.spawning.checks import check_numbers
from carpark_mj.spawning.reset_options import ResetOptions
from carpark_papers.pandita.layouts import SlotsConfig, centre_lines

NAMES = [name for name in LAYOUTS if name.startswith("slots")]
EXACT = 2e-6  # m; float32 at 30 m


def goal(layout):
    """The goal (x, y, heading in degrees) of a car that is head-in."""
    [x, y, yaw] = np.asarray(layout.bay_pose)[np.asarray(layout.goal_mask)][0]
    return [x, y, math.degrees(yaw + math.pi) % 360.0]


@pytest.mark.parametrize("name", NAMES)
def test_the_pictured_scenarios_are_valid_lots_for_his_car(name):
    config, layout = layout_config(name), make_layout(name)
    assert describe_faults(layout) == []
    assert describe_faults(layout, (5.0, 2.0)) == []
    assert layout.num_bays == config.min_bays == 2 * config.slots_per_row
    assert int(layout.goal_mask.sum()) == 1
    kinds = np.asarray(layout.bay_kind)
    assert (kinds == BayKind.RESERVED).sum() == layout.num_bays - 1


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("slots", (-6, 14, 90)),
        ("slots_diagonal", (-9, 14, 126.8699)),
        ("slots_parallel", (-9, 10, 180)),
        ("slots_single", (-2, 14, 90)),
        ("slots_single_diagonal", (-5, 14, 126.8699)),
    ],
)
def test_the_goal_is_the_middle_of_its_slot_head_in(name, expected):
    np.testing.assert_allclose(goal(make_layout(name)), expected, atol=1e-4)


@pytest.mark.parametrize(
    ("name", "slot", "begin", "end"),
    [
        ("slots", 0, (-14, 10), (-14, 18)),
        ("slots", 5, (6, 10), (6, 18)),
        ("slots", 11, (6, -10), (6, -18)),
        ("slots_diagonal", 2, (-6, 10), (-12, 18)),
        ("slots_diagonal", 8, (0, -10), (-6, -18)),
        ("slots_parallel", 0, (-23, 10), (-31, 10)),
        ("slots_parallel", 5, (22, 10), (14, 10)),
        ("slots_parallel", 8, (-13, -10), (-5, -10)),
    ],
)
def test_slots_lie_where_the_specification_has_them(name, slot, begin, end):
    first, last = centre_lines(layout_config(name))
    np.testing.assert_array_equal(first[slot], begin)
    np.testing.assert_array_equal(last[slot], end)


def test_parked_cars_stand_4_m_along_their_slots():
    pose = np.asarray(make_layout("slots").bay_pose)
    np.testing.assert_allclose(pose[[0, 11], :2], [(-14, 14), (6, -14)], atol=EXACT)
    # Along (-0.6, 0.8) of a line 10 m long, whose middle is 5 m along.
    pose = np.asarray(make_layout("slots_diagonal").bay_pose)
    expected = [(-14 - 2.4, 13.2), (6 + 6 - 2.4, -13.2)]
    np.testing.assert_allclose(pose[[0, 11], :2], expected, atol=EXACT)
    turned = np.degrees(pose[[0, 11], 2]) % 360.0 - 180.0
    np.testing.assert_allclose(turned, [126.8699, -126.8699], atol=1e-4)


@pytest.mark.parametrize("name", NAMES)
def test_obstacles_stand_in_two_rows_of_squares(name):
    layout, n = make_layout(name), layout_config(name).slots_per_row
    size = np.asarray(layout.wall_size)
    np.testing.assert_array_equal(size, np.full((2 * (n + 6), 2), 2.0))
    pose = np.asarray(layout.wall_pose)
    first = {6: -26, 1: -14}[n]
    x = first + 4 * np.arange(n + 6)
    for row, y in ((pose[: n + 6], 19), (pose[n + 6 :], -19)):
        np.testing.assert_array_equal(row, np.stack([x, 0 * x + y, 0 * x], axis=-1))
    empty = make_layout(SlotsConfig(obstacles=False))
    assert empty.wall_mask.shape == (0,)
    assert describe_faults(empty) == []


def test_the_car_starts_at_10_0_facing_west_unless_told_otherwise():
    layout = make_layout("slots_parallel")
    np.testing.assert_allclose(layout.spawn_pose, [[10, 0, -math.pi]], atol=EXACT)
    assert float(layout.spawn_size.max()) < 2e-3
    assert not layout.spawn_spread.any()
    anywhere = make_layout(SlotsConfig(start=(-3.0, 1.0), start_heading=None))
    np.testing.assert_array_equal(anywhere.spawn_pose[0, :2], [-3.0, 1.0])
    assert float(anywhere.spawn_spread[0]) == pytest.approx(math.pi)


@pytest.mark.parametrize("shift", [0.0, 3.0, -6.0])
def test_bays_are_the_largest_rectangles_between_the_lines(shift):
    config = SlotsConfig(diagonal_shift=shift, slot_width=4.0)
    layout = make_layout(config)
    begin, end = centre_lines(config)
    aside = np.array([2.0, 0.0])
    corners = np.stack([begin - aside, begin + aside, end + aside, end - aside], 1)
    slot = shapely.polygons(corners)
    pose = np.concatenate([(begin + end) / 2, layout.bay_pose[:, 2:]], axis=1)
    bay = polygons(pose, np.asarray(layout.bay_size))
    assert shapely.covers(shapely.buffer(slot, 1e-4), bay).all()
    wider = polygons(pose, np.asarray(layout.bay_size) + 0.01)
    assert not shapely.covers(slot, wider).any()


def test_a_random_goal_is_any_slot_and_the_others_are_reserved():
    config = SlotsConfig(slots_per_row=3, goal_slot=None)
    keys = jax.random.split(jax.random.key(0), 100)
    drawn = jax.jit(jax.vmap(config.generate))(keys)
    assert (drawn.goal_mask.sum(axis=1) == 1).all()
    assert set(np.argmax(drawn.goal_mask, axis=1).tolist()) == set(range(6))
    assert config.is_random
    assert not SlotsConfig().is_random


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"goal_slot": 12}, "goal_slot must be a whole number from 0 to 11, .* not 12"),
        ({"half_corridor": 0.5}, r"half_corridor must be at least 1.00 m, .* not 0.5"),
        ({"half_corridor": 2.9, "parallel": True}, "at least 3.00 m"),
        ({"start": (10.0, 9.5)}, "half_corridor must be at least 10.50 m"),
        ({"start": (math.inf, 0.0)}, "start must be finite"),
        ({"slot_length": 4.0}, "4.00 m x 4.00 m between their lines, the car needs"),
        ({"diagonal_shift": 20.0}, "diagonal_shift 20.0 m have .* the car needs"),
        ({"diagonal_shift": 6.0, "parallel": True}, "diagonal_shift must be 0 in"),
    ],
)
def test_lots_that_cannot_exist_are_refused_in_one_sentence(changes, message):
    with pytest.raises(ValueError, match=message) as caught:
        SlotsConfig(**changes)
    assert "\n" not in str(caught.value)


def test_a_second_agent_is_refused_for_it_has_no_bay(tmp_path):
    path = tmp_path / "slots.json"
    path.write_text(layout_text(make_layout("slots")))
    mixed = mixture([SlotsConfig(), "square"])
    for layout in ("slots", "slots_parallel", mixed, str(path)):
        one = EnvConfig(layout=layout, num_agents=1, num_parked_cars=11)
        check_numbers(one, layout_config(layout))
        two = dataclasses.replace(one, num_agents=2, num_parked_cars=3)
        with pytest.raises(ValueError, match="num_agents must be at most 1"):
            check_numbers(two, layout_config(layout))


def test_a_van_is_not_sent_into_a_bay_it_does_not_fit():
    config = EnvConfig(
        layout="slots",
        num_agents=1,
        num_parked_cars=0,
        physics="bicycle",
        fleet=FleetConfig(agents=("city", "suv")),
        observation=ContinuousObservation(own_car=True),
    )
    reset, asked = jax.jit(ParkingEnv(config).reset), ResetOptions(goal=jnp.array([2]))
    for key in jax.random.split(jax.random.key(0), 5):
        state, _ = reset(key, options=asked)
        assert (state.motion.size[0] <= state.layout.bay_size[2]).all()


def test_reserved_bays_are_no_goals_of_more_agents():
    """In `slots` one bay of twelve can be a goal."""
    config = EnvConfig(
        layout="slots",
        num_agents=7,
        min_agents=1,
        num_parked_cars=11,
        occupancy=(0.2, 0.8),
        physics="bicycle",
    )
    reset = jax.jit(ParkingEnv(config).reset)
    state, _ = reset(jax.random.key(0), num_present=jnp.int32(7))
    assert state.present.sum() == 1
    assert state.layout.goal_mask[state.goal[0]]
