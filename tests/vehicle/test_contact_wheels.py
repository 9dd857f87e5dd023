"""Contact wheels: controls and what they do, their losses and springs; parked cars."""

import dataclasses
import functools
import math

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from helpers.coulomb import slide

from carpark_mj.config import SimConfig
from carpark_mj.layouts import make_layout
from carpark_mj.physics.coordinates import CarIndex
from carpark_mj.physics.mjx_step import (
    WheelIndex,
    axle_friction,
    contact_car_model,
    mjx,  # pyright: ignore[reportAttributeAccessIssue]
    with_wheels,
)
from carpark_mj.scene import looks, parts
from carpark_mj.scene.build import drivable_scene
from carpark_mj.vehicle import COMPACT, PRESETS, contact_wheels, make_vehicle, preset
from carpark_mj.vehicle.contact_wheels import (
    FULL_BRAKE,
    add_contact_wheels,
    add_controls,
    rolling_loss,
    set_contact_options,
    steering_polynomials,
)
from carpark_mj.vehicle.mjcf import WHEELS, add_car, per_wheel
from carpark_mj.vehicle.parameters import GRAVITY, kerb_to_kerb
from vehicle_suite.formulas import (
    axle_loads,
    front_wheel_angles,
    rolling_mass,
    rolling_resistance,
)


@pytest.mark.parametrize("lock", [25.0, 30.0, 34.2, 36.0])
def test_polynomials_fit_the_ackermann_condition(lock):
    circle = kerb_to_kerb(
        COMPACT.wheelbase, COMPACT.track_width, COMPACT.tyre_width, math.radians(lock)
    )
    params = dataclasses.replace(COMPACT, turning_circle=circle)
    assert math.degrees(params.max_steering) == pytest.approx(lock)
    left, right = steering_polynomials(params)
    for angle in np.linspace(-params.max_steering, params.max_steering, 301):
        fitted = [np.polyval(p[::-1], angle) for p in (left, right)]
        error = np.degrees(
            np.abs(np.subtract(fitted, front_wheel_angles(params, angle)))
        )
        assert error.max() < 0.03
    # The car is symmetric: left lock mirrors right lock, and straight is straight.
    np.testing.assert_allclose(left * [1, 1, -1, 1, -1], right, atol=1e-9)
    assert left[0] == right[0] == 0.0


class Driven:
    """A car on level or tilted ground, at rest."""

    def __init__(self, params=COMPACT, tilt=0.0, suspension=False):
        self.params = params
        spec = mujoco.MjSpec()
        set_contact_options(spec)
        spec.option.gravity = [-9.81 * math.sin(tilt), 0, -9.81 * math.cos(tilt)]
        parts.add_ground(spec)
        add_car(spec.worldbody, spec, params, "", servos=False, suspension=suspension)
        add_contact_wheels(spec, params, "", parts.GROUND, suspension)
        add_controls(spec, params, "")
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)

    def run(self, seconds, steer=0.0, drive=0.0, brake=0.0):
        """Holds the controls; rows of (x, speed, column angle, left, right)."""
        rows = []
        for _ in range(round(seconds / self.model.opt.timestep)):
            for name, value in (("steer", steer), ("drive", drive), ("brake", brake)):
                self.data.actuator(name).ctrl = value
            mujoco.mj_step(self.model, self.data)
            angles = [self.data.joint(f"steer{s}").qpos[0] for s in ("", "_fl", "_fr")]
            rows.append([self.data.qpos[0], self.data.qvel[0], *angles])
        return np.array(rows)

    def roll(self, speed):
        """Sets the car rolling straight on [m/s]."""
        self.data.qvel[0] = speed
        for wheel in WHEELS:
            self.data.joint(f"spin_{wheel}").qvel[0] = speed / self.params.wheel_radius

    def centre(self):
        """Where the centre of gravity is along the road [m]."""
        mujoco.mj_comPos(self.model, self.data)
        return float(self.data.subtree_com[0, 0])

    def wheel_speeds(self):
        """Circumferential speeds (4,) of the wheels [m/s]."""
        spin = [self.data.joint(f"spin_{wheel}").qvel[0] for wheel in WHEELS]
        return self.params.wheel_radius * np.array(spin)


