"""The shipped driver about standstill: coasting, stopping, creeping, time steps."""

import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config import SimConfig, Surface
from carpark_mj.physics.mjx import MjxPhysics
from carpark_mj.vehicle import VehicleParameters, make_vehicle
from carpark_mj.vehicle.drive import HOLD_PEDAL, HOLD_SPEED
from carpark_mj.vehicle.parameters import GRAVITY
from vehicle_suite import formulas
from vehicle_suite.pedals import BOTH_WAYS, DT, SUBSTEPS, Driver, drive_pedals, grip_on
from vehicle_suite.table import Study
from vehicle_suite.testbed import Testbed

STEP = 20  # instants of a control step of 0.2 s
RELEASES = (0.0, -0.06, -0.1, -0.15, -0.2)  # pedals against the motion, after a start
ROLLING = 0.35  # m/s, above `HOLD_SPEED`
STOPS = (-0.06, -0.1, -0.2, -0.3)
WALK = (1.2, 1.3, 1.4, 1.5, 1.6)  # m/s
TAPS, TAP_PEDALS = (10, 20, 30), (0.1, 0.2, 0.3, 0.5, 0.7, 1.0)  # instants
SMOOTH = 5  # instants over which an acceleration is averaged, a fifth of a rocking
GRADE, SLOW = 0.03, 0.2  # rise over run, m/s
# Pedal per m/s, by the rate of the controller [Hz]. The brake, 4 m/s^2 at full pedal,
# allows 2.5 at 5 Hz: a greater gain brakes away more than twice what is too fast.
GAINS = {5: 2.5, 10: 4.0, 50: 2.5}
PEDAL_STEPS = 20  # of a random drive
TIME_STEPS = (0.01, 0.001)  # s
# Tolerances of the median, the 90 % quantile and the worst of random drives.
REVERSING: dict[Surface, tuple[float, float, float]] = {
    "dry": (3.0, 6.0, 25.0),
    "ice": (6.0, 15.0, 30.0),
}


def coast_after_release(
    bed: Testbed, name: str, params: VehicleParameters, quick: bool
) -> Study:
    """A car that starts with the pedal, which is then released or turned to brake."""
    del quick
    study = Study(name, bed.tyres)
    runs = np.array(list(itertools.product(BOTH_WAYS, (0.0, 0.5, 1.5), RELEASES)))
    way, start, pedal = runs.T
    pedals = np.where(np.arange(SUBSTEPS)[:, None] < 2 * STEP, way, way * pedal)
    cars = [make_vehicle(params)]
    _, _, speed = drive_pedals(
        cars, 0.0, way * start, np.ones(len(runs)), Driver(pedals)
    )
    speed = way * speed[2 * STEP - 1 :]  # from the release on
    # Over 0.1 s, in which released wheels ring once or more.
    slowing = (speed[:-10] - speed[10:]) / (10 * DT)
    demand = np.where(pedal <= -HOLD_PEDAL, -pedal * params.max_deceleration, 0.0)
    beyond = np.where(speed[10:] > ROLLING, slowing - demand, 0.0)
    study.row(
        f"braking beyond the pedal above {ROLLING:g} m/s, pedal released",
        "0; rolling resistance and ringing wheels are less than 1.5",
        "m/s^2",
        float(beyond.max()),
        0.0,
        1.5,
    )
    (k,) = np.flatnonzero((start == 0.0) & (pedal == 0.0) & (way > 0))
    mean = (speed[0, k] - speed[4 * STEP, k]) / (4 * STEP * DT)
    expected = formulas.rolling_resistance(params) / formulas.rolling_mass(params)
    study.row(
        "coasting after a start of 0.4 s, mean deceleration over 0.8 s",
        "c_rr m g / (m + 4 I / r^2)",
        "m/s^2",
        float(mean),
        expected,
        0.15,
    )
    return study


def stop_from_a_walk(
    bed: Testbed, name: str, params: VehicleParameters, quick: bool
) -> Study:
    """Stops with weak pedals, released below `HOLD_SPEED`: no rebound, no jerk."""
    del quick
    study = Study(name, bed.tyres)
    runs = np.array(list(itertools.product(STOPS, WALK)))
    pedal, start = runs.T
    driver = Driver(pedal, release=HOLD_SPEED, period=STEP)
    cars = [make_vehicle(params)]
    _, _, speed = drive_pedals(cars, 0.0, start, np.ones(len(runs)), driver)
    rebounds, jerks = (x.reshape(-1, len(WALK)).max(1) for x in _rocking(speed))
    for weak, rebound, hardest in zip(STOPS, rebounds, jerks, strict=True):
        _rock_rows(study, f"stop from a walk, pedal {weak:g}", rebound, hardest)
    return study


def taps(bed: Testbed, name: str, params: VehicleParameters, quick: bool) -> Study:
    """A car at rest whose pedal is tapped and released: no rebound, no jerk."""
    del quick
    study = Study(name, bed.tyres)
    runs = np.array(list(itertools.product(BOTH_WAYS, TAP_PEDALS, TAPS)))
    way, pedal, end = runs.T
    pressed = np.arange(SUBSTEPS)[:, None] < end
    driver = Driver(np.where(pressed, way * pedal, 0.0))
    cars = [make_vehicle(params)]
    _, _, speed = drive_pedals(
        cars, 0.0, np.zeros(len(runs)), np.ones(len(runs)), driver
    )
    rebounds, jerks = _rocking(way * speed, end.astype(int))
    for tap in TAPS:
        rows = end == tap
        what = f"tap of {tap * DT:g} s on the pedal"
        _rock_rows(study, what, rebounds[rows].max(), jerks[rows].max())
    return study


