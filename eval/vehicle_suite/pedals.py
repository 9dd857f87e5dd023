"""The shipped driver on slopes: harder pedals slow down more, and the hold holds.

Unlike the other manoeuvres these have a pedal. `MjxPhysics` drives them as in training;
surfaces scale the cars' grip, so that one compiled program serves a slope.
"""

import dataclasses
import functools
import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config import SimConfig, Surface
from carpark_mj.physics.mjx import CarState, MjxPhysics
from carpark_mj.vehicle import Vehicle, VehicleParameters, make_vehicle
from carpark_mj.vehicle.drive import HOLD_PEDAL, SWITCH_SPEED
from carpark_mj.vehicle.parameters import GRAVITY
from carpark_mj.vehicle.surfaces import SURFACES, with_grip
from vehicle_suite.table import Study, relative
from vehicle_suite.testbed import Testbed

GRADES = (0.0, 0.05, 0.15)  # rise over run
PEDALS = (0.0, 1e-6, 0.04, HOLD_PEDAL, 0.06, 0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 0.85, 1.0)
START = 1.0  # m/s, above `HOLD_SPEED`
BOTH_WAYS = (1.0, -1.0)  # along the car's x
WEAK = (0.06, 0.3, 0.5)  # pedals that no car climbs the steepest slope with
WIDTH = len(PEDALS) * 4  # cars of one call
SECONDS = 15.0


@functools.cache
def _program(grade: float):
    """Compiles `SECONDS` of `WIDTH` cars with constant pedals uphill along x."""
    physics = MjxPhysics(SimConfig(grade_x=grade))

    @jax.jit
    def drive(state: CarState, pedal: jax.Array) -> tuple[jax.Array, jax.Array]:
        controls = jnp.stack([jnp.zeros_like(pedal), pedal], -1)

        def step(state: CarState, _: None):
            state = physics.step(state, controls)
            motion = physics.read(state)
            return state, (motion.pose_w[:, 0], motion.velocity_b[:, 0])

        steps = round(SECONDS / physics.sim.ctrl_dt)
        return jax.lax.scan(step, state, length=steps)[1]

    return physics, drive


def drive_pedals(
    vehicle: Vehicle,
    grade: float,
    start: np.ndarray,
    facing: np.ndarray,
    pedal: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Drives up to `WIDTH` cars of one kind, each with its pedal held.

    Args:
        vehicle: the car.
        grade: rise over run of the ground along x.
        start: (n,) speeds at the start, wheels rolling [m/s].
        facing: (n,) 1 uphill, -1 downhill.
        pedal: (n,).

    Returns:
        Instants (T,) [s], and of each car the way (T, n) along its own x axis [m] and
        its speed (T, n) [m/s].
    """
    n = len(start)
    start, facing, pedal = (np.resize(x, WIDTH) for x in (start, facing, pedal))
    physics, drive = _program(grade)
    cars = jax.tree.map(lambda x: jnp.broadcast_to(x, (WIDTH, *x.shape)), vehicle)
    pose = np.zeros((WIDTH, 3))
    pose[:, 2] = np.where(facing > 0, 0.0, math.pi)
    state = physics.init(jnp.array(pose, jnp.float32), cars)
    qvel = np.zeros((WIDTH, 12))
    qvel[:, 0] = facing * start
    qvel[:, physics.index.spin_dof] = (start / float(vehicle.wheel_radius))[:, None]
    state = dataclasses.replace(state, qvel=jnp.array(qvel, jnp.float32))
    x, speed = jax.device_get(drive(state, jnp.array(pedal, jnp.float32)))
    time = physics.sim.ctrl_dt * np.arange(1, len(x) + 1)
    return time, (x * facing)[:, :n].astype(float), speed[:, :n].astype(float)


def harder_is_slower(
    bed: Testbed, name: str, params: VehicleParameters, quick: bool
) -> Study:
    """Pedals from 0 to -1 against the motion: none may get farther than a weaker one.

    Way is counted up to the farthest point, so that turning round ends it.
    """
    study = Study(name, bed.tyres)
    grades = GRADES[-1:] if quick else GRADES
    runs = np.array(list(itertools.product(BOTH_WAYS, BOTH_WAYS, PEDALS)))
    facing, way, pedal = runs.T
    for grade, surface in itertools.product(grades, SURFACES):
        vehicle = grip_on(params, surface)
        _, x, _ = drive_pedals(vehicle, grade, way * START, facing, -way * pedal)
        reached = np.maximum.accumulate(way * x, axis=0)
        ahead = np.diff(reached.reshape(len(x), 4, len(PEDALS)), axis=-1)
        study.row(
            f"pedals against the motion, {100 * grade:g} % slope, {surface}",
            "0, the way by which a harder pedal gets farther",
            "m",
            max(float(ahead.max()), 0.0),
            0.0,
            1e-3,
        )
    return study


def hold_on_ice(
    bed: Testbed, name: str, params: VehicleParameters, quick: bool
) -> Study:
    """A car without a pedal on a slope of ice slides as on locked wheels, no faster."""
    del quick
    study = Study(name, bed.tyres)
    grade = GRADES[-1]
    facing = np.array(BOTH_WAYS)
    vehicle = grip_on(params, "ice")
    time, _, speed = drive_pedals(vehicle, grade, np.zeros(2), facing, np.zeros(2))
    late = time >= SECONDS / 2
    tilt = math.atan(grade)
    friction = SURFACES["ice"] / SURFACES["dry"] * params.tyre.friction
    expected = GRAVITY * (math.sin(tilt) - friction * math.cos(tilt))
    for where, rows in zip(("uphill", "downhill"), speed.T, strict=True):
        study.row(
            f"held on a {100 * grade:g} % slope of ice, facing {where}",
            "g (sin a - mu cos a), wheels locked",
            "m/s^2",
            float(np.polyfit(time[late], np.abs(rows[late]), 1)[0]),
            expected,
            relative(expected, 0.01),
        )
    return study


def creep(bed: Testbed, name: str, params: VehicleParameters, quick: bool) -> Study:
    """Speed at which a slope takes a car away whose pedal is too weak to climb it.

    It faces uphill and drives forwards, or downhill in reverse. The brake, a_hold v /
    v_switch below `SWITCH_SPEED`, bears what the drive does not.
    """
    del quick
    study = Study(name, bed.tyres)
    grade = GRADES[-1]
    tilt = math.atan(grade)
    runs = np.array(list(itertools.product(BOTH_WAYS, WEAK)))
    facing, pedal = runs.T
    time, _, speed = drive_pedals(
        grip_on(params, "dry"), grade, np.zeros(len(runs)), facing, facing * pedal
    )
    late = time >= SECONDS / 2
    down = GRAVITY * (math.sin(tilt) - params.tyre.rolling_resistance * math.cos(tilt))
    for k, weak in enumerate(WEAK):
        expected = SWITCH_SPEED * (down - weak * params.max_acceleration)
        expected /= params.hold_deceleration
        both = np.abs(speed[late].mean(0)).reshape(2, len(WEAK))[:, k]
        study.row(
            f"creep against the drive, {100 * grade:g} % slope, pedal {weak:g}",
            "v_switch (g (sin a - c_rr cos a) - p a_max) / a_hold",
            "m/s",
            float(both.max()),
            expected,
            relative(expected, 0.02),
        )
    return study


def grip_on(params: VehicleParameters, surface: Surface) -> Vehicle:
    """The car with the grip it has on a surface."""
    return with_grip(make_vehicle(params), SURFACES[surface] / SURFACES["dry"])