def test_steering_keeps_its_rate_and_the_equalities_hold():
    car = Driven()
    rows = car.run(2.5, steer=COMPACT.max_steering)
    rate = np.diff(rows[:, 2]) / car.model.opt.timestep
    assert rate.max() < 1.01 * COMPACT.steering_rate
    assert rows[-1, 2] == pytest.approx(COMPACT.max_steering, abs=1e-4)
    lock_time = COMPACT.max_steering / COMPACT.steering_rate
    reached = np.argmax(rows[:, 2] > 0.97 * COMPACT.max_steering)
    assert reached * car.model.opt.timestep == pytest.approx(lock_time, rel=0.1)
    expected = [front_wheel_angles(COMPACT, angle) for angle in rows[:, 2]]
    error = np.degrees(np.abs(rows[:, 3:] - expected))
    assert error.max() < 0.06  # 0.03 of it the polynomials'


@pytest.mark.parametrize("steer", [0.0, 1.0])
@pytest.mark.parametrize("name", ["compact", "sedan"])  # front- and rear-driven
def test_driven_wheels_settle_at_their_limit_less_the_loss(name, steer):
    params = preset(name)
    reverse = params.max_reverse_speed / params.max_speed
    for drive, reached in ((1.0, 1.0), (0.5, 0.5), (-1.0, reverse)):
        car = Driven(params)
        car.run(15.0, steer=steer * params.max_steering, drive=drive)
        mean = per_wheel(params.front_drive) @ car.wheel_speeds()
        wanted = reached * params.max_speed - rolling_loss(params)
        # Exact straight on; rolling resistance is shared differently in a curve.
        assert mean * np.sign(drive) == pytest.approx(
            wanted, abs=0.05 if steer else 2e-3
        )


def test_a_car_at_full_lock_turns_about_its_rear_axle_s_line():
    car = Driven()
    car.run(6.0, steer=COMPACT.max_steering, drive=0.3)
    radius = math.hypot(*car.data.qvel[:2]) / car.data.qvel[5]
    expected = COMPACT.wheelbase / math.tan(COMPACT.max_steering)
    assert radius == pytest.approx(expected, rel=1e-3)  # 3.882 m


def braked_distance(params, speed, force):
    """Way [m] of v' = -(F + k v) / m until it stands, k of the engine brake."""
    mass = rolling_mass(params)
    b = (force + rolling_resistance(params)) / mass
    k = params.max_acceleration / params.max_speed * params.mass / mass
    return speed / k - b / k**2 * math.log(1 + k * speed / b)


@pytest.mark.parametrize("brake", [0.1, 0.3])
def test_the_brake_is_proportional_to_its_slider(brake):
    car = Driven()
    x, speed = car.run(6.0, drive=1.0)[-1, :2]
    rows = car.run(4.0, brake=brake)
    force = brake * FULL_BRAKE * COMPACT.tyre.friction * COMPACT.mass * GRAVITY
    expected = braked_distance(COMPACT, speed, force)
    assert rows[-1, 0] - x == pytest.approx(expected, rel=0.05)  # pads take 20 ms
    assert abs(rows[-1, 1]) < 1e-6


@pytest.mark.parametrize("suspension", [False, True])
@pytest.mark.parametrize("name", PRESETS)
def test_full_brake_reaches_the_grip_and_turns_no_wheel_back(name, suspension):
    params = preset(name)
    for speed in (3.0, 5.0):
        car = Driven(params, suspension=suspension)
        car.run(2.0)
        car.roll(speed)
        x, furthest, slowest = car.centre(), 0.0, 0.0
        for _ in range(150):
            car.run(0.01, brake=1.0)
            furthest = max(furthest, car.centre() - x)
            slowest = min(slowest, car.wheel_speeds().min())
        grip = params.tyre.friction * GRAVITY
        # 20 ms until the pads press. A suspended car dives, and rocks back afterwards;
        # its light wheels bear a little more than its weight while they slide.
        stop = speed**2 / (2 * grip)
        least = 0.97 if suspension else 1.0
        assert least * stop < furthest < 1.03 * stop + 0.02
        assert abs(car.data.qvel[0]) < 1e-2  # it rocks
        assert slowest > -0.02


def test_a_car_in_a_curve_stops_as_short_and_stays_on_the_ground():
    car = Driven()
    car.run(3.0, steer=COMPACT.max_steering)
    car.roll(3.0)
    start = car.data.qpos[:2].copy()
    car.run(2.0, steer=COMPACT.max_steering, brake=1.0)
    stop = 9.0 / (2 * COMPACT.tyre.friction * GRAVITY)
    # The front wheels scrub sideways at first: 34 deg off the motion.
    assert np.linalg.norm(car.data.qpos[:2] - start) < 1.3 * stop
    assert np.abs(car.data.qvel[:3]).max() < 1e-3
    assert abs(car.data.qpos[2]) < 1e-3


