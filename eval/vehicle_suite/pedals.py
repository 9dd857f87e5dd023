"""The shipped driver on slopes: harder pedals slow down more, and the hold holds.

Unlike the other manoeuvres these have a pedal. `MjxPhysics` drives them as in training;
surfaces scale the cars' grip, so that one compiled program serves a slope.
"""

import functools
import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config import SimConfig, Surface
from carpark_mj.physics.mjx import CarState, MjxPhysics
from carpark_mj.vehicle import Vehicle, VehicleParameters, make_vehicle
from carpark_mj.vehicle.conditions import SURFACES, with_grip
from carpark_mj.vehicle.drive import HOLD_PEDAL, SWITCH_SPEED
from carpark_mj.vehicle.parameters import GRAVITY
from vehicle_suite.table import Study, relative
from vehicle_suite.testbed import Testbed

GRADES = (0.0, 0.05, 0.1, 0.15)  # rise over run
PEDALS = (0.0, 1e-6, 0.04, HOLD_PEDAL, 0.06, 0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 0.85, 1.0)
Array = jax.Array | np.ndarray | float

STARTS = (1.0, 2.0)  # m/s, above `HOLD_SPEED`
BOTH_WAYS = (1.0, -1.0)  # along the car's x
WEAK = (0.06, 0.3, 0.5)  # pedals that no car climbs the steepest slope with
WIDTH = len(PEDALS) * 8  # cars of one call
SECONDS, DT = 15.0, 0.01  # s, of a drive and between its instants
SUBSTEPS = round(SECONDS / DT)


class Driver(NamedTuple):
    """Who presses the pedals of cars (n,): open loop, speed control, a stop.

    Attributes:
        pedal: (n,) or, by instant, (`SUBSTEPS`, n), in [-1, 1].
        target: (n,) speed to be controlled [m/s].
        gain: (n,) pedal per m/s below it; 0 is no control.
        release: (n,) speed below which the pedal is let go for good [m/s]; 0 is never.
        period: control period of all cars [instants].
    """

    pedal: Array
    target: Array = 0.0
    gain: Array = 0.0
    release: Array = 0.0
    period: Array = 1


@functools.cache
def _program(grade: float):
    """Compiles `SECONDS` of `WIDTH` cars with a driver, on a slope uphill along x."""
    physics = MjxPhysics(SimConfig(grade_x=grade, ctrl_dt=DT, trace_dt=DT))

    @jax.jit
    def drive(state: CarState, driver: Driver) -> tuple[jax.Array, jax.Array]:
        def step(carry: tuple[CarState, jax.Array, jax.Array], now):
            state, pedal, released = carry
            instant, asked = now
            speed = physics.read(state).velocity_b[:, 0]
            asked = asked + driver.gain * (driver.target - speed)
            lets_go = released | (jnp.abs(speed) < driver.release)
            asked = jnp.where(lets_go, 0.0, jnp.clip(asked, -1.0, 1.0))
            acts = instant % driver.period == 0
            pedal = jnp.where(acts, asked, pedal)
            released = jnp.where(acts, lets_go, released)
            controls = jnp.stack([jnp.zeros_like(pedal), pedal], -1)
            state = physics.step(state, controls)
            motion = physics.read(state)
            seen = motion.pose_w[:, 0], motion.velocity_b[:, 0]
            return (state, pedal, released), seen

        start = state, jnp.zeros(WIDTH), jnp.zeros(WIDTH, bool)
        return jax.lax.scan(step, start, (jnp.arange(SUBSTEPS), driver.pedal))[1]

    return physics, drive


def drive_pedals(
    cars: Sequence[Vehicle],
    grade: float,
    start: np.ndarray,
    facing: np.ndarray,
    driver: Driver,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Drives up to `WIDTH` cars.

    Args:
        cars: one, or as many as there are runs.
        grade: rise over run of the ground along x.
        start: (n,) speeds at the start, wheels rolling [m/s].
        facing: (n,) 1 uphill, -1 downhill.
        driver: of the cars.

    Returns:
        Instants (T,) [s], and of each car the way (T, n) along its own x axis [m] and
        its speed (T, n) [m/s].
    """
    n = len(start)
    physics, drive = _program(grade)
    fill = np.arange(WIDTH) % n
    many = [cars[k % len(cars)] for k in fill.tolist()]
    stacked = jax.tree.map(lambda *x: jnp.stack(x), *many)
    start, facing = start[fill], facing[fill]
    pose = np.zeros((WIDTH, 3))
    pose[:, 2] = np.where(facing > 0, 0.0, math.pi)
    state = physics.init(jnp.array(pose, jnp.float32), stacked)
    state = physics.set_speed(state, jnp.array(start, jnp.float32))

    def filled(value: Array) -> np.ndarray:
        whole = np.broadcast_to(value, (*np.shape(value)[:-1], n))
        return np.asarray(whole[..., fill], np.float32)

    whole = Driver(
        np.broadcast_to(filled(driver.pedal), (SUBSTEPS, WIDTH)),
        *map(filled, (driver.target, driver.gain, driver.release)),
        period=np.array(driver.period),
    )
    x, speed = jax.device_get(drive(state, whole))
    time = DT * np.arange(1, SUBSTEPS + 1)
    return time, (x * facing)[:, :n].astype(float), speed[:, :n].astype(float)


def harder_is_slower(
    bed: Testbed, name: str, params: VehicleParameters, quick: bool
) -> Study:
    """Pedals from 0 to -1 against the motion: none may get farther than a weaker one.

    Way is counted up to the farthest point, so that turning round ends it.
    """
    study = Study(name, bed.tyres)
    grades = GRADES[2:3] if quick else GRADES
    runs = np.array(list(itertools.product(BOTH_WAYS, BOTH_WAYS, STARTS, PEDALS)))
    facing, way, start, pedal = runs.T
    for grade, surface in itertools.product(grades, SURFACES):
        cars = [grip_on(params, surface)]
        driver = Driver(-way * pedal)
        _, x, _ = drive_pedals(cars, grade, way * start, facing, driver)
        reached = np.maximum.accumulate(way * x, axis=0)
        ahead = np.diff(reached.reshape(len(x), 8, len(PEDALS)), axis=-1)
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
    cars = [grip_on(params, "ice")]
    time, _, speed = drive_pedals(cars, grade, np.zeros(2), facing, Driver(0.0))
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

    It faces uphill and drives forwards, or downhill in reverse. The hold, a_hold v /
    v_switch below `SWITCH_SPEED`, bears what the drive does not.
    """
    del quick
    study = Study(name, bed.tyres)
    grade = GRADES[-1]
    tilt = math.atan(grade)
    runs = np.array(list(itertools.product(BOTH_WAYS, WEAK)))
    facing, pedal = runs.T
    cars = [grip_on(params, "dry")]
    driver = Driver(facing * pedal)
    time, _, speed = drive_pedals(cars, grade, np.zeros(len(runs)), facing, driver)
    late = time >= SECONDS / 2
    study.row(
        f"rolling back before a weak drive holds, {100 * grade:g} % slope",
        "0, the fastest",
        "m/s",
        max(float(-(speed * facing).min()), 0.0),
        0.0,
        0.06,
    )
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
