"""The shipped driver: pedals on slopes, standstill, and options of `SimConfig`.

Unlike the other manoeuvres these have a pedal: `MjxPhysics` drives as in training.
"""

import itertools
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from carpark_mj.config import EnvConfig, EpisodeConfig, SimConfig, Surface
from carpark_mj.env import ParkingEnv
from carpark_mj.geometry import move_forward
from carpark_mj.layouts import make_layout
from carpark_mj.mdp.collisions import KERB_HEIGHT
from carpark_mj.physics.forces import grade_at
from carpark_mj.spawning.reset_options import ResetOptions
from carpark_mj.vehicle import Vehicle, VehicleParameters, make_vehicle
from carpark_mj.vehicle.drive import CREEP_SPEED, HOLD_PEDAL, HOLD_SPEED, SWITCH_SPEED
from carpark_mj.vehicle.parameters import GRAVITY
from carpark_mj.vehicle.vehicle import SURFACES, with_grip
from vehicle_suite.formulas import rolling_mass, rolling_resistance
from vehicle_suite.report import Study
from vehicle_suite.shipped import Driver, drive

GRADES = (0.0, 0.05, 0.1, 0.15)  # rise over run
STEEP, TILT = GRADES[-1], math.atan(GRADES[-1])  # the steepest, in rad
PEDALS = (0.0, 1e-6, 0.04, HOLD_PEDAL, 0.06, 0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 0.85, 1.0)
STARTS = (1.0, 2.0)  # m/s, above `HOLD_SPEED`
BOTH_WAYS = (1.0, -1.0)  # along the car's x
WEAK = (0.06, 0.3, 0.5)  # pedals that no car climbs the steepest slope with
WIDTH = len(PEDALS) * 8  # cars of one call of `drive_pedals`, so that it compiles once
SECONDS, DT = 15.0, 0.01  # s, of a drive and between its instants
TIME = DT * np.arange(1, round(SECONDS / DT) + 1)  # s
LATE = TIME >= SECONDS / 2
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
CREEP = 0.4  # m/s^2, 14 N m at the clutch through 15:1 in a car of 1.4 t


def drive_pedals(
    car: Vehicle,
    pedal: ArrayLike,
    start: ArrayLike = 0.0,
    facing: ArrayLike = 1.0,
    grade: float = 0.0,
    driver: Driver = Driver(),  # noqa: B008
) -> tuple[np.ndarray, np.ndarray]:
    """Drives up to `WIDTH` of a car straight on ground that rises along x.

    Args:
        car: all are like it.
        pedal: (n,), (T, n) or one of all, in [-1, 1].
        start: (n,) or of all, speeds at the start, wheels rolling [m/s].
        facing: (n,) or of all: 1 uphill, -1 downhill.
        grade: rise over run.
        driver: of the cars.

    Returns:
        Ways along the cars' x axes [m] and speeds [m/s], (T, n) at `TIME`.
    """
    n = np.broadcast(np.atleast_2d(pedal)[0], start, facing).size
    fill = np.arange(WIDTH) % n
    start, facing = np.broadcast_to(start, n), np.broadcast_to(facing, n)
    controls = np.zeros((len(TIME), WIDTH, 2))
    controls[..., 1] = np.broadcast_to(pedal, (len(TIME), n))[:, fill]
    cars = jax.tree.map(lambda x: jnp.stack([x] * WIDTH), car)
    pose = np.outer(facing[fill] < 0, [0.0, 0.0, math.pi])
    sim = SimConfig(grade_x=grade, ctrl_dt=DT, trace_dt=DT)
    motion = drive(sim, cars, controls, start[fill], pose, driver).motion
    way, speed = np.asarray(motion.pose_w)[..., 0], np.asarray(motion.speed)
    return way[:, :n].astype(float) * facing, speed[:, :n].astype(float)