def test_the_brake_holds_on_a_slope_and_lets_go():
    grade = math.atan(0.05)
    car = Driven(tilt=grade)
    speed = car.run(6.0, brake=1.0)[-1, 1]
    assert abs(speed) < 5e-6  # regularised friction; measured 2e-6
    rolling = car.run(2.0)[-1, 1]
    assert rolling < -0.3  # the pads are off


def test_torque_is_dealt_out_in_fixed_shares():
    model = Driven().model
    for tendon, joint, share in (
        ("drive", "spin", COMPACT.front_drive),
        ("brake", "pad", COMPACT.front_brake),
    ):
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        data.qvel[:] = 0
        dofs = [model.joint(f"{joint}_{w}").dofadr[0] for w in WHEELS]
        row = model.tendon(tendon).id
        data.qvel[dofs] = [1.0, 2.0, 3.0, 4.0]
        mujoco.mj_fwdVelocity(model, data)
        assert data.ten_velocity[row] == pytest.approx(
            np.dot(per_wheel(share), [1.0, 2.0, 3.0, 4.0])
        )


AXES = ("x", "y", "yaw")
VAN = PRESETS["van"]


@functools.cache
def parked(params):
    spec = mujoco.MjSpec()
    spec.option.timestep = 0.002
    looks.add_materials(spec)
    parts.add_parked_cars(spec, (params,))
    return spec.compile()


def moved(params, pose, rates, seconds, downhill=0.0):
    """Pose and rates of the rear axle after a slide in MuJoCo."""
    model = parked(params)
    model.opt.gravity = -GRAVITY * np.array([downhill, 0.0, 1.0])
    data = mujoco.MjData(model)
    joints = [data.joint(f"parked0/{axis}") for axis in AXES]
    for joint, at, rate in zip(joints, pose, rates, strict=True):
        joint.qpos, joint.qvel = at, rate
    mujoco.mj_step(model, data, nstep=round(seconds / model.opt.timestep))
    return np.array([(*j.qpos, *j.qvel) for j in joints]).T


@pytest.mark.parametrize("params", [COMPACT, VAN], ids=["compact", "van"])
def test_a_slide_ends_where_four_coulomb_wheels_end_it(params):
    rng = np.random.default_rng(3)
    pose = rng.uniform((-9, -9, -3), (9, 9, 3), (12, 3))
    rates = rng.uniform((-2.5, -2.5, -2), (2.5, 2.5, 2), (12, 3))
    expected = slide(params, pose, rates, 1.5)
    assert np.ptp((expected - pose)[:, 2]) > math.radians(30)
    for k in range(len(pose)):
        found, rest = moved(params, pose[k], rates[k], 1.5)
        assert np.abs(rest).max() < 1e-3
        assert np.linalg.norm((found - expected[k])[:2]) < 0.04
        assert abs(found[2] - expected[k, 2]) < math.radians(1.5)


@pytest.mark.parametrize(("share", "holds"), [(0.2, True), (0.95, True), (1.05, False)])
def test_a_parked_car_stands_on_a_slope_up_to_its_grip(share, holds):
    downhill = share * COMPACT.tyre.friction
    start, still = np.array([0.0, 0.0, 0.3]), np.zeros(3)
    begun, _ = moved(COMPACT, start, still, 0.5, downhill=downhill)
    found, rates = moved(COMPACT, start, still, 2.5, downhill=downhill)
    if holds:  # it creeps by less than 1 mm in a minute
        assert np.abs((found - begun) / 2.0).max() < 1e-3 / 60
    else:
        assert rates[0] < -0.2


# Contact wheels: their losses, and springs that leave a car as high as it was

DT = 0.002
SPRUNG = SimConfig(sim_dt=0.004, tyres="contact", suspension=True)


def contact_model(params, suspension: bool):
    """The car on contact wheels, solved as in scenes."""
    sim = SimConfig(sim_dt=DT, tyres="contact", suspension=suspension)
    model = contact_car_model(params, sim)
    for name in ("impratio", "iterations", "ls_iterations", "tolerance"):
        setattr(model.opt, name, getattr(contact_wheels, name.upper()))
    return model


def settled(params, suspension: bool, seconds: float = 4.0):
    model = contact_model(params, suspension)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=round(seconds / DT))
    return model, data


