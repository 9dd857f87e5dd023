"""What agents observe: scenes by hand, invariances, ranges while driving, movers."""

import math

import jax.numpy as jnp
import numpy as np
import pytest
from helpers.observing import BAYS, CONFIGS, observe_jit, observed
from helpers.scenes import LOTS, cars, fields_of, lot, mjx_env, mjx_rollout
from helpers.states import config_of, hand_cars, state_of

from carpark_mj.config import RayConfig, RingConfig
from carpark_mj.geometry import rotate
from carpark_mj.geometry.obstacles import Boxes, Discs, Movers, ObstacleKind
from carpark_mj.layouts import make_layout
from carpark_mj.observations import ContinuousObservation, make_fields
from carpark_mj.observations.fields import FAR, NEAR, ObservationInput
from carpark_mj.observations.tracked import PACE, movers_part


def test_a_hand_worked_scene():
    # Agent 0 at (2, 1) facing north: ahead is +y, left is -x.
    motion = cars(
        [(2.0, 1.0, math.pi / 2), (2.0, 5.0, math.pi), (-3.0, 1.0, 0.0)],
        speed=[1.5, -0.6, 3.0],
        steering=[-0.3, 0.0, 0.6],
        yaw_rate=[0.25, 0.1, -0.5],
        size=[(4.0, 2.0), (5.0, 1.5), (4.0, 2.0)],
    )
    config = ContinuousObservation(2, 2, rings=RingConfig(), rays=RayConfig())
    named = observed(config, BAYS, motion, [0, 1, 2], [2, 3])
    expected = {
        "speed": [0.5],
        "steering": [-0.5],
        "yaw_rate": [0.25],
        # Goal 4 m ahead and 8 m to the right, turned like the car.
        "goal_position": [4 / 20, -8 / 20],
        "goal_near": [1.0, -1.0],
        "goal_heading": [1.0, 0.0],
        "goal_distance": [math.hypot(4, 8) / 20],
        # Seen from the goal, which faces north too, the car is behind and left.
        "in_bay": [-1.0, 1.0],
        "goal_size": [2 / 5, 1 / 5],
        # Agent 1 is 4 m ahead facing left, its goal (-4, 0) is 1 m behind, 6 m left.
        "agent_0_present": [1.0],
        "agent_0_position": [4 / 20, 0.0],
        "agent_0_near_position": [4 / 6, 0.0],
        "agent_0_heading": [0.0, 1.0],
        "agent_0_size": [1.0, 0.3],
        "agent_0_speed": [-0.2],
        "agent_0_goal": [-1 / 20, 6 / 20],
        # Agent 2 is 5 m to the left facing right, its goal (2, 2) 1 m ahead.
        "agent_1_present": [1.0],
        "agent_1_position": [0.0, 5 / 20],
        "agent_1_near_position": [0.0, 5 / 6],
        "agent_1_heading": [0.0, -1.0],
        "agent_1_size": [0.8, 0.4],
        "agent_1_speed": [1.0],
        "agent_1_goal": [1 / 20, 0.0],
        # Parked cars stand in bays 2 and 3, 1 m and 8 m ahead, facing right.
        "parked_car_0_present": [1.0],
        "parked_car_0_position": [1 / 20, 0.0],
        "parked_car_0_near_position": [1 / 6, 0.0],
        "parked_car_0_heading": [0.0, -1.0],
        "parked_car_0_size": [0.8, 0.4],
        "parked_car_1_present": [1.0],
        "parked_car_1_position": [8 / 20, 0.0],
        "parked_car_1_near_position": [1.0, 0.0],
        "parked_car_1_heading": [0.0, -1.0],
        "parked_car_1_size": [0.8, 0.4],
    }
    assert named.keys() == expected.keys()
    for name, value in expected.items():
        # cos(pi / 2) is 4e-8 in float32, times 8 m.
        np.testing.assert_allclose(named[name][0], value, atol=1e-6, err_msg=name)


def test_close_to_the_goal_the_near_fields_tell_the_offset():
    # 0.9 m behind and 0.6 m right of bay 1, which faces east, and turned by 0.2 rad.
    motion = cars([(-4.9, -0.6, 0.2)])
    named = observed(CONFIGS[1], BAYS, motion, [1])
    np.testing.assert_allclose(named["in_bay"][0], [-0.3, -0.2], atol=1e-6)
    # The goal in the car's frame: turned back by 0.2 rad.
    ahead = 0.9 * math.cos(0.2) + 0.6 * math.sin(0.2)
    left = 0.6 * math.cos(0.2) - 0.9 * math.sin(0.2)
    near = [ahead / NEAR, left / NEAR]
    np.testing.assert_allclose(named["goal_near"][0], near, atol=1e-6)
    far = [ahead / FAR, left / FAR]
    np.testing.assert_allclose(named["goal_position"][0], far, atol=1e-6)
    heading = [math.cos(0.2), -math.sin(0.2)]
    np.testing.assert_allclose(named["goal_heading"][0], heading, atol=1e-6)


