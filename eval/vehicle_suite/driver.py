"""The shipped driver: pedals on slopes, standstill, and options of `SimConfig`.

Unlike the other manoeuvres these have a pedal: `MjxPhysics` drives as in training.
"""

import functools
import itertools
import math
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
from vehicle_suite.report import Study

GRADES = (0.0, 0.05, 0.1, 0.15)  # rise over run
PEDALS = (0.0, 1e-6, 0.04, HOLD_PEDAL, 0.06, 0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 0.85, 1.0)

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
        target: speed to be controlled [m/s].
        gain: pedal per m/s below it; 0 is no control.
        release: speed below which the pedal is let go for good [m/s]; 0 is never.
        period: control period [instants].
    """

    pedal: jax.Array | np.ndarray | float
    target: float = 0.0
    gain: float = 0.0
    release: float = 0.0
    period: int = 1


@functools.cache
def _program(grade: float):
    """Compiles `SECONDS` of `WIDTH` cars with a driver, on a slope uphill along x."""
    physics = MjxPhysics(SimConfig(grade_x=grade, ctrl_dt=DT, trace_dt=DT))

    @jax.jit
    def run(state: CarState, driver: Driver) -> tuple[jax.Array, jax.Array]:
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

    return physics, run


def drive_pedals(
    car: Vehicle,
    driver: Driver,
    start: np.ndarray,
    facing: np.ndarray | float = 1.0,
    grade: float = 0.0,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Drives up to `WIDTH` of a car on ground that rises along x.

    Args:
        car: all are like it.
        driver: of the cars.
        start: (n,) speeds at the start, wheels rolling [m/s].
        facing: (n,) or of all: 1 uphill, -1 downhill.
        grade: rise over run.

    Returns:
        Instants (T,) [s], ways (T, n) along the cars' x axes [m], speeds (T, n) [m/s].
    """
    n = len(start)
    physics, run = _program(grade)
    fill = np.arange(WIDTH) % n
    facing = np.broadcast_to(facing, n)
    pose = np.zeros((WIDTH, 3))
    pose[:, 2] = np.where(facing[fill] > 0, 0.0, math.pi)
    cars = jax.tree.map(lambda x: jnp.stack([x] * WIDTH), car)
    state = physics.init(jnp.array(pose, jnp.float32), cars)
    state = physics.set_speed(state, jnp.array(start[fill], jnp.float32))
    pedal = np.broadcast_to(driver.pedal, (SUBSTEPS, n))[:, fill]
    whole = driver._replace(pedal=np.asarray(pedal, np.float32))
    x, speed = jax.device_get(run(state, whole))
    time = DT * np.arange(1, SUBSTEPS + 1)
    return time, x[:, :n].astype(float) * facing, speed[:, :n].astype(float)


def drive(
    sim: SimConfig, cars: Vehicle, controls: np.ndarray, speed: float = 0.0
) -> Motion:
    """The motion (T, ...) of cars (...) after each of the control steps (T, ..., 2)."""
    physics, dtype = MjxPhysics(sim), jnp.result_type(float)
    state = physics.init(jnp.zeros((*controls.shape[1:-1], 3), dtype), cars)
    if speed:
        state = physics.set_speed(state, jnp.array(speed, dtype))

    def step(state: CarState, command: jax.Array) -> tuple[CarState, Motion]:
        state = physics.step(state, command)
        return state, physics.read(state)

    run = jax.jit(lambda state, commands: jax.lax.scan(step, state, commands)[1])
    return jax.device_get(run(state, jnp.array(controls, dtype)))


def harder_is_slower(study: Study) -> None:
    """Pedals from 0 to -1 against the motion: none may get farther than a weaker one.

    Way is counted up to the farthest point, so that turning round ends it.
    """
    params = study.params
    grades = GRADES[2:3] if study.quick else GRADES
    runs = np.array(list(itertools.product(BOTH_WAYS, BOTH_WAYS, STARTS, PEDALS)))
    facing, way, start, pedal = runs.T
    for grade, surface in itertools.product(grades, SURFACES):
        driver = Driver(-way * pedal)
        car = grip_on(params, surface)
        _, x, _ = drive_pedals(car, driver, way * start, facing, grade)
        reached = np.maximum.accumulate(way * x, axis=0)
        ahead = np.diff(reached.reshape(len(x), 8, len(PEDALS)), axis=-1)
        what = f"pedals against the motion, {100 * grade:g} % slope, {surface}"
        study.row(what, max(float(ahead.max()), 0.0))


