"""Bays: who fits, which end goes in first, from file to parked car, and exits."""

import json
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.observing import observed
from helpers.rules import LIMITS
from helpers.scenes import cars, lot
from helpers.spawning import many, misaligned, placing_one
from helpers.states import hand_cars, parked_at, parked_in, state_of

from carpark_mj.config import (
    EnvConfig,
    EpisodeConfig,
    FleetConfig,
    RayConfig,
    RewardConfig,
)
from carpark_mj.geometry import box_inside
from carpark_mj.layouts import (
    BayEnd,
    Maxima,
    build,
    layout_maxima,
    make_layout,
    mixture,
    pad_layout,
)
from carpark_mj.layouts.files import layout_text, read_json
from carpark_mj.mdp.parked_cars import (
    BayFits,
    bay_fits,
    fits,
    free_bays,
    marked,
    poses_in_bays,
)
from carpark_mj.mdp.progress import goal_potential, mix_in_maneuver
from carpark_mj.mdp.terminations import is_parked
from carpark_mj.observations import ContinuousObservation
from carpark_mj.planning.search import _poses_in_bay
from carpark_mj.spawning.fleet import draw_bays, kind_logits
from carpark_mj.spawning.goals import goal_of_start
from carpark_mj.spawning.placing import SpawnInputs, start_placing
from carpark_mj.spawning.special_starts import (
    REVERSE_SHAPES,
    clamp_to_bay_end,
    paths_out,
)
from carpark_mj.spawning.starts import draw_uniform
from carpark_mj.tasks.goal_pose import goal_features
from carpark_mj.types import NO_BAY
from carpark_mj.vehicle import COMPACT, make_vehicle

ROW = lot([(10.0 * k, 0.0, 0.0) for k in range(4)])


def test_a_bay_must_leave_the_slack_in_length_and_in_width():
    bays = jnp.array([[5.0, 2.5], [4.4, 2.5], [5.0, 1.9], [4.3, 1.8]])
    car = jnp.array([4.3, 1.8])
    np.testing.assert_array_equal(fits(bays, car), [True] * 4)
    np.testing.assert_array_equal(fits(bays, car, 0.05), [True, True, True, False])
    np.testing.assert_array_equal(fits(bays, car, 0.3), [True, False, False, False])
    both = fits(bays, jnp.array([[4.3, 1.8], [4.9, 2.0]]))
    np.testing.assert_array_equal(both[1], [True, False, False, False])


def test_only_agents_of_a_fleet_need_the_rules_slack():
    size = jnp.array([[4.95, 2.4]])
    layout = ROW.replace(bay_size=jnp.full((4, 2), 5.0).at[0, 0].set(4.9))
    assert bay_fits(EnvConfig(), layout, size, size) == BayFits()
    some = EnvConfig(occupancy=(0.2, 0.4))  # all of one kind: any bay is a goal
    found = bay_fits(some, layout, size, size)
    assert found.agents is None
    np.testing.assert_array_equal(found.parked_cars, [[False, True, True, True]])
    rules = {"strict": [False] * 4, "tanner": [False, True, True, True]}
    for rule, agents in rules.items():
        fleet = EnvConfig(
            fleet=FleetConfig(agents=("city", "van")),
            observation=ContinuousObservation(own_car=True),
            episode=EpisodeConfig(parked_rule=rule),
        )
        found = bay_fits(fleet, layout, size, size)
        np.testing.assert_array_equal(found.agents, [agents])
        np.testing.assert_array_equal(found.parked_cars, [[False, True, True, True]])


def test_no_bay_marks_nothing_and_padding_is_never_free():
    layout = pad_layout(ROW, Maxima(6, 1, 1, 0, 1))
    bays = jnp.array([2, NO_BAY], jnp.int32)
    assert free_bays(layout, bays).tolist() == [True, True, False, True, False, False]
    assert marked(layout, bays).tolist() == [False, False, True, False, False, False]


def draw_many(fit, cars, free, anywhere=False, count=4000):
    wanted = fit, jnp.array(cars), jnp.array(free)
    return many(lambda key: draw_bays(*wanted, key, anywhere), count)


def test_kinds_that_fit_are_drawn_equally_often():
    # Kind 0 fits everywhere, kind 1 in bay 2 only, kind 2 in bay 0, which is taken.
    fit = jnp.array([[True] * 4, [False, False, True, False], [True, *[False] * 3]])
    kind, bay = draw_many(jnp.stack([fit, fit]), [True] * 2, [False, True, True, True])
    assert (bay[:, 0] != bay[:, 1]).all()
    assert (bay > 0).all()
    # Deviation of a share of 4,000 at most 0.8 %: five of them.
    np.testing.assert_allclose((kind == 1).mean(axis=0)[0], 0.5, atol=0.04)
    assert not (kind == 2).any()
    assert (bay[kind == 1] == 2).all()
    second = bay[:, 0] == 2  # then no bay is left for kind 1
    assert (kind[second, 1] == 0).all()


def test_who_finds_no_bay_that_fits_gets_none_or_any():
    fit = jnp.array([[[False, False, False, True]]] * 3)
    for anywhere in (False, True):
        _, bay = draw_many(fit, [True, False, True], [True] * 4, anywhere, count=50)
        assert (bay[:, 0] == 3).all()
        assert (bay[:, 1] == NO_BAY).all()  # wants none
        assert set(bay[:, 2]) == ({0, 1, 2} if anywhere else {NO_BAY})


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
    way = mix_in_maneuver(20.0, jnp.zeros(3), car, motion.pose_w, goal, one_way)
    assert (np.asarray(way) > 5.0).tolist() == wrong.tolist()
    none = mix_in_maneuver(0.0, jnp.zeros(3), car, motion.pose_w, goal, one_way)
    assert none.tolist() == [0.0] * 3  # a reach of 0 is nowhere


