"""The grid world: hand-worked moves, and what holds for every drive on it."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import cars, moved
from helpers.states import parked_in, state_of

from carpark_mj.config import WORLD_UNIT, EnvConfig, EpisodeConfig, SimConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.layouts import make_layout
from carpark_mj.mdp.collisions import find_hits
from carpark_mj.mdp.terminations import detect_events
from carpark_mj.observations import make_fields
from carpark_mj.registry import environment
from carpark_mj.vehicle import make_vehicle, preset
from carpark_mj.wrappers.options import observation_space
from carpark_papers.tanner.environments import TANNER_QLEARNING
from carpark_papers.tanner.grid import COARSE, FINE, GridConfig, GridPhysics

BOX = make_vehicle(preset("tanner"))
KEEP = 1  # the coarse grid's middle choice: no acceleration, no turn


def start(grid, pose):
    """Physics and cars at rest at poses (n, 3)."""
    physics = GridPhysics(grid, SimConfig())
    pose = jnp.asarray(pose, jnp.float32)
    vehicle = jax.tree.map(
        lambda x: jnp.broadcast_to(x, (*pose.shape[:-1], *x.shape)), BOX
    )
    return physics, physics.init(pose, vehicle)


def drive(physics, state, controls):
    """States after every step of controls (steps, cars, 2), stacked."""

    def step(state, action):
        state = physics.step(state, action)
        return state, dataclasses.replace(state, vehicle=None)

    return jax.jit(lambda s, c: jax.lax.scan(step, s, c)[1])(state, controls)


def random_drive(grid, num_cars=32, num_steps=60, pose=None):
    """Random controls (steps, cars, 2) and the states they lead through."""
    key = jax.random.key(0)
    choices = jnp.array(grid.choices)
    controls = jax.random.randint(key, (num_steps, num_cars, 2), 0, choices)
    pose = jnp.zeros((num_cars, 3)) if pose is None else pose
    physics, state = start(grid, pose)
    return controls, drive(physics, state, controls), state


@pytest.mark.parametrize(
    ("at_rest", "heading", "turn"),
    [
        (False, [0, 1, 1, 1, 0], [0, 1, 0, 0, -1]),
        (True, [0, 1, 2, 1, 0], [0, 1, 1, -1, -1]),
    ],
)
def test_a_coarse_drive_by_hand(at_rest, heading, turn):
    # Nose up (+y). Ahead, right by 45 deg, stop, turn if it may, reverse to the left.
    grid = dataclasses.replace(COARSE, turn_at_rest=at_rest)
    physics, state = start(grid, [[0.0, 0.0, math.pi / 2]])
    controls = jnp.array([[2, KEEP], [KEEP, 2], [0, 2], [KEEP, 0], [0, 0]])[:, None]
    path = drive(physics, state, controls)
    points = [[0, 1], [1, 2], [1, 2], [1, 2], [1, 1]]
    np.testing.assert_array_equal(path.point[:, 0], points)
    np.testing.assert_array_equal(path.level[:, 0], [1, 1, 0, 0, -1])
    np.testing.assert_array_equal(path.heading[:, 0], heading)
    np.testing.assert_array_equal(path.turn[:, 0], turn)


@pytest.mark.parametrize("grid", [COARSE, FINE], ids=["coarse", "fine"])
def test_the_sharpest_turns_bound_the_observed_yaw_rate(grid):
    config = EnvConfig(physics=grid)
    names = [field.name for field in make_fields(config) for _ in range(field.size)]
    index, space = names.index("yaw_rate"), observation_space(config)
    fastest, (_, turns) = 2 * grid.max_acceleration, grid.choices
    physics, state = start(grid, np.zeros((2, 3)))
    state = physics.step(state, jnp.array([[fastest, 0], [fastest, turns - 1]]))
    bounds = space.high[index], space.low[index]
    np.testing.assert_array_equal(physics.read(state).yaw_rate, bounds)


def test_a_fine_move_by_hand():
    # Level 4 along 15 deg is 16 points: (16 sin 15, 16 cos 15) = (4.14, 15.45).
    physics, state = start(FINE, [[0.0, 0.0, math.pi / 2]])
    path = drive(physics, state, jnp.array([[[4, 3]], [[4, 4]]]))
    np.testing.assert_array_equal(path.point[:, 0], [[0, 8], [4, 8 + 15]])


@pytest.mark.parametrize("grid", [COARSE, FINE], ids=["coarse", "fine"])
def test_levels_and_turns_keep_limits_and_nobody_turns_standing(grid):
    controls, path, _ = random_drive(grid)
    level, heading = np.asarray(path.level), np.asarray(path.heading)
    assert level.min() == -grid.max_reverse
    assert level.max() == grid.max_forward
    change = np.diff(level, axis=0)
    assert np.abs(change).max() == grid.max_acceleration
    turned = np.diff(heading, axis=0)
    turned = (turned + grid.headings // 2) % grid.headings - grid.headings // 2
    assert np.abs(turned).max() == grid.max_turn
    assert np.all(turned[level[1:] == 0] == 0)
    free = level[1:] != 0
    asked = np.asarray(controls)[1:, :, 1] - grid.max_turn
    np.testing.assert_array_equal(turned[free], asked[free])
    assert (~free & (asked != 0)).any()
    assert heading.min() == 0
    assert heading.max() == grid.headings - 1


@pytest.mark.parametrize("grid", [COARSE, FINE], ids=["coarse", "fine"])
def test_every_move_is_the_exact_one_to_the_nearest_point(grid):
    _, path, _ = random_drive(grid)
    moves = np.diff(np.asarray(path.point), axis=0)
    angle = 2 * np.pi / grid.headings * np.asarray(path.heading)[1:]
    reach = grid.speed_step * np.asarray(path.level)[1:]
    exact = reach[..., None] * np.stack([np.sin(angle), np.cos(angle)], axis=-1)
    assert moves.dtype.kind == "i"
    assert np.abs(moves - exact).max() <= 0.5 + 1e-6


def test_moves_to_opposite_sides_are_equally_long():
    # One point along 30 deg is (0.5, 0.87): a half.
    grid = GridConfig(points=1, speed_step=1, headings=12, max_turn=1)
    moves = np.asarray(GridPhysics(grid, SimConfig())._moves)
    middle = grid.max_reverse
    np.testing.assert_array_equal(moves[middle - 1], -moves[middle + 1])
    np.testing.assert_array_equal(moves[:, (np.arange(12) + 6) % 12], -moves)


@pytest.mark.parametrize("grid", [COARSE, FINE], ids=["coarse", "fine"])
def test_a_quarter_turn_of_the_start_turns_the_whole_drive(grid):
    pose = jnp.tile(jnp.array([0.0, 0.0, math.pi / 2]), (32, 1))
    _, path, _ = random_drive(grid, pose=pose)
    turned = random_drive(grid, pose=moved(pose, (0.0, 0.0, -math.pi / 2)))[1]
    x, y = np.moveaxis(np.asarray(path.point), -1, 0)
    np.testing.assert_array_equal(turned.point, np.stack([y, -x], axis=-1))


def test_mirrored_turns_mirror_the_drive():
    pose = jnp.tile(jnp.array([0.0, 0.0, math.pi / 2]), (32, 1))
    controls, path, state = random_drive(FINE, pose=pose)
    mirror = jnp.stack([controls[..., 0], 2 * FINE.max_turn - controls[..., 1]], -1)
    other = drive(GridPhysics(FINE, SimConfig()), state, mirror)
    np.testing.assert_array_equal(other.point, path.point * jnp.array([-1, 1]))


def test_a_batch_is_its_cars_one_by_one():
    controls, path, state = random_drive(FINE, num_cars=4, num_steps=20)
    physics = GridPhysics(FINE, SimConfig())
    for car in range(4):
        alone = jax.tree.map(lambda x, car=car: x[car], state)
        for step, control in enumerate(controls[:, car]):
            alone = physics.step(alone, control)
            np.testing.assert_array_equal(alone.point, path.point[step, car])
            np.testing.assert_array_equal(alone.heading, path.heading[step, car])


def test_reading_is_in_metres_and_counter_clockwise_radians():
    physics, state = start(COARSE, [[0.0, 0.0, math.pi / 2], [3 * WORLD_UNIT, 0, 0]])
    state = physics.step(state, jnp.array([[2, 2], [0, KEEP]]))
    vehicle = physics.read(state)
    expected = [[WORLD_UNIT, WORLD_UNIT, math.pi / 4], [2 * WORLD_UNIT, 0.0, 0.0]]
    np.testing.assert_allclose(vehicle.pose_w, expected, atol=1e-6)
    per_second = WORLD_UNIT / 0.2
    np.testing.assert_allclose(vehicle.speed, [per_second, -per_second], rtol=1e-6)
    np.testing.assert_allclose(vehicle.yaw_rate, [-math.pi / 4 / 0.2, 0], rtol=1e-6)
    np.testing.assert_allclose(
        vehicle.size[0], [7.9 * WORLD_UNIT, 3.9 * WORLD_UNIT], rtol=1e-6
    )
    np.testing.assert_array_equal(vehicle.trace_w[:, -1], vehicle.pose_w)
    assert vehicle.finite.all()


def test_cars_start_on_the_nearest_point_and_where_masked():
    key = jax.random.key(1)
    pose = jax.random.uniform(key, (50, 3), minval=-3.0, maxval=3.0)
    physics, state = start(FINE, pose)
    read = physics.read(state).pose_w
    assert np.abs(read[:, :2] - pose[:, :2]).max() <= FINE.point_size / 2 + 1e-6
    gap = np.asarray(read[:, 2] - pose[:, 2])
    assert np.abs(np.angle(np.exp(1j * gap))).max() <= math.pi / 24 + 1e-6
    again = physics.init(read, state.vehicle)
    np.testing.assert_array_equal(again.point, state.point)
    np.testing.assert_array_equal(again.heading, state.heading)
    mask = jnp.arange(50) < 10
    shifted = physics.place(state, mask, read + 1.0, state.vehicle)
    assert (shifted.point != state.point).all(axis=1)[:10].all()
    np.testing.assert_array_equal(shifted.point[10:], state.point[10:])


# In the study's lot


def bay_of(layout, x, y):
    gap = np.abs(np.asarray(layout.bay_pose)[:, :2] - WORLD_UNIT * np.array([x, y]))
    return int(gap.sum(axis=1).argmin())


def at(x, y, degrees=90.0):
    """The study's car at a point in world units."""
    pose = [[x * WORLD_UNIT, y * WORLD_UNIT, math.radians(degrees)]]
    return cars(pose, size=BOX.size)


