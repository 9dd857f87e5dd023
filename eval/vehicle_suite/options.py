"""What `SimConfig` can add to a car, against formulas and against the plain car.

`MjxPhysics` and its driver run as in training; options are off elsewhere.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config import EnvConfig, EpisodeConfig, SimConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.geometry import move_forward
from carpark_mj.layouts import make_layout
from carpark_mj.mdp.collisions import KERB_HEIGHT
from carpark_mj.observations.sensors import reckon
from carpark_mj.physics.gravity import grade_at
from carpark_mj.physics.mjx import CarState, MjxPhysics
from carpark_mj.spawning.reset_options import ResetOptions
from carpark_mj.types import Motion, Odometry
from carpark_mj.vehicle import VehicleParameters, make_vehicle
from carpark_mj.vehicle.drive import CREEP_SPEED
from carpark_mj.vehicle.parameters import GRAVITY
from vehicle_suite.formulas import rolling_mass
from vehicle_suite.table import Study, relative
from vehicle_suite.testbed import Testbed

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
    """The motion (T,) of one car after each of T control steps.

    Args:
        sim: the options, and the control step.
        params: the car.
        controls: (T, 2) steer and pedal.
        pose: at the start.
        speed: at the start, wheels rolling [m/s].
    """
    physics = MjxPhysics(sim)
    state = physics.init(jnp.array(pose, jnp.float32), make_vehicle(params))
    if speed:
        state = physics.set_speed(state, jnp.float32(speed))

    def step(state: CarState, command: jax.Array) -> tuple[CarState, Motion]:
        state = physics.step(state, command)
        return state, physics.read(state)

    drive = jax.jit(lambda state, commands: jax.lax.scan(step, state, commands)[1])
    return jax.device_get(drive(state, jnp.array(controls, jnp.float32)))


def delays(bed: Testbed, name: str, params: VehicleParameters, quick: bool) -> Study:
    """Late commands: when the wheels turn, and the way of commands given later."""
    study = Study(name, bed.tyres)
    late = SimConfig(steering_delay=STEERING_DELAY, pedal_delay=PEDAL_DELAY)
    steps = 10 if quick else 30
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
    return study


def automatic(bed: Testbed, name: str, params: VehicleParameters, quick: bool) -> Study:
    """The pedal released at a walk: the speed goes to where the creep is resistance.

    m_eff v' = m (a (1 - v / v_creep) - g c_rr), so that v approaches its last value
    exponentially.
    """
    study = Study(name, bed.tyres)
    seconds = 4.0 if quick else 12.0
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
    return study


def odometry(bed: Testbed, name: str, params: VehicleParameters, quick: bool) -> Study:
    """What a car with wrong wheels believes, ahead and on full lock."""
    study = Study(name, bed.tyres)
    steps = 20 if quick else 50
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
    return study


def wheel_stop(
    bed: Testbed, name: str, params: VehicleParameters, quick: bool
) -> Study:
    """A car reverses into a bay until a wheel stop stops its rear tyres."""
    del quick
    study = Study(name, bed.tyres)
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
    return study


def ramp(bed: Testbed, name: str, params: VehicleParameters, quick: bool) -> Study:
    """A car coasts up a ramp, and drives on one that is longer than its way."""
    study = Study(name, bed.tyres)
    sim = SimConfig(ramp=(2.0, 3.0, 0.05))
    coast = np.zeros((20 if quick else 24, 2))
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
    return study