def cases(*values: tuple[float, ...]) -> np.ndarray:
    """Columns of all combinations of the values."""
    return np.array(list(itertools.product(*values))).T


def grip_on(params: VehicleParameters, surface: Surface = "dry") -> Vehicle:
    """The car with the grip it has on a surface."""
    return with_grip(make_vehicle(params), SURFACES[surface] / SURFACES["dry"])


def downhill(params: VehicleParameters, tilt: float) -> float:
    """What gravity less rolling resistance accelerates by down a slope [m/s^2]."""
    resistance = params.tyre.rolling_resistance * math.cos(tilt)
    return GRAVITY * (math.sin(tilt) - resistance)


def harder_is_slower(study: Study) -> None:
    """Pedals from 0 to -1 against the motion: none may get farther than a weaker one.

    Way is counted up to the farthest point, so that turning round ends it.
    """
    facing, way, start, pedal = cases(BOTH_WAYS, BOTH_WAYS, STARTS, PEDALS)
    grades = GRADES[2:3] if study.quick else GRADES
    for grade, surface in itertools.product(grades, SURFACES):
        car = grip_on(study.params, surface)
        x, _ = drive_pedals(car, -way * pedal, way * start, facing, grade)
        reached = np.maximum.accumulate(way * x, axis=0)
        ahead = np.diff(reached.reshape(len(x), 8, len(PEDALS)), axis=-1)
        what = f"pedals against the motion, {100 * grade:g} % slope, {surface}"
        study.row(what, max(float(ahead.max()), 0.0))


def hold_on_ice(study: Study) -> None:
    """A car without a pedal on a slope of ice slides as on locked wheels, no faster."""
    car = grip_on(study.params, "ice")
    _, speed = drive_pedals(car, 0.0, facing=BOTH_WAYS, grade=STEEP)
    friction = SURFACES["ice"] / SURFACES["dry"] * study.params.tyre.friction
    expected = GRAVITY * (math.sin(TILT) - friction * math.cos(TILT))
    for where, rows in zip(("uphill", "downhill"), speed.T, strict=True):
        slope = np.polyfit(TIME[LATE], np.abs(rows[LATE]), 1)[0]
        what = f"held on a {100 * STEEP:g} % slope of ice, facing {where}"
        study.row(what, float(slope), expected)


def creep(study: Study) -> None:
    """Speed at which a slope takes a car away whose pedal is too weak to climb it.

    It faces uphill and drives forwards, or downhill in reverse. The hold, a_hold v /
    v_switch below `SWITCH_SPEED`, bears what the drive does not.
    """
    params, slope = study.params, f"{100 * STEEP:g} % slope"
    facing, pedal = cases(BOTH_WAYS, WEAK)
    car = grip_on(params)
    _, speed = drive_pedals(car, facing * pedal, facing=facing, grade=STEEP)
    what = f"rolling back before a weak drive holds, {slope}"
    study.row(what, max(float(-(speed * facing).min()), 0.0))
    both = np.abs(speed[LATE].mean(0)).reshape(2, len(WEAK)).max(0)
    for weak, found in zip(WEAK, both, strict=True):
        rest = downhill(params, TILT) - weak * params.max_acceleration
        expected = SWITCH_SPEED * rest / params.hold_deceleration
        what = f"creep against the drive, {slope}, pedal {weak:g}"
        study.row(what, float(found), expected)


def coast_after_release(study: Study) -> None:
    """A car that starts with the pedal, which is then released or turned to brake."""
    params = study.params
    way, start, pedal = cases(BOTH_WAYS, (0.0, 0.5, 1.5), RELEASES)
    pedals = np.where(np.arange(len(TIME))[:, None] < 2 * STEP, way, way * pedal)
    _, speed = drive_pedals(make_vehicle(params), pedals, way * start)
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
    pedal, start = cases(STOPS, WALK)
    driver = Driver(release=HOLD_SPEED, period=STEP)
    _, speed = drive_pedals(make_vehicle(study.params), pedal, start, driver=driver)
    groups = {f"stop from a walk, pedal {p:g}": pedal == p for p in STOPS}
    _rock_rows(study, groups, speed)


