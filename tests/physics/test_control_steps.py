"""Starts, and control steps of 20 substeps: traces, delays and broken numbers."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.trees import agent_of, same

from carpark_mj.config import EnvConfig, SimConfig
from carpark_mj.physics.bicycle import BicyclePhysics
from carpark_mj.physics.mjx import CarState, MjxPhysics
from carpark_mj.physics.mjx_step import ContactPhysics
from carpark_mj.types import Motion
from carpark_mj.vehicle import COMPACT, PRESETS, make_vehicle
from carpark_mj.vehicle.drive import make_lines, receive, send
from vehicle_suite.shipped import drive

NUM_COPIES = 6
CONTROLS = np.array(
    [[0.5, 1.0], [-1.0, 0.7], [0.0, -1.0], [0.3, 0.3], [1.0, -0.5], [0.0, 0.0]],
    np.float32,
)
POSES = np.array([[i, 2.0 * i, 0.7 * i - 2.0] for i in range(NUM_COPIES)], np.float32)


def stack(cars):
    return jax.tree.map(lambda *x: jnp.stack(x), *map(make_vehicle, cars))


@pytest.fixture(scope="module")
def physics() -> MjxPhysics:
    return MjxPhysics(SimConfig())


@pytest.fixture(scope="module")
def step(physics: MjxPhysics):
    return jax.jit(physics.step)


@pytest.fixture(scope="module")
def start(physics: MjxPhysics) -> CarState:
    cars = stack([COMPACT, PRESETS["van"]] * (NUM_COPIES // 2))
    return physics.init(jnp.array(POSES), cars)


@pytest.fixture(scope="module")
def moving(step, start: CarState) -> CarState:
    """Six cars after 1 s of driving."""
    state = start
    for _ in range(5):
        state = step(state, CONTROLS)
    return state


def see(physics: MjxPhysics, state: CarState) -> Motion:
    return jax.device_get(physics.read(state))


def spoil(state: CarState, field: str, car: int, value: float) -> CarState:
    leaf = getattr(state, field)
    first = (car,) + (0,) * (leaf.ndim - 1)
    return state.replace(**{field: leaf.at[first].set(value)})


@pytest.mark.parametrize("name", ["mjx", "bicycle", "contact"])
def test_cars_are_put_at_rest_and_others_left_alone(name):
    tyres = "contact" if name == "contact" else "brush"
    config = EnvConfig(
        physics="bicycle" if name == "bicycle" else "mjx",
        sim=SimConfig(tyres=tyres, sim_dt=0.004),
    )
    physics = config.physics_config.make(config, None, COMPACT)
    assert isinstance(physics, ContactPhysics) == (name == "contact")
    start = physics.init(jnp.array(POSES), stack([COMPACT] * NUM_COPIES))
    seen = see(physics, start)
    # float32 rounding.
    assert seen.pose_w == pytest.approx(POSES, abs=1e-6)
    assert np.abs(seen.trace_w - POSES[:, None]).max() < 1e-6
    assert not seen.velocity_b.any()
    assert not seen.yaw_rate.any()
    assert seen.finite.all()
    moving, first = physics.set_speed(start, jnp.ones(NUM_COPIES)), np.arange(6) < 3
    where = jnp.array(POSES[::-1] + np.array([0.0, 0.0, 4 * np.pi]))
    after = physics.place(moving, first, where, stack([PRESETS["suv"]] * NUM_COPIES))
    seen = see(physics, after)
    assert seen.pose_w[first] == pytest.approx(POSES[::-1][first], abs=2e-6)
    np.testing.assert_array_equal(seen.speed == 0.0, first)
    np.testing.assert_array_equal(seen.size[:, 0] == PRESETS["suv"].length, first)
    assert same(agent_of(after, ~first), agent_of(moving, ~first))


def test_a_control_step_is_its_substeps_and_traces_them_evenly(physics, step):
    fine, cars = SimConfig(ctrl_dt=0.01, trace_dt=0.01), stack([COMPACT] * NUM_COPIES)
    controls = np.tile(CONTROLS, (100, 1, 1))
    substeps = drive(fine, cars, controls, pose=POSES).motion.pose_w.swapaxes(0, 1)
    state = physics.init(jnp.array(POSES), cars)
    for i in range(5):
        state = step(state, CONTROLS)
        seen = see(physics, state)
        assert seen.trace_w.shape == (NUM_COPIES, 4, 3)
        expected = substeps[:, 20 * i :][:, [4, 9, 14, 19]]
        # Two programs in float32, measured 2.4e-7.
        assert seen.trace_w == pytest.approx(expected, abs=3e-6)
        assert np.array_equal(seen.pose_w, seen.trace_w[:, -1])


@pytest.mark.parametrize(
    ("steering", "pedal"), [(0.24, 0.1), (0.2, 0.0), (0.0, 0.05), (0.4, 0.45)]
)
def test_every_control_acts_its_delay_after_it_was_sent(steering, pedal):
    sim = SimConfig(sim_dt=0.01, steering_delay=steering, pedal_delay=pedal)
    commands = np.arange(1.0, 13.0).reshape(6, 2).astype(np.float32)
    lines, acting = make_lines(sim, jnp.zeros(())), []
    for command in commands:
        lines = send(sim, lines, jnp.array(command))
        for _ in range(sim.num_substeps):
            lines, now = receive(lines, (command[0], command[1]), sim.sim_dt)
            acting.append([float(x) for x in now])
    sent = np.repeat(commands, sim.num_substeps, axis=0)
    for column, delay in enumerate((steering, pedal)):
        late = np.zeros(round(delay / sim.sim_dt))
        expected = np.concatenate([late, sent[:, column]])[: len(sent)]
        np.testing.assert_array_equal(np.array(acting)[:, column], expected)


def test_placed_cars_have_no_controls_on_their_way(physics, step, start):
    assert start.actuators.lines is None  # exact without delays
    slow = MjxPhysics(SimConfig(steering_delay=0.2, pedal_delay=0.2))
    late = slow.init(jnp.array(POSES), start.vehicle)
    late_step = jax.jit(slow.step)
    late = late_step(late, CONTROLS[:, ::-1])
    np.testing.assert_array_equal(see(slow, late).steering, 0.0)
    # A control step later they have done what cars without delays do at once.
    after, at_once = (
        see(slow, late_step(late, CONTROLS)),
        step(start, CONTROLS[:, ::-1]),
    )
    expected = see(physics, at_once)
    assert after.pose_w == pytest.approx(expected.pose_w, abs=1e-6)
    assert np.abs(after.steering).max() > 0.05
    assert after.steering == pytest.approx(expected.steering, abs=1e-6)
    placed = slow.place(late, jnp.arange(6) < 3, jnp.array(POSES), start.vehicle)
    lines = placed.actuators.lines
    assert lines is not None
    assert lines.pedal is not None
    sent = np.asarray(lines.pedal.sent[0])
    assert not sent[:3].any()
    np.testing.assert_array_equal(sent[3:], CONTROLS[3:, 0])


@pytest.mark.parametrize("back_end", [MjxPhysics, BicyclePhysics])
def test_cars_that_are_halted_stand_where_told_and_steer_on(back_end):
    physics = back_end(SimConfig())
    start = physics.init(jnp.array(POSES), stack([COMPACT] * NUM_COPIES))
    start = physics.set_speed(start, jnp.full(NUM_COPIES, 1.0))
    steering = jnp.full(NUM_COPIES, 0.2, jnp.float32)
    turned = dataclasses.replace(start.actuators, steering=steering)
    start = dataclasses.replace(start, actuators=turned)
    trace = np.repeat(POSES[:, None], 4, axis=1)
    trace[:, :2, 0] += 0.1
    mask = np.arange(NUM_COPIES) < 2
    state = physics.halt(start, jnp.array(mask), jnp.array(trace))
    seen = see(physics, state)
    np.testing.assert_allclose(seen.pose_w, POSES, atol=1e-6)
    np.testing.assert_allclose(seen.trace_w[:2], trace[:2], atol=1e-6)
    np.testing.assert_array_equal(seen.speed != 0.0, ~mask)
    np.testing.assert_allclose(seen.steering, 0.2, atol=1e-6)
    held = np.where(mask, COMPACT.hold_deceleration, 0.0)
    np.testing.assert_allclose(state.actuators.hold, held)


def test_a_broken_car_is_put_to_rest_and_disturbs_nobody(physics, step, moving):
    before, controls = see(physics, moving), CONTROLS.copy()
    controls[4] = np.nan
    spoiled = spoil(spoil(moving, "qvel", 1, np.nan), "qvel", 3, np.inf)
    after, expected = step(spoiled, controls), step(moving, CONTROLS)
    seen = see(physics, after)
    assert seen.finite.tolist() == [True, False, True, False, False, True]
    assert seen.pose_w[1] == pytest.approx(before.pose_w[1], abs=1e-6)  # float32
    assert np.array_equal(seen.trace_w[1], np.tile(seen.pose_w[1], (4, 1)))
    assert not seen.velocity_b[1].any()
    assert seen.yaw_rate[1] == 0.0
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(after))
    neighbours = np.array([0, 2, 5])
    assert same(*(agent_of(cars, neighbours) for cars in (after, expected)))
    # It drives on with the next good steps.
    for _ in range(5):
        after = step(after, CONTROLS)
    later = see(physics, after)
    assert later.finite.all()
    travelled = np.linalg.norm((later.pose_w - seen.pose_w)[:, :2], axis=1)
    assert (travelled[[1, 3, 2]] > 0.2).all()


def test_a_car_with_a_broken_position_is_flagged_every_step(physics, step, moving):
    # `step` never stores such a position itself, and keeps none it could go back to:
    # only a new start repairs it.
    state = spoil(moving, "qpos", 1, np.nan)
    for _ in range(2):
        state = step(state, CONTROLS)
        assert see(physics, state).finite.tolist() == [True, False] + [True] * 4