@pytest.mark.parametrize("padding", [False, True])
def test_rings_count_walls_and_discs_in_reach_up_to_the_cap(padding):
    # Unit squares whose nearest faces are 1, 2, 2, 2 and 3 m from the origin, and discs
    # whose rims are 1.5 m and 2.5 m away; the last wall and disc may be padding.
    walls = [(1.5, 0, 0), (-2.5, 0, 0), (0, 2.5, 0), (3.5, 0.0, 0.0), (0, -2.5, 0)]
    layout = lot([(20.0, 0.0, 0.0)], walls, discs=[(2.0, 0.0, 0.5), (0.0, -2.75, 0.25)])
    layout = layout.replace(
        wall_mask=layout.wall_mask.at[-1].set(not padding),
        disc_mask=layout.disc_mask.at[-1].set(not padding),
    )
    motion = cars([(0.0, 0.0, 1.0), (100.0, 0.0, 0.0)])
    rings = RingConfig((1.9, 2.1, 3.9, 4.1, 5.1, 6.1), cap=6)
    named = observed(ContinuousObservation(0, 0, rings=rings), layout, motion, [0, 0])
    counts = np.squeeze([named[f"ring_{d:g}m"] for d in rings.diameters])
    expected = [0, 1, 2, 4, 4, 5] if padding else [0, 1, 2, 5, 6, 6]  # 7 are capped
    np.testing.assert_allclose(6 * counts[:, 0], expected, atol=1e-6)
    np.testing.assert_array_equal(counts[:, 1], 0.0)


def test_cars_that_do_not_exist_are_all_zeros():
    config = ContinuousObservation(3, 2)
    alone = observed(config, BAYS, cars([(1.0, 2.0, 0.5)]), [0])
    pair = observed(config, BAYS, cars([(1.0, 2.0, 0.5), (8.0, 2.0, 1.0)]), [0, 1], [2])
    for name, value in alone.items():
        there = name.startswith(("agent_0", "parked_car_0"))
        if name.startswith(("agent_", "parked_car_")):
            np.testing.assert_array_equal(value, 0.0)
            assert there or not pair[name].any()
            assert not name.endswith("present") or (pair[name] == there).all()


def test_tracked_cars_are_the_nearest_in_order():
    config, layout = ContinuousObservation(2, 2), make_layout("square")
    rng = np.random.default_rng(2)
    motion = cars(rng.uniform([-15, -15, -3.1], [15, 15, 3.1], (6, 3)))
    goal, parked_bay = np.split(rng.permutation(36)[:22], [6])
    named = observed(config, layout, motion, goal, parked_bay)
    xy = np.asarray(motion.pose_w[:, :2])
    parked_xy = np.asarray(layout.bay_pose)[parked_bay, :2]
    for kind, other in (("agent", xy), ("parked_car", parked_xy)):
        gap = np.linalg.norm(xy[:, None] - other, axis=-1)
        if kind == "agent":
            np.fill_diagonal(gap, np.inf)
        nearest = np.sort(gap, axis=1)[:, :2]
        for k in range(2):
            seen = np.linalg.norm(named[f"{kind}_{k}_position"], axis=-1) * FAR
            np.testing.assert_allclose(seen, nearest[:, k], atol=1e-5)  # float32


def test_numbers_observed_vary_and_keep_to_their_ranges():
    observation = np.stack([timestep.observation for timestep in mjx_rollout()[3]])
    config = mjx_env().config
    named = fields_of(observation, config)
    for field in make_fields(config):
        value = named[field.name]
        # 1e-5: headings are unit vectors, steering reaches its limit, up to rounding.
        assert value.min() >= field.low - 1e-5, field
        assert value.max() <= field.high + 1e-5, field
    # Three agents and eight parked cars of one size: all tracked cars exist always.
    slots = [f"agent_{k}" for k in range(2)] + [f"parked_car_{k}" for k in range(4)]
    constant = {n for n, x in named.items() if np.ptp(x, axis=(0, 1, 2)).min() == 0}
    assert constant == {
        f"{slot}_{part}" for slot in slots for part in ("present", "size")
    }
    # `goal_size` varies between the lots of the batch only.
    assert named["goal_size"].shape[1] == LOTS


def test_what_an_agent_drives_by_hand():
    motion = cars([(0.0, 0.0, 0.0)] * 2, size=[(4.0, 2.0), (5.0, 1.5)])
    lock = [math.atan(0.5), math.atan(0.75)]
    sizes = {"wheelbase": [2.5, 3.0], "centre_offset": [1.25, 1.5]}
    vehicle = hand_cars(motion, max_steering=lock, **sizes)
    state = state_of(BAYS, motion, [0, 1])
    state = state.replace(physics=state.physics.replace(vehicle=vehicle))
    config = config_of(ContinuousObservation(own_car=True))
    named = fields_of(observe_jit(config, state), config)
    for name, value in {
        "own_size": [[0.8, 0.4], [1.0, 0.3]],
        "own_wheelbase": [[0.5], [0.6]],
        "own_rear_axle": [[0.25], [0.3]],
        "own_turning_radius": [[1.0], [0.8]],  # 5 m and 4 m
    }.items():
        np.testing.assert_allclose(named[name], value, rtol=1e-6, err_msg=name)