def taps(study: Study) -> None:
    """A car at rest whose pedal is tapped and released: no rebound, no jerk."""
    way, pedal, end = cases(BOTH_WAYS, TAP_PEDALS, TAPS)
    pressed = np.arange(len(TIME))[:, None] < end
    pedals = np.where(pressed, way * pedal, 0.0)
    _, speed = drive_pedals(make_vehicle(study.params), pedals)
    groups = {f"tap of {tap * DT:g} s on the pedal": end == tap for tap in TAPS}
    _rock_rows(study, groups, way * speed, end)


def _rock_rows(
    study: Study,
    groups: dict[str, np.ndarray],
    speed: np.ndarray,
    start: np.ndarray | int = 0,
) -> None:
    """How groups of cars (T, n) [m/s] that drove forwards come to rest.

    Rows of the fastest speed backwards and of the greatest jerk [m/s^3] below 0.05 m/s,
    from an instant (n,) on.
    """
    acceleration = np.diff(speed, axis=0) / DT
    smooth = np.lib.stride_tricks.sliding_window_view(acceleration, SMOOTH, 0).mean(-1)
    jerk = np.abs(np.diff(smooth, axis=0) / DT)
    middle = (SMOOTH + 1) // 2  # of the instants that a jerk is computed from
    counts = np.abs(speed[middle : middle + len(jerk)]) < 0.05
    counts &= np.arange(len(jerk))[:, None] >= start
    jerk = np.where(counts, jerk, 0.0)
    for what, cars in groups.items():
        study.row(f"{what}, rebound", max(float(-speed[:, cars].min()), 0.0))
        study.row(f"{what}, jerk below 0.05 m/s", float(jerk[:, cars].max()))


def speed_control(study: Study) -> None:
    """A proportional controller asks for 0.2 m/s on a slope of 3 %, both ways."""
    params, car, tilt = study.params, grip_on(study.params), math.atan(GRADE)
    for rate, gain in GAINS.items():
        driver = Driver(SLOW, gain, period=round(1 / (rate * DT)))
        _, speed = drive_pedals(car, 0.0, 0.0, BOTH_WAYS, GRADE, driver)
        up, down = speed[TIME > 3.0].T
        for where, late, load, most in (
            ("uphill", up, -downhill(params, -tilt), params.max_acceleration),
            ("downhill", down, -downhill(params, tilt), params.max_deceleration),
        ):
            expected = SLOW - load / (gain * most)
            what = f"speed control at {SLOW:g} m/s, {rate} Hz, 3 % {where}"
            study.row(f"{what}, mean", float(late.mean()), expected)
            study.row(f"{what}, least", float(late.min()), expected)


def reversing(study: Study) -> None:
    """Path errors of a time step of 10 ms under random pedals, in float64."""
    drives = 8 if study.quick else 48
    surfaces: tuple[Surface, ...] = ("dry", "ice")
    controls = np.zeros((PEDAL_STEPS, drives, 2))
    dice = np.random.default_rng(0)
    controls[..., 1] = dice.uniform(-1.0, 1.0, (PEDAL_STEPS, drives))
    with jax.enable_x64(True):
        cars = [grip_on(study.params, s) for s in surfaces for _ in range(drives)]
        fleet = jax.tree.map(lambda *x: jnp.stack(x), *cars)
        twice = np.tile(controls, (1, len(surfaces), 1))
        sims = (SimConfig(sim_dt=dt, trace_dt=0.1) for dt in (0.01, 0.001))
        motions = (drive(sim, fleet, twice).motion for sim in sims)
        paths = (np.asarray(motion.trace_w)[..., 0] for motion in motions)
        coarse, exact = (np.moveaxis(x, 2, 1).reshape(-1, len(cars)) for x in paths)
    length = np.abs(np.diff(exact, axis=0)).sum(0)
    error = 100 * np.abs(coarse - exact).max(0) / length
    what = "time-step error, 10 against 1 ms, random reversing"
    for surface, errors in zip(surfaces, np.split(error, len(surfaces)), strict=True):
        for share in (0.5, 0.9, 1.0):
            name = f"{what}, {surface}, quantile {share:g}"
            study.row(name, float(np.quantile(errors, share)))