@pytest.mark.parametrize(
    ("x", "y", "degrees", "parked"),
    [
        (24, 32, 90, True),
        (25, 31, 45, True),  # one point off in both, at any heading
        (23, 33, 0, True),
        (24, 30, 90, False),
        (22, 32, 90, False),
    ],
)
def test_parked_is_within_a_point_of_the_bay_and_wins_over_a_crash(
    x, y, degrees, parked
):
    layout = make_layout("square")
    goal = [bay_of(layout, 24, 32)]
    state = state_of(layout, at(x, y, degrees), goal)
    events = detect_events(TANNER_QLEARNING.episode, state)
    assert bool(events.parked[0]) is parked
    # Across the bay at its mouth the car's corner is in the block beside it.
    assert find_hits(state_of(layout, at(25, 31, 45), goal))["wall"][0]


def test_neighbours_in_their_bays_do_not_touch_and_leaning_ones_do():
    layout = make_layout("square")
    parked = parked_in(layout, [bay_of(layout, 0, 32)], BOX.size)

    def hits(*place):
        state = state_of(layout, at(*place), 0, parked_cars=parked)
        return bool(find_hits(state)["parked_car"][0])

    assert not hits(6, 32)
    assert not hits(4, 32)  # 3.9 wide, 4 apart
    assert hits(3, 32)
    assert hits(4, 29, 45)


