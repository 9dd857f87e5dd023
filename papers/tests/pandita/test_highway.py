"""highway-env's car against highway-env itself, and against its equations."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from carpark_mj.config import EnvConfig, SimConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.vehicle import make_vehicle, preset
from carpark_papers.pandita.task import HighwayPhysics

SIM = SimConfig(sim_dt=1 / 15, trace_dt=1 / 15)
PHYSICS = HighwayPhysics(SIM)
STEP = jax.jit(PHYSICS.step)
READ = jax.jit(PHYSICS.read)
CARS, STEPS = 100, 100


def cars(count, speed=0.0):
    kind = make_vehicle(preset("highway"))
    vehicle = jax.tree.map(lambda x: jnp.broadcast_to(x, (count, *x.shape)), kind)
    rng = np.random.default_rng(1)
    pose = rng.uniform(-1, 1, (count, 3)) * [20.0, 20.0, 3.0]
    state = PHYSICS.init(jnp.asarray(pose, jnp.float32), vehicle)
    return state.replace(speed=jnp.broadcast_to(jnp.float32(speed), (count,)))


class Equations:
    """`Vehicle.step` of highway-env 1.12 in float64, for where it is not installed."""

    def __init__(self, position, heading, speed):
        self.position, self.heading, self.speed = position, heading, speed

    def act(self, action):
        self.action = action

    def step(self, dt):
        beta = math.atan(math.tan(self.action["steering"]) / 2)
        acceleration = self.action["acceleration"]
        if self.speed > 40.0:
            acceleration = min(acceleration, 40.0 - self.speed)
        if self.speed < -40.0:
            acceleration = max(acceleration, -40.0 - self.speed)
        course = self.heading + beta
        way = np.array([math.cos(course), math.sin(course)])
        self.position = self.position + self.speed * dt * way
        self.heading += self.speed * math.sin(beta) / 2.5 * dt
        self.speed += acceleration * dt

    @property
    def velocity(self):
        return self.speed * np.array([math.cos(self.heading), math.sin(self.heading)])


def theirs(name, position, heading, speed):
    if name == "equations":
        return Equations(np.array(position, float), heading, speed)
    kinematics = pytest.importorskip("highway_env.vehicle.kinematics")
    return kinematics.Vehicle(None, position, heading, speed)


def drive(vehicle, control):
    steering, acceleration = control[0] * math.pi / 4, control[1] * 5.0
    vehicle.act({"steering": steering, "acceleration": acceleration})
    for _ in range(3):
        vehicle.step(1 / 15)
    return [*vehicle.position, vehicle.heading, vehicle.speed, *vehicle.velocity]


def seen(state):
    """(cars, 6) x, y, heading, speed, vx and vy."""
    motion = READ(state)
    yaw, speed = motion.pose_w[:, 2], motion.speed
    velocity = speed[:, None] * np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
    return np.concatenate([motion.pose_w, speed[:, None], velocity], axis=1)


def differences(found, expected):
    found, expected = np.array(found, float), np.array(expected, float)
    off = found - expected
    off[..., 2] = (off[..., 2] + np.pi) % (2 * np.pi) - np.pi
    return np.abs(off)


@pytest.mark.parametrize("name", ["highway-env", "equations"])
def test_ten_thousand_random_steps_are_highway_envs_to_rounding(name):
    state = cars(CARS, np.random.default_rng(2).uniform(-10, 10, CARS))
    rng = np.random.default_rng(0)
    worst = np.zeros(6)
    for _ in range(STEPS):
        control = rng.uniform(-1, 1, (CARS, 2)).astype(np.float32)
        before = seen(state).astype(float)
        expected = [
            drive(theirs(name, row[:2], row[2], row[3]), each.astype(float))
            for row, each in zip(before, control, strict=True)
        ]
        state = STEP(state, jnp.asarray(control))
        off = differences(seen(state), expected)
        # Rounding of float32 grows with the numbers rounded.
        scale = 1.0 + np.abs(before[:, [0, 1, 2, 3, 3, 3]])
        worst = np.maximum(worst, (off / scale).max(axis=0))
    assert worst.max() < 1e-6, worst


@pytest.mark.parametrize("speed", [39.5, 42.0, -39.5, -42.0])
def test_speed_limits_hold_as_highway_envs_do(speed):
    state = cars(1, speed)
    row = seen(state)[0].astype(float)
    other = theirs("equations", row[:2], row[2], row[3])
    control = np.array([0.1, np.sign(speed)])
    for _ in range(10):
        state, expected = (
            STEP(state, jnp.asarray(control[None], jnp.float32)),
            drive(other, control),
        )
    assert differences(seen(state)[0], expected).max() < 1e-3


def test_the_trace_holds_every_substep():
    state = STEP(cars(4, 3.0), jnp.array([[0.5, 1.0]] * 4))
    trace = READ(state).trace_w
    assert trace.shape == (4, 3, 3)
    gaps = np.linalg.norm(np.diff(trace[..., :2], axis=1), axis=-1)
    # It gains 5 m/s^2 / 15 Hz a substep, and moves with the speed it had before.
    np.testing.assert_allclose(
        gaps, [[(3 + k / 3) / 15 for k in (1, 2)]] * 4, rtol=1e-4
    )


def test_the_task_runs_on_it():
    config = EnvConfig(physics="highway", vehicle="highway", num_agents=1, sim=SIM)
    env = ParkingEnv(config)
    state, _ = jax.jit(env.reset)(jax.random.key(0))
    _, timestep = jax.jit(env.step)(state, jnp.ones((1, 2)))
    assert timestep.motion.speed[0] == pytest.approx(1.0, abs=1e-5)
    with pytest.raises(ValueError, match="highway physics, which has no tyres"):
        HighwayPhysics(SimConfig(surface="ice"))
