"""The shipped driver: pedals on slopes, standstill, and options of `SimConfig`.

Unlike the other manoeuvres these have a pedal: `MjxPhysics` drives as in training.
"""

import functools
import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config import EnvConfig, EpisodeConfig, SimConfig, Surface
from carpark_mj.env import ParkingEnv
from carpark_mj.geometry import move_forward
from carpark_mj.layouts import make_layout
from carpark_mj.mdp.collisions import KERB_HEIGHT
from carpark_mj.observations.sensors import reckon
from carpark_mj.physics.forces import grade_at
from carpark_mj.physics.mjx import CarState, MjxPhysics
from carpark_mj.spawning.reset_options import ResetOptions
from carpark_mj.types import Motion, Odometry
from carpark_mj.vehicle import Vehicle, VehicleParameters, make_vehicle
from carpark_mj.vehicle.drive import CREEP_SPEED, HOLD_PEDAL, HOLD_SPEED, SWITCH_SPEED
from carpark_mj.vehicle.parameters import GRAVITY
from carpark_mj.vehicle.vehicle import SURFACES, with_grip
from vehicle_suite.formulas import rolling_mass, rolling_resistance
from vehicle_suite.report import Study, relative

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
    """Drives up to `WIDTH` cars on ground that rises by `grade` along x.

    Args:
        cars: one, or as many as there are runs.
        grade: rise over run.
        start: (n,) speeds at the start, wheels rolling [m/s].
        facing: (n,) 1 uphill, -1 downhill.
        driver: of the cars.

    Returns:
        Instants (T,) [s], ways (T, n) along the cars' x axes [m], speeds (T, n) [m/s].
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


def harder_is_slower(study: Study) -> None:
    """Pedals from 0 to -1 against the motion: none may get farther than a weaker one.

    Way is counted up to the farthest point, so that turning round ends it.
    """
    params = study.params
    grades = GRADES[2:3] if study.quick else GRADES
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


def hold_on_ice(study: Study) -> None:
    """A car without a pedal on a slope of ice slides as on locked wheels, no faster."""
    params = study.params
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


def creep(study: Study) -> None:
    """Speed at which a slope takes a car away whose pedal is too weak to climb it.

    It faces uphill and drives forwards, or downhill in reverse. The hold, a_hold v /
    v_switch below `SWITCH_SPEED`, bears what the drive does not.
    """
    params = study.params
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


def grip_on(params: VehicleParameters, surface: Surface) -> Vehicle:
    """The car with the grip it has on a surface."""
    return with_grip(make_vehicle(params), SURFACES[surface] / SURFACES["dry"])


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


def coast_after_release(study: Study) -> None:
    """A car that starts with the pedal, which is then released or turned to brake."""
    params = study.params
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
    expected = rolling_resistance(params) / rolling_mass(params)
    study.row(
        "coasting after a start of 0.4 s, mean deceleration over 0.8 s",
        "c_rr m g / (m + 4 I / r^2)",
        "m/s^2",
        float(mean),
        expected,
        0.15,
    )


def stop_from_a_walk(study: Study) -> None:
    """Stops with weak pedals, released below `HOLD_SPEED`: no rebound, no jerk."""
    params = study.params
    runs = np.array(list(itertools.product(STOPS, WALK)))
    pedal, start = runs.T
    driver = Driver(pedal, release=HOLD_SPEED, period=STEP)
    cars = [make_vehicle(params)]
    _, _, speed = drive_pedals(cars, 0.0, start, np.ones(len(runs)), driver)
    rebounds, jerks = (x.reshape(-1, len(WALK)).max(1) for x in _rocking(speed))
    for weak, rebound, hardest in zip(STOPS, rebounds, jerks, strict=True):
        _rock_rows(study, f"stop from a walk, pedal {weak:g}", rebound, hardest)


def taps(study: Study) -> None:
    """A car at rest whose pedal is tapped and released: no rebound, no jerk."""
    params = study.params
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


def speed_control(study: Study) -> None:
    """A proportional controller asks for 0.2 m/s on a slope of 3 %, both ways."""
    params = study.params
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


def reversing(study: Study) -> None:
    """Path errors of a time step of 10 ms under random pedals, in float64."""
    params = study.params
    drives = 8 if study.quick else 48
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


CREEP = 0.4  # m/s^2, 14 N m at the clutch through 15:1 in a car of 1.4 t
ERROR = (0.01, 1.3e-3, 0.01)  # m/m, rad/m and rad/rad of the odometry
STEERING_DELAY, PEDAL_DELAY = 0.24, 0.1  # s, `simple_planning_simulator` of Autoware


def drive_option(
    sim: SimConfig,
    params: VehicleParameters,
    controls: np.ndarray,
    pose: Sequence[float] = (0.0, 0.0, 0.0),
    speed: float = 0.0,
) -> Motion:
    """The motion (T,) of one car after each of the control steps (T, 2)."""
    physics = MjxPhysics(sim)
    state = physics.init(jnp.array(pose, jnp.float32), make_vehicle(params))
    if speed:
        state = physics.set_speed(state, jnp.float32(speed))

    def step(state: CarState, command: jax.Array) -> tuple[CarState, Motion]:
        state = physics.step(state, command)
        return state, physics.read(state)

    drive = jax.jit(lambda state, commands: jax.lax.scan(step, state, commands)[1])
    return jax.device_get(drive(state, jnp.array(controls, jnp.float32)))


def delays(study: Study) -> None:
    """Late commands: when the wheels turn, and the way of commands given later."""
    params = study.params
    late = SimConfig(steering_delay=STEERING_DELAY, pedal_delay=PEDAL_DELAY)
    steps = 10 if study.quick else 30
    controls = np.random.default_rng(0).uniform(-1.0, 1.0, (steps, 2))
    controls[:, 1] = np.abs(controls[:, 1])
    driven = drive_option(late, params, controls)
    every = SimConfig(ctrl_dt=late.sim_dt, trace_dt=late.sim_dt)
    held = np.repeat(controls, late.num_substeps, axis=0)
    for column, delay in enumerate((STEERING_DELAY, PEDAL_DELAY)):
        count = round(delay / late.sim_dt)
        held[:, column] = np.concatenate([np.zeros(count), held[:-count, column]])
    given = drive_option(every, params, held)
    ends = slice(late.num_substeps - 1, None, late.num_substeps)
    apart = driven.pose_w[:, :2] - given.pose_w[ends, :2]
    study.row(
        f"steering {STEERING_DELAY:g} s and pedal {PEDAL_DELAY:g} s late, way",
        "that of the commands given so much later",
        "m",
        float(np.abs(apart).max()),
        0.0,
        1e-4,
    )
    lock = np.tile([1.0, 0.0], (2, 1))
    turned = drive_option(late, params, lock).steering[-1]
    study.row(
        "steering late, full lock at standstill",
        "t - delta / rate",
        "s",
        2 * late.ctrl_dt - float(turned) / params.steering_rate,
        STEERING_DELAY,
        relative(STEERING_DELAY, 0.001),
    )


def automatic(study: Study) -> None:
    """The pedal released at a walk: the speed goes to where the creep is resistance.

    m_eff v' = m (a (1 - v / v_creep) - g c_rr), so that v approaches its last value
    exponentially.
    """
    params = study.params
    seconds = 4.0 if study.quick else 12.0
    sim = SimConfig(creep=CREEP)
    controls = np.zeros((round(seconds / sim.ctrl_dt), 2))
    speed = drive_option(sim, params, controls, speed=0.5).speed
    last = CREEP_SPEED * (1.0 - GRAVITY * params.tyre.rolling_resistance / CREEP)
    rate = CREEP / CREEP_SPEED * params.mass / rolling_mass(params)
    for time in (1.0, seconds):
        expected = last + (0.5 - last) * np.exp(-rate * time)
        study.row(
            f"automatic creeping from 0.5 m/s, after {time:g} s",
            "v_e + (v - v_e) exp(-k t), v_e = v_creep (1 - g c_rr / a)",
            "m/s",
            float(speed[round(time / sim.ctrl_dt) - 1]),
            float(expected),
            relative(float(expected), 0.002),
        )


def odometry(study: Study) -> None:
    """What a car with wrong wheels believes, ahead and on full lock."""
    params = study.params
    steps = 20 if study.quick else 50
    offset = jnp.float32(params.centre_offset)

    def believe(steer: float, error: tuple[float, ...]) -> tuple[np.ndarray, float]:
        """What it believes too much of its pose (3,), and the way of its rear axle."""
        controls = np.tile([steer, 0.5], (steps, 1))
        poses = drive_option(SimConfig(), params, controls).pose_w
        start = Odometry(jnp.zeros(3), jnp.array(error))

        def step(carry: tuple[Odometry, jax.Array], pose: jax.Array):
            odometry, before = carry
            return (reckon(odometry, before, pose, offset), pose), None

        first = start, jnp.zeros(3)
        (after, _), _ = jax.jit(lambda p: jax.lax.scan(step, first, p))(poses)
        turned = np.unwrap(np.append(0.0, poses[:, 2]))[-1]
        wrong = np.asarray(after.pose_w) - poses[-1]
        wrong[2] = (wrong[2] + np.pi) % (2 * np.pi) - np.pi
        return wrong, turned if steer else float(poses[-1, 0])

    scale, veer, turn = ERROR
    for row, formula, unit, steer, error, place, size in (
        ("distance ahead", "e_s s", "m", 0.0, (scale, 0.0, 0.0), 0, scale),
        ("heading ahead", "e_v s", "rad", 0.0, (0.0, veer, 0.0), 2, veer),
        ("heading on full lock", "e_t phi", "rad", 1.0, (0.0, 0.0, turn), 2, turn),
    ):
        wrong, way = believe(steer, error)
        expected = size * way
        study.row(
            f"odometry, {row}",
            formula,
            unit,
            float(wrong[place]),
            expected,
            relative(expected, 0.002),
        )


def wheel_stop(study: Study) -> None:
    """A car reverses into a bay until a wheel stop stops its rear tyres."""
    params = study.params
    distance = 0.9
    config = EnvConfig(
        num_agents=1,
        num_parked_cars=0,
        episode=EpisodeConfig(
            parked_rule="precise", kerb_speed=0.6, wheel_stops=distance, respawn=False
        ),
    )
    env = ParkingEnv(config, vehicle=params)
    layout = make_layout(env.layout_config)
    bay, (length, _) = layout.bay_pose[0], layout.bay_size[0]
    start = move_forward(bay, 1.0)
    options = ResetOptions(pose=start[None], goal=jnp.zeros(1, jnp.int32))
    state, _ = jax.jit(env.reset)(jax.random.key(0), options=options)
    step, speed = jax.jit(env.step), 0.0
    for _ in range(60):  # drives back at a walk
        pedal = np.clip(2.0 * (-0.4 - speed), -1.0, 1.0)
        state, timestep = step(state, jnp.array([[0.0, pedal]]))
        speed = float(timestep.motion.speed[0])
    to_end = jnp.dot(
        (state.motion.xy[0] - bay[:2]), jnp.array([jnp.cos(bay[2]), jnp.sin(bay[2])])
    )
    found = float(to_end) + float(length) / 2 - params.centre_offset
    radius = params.wheel_radius
    expected = distance + np.sqrt(2 * radius * KERB_HEIGHT - KERB_HEIGHT**2)
    study.row(
        f"wheel stop {100 * KERB_HEIGHT:g} cm high, touched at 0.4 m/s, rear axle",
        "d + sqrt(2 r h - h^2)",
        "m",
        found,
        float(expected),
        (0.4 * config.sim.trace_dt, "it stands at the last instant before the touch"),
    )


def ramp(study: Study) -> None:
    """A car coasts up a ramp, and drives on one that is longer than its way."""
    params = study.params
    sim = SimConfig(ramp=(2.0, 3.0, 0.05))
    coast = np.zeros((20 if study.quick else 24, 2))
    driven = drive_option(sim, params, coast, speed=2.8)
    # Of the centre of gravity, which is where the slope is.
    ahead = params.cg_to_rear_axle - params.centre_offset
    x = np.linspace(ahead, ahead + float(driven.pose_w[-1, 0]), 4001)
    angle = np.arctan(np.asarray(grade_at(sim, jnp.array(x))))
    climbed, pressed = np.trapezoid(np.sin(angle), x), np.trapezoid(np.cos(angle), x)
    lost = climbed + params.tyre.rolling_resistance * pressed
    expected = np.sqrt(2.8**2 - 2 * GRAVITY * params.mass / rolling_mass(params) * lost)
    study.row(
        "ramp of 5 %, coasting up from 2.8 m/s, speed above it",
        "m_eff (v^2 - v0^2) / 2 = -m g (z + c_rr integral cos a)",
        "m/s",
        float(driven.speed[-1]),
        float(expected),
        relative(float(expected), 0.01),
    )
    controls = np.random.default_rng(0).uniform(-1.0, 1.0, (len(coast), 2))
    wide = drive_option(SimConfig(ramp=(-99.0, 99.0, 0.1)), params, controls)
    steady = drive_option(SimConfig(grade_x=0.1), params, controls)
    study.row(
        "ramp of 10 %, driving on it",
        "the way on a slope",
        "m",
        float(np.abs(wide.pose_w[:, :2] - steady.pose_w[:, :2]).max()),
        0.0,
        1e-4,
    )