@pytest.mark.parametrize("name", PRESETS)
def test_every_car_sits_as_high_and_as_level_as_without_springs(name):
    _, rigid = settled(PRESETS[name], False)
    _, sprung = settled(PRESETS[name], True)
    # A tenth of a millimetre, at both axles; pitch is twice the quaternion's y.
    apart = np.abs(sprung.qpos[[2, 5]] - rigid.qpos[[2, 5]])
    assert apart[0] < 1e-4
    assert 2 * apart[1] * PRESETS[name].wheelbase < 1e-4
    assert np.abs([sprung.joint(f"travel_{w}").qpos for w in WHEELS]).max() < 1e-4
    assert np.abs(sprung.qvel).max() < 1e-4


def test_a_spring_carries_its_corner_without_the_wheel():
    model = contact_model(COMPACT, True)
    front, rear = axle_loads(COMPACT)
    wheel = COMPACT.wheel_mass * 9.81
    # In front a knuckle stands on the tyre beside the wheel.
    knuckle = COMPACT.knuckle_mass * 9.81
    expected = {"fl": front / 2 - wheel - knuckle, "rr": rear / 2 - wheel}
    for corner, force in expected.items():
        joint = model.joint(f"travel_{corner}")
        spring = -model.qpos_spring[joint.qposadr[0]] * joint.stiffness[0]
        assert spring == pytest.approx(force, rel=1e-9)


def test_a_car_kicked_upwards_heaves_as_a_damped_oscillator():
    # Sprung centre of gravity midway: heave alone, omega^2 = 4 k / m.
    knuckles = 2 * COMPACT.knuckle_mass * COMPACT.wheelbase / 2 / COMPACT.mass
    middle = COMPACT.wheelbase / 2 - knuckles
    car = dataclasses.replace(COMPACT, cg_to_front_axle=middle)
    sprung = car.mass - 4 * car.wheel_mass - 2 * car.knuckle_mass
    omega = math.sqrt(4 * car.tyre.vertical_stiffness / sprung)
    assert 1.3 < omega / (2 * math.pi) < 1.6  # Hz, a passenger car's
    model, data = settled(car, True)
    data.qvel[2] = kick = 0.05
    for wheel in WHEELS:
        data.joint(f"travel_{wheel}").qvel = -kick
    speed = []
    for _ in range(round(1.0 / DT)):
        mujoco.mj_step(model, data)
        speed.append(data.qvel[2])
    zeta = 4 * car.tyre.vertical_damping / sprung / (2 * omega)
    fast, time = omega * math.sqrt(1 - zeta**2), DT * np.arange(1, len(speed) + 1)
    wave = np.cos(fast * time) - zeta * omega / fast * np.sin(fast * time)
    expected = kick * np.exp(-zeta * omega * time) * wave
    assert np.abs(speed - expected).max() < 0.02 * kick


def test_friction_of_the_axles_is_rolling_resistance_and_brake():
    loss = axle_friction(make_vehicle(VAN), jnp.array([10.0, 10.0, 0.0, 0.0]))
    rolling = rolling_resistance(VAN) * VAN.wheel_radius
    assert float(loss.sum()) == pytest.approx(rolling + 20.0, rel=1e-5)


def test_in_mjx_springs_and_friction_are_each_cars_own():
    """The van's data in the compact's model are the van's model."""
    van = dataclasses.replace(VAN, tyre=dataclasses.replace(VAN.tyre, friction=0.7))
    model, expected = (contact_car_model(p, SPRUNG) for p in (COMPACT, van))
    vehicle = make_vehicle(van)
    changed = with_wheels(
        mjx.put_model(model), CarIndex(model), WheelIndex(model), vehicle, jnp.zeros(4)
    )
    springs = "jnt_stiffness", "dof_damping", "qpos_spring", "geom_size"
    for name in (*springs, "dof_frictionloss", "pair_friction"):
        found = np.asarray(getattr(changed, name))
        assert found == pytest.approx(getattr(expected, name), rel=1e-5), name
    assert not np.allclose(model.qpos_spring, expected.qpos_spring)
    assert not np.allclose(model.pair_friction, expected.pair_friction)


def test_an_exported_scene_has_springs_if_asked():
    layout = make_layout("square")
    poses = np.array([[0.0, 0.0, 0.0]])
    for sprung, count in ((False, 0), (True, 4)):
        spec = drivable_scene(layout, COMPACT, poses, np.zeros((0, 3)), sprung)
        model = spec.compile()
        slides = [model.joint(i).name for i in range(model.njnt)]
        assert sum(name.startswith("agent0/travel_") for name in slides) == count