def automatic(study: Study) -> None:
    """The pedal released at a walk: the speed goes to where the creep is resistance.

    m_eff v' = m (a (1 - v / v_creep) - g c_rr), so that v approaches its last value
    exponentially.
    """
    params, seconds = study.params, 4.0 if study.quick else 12.0
    sim = SimConfig(creep=CREEP)
    controls = np.zeros((round(seconds / sim.ctrl_dt), 2))
    speed = drive(sim, make_vehicle(params), controls, 0.5).motion.speed
    last = CREEP_SPEED * (1.0 - GRAVITY * params.tyre.rolling_resistance / CREEP)
    rate = CREEP / CREEP_SPEED * params.mass / rolling_mass(params)
    for time in (1.0, seconds):
        expected = last + (0.5 - last) * np.exp(-rate * time)
        found = float(speed[round(time / sim.ctrl_dt) - 1])
        study.row(f"automatic creeping from 0.5 m/s, after {time:g} s", found, expected)


def wheel_stop(study: Study) -> None:
    """A car reverses into a bay until a wheel stop stops its rear tyres."""
    params, distance = study.params, 0.9
    rules: Any = {"parked_rule": "precise", "kerb_speed": 0.6, "respawn": False}
    episode = EpisodeConfig(wheel_stops=distance, **rules)
    config = EnvConfig(num_agents=1, num_parked_cars=0, episode=episode)
    env = ParkingEnv(config, vehicle=params)
    layout = make_layout(env.layout_config)
    bay, (length, _) = layout.bay_pose[0], layout.bay_size[0]
    start = move_forward(bay, 1.0)[None]
    options = ResetOptions(pose=start, goal=jnp.zeros(1, jnp.int32))
    state, _ = jax.jit(env.reset)(jax.random.key(0), options=options)
    step, speed = jax.jit(env.step), 0.0
    for _ in range(60):  # drives back at a walk
        pedal = np.clip(2.0 * (-0.4 - speed), -1.0, 1.0)
        state, timestep = step(state, jnp.array([[0.0, pedal]]))
        speed = float(timestep.motion.speed[0])
    ahead = jnp.array([jnp.cos(bay[2]), jnp.sin(bay[2])])
    to_end = float(jnp.dot(state.motion.xy[0] - bay[:2], ahead))
    found = to_end + float(length) / 2 - params.centre_offset
    reach = math.sqrt(2 * params.wheel_radius * KERB_HEIGHT - KERB_HEIGHT**2)
    height = f"{100 * KERB_HEIGHT:g} cm"
    what = f"wheel stop {height} high, touched at 0.4 m/s, rear axle"
    study.row(what, found, distance + reach)


def ramp(study: Study) -> None:
    """A car coasts up a ramp, and drives on one that is longer than its way."""
    params, car = study.params, make_vehicle(study.params)
    sim = SimConfig(ramp=(2.0, 3.0, 0.05))
    coast = np.zeros((20 if study.quick else 24, 2))
    driven = drive(sim, car, coast, 2.8).motion
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
    wide, steady = (
        drive(sim, car, controls).motion.pose_w[:, :2]
        for sim in (SimConfig(ramp=(-99.0, 99.0, 0.1)), SimConfig(grade_x=0.1))
    )
    study.row("ramp of 10 %, driving on it", float(np.abs(wide - steady).max()))
