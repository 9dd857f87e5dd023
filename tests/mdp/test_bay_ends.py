"""Bays that say which end of a car goes in first, from the file to the parked car.

One row of three bays whose heading, that of a car that has backed in, is 0: either end,
nose first, tail first.
"""

import json
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.observing import observed
from helpers.rules import LIMITS
from helpers.scenes import cars
from helpers.states import hand_cars, parked_at, parked_in, state_of

from carpark_mj.config import RayConfig, RewardConfig, SpawnConfig
from carpark_mj.layouts import (
    BayEnd,
    build,
    layout_maxima,
    make_layout,
    mixture,
    pad_layout,
)
from carpark_mj.layouts.files import layout_text, read_json
from carpark_mj.mdp.parked_cars import BayFits, poses_in_bays
from carpark_mj.mdp.progress import goal_potential, mix_in_maneuver
from carpark_mj.mdp.terminations import is_parked
from carpark_mj.observations import ContinuousObservation
from carpark_mj.planning.search import _poses_in_bay
from carpark_mj.spawning.placing import SpawnInputs, start_placing, surroundings
from carpark_mj.spawning.special_starts import (
    clamp_to_bay_end,
    misaligned_pose,
    misaligned_shapes,
    paths_out,
    reverse_shapes,
)
from carpark_mj.spawning.starts import draw_uniform
from carpark_mj.tasks.goal_pose import goal_features
from carpark_mj.vehicle import COMPACT, make_vehicle

ENDS = ("either", "nose_first", "tail_first")
PLACES = [(0.0, 0.0), (0.0, 3.0), (0.0, 6.0)]
BAY = jnp.array([5.0, 2.5])
IN, OUT = math.pi, 0.0  # headings of cars with their nose in, and out
FITS = {IN: [True, True, False], OUT: [True, False, True]}


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    rows = [
        {"pose": [*xy, 0.0], "size": [5.0, 2.5], "end": end}
        for xy, end in zip(PLACES, ENDS, strict=True)
    ]
    del rows[0]["end"]
    data = {
        "format": "carpark_mj layout 1",
        "bays": rows,
        "spawns": [{"pose": [10.0, 3.0, 1.5708], "size": [6.0, 1.0]}],
        "extent": [15.0, 15.0],
    }
    file = tmp_path_factory.mktemp("ends") / "ends.json"
    file.write_text(json.dumps(data))
    return file


@pytest.fixture(scope="module")
def layout(path):
    return read_json(path)


def standing(yaw):
    """A car in the middle of every bay."""
    return cars([(*xy, yaw) for xy in PLACES])


def test_files_say_which_end_and_are_written_as_they_were_read(layout, tmp_path):
    assert layout.bay_end.tolist() == [*BayEnd]
    (tmp_path / "again.json").write_text(layout_text(layout))
    again = read_json(tmp_path / "again.json")
    assert jax.tree.all(jax.tree.map(np.array_equal, layout, again))


def test_groups_and_mixtures_with_and_without_ends_join(layout, path):
    poses = jnp.zeros((2, 3)).at[:, 1].set(jnp.array([20.0, 25.0]))
    groups = [build.bays(poses, BAY), build.bays(poses + 30.0, BAY, end=[1, 2])]
    assert build.assemble((99.0, 99.0), *groups).bay_end.tolist() == [0, 0, 1, 2]
    plain = make_layout("square_compact")
    padded = pad_layout(plain, layout_maxima([plain, layout]))
    assert padded.bay_end.tolist() == [BayEnd.EITHER] * 36
    both = mixture([str(path), "square_compact"])
    assert make_layout(both, jax.random.key(0)).bay_end.shape == (36,)


@pytest.mark.parametrize("rule", LIMITS)
@pytest.mark.parametrize("yaw", [IN, OUT])
def test_no_rule_holds_the_wrong_way_round(layout, rule, yaw):
    sizes = jnp.broadcast_to(BAY, (3, 2))
    for off in (0.0, 0.01, -0.01):
        motion = standing(yaw + off)
        got = is_parked(rule, motion, layout.bay_pose, sizes, layout.bay_end)
        assert got.tolist() == FITS[yaw]
        assert is_parked(rule, motion, layout.bay_pose, sizes).all()