def hold_on_ice(study: Study) -> None:
    """A car without a pedal on a slope of ice slides as on locked wheels, no faster."""
    params = study.params
    grade = GRADES[-1]
    facing = np.array(BOTH_WAYS)
    car = grip_on(params, "ice")
    time, _, speed = drive_pedals(car, Driver(0.0), np.zeros(2), facing, grade)
    late = time >= SECONDS / 2
    tilt = math.atan(grade)
    friction = SURFACES["ice"] / SURFACES["dry"] * params.tyre.friction
    expected = GRAVITY * (math.sin(tilt) - friction * math.cos(tilt))
    for where, rows in zip(("uphill", "downhill"), speed.T, strict=True):
        what = f"held on a {100 * grade:g} % slope of ice, facing {where}"
        slope = np.polyfit(time[late], np.abs(rows[late]), 1)[0]
        study.row(what, float(slope), expected)


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
    car, driver = grip_on(params, "dry"), Driver(facing * pedal)
    time, _, speed = drive_pedals(car, driver, np.zeros(len(runs)), facing, grade)
    late = time >= SECONDS / 2
    slope = f"{100 * grade:g} % slope"
    what = f"rolling back before a weak drive holds, {slope}"
    study.row(what, max(float(-(speed * facing).min()), 0.0))
    down = GRAVITY * (math.sin(tilt) - params.tyre.rolling_resistance * math.cos(tilt))
    for k, weak in enumerate(WEAK):
        expected = SWITCH_SPEED * (down - weak * params.max_acceleration)
        expected /= params.hold_deceleration
        both = np.abs(speed[late].mean(0)).reshape(2, len(WEAK))[:, k]
        what = f"creep against the drive, {slope}, pedal {weak:g}"
        study.row(what, float(both.max()), expected)


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
REVERSING: tuple[Surface, ...] = ("dry", "ice")


def coast_after_release(study: Study) -> None:
    """A car that starts with the pedal, which is then released or turned to brake."""
    params = study.params
    runs = np.array(list(itertools.product(BOTH_WAYS, (0.0, 0.5, 1.5), RELEASES)))
    way, start, pedal = runs.T
    pedals = np.where(np.arange(SUBSTEPS)[:, None] < 2 * STEP, way, way * pedal)
    car = make_vehicle(params)
    _, _, speed = drive_pedals(car, Driver(pedals), way * start)
    speed = way * speed[2 * STEP - 1 :]  # from the release on
    # Over 0.1 s, in which released wheels ring once or more.
    slowing = (speed[:-10] - speed[10:]) / (10 * DT)
    demand = np.where(pedal <= -HOLD_PEDAL, -pedal * params.max_deceleration, 0.0)
    beyond = np.where(speed[10:] > ROLLING, slowing - demand, 0.0)
    what = f"braking beyond the pedal above {ROLLING:g} m/s, pedal released"
    study.row(what, float(beyond.max()))
    (k,) = np.flatnonzero((start == 0.0) & (pedal == 0.0) & (way > 0))
    mean = (speed[0, k] - speed[4 * STEP, k]) / (4 * STEP * DT)
    expected = rolling_resistance(params) / rolling_mass(params)
    what = "coasting after a start of 0.4 s, mean deceleration over 0.8 s"
    study.row(what, float(mean), expected)


def stop_from_a_walk(study: Study) -> None:
    """Stops with weak pedals, released below `HOLD_SPEED`: no rebound, no jerk."""
    params = study.params
    runs = np.array(list(itertools.product(STOPS, WALK)))
    pedal, start = runs.T
    driver = Driver(pedal, release=HOLD_SPEED, period=STEP)
    _, _, speed = drive_pedals(make_vehicle(params), driver, start)
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
    _, _, speed = drive_pedals(make_vehicle(params), driver, np.zeros(len(runs)))
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
    study.row(f"{what}, rebound", float(rebound))
    study.row(f"{what}, jerk below 0.05 m/s", float(jerk))


