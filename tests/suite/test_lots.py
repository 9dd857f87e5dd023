"""Levels of whole lots: cars, goals, sizes, and where cars drive in MetaDrive's."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.cases import AMONG, drives, episode
from shapely import LineString, Point, Polygon

from carpark_mj.config import EnvConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.geometry import box_corners, boxes_overlap
from carpark_mj.layouts import make_layout
from carpark_mj.layouts.checks import describe_faults
from carpark_mj.layouts.types import BayKind
from carpark_mj.registry import ANYWHERE, CONSIDERATE, SQUARE
from carpark_mj.spawning.reset_options import check_starts
from carpark_mj.suite.evaluation import (
    BLIND,
    SuiteConfig,
    policy_env,
    require_cases,
    suite_env,
)
from carpark_mj.suite.levels import find_level, pick_cases, require_filmed
from carpark_mj.suite.lots import NAMES, PARKED, read_sheets
from carpark_mj.suite.metadrive import MetaDriveConfig
from carpark_mj.suite.report import by_level, same_columns, table_rows
from carpark_mj.suite.results import key_of, read_runs, write_run
from carpark_mj.types import NO_BAY

COUNT = 12
ENV = dataclasses.replace(suite_env(ANYWHERE, "strict"), physics="bicycle")


def test_movers_come_from_the_level_not_from_the_policy():
    env = suite_env(CONSIDERATE, "strict")
    moving = {name: find_level(name).env(env).movers for name in ("sheets", "tpcap")}
    assert moving == {"sheets": (), "tpcap": ()}
    assert find_level("busy").env(env).movers == find_level("busy").env(ENV).movers


def begin(level):
    """Cases, and the states with which they begin."""
    cases, env = pick_cases(level, COUNT), ParkingEnv(find_level(level).env(ENV))

    def reset(layout, start):
        return env.reset_to_layout(layout, start.key, None, start.options)[0]

    states = jax.device_get(jax.jit(jax.vmap(reset))(cases.layouts, cases.start))
    goal = states.goal[:, 0], np.arange(COUNT)
    check_starts(env.config, cases.start.options, states)
    assert not (states.goal == NO_BAY).any()
    return cases, states, goal[::-1]


def test_every_sheet_drives_in_turn_to_a_bay_that_it_fits_in():
    cases, states, goal = begin("sheets")
    cars = list(read_sheets().values())
    assert cases.kind.tolist() == list(NAMES)
    sizes = np.array([[car.length, car.width] for car in cars])
    np.testing.assert_allclose(states.motion.size[:, 0], sizes, rtol=1e-6)
    axles = [car.wheelbase for car in cars]
    np.testing.assert_allclose(states.physics.vehicle.wheelbase[:, 0], axles, 1e-6)
    room = states.layout.bay_size[goal] - sizes
    assert room.min() > ENV.episode.slack - 1e-5
    assert (states.parked_cars.bay != NO_BAY).any(axis=1).all()


@pytest.mark.parametrize("level", ["sheets", *PARKED, "metadrive"])
def test_planner_zero_and_random_meet_the_cases_of_policies(level):
    config, to_env = SuiteConfig(("zero",)), find_level(level).env
    shown = to_env(policy_env("anywhere", ANYWHERE, config))
    for name in BLIND:
        env = to_env(policy_env(name, EnvConfig(), config))
        for field in ("layout", "fleet", "jitter", "occupancy", "num_parked_cars"):
            assert getattr(env, field) == getattr(shown, field)
    with pytest.raises(ValueError, match=r"own_car"):  # it would not know its car
        find_level("sheets").env(policy_env("square", SQUARE, config))


@pytest.mark.parametrize("level", PARKED)
def test_a_car_in_a_real_car_park_gets_a_bay_it_fits_in(level):
    _, states, goal = begin(level)
    room = states.layout.bay_size[goal] - states.motion.size[:, 0]
    assert room.min() > ENV.episode.slack - 1e-5
    assert ((states.parked_cars.bay != NO_BAY).sum(axis=1) == PARKED[level]).all()
    assert len(np.unique(states.layout.extent, axis=0)) == 1
    assert len(np.unique(states.layout.bay_mask.sum(axis=1))) > 3


def test_cars_drive_in_to_metadrives_spaces_and_out_of_them():
    _, states, goal = begin("metadrive")
    leaves = states.layout.bay_kind[goal] == BayKind.EXIT
    assert 0 < leaves.sum() < COUNT
    at = states.motion.pose_w[:, 0, None, :2] - states.layout.bay_pose[..., :2]
    spaces = np.hypot(*np.moveaxis(at, -1, 0))[:, :8]  # exits follow them
    np.testing.assert_array_equal(spaces.min(axis=1) < 3.0, leaves)


def test_levels_of_other_columns_are_read_and_shown_together(tmp_path):
    rows = [
        episode(0),
        episode(1, end="crashed", kind="perpendicular"),
        episode(0, "busy", **AMONG),
        episode(0, "sheets", policy="y"),
    ]
    write_run(tmp_path, rows, {key_of(rows[0]): drives(9)})
    read, _ = read_runs([tmp_path])
    assert sorted(map(key_of, read)) == sorted(map(key_of, rows))
    busy = next(row for row in read if row["level"] == "busy")
    assert {**AMONG}.items() <= busy.items()
    assert all("least_gap" not in row for row in read if row is not busy)
    table = same_columns([r for name in "xy" for r in table_rows(name, read)])
    assert len({tuple(row) for row in table}) == 1
    assert [row["least gap [m]"] for row in table if row["level"] == "busy"] == [1.0]
    shown = by_level(table)
    assert [row["policy"] for row in shown] == ["x", "y"]
    assert list(shown[0]) == ["policy", "normal", "busy", "sheets"]
    assert shown[0]["normal"].startswith("50.0 (")
    assert (shown[0]["sheets"], shown[1]["normal"]) == ("–", "–")
    # Within a level columns still have to agree.
    other = tmp_path / "other"
    other.mkdir()
    more = [episode(2, **AMONG)]
    write_run(other, more, {key_of(more[0]): drives(9)})
    with pytest.raises(ValueError, match=r"x with different columns"):
        read_runs([tmp_path, other])


def test_levels_with_fewer_cases_are_driven_whole():
    config = SuiteConfig(("zero",), levels=("tpcap", "metadrive"), cases=100)
    require_cases(config)
    assert [len(pick_cases(x, 100).number) for x in config.levels] == [20, 100]
    with pytest.raises(ValueError, match=r"first_case must be 0 to 19"):
        require_cases(dataclasses.replace(config, first_case=20))


def test_files_cannot_be_filmed_where_something_moves_or_parks():
    require_filmed("tpcap")
    for level in ("busy", "san_jose"):
        with pytest.raises(ValueError, match=level):
            require_filmed(level)


CAR = (4.515, 1.852)  # MetaDrive's default car [m]
# The lot's middle in coordinates whose x begins with the road: half of 20 + 2 * 4 +
# 3 * 3.5 + 4 + 10 + 1.5 * 3.5.
MIDDLE = np.array([57.75 / 2, 0.0])


@pytest.fixture(scope="module")
def layout():
    return make_layout("metadrive")


def test_spaces_exits_and_starts_lie_where_metadrive_has_them(layout):
    assert not describe_faults(layout, CAR)
    kind = np.asarray(layout.bay_kind)
    assert kind.tolist() == [BayKind.STANDARD] * 8 + [BayKind.EXIT] * 3
    bay = np.asarray(layout.bay_pose)
    at = bay[:, :2] + MIDDLE
    # Spaces 3.5 m x 8 m, side by side, 4 m from the middles of the lanes at 1.75 m.
    columns = (24.0, 27.5, 31.0, 34.5)
    expected = [(x, y) for y in (-9.75, 9.75) for x in columns]
    np.testing.assert_allclose(at[:8], expected, atol=1e-5)
    assert np.unique(layout.bay_size[:8], axis=0).tolist() == [[8.0, 3.5]]
    np.testing.assert_allclose(np.sin(bay[:8, 2]), [1.0] * 4 + [-1.0] * 4)
    # The lane that leaves by the road ends where the road's second half begins; those
    # of the arms end 10 m beyond right turns of 10 m radius from 42.5 m on.
    ends = at[8:] - 5.0 * np.stack([np.cos(bay[8:, 2]), np.sin(bay[8:, 2])], 1)
    expected = [(10.0, 1.75), (52.5, -21.75), (56.0, 21.75)]
    np.testing.assert_allclose(ends, expected, atol=1e-5)
    # Three starts 4 m from the lanes' beginnings, eight in the middles of the spaces.
    start = np.asarray(layout.spawn_pose)
    expected = [(14.0, -1.75), (56.0, -17.75), (52.5, 17.75)]
    np.testing.assert_allclose(start[:3, :2] + MIDDLE, expected, atol=1e-5)
    np.testing.assert_allclose(start[3:], bay[:8], atol=1e-5)


def test_kerbs_close_the_lot_and_stand_on_no_way(layout):
    pose, size = layout.wall_pose, layout.wall_size
    kerbs = [Polygon(c) for c in np.asarray(box_corners(pose, size))]
    # A way around the lot crosses a kerb wherever it leaves the ground.
    inside = Point(0.0, 0.0)
    for angle in np.linspace(0.0, 2 * math.pi, 200):
        far = Point(80 * math.cos(angle), 80 * math.sin(angle))
        assert any(k.intersects(LineString([inside, far])) for k in kerbs)
    # Bends of 4 m from lanes into spaces and of 10 m at the junction are free.
    ways = [_arc((20.0, -5.75), 4.0, 0, 90), _arc((38.5, -5.75), 4.0, 90, 180)]
    ways += [_arc((20.0, 5.75), 4.0, -90, 0), _arc((42.5, -11.75), 10.0, 0, 90)]
    for way in ways:
        car = jnp.array(np.concatenate([way[:, :2] - MIDDLE, way[:, 2:]], 1))
        hit = boxes_overlap(car[:, None], jnp.array(CAR), pose, size)
        assert not hit.any()


def _arc(centre, radius, begin, end):
    angle = np.radians(np.linspace(begin, end, 30))
    x, y = centre[0] + radius * np.cos(angle), centre[1] + radius * np.sin(angle)
    return np.stack([x, y, angle + math.pi / 2], 1)


def test_more_spaces_make_a_longer_lot():
    lot = make_layout(MetaDriveConfig(spaces=12))
    assert lot.num_bays == MetaDriveConfig(spaces=12).min_bays == 15
    assert float(lot.extent[0]) == pytest.approx((57.75 + 2 * 3.5) / 2 + 0.3)
    with pytest.raises(ValueError, match=r"spaces must .*, not 7"):
        MetaDriveConfig(spaces=7)