def test_room_to_the_lines_by_hand():
    # Bays of 5 m x 2.5 m along x: 0.1 m too far in and 0.2 m to the left of the middle
    # of one, and 5 m short of the other on both axes.
    bay_pose = BAYS.bay_pose.at[:, 2].set(0.0)
    bay_size = jnp.broadcast_to(jnp.array([5.0, 2.5]), BAYS.bay_size.shape)
    layout = BAYS.replace(bay_pose=bay_pose, bay_size=bay_size)
    (x, y), (a, b) = bay_pose[0, :2].tolist(), bay_pose[1, :2].tolist()
    poses = [(x + 0.1, y + 0.2, 0.0), (a - 5.0, b - 5.0, 0.3)]
    motion = cars(poses, size=[(4.6, 1.8)] * 2)
    config = config_of(ContinuousObservation(lines=True))
    named = fields_of(observe_jit(config, state_of(layout, motion, [0, 1])), config)
    expected = np.clip(np.array([0.1, 0.3, 0.15, 0.55]) / 0.5, -1.0, 1.0)
    np.testing.assert_allclose(named["line_room"][0], expected, atol=1e-5)
    np.testing.assert_array_equal(named["line_room"][1], [1.0, -1.0, 1.0, -1.0])


FACING = np.array([(0.0, 0.0, np.pi / 2)])  # north
PEOPLE = Discs(
    jnp.array([[0.0, 6.0], [8.0, 0.0], [-3.0, 0.0], [0.0, 4.0]]),
    jnp.full(4, 0.3),
    jnp.array([[1.0, 0.0], [0.0, 0.0], [0.0, -1.0], [0.0, 0.0]]),
    jnp.array([True, True, True, False]),
    kind=ObstacleKind.PERSON,
)
CART = Boxes(
    jnp.array([[-9.0, 0.0, np.pi]]), jnp.array([[2.0, 1.0]]), jnp.array([[-2.0, 0.0]])
)


def see(count, movers=(PEOPLE, CART), facing=FACING):
    """Rows (count, k) of fields by name, and the fields' names, of one car."""
    state = state_of(
        lot([(30.0, 0.0, 0.0)]),
        cars(facing),
        0,
        movers=Movers((), tuple((group,) for group in movers)),
    )
    part = movers_part(count)
    values = part.fill(ObservationInput.of(state))
    assert [*values]
    assert {*values} == {field.name for field in part.fields}
    for field in part.fields:
        assert values[field.name].shape == (1, field.size)
        assert (values[field.name] >= field.low - 1e-6).all()
        assert (values[field.name] <= field.high + 1e-6).all()
    return [
        {
            field.name.removeprefix(f"mover_{k}_"): np.asarray(values[field.name][0])
            for field in part.fields
            if field.index == k
        }
        for k in range(count)
    ]


def places(rows):
    """Positions [m] of the rows that are present."""
    return [tuple(np.round(r["position"] * 20.0, 3)) for r in rows if r["present"]]


def test_nearest_movers_come_first_in_the_own_frame():
    rows = see(6)
    # North is ahead: west is left. The masked one, 4 m ahead, is not there.
    assert places(rows) == [(0, 3), (6, 0), (0, -8), (0, 9)]
    np.testing.assert_allclose(rows[0]["velocity"] * PACE, [-1, 0], atol=1e-6)
    np.testing.assert_allclose(rows[1]["velocity"] * PACE, [0, -1], atol=1e-6)
    np.testing.assert_allclose(rows[1]["size"] * 5.0, [0.6, 0.6], atol=1e-6)
    np.testing.assert_allclose(rows[3]["size"] * 5.0, [2.0, 1.0], atol=1e-6)
    np.testing.assert_allclose(rows[3]["heading"], [0, 1], atol=1e-6)
    assert [float(row["person"][0]) for row in rows] == [1, 1, 1, 0, 0, 0]
    assert all((value == 0).all() for row in rows[4:] for value in row.values())
    assert places(see(2)) == [(0, 3), (6, 0)]
    assert places(see(2, movers=())) == []


def test_a_turned_lot_looks_the_same_also_with_those_who_stand():
    angle = 2.5

    def turn(group):
        pose = group.pose_w.at[:, :2].set(rotate(group.pose_w[:, :2], angle))
        if isinstance(group, Boxes):
            pose = pose.at[:, 2].add(angle)
        return group.replace(pose_w=pose, velocity_w=rotate(group.velocity_w, angle))

    turned = see(
        4, movers=(turn(PEOPLE), turn(CART)), facing=np.add(FACING, [0, 0, angle])
    )
    for row, other in zip(see(4), turned, strict=True):
        for name, value in row.items():
            np.testing.assert_allclose(other[name], value, atol=1e-5, err_msg=name)