def _rocking(
    speed: np.ndarray, start: np.ndarray | int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """How cars (T, n) [m/s] that drove forwards come to rest.

    Returns:
        Fastest speeds backwards (n,) [m/s], and the greatest jerks (n,) [m/s^3] below
        0.05 m/s, from an instant (n,) on.
    """
    kernel = np.ones(SMOOTH) / SMOOTH
    acceleration = np.diff(speed, axis=0) / DT
    smooth = np.array([np.convolve(a, kernel, "valid") for a in acceleration.T]).T
    jerk = np.abs(np.diff(smooth, axis=0) / DT)
    middle = (SMOOTH + 1) // 2  # of the instants that a jerk is computed from
    counts = np.abs(speed[middle : middle + len(jerk)]) < 0.05
    counts &= np.arange(len(jerk))[:, None] >= start
    return np.maximum(-speed.min(0), 0.0), np.where(counts, jerk, 0.0).max(0)


def _rock_rows(study: Study, what: str, rebound: float, jerk: float) -> None:
    study.row(f"{what}, rebound", "0", "m/s", float(rebound), 0.0, 0.03)
    study.row(f"{what}, jerk below 0.05 m/s", "0", "m/s^3", float(jerk), 0.0, 10.0)


def speed_control(
    bed: Testbed, name: str, params: VehicleParameters, quick: bool
) -> Study:
    """A proportional controller asks for 0.2 m/s on a slope of 3 %, both ways."""
    del quick
    study = Study(name, bed.tyres)
    facing, cars = np.array(BOTH_WAYS), [grip_on(params, "dry")]
    for rate, gain in GAINS.items():
        driver = Driver(0.0, target=SLOW, gain=gain, period=round(1 / (rate * DT)))
        time, _, speed = drive_pedals(cars, GRADE, np.zeros(2), facing, driver)
        late = speed[time > 3.0]
        for k, where in enumerate(("uphill", "downhill")):
            tilt = math.atan(GRADE) * facing[k]
            load = math.sin(tilt) + params.tyre.rolling_resistance * math.cos(tilt)
            most = params.max_acceleration if load > 0 else params.max_deceleration
            expected = SLOW - GRAVITY * load / (gain * most)
            what = f"speed control at {SLOW:g} m/s, {rate} Hz, 3 % {where}"
            mean, least = float(late[:, k].mean()), float(late[:, k].min())
            formula = "v - g (sin a + c_rr cos a) / (K a_pedal)"
            study.row(f"{what}, mean", formula, "m/s", mean, expected, 0.06)
            study.row(f"{what}, least", formula, "m/s", least, expected, 0.16)
    return study


def reversing(bed: Testbed, name: str, params: VehicleParameters, quick: bool) -> Study:
    """Path errors of a time step of 10 ms under random pedals, in float64."""
    study = Study(name, bed.tyres)
    drives = 8 if quick else 48
    pedals = np.random.default_rng(0).uniform(-1.0, 1.0, (PEDAL_STEPS, drives))
    with jax.enable_x64(True):
        coarse, exact = (_random_drives(params, pedals, dt) for dt in TIME_STEPS)
    length = np.abs(np.diff(exact, axis=0)).sum(0)
    error = 100 * np.abs(coarse - exact).max(0) / length
    for surface, errors in zip(REVERSING, error, strict=True):
        for share, most in zip((0.5, 0.9, 1.0), REVERSING[surface], strict=True):
            study.row(
                "time-step error, 10 against 1 ms, random reversing, "
                f"{surface}, quantile {share:g}",
                "0",
                "% of the path",
                float(np.quantile(errors, share)),
                0.0,
                most,
            )
    return study


def _random_drives(
    params: VehicleParameters, pedals: np.ndarray, dt: float
) -> np.ndarray:
    """Ways (T, surfaces, n) [m] of cars with pedals (steps, n), at every 0.1 s."""
    physics = MjxPhysics(SimConfig(sim_dt=dt, trace_dt=0.1))
    shape = (len(REVERSING), pedals.shape[1])
    grips = [grip_on(params, surface) for surface in REVERSING]
    cars = jax.tree.map(lambda *x: jnp.repeat(jnp.stack(x), shape[1], axis=0), *grips)

    @jax.jit
    def drive(state, pedals):
        def step(state, pedal):
            pedal = jnp.tile(pedal, shape[0])
            controls = jnp.stack([jnp.zeros_like(pedal), pedal], -1)
            state = physics.step(state, controls)
            return state, state.trace_w[..., 0]

        return jax.lax.scan(step, state, pedals)[1]

    start = physics.init(jnp.zeros((math.prod(shape), 3)), cars)
    traces = drive(start, jnp.array(pedals))
    return np.asarray(jnp.moveaxis(traces, 2, 1)).reshape(-1, *shape)