def speed_control(study: Study) -> None:
    """A proportional controller asks for 0.2 m/s on a slope of 3 %, both ways."""
    params = study.params
    facing, car = np.array(BOTH_WAYS), grip_on(params, "dry")
    for rate, gain in GAINS.items():
        driver = Driver(0.0, target=SLOW, gain=gain, period=round(1 / (rate * DT)))
        time, _, speed = drive_pedals(car, driver, np.zeros(2), facing, GRADE)
        late = speed[time > 3.0]
        for k, where in enumerate(("uphill", "downhill")):
            tilt = math.atan(GRADE) * facing[k]
            load = math.sin(tilt) + params.tyre.rolling_resistance * math.cos(tilt)
            most = params.max_acceleration if load > 0 else params.max_deceleration
            expected = SLOW - GRAVITY * load / (gain * most)
            what = f"speed control at {SLOW:g} m/s, {rate} Hz, 3 % {where}"
            study.row(f"{what}, mean", float(late[:, k].mean()), expected)
            study.row(f"{what}, least", float(late[:, k].min()), expected)


def reversing(study: Study) -> None:
    """Path errors of a time step of 10 ms under random pedals, in float64."""
    params = study.params
    drives = 8 if study.quick else 48
    pedals = np.random.default_rng(0).uniform(-1.0, 1.0, (PEDAL_STEPS, drives))
    controls = np.stack([np.zeros_like(pedals), pedals], -1)
    with jax.enable_x64(True):
        cars = [grip_on(params, s) for s in REVERSING for _ in range(drives)]
        fleet = jax.tree.map(lambda *x: jnp.stack(x), *cars)
        twice = np.tile(controls, (1, len(REVERSING), 1))
        coarse, exact = (
            drive(SimConfig(sim_dt=dt, trace_dt=0.1), fleet, twice).trace_w[..., 0]
            for dt in TIME_STEPS
        )
    coarse, exact = (
        np.moveaxis(x, 2, 1).reshape(-1, x.shape[1]) for x in (coarse, exact)
    )
    length = np.abs(np.diff(exact, axis=0)).sum(0)
    error = 100 * np.abs(coarse - exact).max(0) / length
    what = "time-step error, 10 against 1 ms, random reversing"
    for surface, errors in zip(REVERSING, np.split(error, len(REVERSING)), strict=True):
        for share in (0.5, 0.9, 1.0):
            name = f"{what}, {surface}, quantile {share:g}"
            study.row(name, float(np.quantile(errors, share)))


CREEP = 0.4  # m/s^2, 14 N m at the clutch through 15:1 in a car of 1.4 t
ERROR = (0.01, 1.3e-3, 0.01)  # m/m, rad/m and rad/rad of the odometry
STEERING_DELAY, PEDAL_DELAY = 0.24, 0.1  # s, `simple_planning_simulator` of Autoware


def delays(study: Study) -> None:
    """Late commands: when the wheels turn, and the way of commands given later."""
    params = study.params
    late = SimConfig(steering_delay=STEERING_DELAY, pedal_delay=PEDAL_DELAY)
    steps = 10 if study.quick else 30
    controls = np.random.default_rng(0).uniform(-1.0, 1.0, (steps, 2))
    controls[:, 1] = np.abs(controls[:, 1])
    car = make_vehicle(params)
    driven = drive(late, car, controls)
    every = SimConfig(ctrl_dt=late.sim_dt, trace_dt=late.sim_dt)
    held = np.repeat(controls, late.num_substeps, axis=0)
    for column, delay in enumerate((STEERING_DELAY, PEDAL_DELAY)):
        count = round(delay / late.sim_dt)
        held[:, column] = np.concatenate([np.zeros(count), held[:-count, column]])
    given = drive(every, car, held)
    ends = slice(late.num_substeps - 1, None, late.num_substeps)
    apart = driven.pose_w[:, :2] - given.pose_w[ends, :2]
    what = f"steering {STEERING_DELAY:g} s and pedal {PEDAL_DELAY:g} s late, way"
    study.row(what, float(np.abs(apart).max()))
    turned = drive(late, car, np.tile([1.0, 0.0], (2, 1))).steering[-1]
    turning = float(turned) / params.steering_rate
    what = "steering late, full lock at standstill"
    study.row(what, 2 * late.ctrl_dt - turning, STEERING_DELAY)