@pytest.mark.parametrize("yaw", [IN, OUT])
def test_the_wrong_way_round_is_farther_from_the_goal(layout, yaw):
    weights = RewardConfig(progress=0.2, alignment=0.5)
    motion, goal, one_way = standing(yaw), layout.parked_pose, layout.one_way
    got = goal_potential(weights, motion.pose_w, goal, one_way=one_way)
    wrong = ~np.array(FITS[yaw])
    np.testing.assert_allclose(got, np.where(wrong, -0.5 * math.pi, 0.0), atol=1e-5)
    car = hand_cars(motion, max_steering=0.6)
    way = mix_in_maneuver(20.0, jnp.zeros(3), car, motion, goal, one_way)
    assert (np.asarray(way) > 5.0).tolist() == wrong.tolist()


def test_agents_observe_the_heading_to_park_with(layout):
    observation = ContinuousObservation(tracked_agents=0, rays=RayConfig(count=0))
    goals = jnp.arange(3)
    fields = observed(observation, layout, standing(OUT), goals)
    np.testing.assert_allclose(
        fields["goal_heading"], [[1, 0], [-1, 0], [1, 0]], atol=1e-6
    )
    np.testing.assert_allclose(fields["goal_position"], 0.0, atol=1e-6)


def test_parked_cars_stand_as_they_must(layout):
    yaw = poses_in_bays(layout, parked_in(layout, [0, 1, 2]))[:, 2]
    np.testing.assert_allclose(np.cos(yaw), [1, -1, 1], atol=1e-6)


def test_the_goal_of_park_goal_is_the_end_that_may_go_in(layout):
    state = state_of(layout, standing(OUT), jnp.arange(3))
    np.testing.assert_allclose(goal_features(state)[:, 4], [-1, -1, 1], atol=1e-6)


def test_the_planner_has_one_way_round_where_there_is_one():
    goal = np.array([1.0, 2.0, 0.5])
    assert _poses_in_bay(goal).shape == (2, 3)
    np.testing.assert_array_equal(_poses_in_bay(goal[None]), goal[None])


def test_reverse_starts_drive_out_of_where_the_car_must_park(layout):
    shapes = reverse_shapes(SpawnConfig(close_ratio=0.0, reverse_ratio=1.0))
    draws = draw_uniform(shapes, jax.random.key(0))
    car = jax.tree.map(lambda x: x[None], make_vehicle(COMPACT))
    for end, facing in ((BayEnd.NOSE_FIRST, {-1.0}), (BayEnd.TAIL_FIRST, {1.0})):
        nose_out = clamp_to_bay_end(layout, jnp.int32(end), draws.nose_out)
        right = draws._replace(nose_out=nose_out)
        paths = paths_out(car, jnp.int32(0), jnp.zeros(3), right)
        assert set(np.round(np.cos(paths[:, 0, 2]), 5)) == facing
    np.testing.assert_array_equal(
        clamp_to_bay_end(layout, jnp.int32(BayEnd.EITHER), draws.nose_out),
        draws.nose_out,
    )


def test_misaligned_starts_stand_as_the_car_must_park(layout):
    spawn = SpawnConfig(close_ratio=0.0, misaligned_ratio=1.0)
    shapes = misaligned_shapes(spawn)
    car = jax.tree.map(lambda x: x[None], make_vehicle(COMPACT))
    inputs = SpawnInputs(layout, parked_at(), None, None, BayFits(), car)

    def start(goal, key):
        alone = jnp.array([True])
        placing = start_placing(goal[None], parked_at().bay, jnp.zeros((1, 3)), alone)
        around = surroundings(inputs, placing, jnp.array(0))
        draws = draw_uniform(shapes, key)
        return misaligned_pose(inputs, placing, around, jnp.array(0), draws)

    keys = jax.random.split(jax.random.key(0), 64)
    pose, found = jax.vmap(lambda goal: jax.vmap(lambda key: start(goal, key))(keys))(
        jnp.arange(3)
    )
    assert found.all()
    nose_in = np.cos(pose[..., 2]) < 0.0
    assert 0.3 < nose_in[0].mean() < 0.7
    assert nose_in[1].all()
    assert not nose_in[2].any()