def test_who_would_leave_the_world_hits_a_wall_first():
    layout = make_layout("square")
    edge = [36, 37, 38, -36, -37, -38]
    grid = np.meshgrid(edge, np.arange(-38, 39, 4), (0, 45, 90, 135))
    x, y, degrees = (axis.ravel() for axis in grid)
    sides = [(x, y, degrees), (y, x, degrees)]
    place = np.concatenate([np.stack(side, axis=-1) for side in sides])
    pose = place * [WORLD_UNIT, WORLD_UNIT, math.pi / 180]

    def hits(pose):
        return find_hits(state_of(layout, cars(pose[None], size=BOX.size), 0))["wall"]

    hit = jax.jit(jax.vmap(hits))(jnp.asarray(pose, jnp.float32))
    assert hit.all()


# Choices and refusals


def test_impossible_grids_and_grounds_are_refused_in_a_sentence():
    with pytest.raises(ValueError, match=r"max_turn must be less than half of 8 .* 4"):
        GridConfig(headings=8, max_turn=4)
    with pytest.raises(ValueError, match=r"grade_x 0.1 has no effect in grid physics"):
        GridPhysics(FINE, SimConfig(grade_x=0.1))
    for setting, value in (("surface", "ice"), ("pedal_delay", 0.1), ("creep", 0.4)):
        sim = SimConfig(**{setting: value})  # pyright: ignore
        with pytest.raises(ValueError, match=f"{setting} .* in bicycle physics"):
            ParkingEnv(EnvConfig(physics="bicycle", sim=sim))
    with pytest.raises(ValueError, match=r"ramp .* has no effect in bicycle"):
        ParkingEnv(EnvConfig(physics="bicycle", sim=SimConfig(ramp=(0.0, 9.0, 0.1))))
    with pytest.raises(ValueError, match=r"scene physics has one gravity.* 0.1"):
        EnvConfig(physics="scene", sim=SimConfig(ramp=(0.0, 9.0, 0.1)))
    with pytest.raises(ValueError, match=r"kerb_speed needs .* bicycle, not grid"):
        ParkingEnv(EnvConfig(physics="grid", episode=EpisodeConfig(kerb_speed=0.5)))
    with pytest.raises(ValueError, match="unknown environment 'tokyo'; choose from"):
        environment("tokyo")