def test_the_end_that_goes_in_is_everybody_s(layout):
    """Of observations, of parked cars, of the task `park_goal`, of the planner."""
    observation = ContinuousObservation(tracked_agents=0, rays=RayConfig(count=0))
    fields = observed(observation, layout, standing(OUT), jnp.arange(3))
    heading = [[1, 0], [-1, 0], [1, 0]]
    np.testing.assert_allclose(fields["goal_heading"], heading, atol=1e-6)
    np.testing.assert_allclose(fields["goal_position"], 0.0, atol=1e-6)
    yaw = poses_in_bays(layout, parked_in(layout, [0, 1, 2]))[:, 2]
    np.testing.assert_allclose(np.cos(yaw), [1, -1, 1], atol=1e-6)
    state = state_of(layout, standing(OUT), jnp.arange(3))
    np.testing.assert_allclose(goal_features(state)[:, 4], [-1, -1, 1], atol=1e-6)
    goal = np.array([1.0, 2.0, 0.5])
    assert _poses_in_bay(goal).shape == (2, 3)
    np.testing.assert_array_equal(_poses_in_bay(goal[None]), goal[None])


def test_reverse_starts_drive_out_of_where_the_car_must_park(layout):
    draws = draw_uniform(REVERSE_SHAPES, jax.random.key(0))
    drawn = draws["nose_out"]
    car = jax.tree.map(lambda x: x[None], make_vehicle(COMPACT))
    for end, facing in ((BayEnd.NOSE_FIRST, {-1.0}), (BayEnd.TAIL_FIRST, {1.0})):
        right = {**draws, "nose_out": clamp_to_bay_end(layout, jnp.int32(end), drawn)}
        paths = paths_out(car, jnp.int32(0), jnp.zeros(3), right)
        assert set(np.round(np.cos(paths[:, 0, 2]), 5)) == facing
    either = clamp_to_bay_end(layout, jnp.int32(BayEnd.EITHER), drawn)
    np.testing.assert_array_equal(either, drawn)


def test_misaligned_starts_face_either_way(layout):
    """Within the lines only the wrong way round, where one end is asked for."""
    car = jax.tree.map(lambda x: x[None], make_vehicle(COMPACT))
    inputs = SpawnInputs(layout, parked_at(), cars=car)
    size = inputs.cars.size[0]
    for goal, wrong in ((0, ()), (1, (False,)), (2, (True,))):
        pose, found = misaligned(inputs, placing_one(inputs, goal), 256)
        assert found.all()
        nose_in = np.cos(pose[:, 2]) < 0.0
        assert 0.3 <= nose_in.mean() <= 0.7
        bay = layout.bay_pose[goal], layout.bay_size[goal]
        inside = np.asarray(box_inside(jnp.asarray(pose), size, *bay))
        assert set(nose_in[inside]) == set(wrong)


def test_cars_in_bays_drive_out_and_others_to_free_bays():
    layout = make_layout("metadrive")
    # Agents 1 and 2 drive to spaces, 3 to an exit; 4 waits, its goal is free again.
    goal = jnp.array([5, 0, 1, 8, 2])
    waiting = jnp.array([False, False, False, False, True])
    nobody = jnp.full(0, NO_BAY)

    def goals(pose, goal=goal, waiting=waiting, agent=0):
        poses = jnp.tile(pose, (len(goal), 1))
        placing = start_placing(goal, nobody, poses, waiting)
        scores = jax.random.uniform(jax.random.key(0), (500, 11))
        draw = jax.vmap(lambda s: goal_of_start(layout, placing, jnp.int32(agent), s))
        return np.bincount(np.asarray(draw(scores)), minlength=11)

    out = goals(layout.bay_pose[6])
    assert not out[:8].any()
    assert out[8:].min() > 500 / 3 * 0.8  # an exit may be the goal of several
    into = goals(layout.spawn_pose[1])
    assert into[[0, 1, 8, 9, 10]].tolist() == [0] * 5
    assert into[2:8].min() > 500 / 6 * 0.6
    # They leave again where every bay is another agent's goal.
    goal = jnp.arange(9).at[8].set(NO_BAY)
    full = goals(layout.spawn_pose[1], goal, jnp.arange(9) == 8, 8)
    assert not full[:8].any()
    assert full[8:].all()


def test_snug_cars_are_those_with_the_least_room():
    """Half are drawn by room: 0.1, 0.3 and 2.1 m, by factors of e for 0.2 m."""
    fit = jnp.array([[True, True], [True, False], [True, True], [False, False]])
    room = jnp.array([[0.5, 0.1], [0.3, 0.0], [2.1, 2.5], [-1.0, -1.0]])
    equal = jax.nn.softmax(kind_logits(fit, room, 0.0))
    np.testing.assert_allclose(equal, [1 / 3, 1 / 3, 1 / 3, 0.0], atol=1e-6)
    weights = np.array([1.0, np.exp(-1.0), np.exp(-10.0), 0.0])
    close = weights / weights.sum()
    half = jax.nn.softmax(kind_logits(fit, room, 0.5))
    np.testing.assert_allclose(half, 0.5 * close + 0.5 * equal, atol=1e-6)
    nowhere = jax.nn.softmax(kind_logits(jnp.zeros_like(fit), room, 0.5))
    np.testing.assert_allclose(nowhere, 0.25, atol=1e-6)