def automatic(study: Study) -> None:
    """The pedal released at a walk: the speed goes to where the creep is resistance.

    m_eff v' = m (a (1 - v / v_creep) - g c_rr), so that v approaches its last value
    exponentially.
    """
    params = study.params
    seconds = 4.0 if study.quick else 12.0
    sim = SimConfig(creep=CREEP)
    controls = np.zeros((round(seconds / sim.ctrl_dt), 2))
    speed = drive(sim, make_vehicle(params), controls, 0.5).speed
    last = CREEP_SPEED * (1.0 - GRAVITY * params.tyre.rolling_resistance / CREEP)
    rate = CREEP / CREEP_SPEED * params.mass / rolling_mass(params)
    for time in (1.0, seconds):
        expected = last + (0.5 - last) * np.exp(-rate * time)
        found = float(speed[round(time / sim.ctrl_dt) - 1])
        study.row(f"automatic creeping from 0.5 m/s, after {time:g} s", found, expected)


def odometry(study: Study) -> None:
    """What a car with wrong wheels believes, ahead and on full lock."""
    params = study.params
    steps = 20 if study.quick else 50
    offset = jnp.float32(params.centre_offset)

    def believe(steer: float, error: tuple[float, ...]) -> tuple[np.ndarray, float]:
        """What it believes too much of its pose (3,), and the way of its rear axle."""
        controls = np.tile([steer, 0.5], (steps, 1))
        poses = drive(SimConfig(), make_vehicle(params), controls).pose_w
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
    for what, steer, error, place, size in (
        ("distance ahead", 0.0, (scale, 0.0, 0.0), 0, scale),
        ("heading ahead", 0.0, (0.0, veer, 0.0), 2, veer),
        ("heading on full lock", 1.0, (0.0, 0.0, turn), 2, turn),
    ):
        wrong, way = believe(steer, error)
        study.row(f"odometry, {what}", float(wrong[place]), size * way)


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
    height = f"{100 * KERB_HEIGHT:g} cm"
    what = f"wheel stop {height} high, touched at 0.4 m/s, rear axle"
    study.row(what, found, float(expected))


def ramp(study: Study) -> None:
    """A car coasts up a ramp, and drives on one that is longer than its way."""
    params = study.params
    sim = SimConfig(ramp=(2.0, 3.0, 0.05))
    coast = np.zeros((20 if study.quick else 24, 2))
    car = make_vehicle(params)
    driven = drive(sim, car, coast, 2.8)
    # Of the centre of gravity, which is where the slope is.
    ahead = params.cg_to_rear_axle - params.centre_offset
    x = np.linspace(ahead, ahead + float(driven.pose_w[-1, 0]), 4001)
    angle = np.arctan(np.asarray(grade_at(sim, jnp.array(x))))
    climbed, pressed = np.trapezoid(np.sin(angle), x), np.trapezoid(np.cos(angle), x)
    lost = climbed + params.tyre.rolling_resistance * pressed
    expected = np.sqrt(2.8**2 - 2 * GRAVITY * params.mass / rolling_mass(params) * lost)
    what = "ramp of 5 %, coasting up from 2.8 m/s, speed above it"
    study.row(what, float(driven.speed[-1]), float(expected))
    controls = np.random.default_rng(0).uniform(-1.0, 1.0, (len(coast), 2))
    wide = drive(SimConfig(ramp=(-99.0, 99.0, 0.1)), car, controls)
    steady = drive(SimConfig(grade_x=0.1), car, controls)
    apart = np.abs(wide.pose_w[:, :2] - steady.pose_w[:, :2])
    study.row("ramp of 10 %, driving on it", float(apart.max()))
