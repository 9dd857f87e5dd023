"""What a car does with its controls: steering, torques, lags, the holding brake."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from carpark_mj.vehicle import (
    COMPACT,
    PRESETS,
    Vehicle,
    VehicleParameters,
    make_vehicle,
)
from carpark_mj.vehicle.drive import (
    CREEP_SPEED,
    HOLD_PEDAL,
    HOLD_SPEED,
    SWITCH_SPEED,
    Actuators,
    ackermann,
    actuate,
    close_hold,
    demanded_torques,
    hold_braking,
    init_actuators,
    press_pedal,
    roll_freely,
    steer_towards,
)
from vehicle_suite.formulas import front_wheel_angles

ANGLES = np.radians([-34.2, -20.0, -5.0, 5.0, 20.0, 34.2])
FORCE_TO_TORQUE = COMPACT.mass * COMPACT.wheel_radius
# Below this, float32 rounding of sums of torques of up to 4000 N m; measured 5e-4.
TORQUE_TOLERANCE = 2e-3  # N m


@pytest.fixture(scope="module")
def torques(compact: Vehicle):
    """Drive and brake torque [N m] for arrays of pedals, speeds and holds."""
    function = jax.jit(
        jax.vmap(lambda p, v, hold: demanded_torques(compact, p, hold, v, v))
    )

    def summed(pedal, speed, hold=0.0) -> tuple[np.ndarray, np.ndarray]:
        asked = [np.float32(x) for x in (pedal, speed, hold)]
        drive, brake = function(*(x.ravel() for x in np.broadcast_arrays(*asked)))
        return np.asarray(drive), np.asarray(brake)

    return summed


def grid(pedals: np.ndarray, speeds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    pedal, speed = np.meshgrid(pedals, speeds)
    return pedal.ravel(), speed.ravel()


@pytest.mark.parametrize("fraction", [0.0, 0.6, 1.0])
def test_front_wheels_share_track_over_wheelbase_in_cotangents(fraction: float):
    """The inner wheel turns more; without Ackermann both are parallel."""
    params = dataclasses.replace(COMPACT, ackermann=fraction)
    wheels = np.asarray(ackermann(make_vehicle(params), jnp.array(ANGLES)))
    expected = np.transpose([front_wheel_angles(params, angle) for angle in ANGLES])
    np.testing.assert_allclose(wheels, expected, rtol=1e-6)  # float32
    np.testing.assert_array_equal(wheels[::-1, ::-1], -wheels)


@pytest.mark.parametrize("steer", [-1.0, -0.3, 0.7, 1.0])
def test_steering_reaches_its_target_at_the_limited_rate(
    compact: Vehicle, steer: float
):
    angle, dt = jnp.zeros(()), 0.01
    steps = []
    for _ in range(200):
        new = steer_towards(compact, angle, jnp.array(steer), dt)
        steps.append(float(new - angle))
        angle = new
    limit = COMPACT.steering_rate * dt
    moving = np.abs(steps) > 1e-6
    # float32 rounding of angles up to 0.6 rad: 6e-8.
    assert np.abs(steps).max() == pytest.approx(limit, abs=1e-7)
    assert angle == pytest.approx(steer * COMPACT.max_steering, abs=1e-7)
    assert moving.sum() == np.ceil(abs(steer) * COMPACT.max_steering / limit)
    lock = jnp.array(np.sign(steer) * COMPACT.max_steering)
    assert steer_towards(compact, lock, 5.0 * jnp.sign(lock), dt) == lock


def test_a_pedal_against_the_motion_brakes_in_proportion(torques):
    speeds = np.array([-1.9, -1, -HOLD_SPEED, -0.2, -SWITCH_SPEED])
    pedal, speed = grid(np.linspace(0.1, 1, 7), speeds)
    for sign in (1, -1):
        drive, brake = torques(sign * pedal, sign * speed)
        expected = pedal * COMPACT.max_deceleration * FORCE_TO_TORQUE
        assert drive.tolist() == [0.0] * len(drive)
        assert brake == pytest.approx(expected, abs=TORQUE_TOLERANCE)


def test_a_pedal_against_a_crawl_drives_while_brake_and_hold_fade(torques):
    pedal, speed = grid(np.linspace(0.1, 1, 7), np.array([-0.099, -0.05, -1e-6]))
    fading = -speed / SWITCH_SPEED * FORCE_TO_TORQUE
    for sign in (1, -1):
        drive, brake = torques(sign * pedal, sign * speed)
        driven = pedal * COMPACT.max_acceleration * FORCE_TO_TORQUE
        retarding = np.maximum(fading * pedal * COMPACT.max_deceleration, driven)
        assert drive == pytest.approx(sign * driven, abs=TORQUE_TOLERANCE)
        assert brake == pytest.approx(retarding - driven, abs=TORQUE_TOLERANCE)
        # A closed hold bears what a weak drive does not.
        _, brake = torques(sign * pedal, sign * speed, COMPACT.hold_deceleration)
        held = fading * COMPACT.hold_deceleration
        assert brake == pytest.approx(held, abs=TORQUE_TOLERANCE)
    # From a standstill there is nothing to brake.
    assert torques(-0.5, 0.0)[1] == torques(0.5, -0.0)[1] == 0.0


def wheels_at(speed: np.ndarray) -> dict[str, np.ndarray]:
    """Speeds of driven wheels that roll, slip under the brake, stand or spin."""
    return {
        "roll": speed,
        "slip": 0.8 * speed,
        "stand": 0.0 * speed,
        "spin": speed + np.sign(speed),
    }


@pytest.mark.parametrize("wheels", ["roll", "slip", "stand", "spin"])
@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize("params", PRESETS.values(), ids=PRESETS)
def test_no_pedal_against_the_motion_retards_less_than_a_weaker(
    params: VehicleParameters, way: int, wheels: str
):
    vehicle = make_vehicle(params)
    pedals = -way * np.array([0.0, 1e-6, 0.01, 0.04, 0.0499, *np.linspace(0.05, 1, 96)])
    speeds = way * np.array([SWITCH_SPEED, 0.2, 0.299, 0.3, 0.31, 1, 2, 3, 4, 10, 30])
    speed, pedal = np.meshgrid(np.float32(speeds), np.float32(pedals))
    wheel_speed = wheels_at(speed)[wheels]
    for hold in (0.0, 0.05, 1.0, params.hold_deceleration):
        before = jnp.full(pedal.shape, hold)
        hold_after = close_hold(vehicle, before, pedal, speed, 0.01)
        drive, brake = demanded_torques(vehicle, pedal, hold_after, speed, wheel_speed)
        retarding = np.asarray(brake, float) - way * np.asarray(drive, float)
        assert np.diff(retarding, axis=0).min() >= 0.0


def test_beyond_the_speed_limit_brakes_help_whatever_the_pedal(torques):
    against = np.array([-1.0, 0.0, 1e-6, 0.04, 0.2, 1.0])
    for limit in (COMPACT.max_speed, -COMPACT.max_reverse_speed):
        drive, brake = torques(-np.sign(limit) * against, 1.2 * limit)
        # 20 % over the limit: 0.2 v / 0.4 s, beside what the pedal brakes with.
        over = 0.2 * abs(limit) / COMPACT.speed_limit_time
        pedal = COMPACT.max_deceleration * np.array([0.0, 0.0, 0.0, 0.0, 0.2, 1.0])
        assert drive.tolist() == [0.0] * len(against)
        assert brake == pytest.approx((over + pedal) * FORCE_TO_TORQUE, rel=1e-5)


def test_a_pedal_along_the_motion_accelerates_in_proportion(torques):
    # Low enough for the speed limiter not to act: 2 m/s^2 x 0.4 s below the limit.
    pedal, speed = grid(np.linspace(0.1, 1, 7), np.array([0.0, 0.3, 1.1]))
    for sign in (1, -1):
        drive, brake = torques(sign * pedal, sign * speed)
        expected = sign * pedal * COMPACT.max_acceleration * FORCE_TO_TORQUE
        assert brake.tolist() == [0.0] * len(brake)
        assert drive == pytest.approx(expected, abs=TORQUE_TOLERANCE)
    for speed in (-1.0, 0.0, 1.0):  # pedals beyond one count as one
        assert torques(7.0, speed) == torques(1.0, speed)
        assert torques(-7.0, speed) == torques(-1.0, speed)


def test_without_a_pedal_the_hold_brakes_and_nothing_drives(torques):
    below = HOLD_PEDAL * 0.99
    speeds = np.array([-8.0, -0.29, -0.01, 0.0, 0.01, 0.29, 1.0, 8.0])
    pedal, speed = grid(np.linspace(-below, below, 5), speeds)
    inside = (speed <= COMPACT.max_speed) & (speed >= -COMPACT.max_reverse_speed)
    drive, brake = torques(pedal, speed, COMPACT.hold_deceleration)
    expected = COMPACT.hold_deceleration * FORCE_TO_TORQUE
    assert drive.tolist() == [0.0] * len(pedal)
    assert brake[inside] == pytest.approx(expected, abs=10 * TORQUE_TOLERANCE)
    assert (brake >= expected * (1 - 1e-6)).all()
    assert COMPACT.hold_deceleration > COMPACT.tyre.friction * 9.81  # wheels lock
    # An open hold lets the car coast.
    drive, brake = torques(0.0, np.array([-1.9, -HOLD_SPEED, HOLD_SPEED, 2.9]))
    assert drive.tolist() == brake.tolist() == [0.0] * 4


@pytest.mark.parametrize("front", [0.0, 0.4, 1.0])
def test_torque_shares_sum_to_one_and_are_equal_across_an_axle(front: float):
    brake = max(front, 0.01)
    params = dataclasses.replace(COMPACT, front_drive=front, front_brake=brake)
    vehicle = make_vehicle(params)
    for share, expected in ((vehicle.drive_share, front), (vehicle.brake_share, brake)):
        # float32 rounding.
        assert share.sum() == pytest.approx(1.0, abs=1e-6)
        assert share[:2].sum() == pytest.approx(expected, abs=1e-6)
        assert share[0] == share[1]
        assert share[2] == share[3]


def test_torque_and_power_limit_the_drive_but_not_the_brake():
    weak = dataclasses.replace(COMPACT, max_drive_torque=500.0, max_power=1000.0)
    vehicle = make_vehicle(weak)
    speeds = jnp.array([0.0, 0.5, 1.0, 2.0])
    nothing = jnp.zeros(4)
    drive, brake = demanded_torques(vehicle, nothing + 1, nothing, speeds, speeds)
    # min(T, P r / v), r = 0.316 m, by hand
    assert np.asarray(drive) == pytest.approx([500.0, 500.0, 316.0, 158.0], rel=1e-6)
    assert not brake.any()
    _, brake = demanded_torques(vehicle, nothing - 1, nothing, speeds, speeds)
    full = COMPACT.max_deceleration * FORCE_TO_TORQUE
    assert brake[-1] == pytest.approx(full, rel=1e-6)


def followed(vehicle: Vehicle, controls: tuple[float, float], steps: int) -> Actuators:
    """The actuators of a standing car over substeps of 10 ms, stacked."""
    asked = jnp.array(controls[0]), jnp.array(controls[1])

    def substep(actuators, _):
        after, *_ = actuate(
            vehicle, actuators, asked, jnp.zeros(()), jnp.zeros(()), 0.01
        )
        return after, after

    return jax.lax.scan(substep, init_actuators(vehicle), length=steps)[1]


def test_lags_are_first_order_and_exact_at_the_substeps():
    slow = dataclasses.replace(
        COMPACT, steering_lag=0.1, drive_lag=0.25, steering_rate=100.0
    )
    reached = followed(make_vehicle(slow), (1.0, 1.0), 100)
    time = 0.01 * np.arange(1, 101)
    steering = COMPACT.max_steering * (1 - np.exp(-time / 0.1))
    drive = COMPACT.max_acceleration * FORCE_TO_TORQUE * (1 - np.exp(-time / 0.25))
    # float32 rounding of 100 products.
    assert np.asarray(reached.steering) == pytest.approx(steering, rel=1e-5)
    assert np.asarray(reached.drive) == pytest.approx(drive, rel=1e-5)


def test_lagging_steering_never_exceeds_its_rate():
    slow = make_vehicle(dataclasses.replace(COMPACT, steering_lag=0.1))
    steering = np.asarray(followed(slow, (1.0, 0.0), 400).steering)
    rate = np.diff(steering, prepend=0.0) / 0.01
    assert rate.max() <= COMPACT.steering_rate * (1 + 1e-4)  # float32 differences
    assert rate[:100] == pytest.approx(COMPACT.steering_rate, rel=1e-4)
    assert steering[-1] == pytest.approx(COMPACT.max_steering, rel=1e-5)


def test_without_lag_the_actuators_are_where_they_are_asked_to_be(compact: Vehicle):
    start = Actuators(jnp.array(0.1), jnp.array(-300.0), jnp.array(0.0))
    controls, speed = (jnp.array(0.5), jnp.array(0.7)), jnp.array(0.4)
    after, *_ = actuate(compact, start, controls, speed, speed, 0.01)
    demanded, _ = demanded_torques(compact, controls[1], start.hold, speed, speed)
    assert after.drive == demanded
    assert after.steering == steer_towards(compact, start.steering, controls[0], 0.01)
    # An offset turns the wheels, but not the command.
    skewed = dataclasses.replace(compact, steering_offset=jnp.array(0.02))
    start, still = init_actuators(compact), jnp.zeros(())
    after, angles, *_ = actuate(skewed, start, (still, still), still, still, 0.01)
    assert after.steering == 0.0
    assert angles == ackermann(compact, jnp.array(0.02))


def test_the_speed_limiter_goes_by_driven_wheels_that_spin(compact: Vehicle):
    def drive(speed: float, wheel_speed: float, pedal: float = 1.0) -> float:
        asked = [jnp.array(x) for x in (pedal, 0.0, speed, wheel_speed)]
        return float(demanded_torques(compact, *asked)[0])

    full = COMPACT.max_acceleration * FORCE_TO_TORQUE
    assert drive(0.2, 0.6) == pytest.approx(full)  # slips, but does not spin
    assert drive(0.2, 1.5) == pytest.approx(full)  # spins below the limit
    assert drive(0.2, COMPACT.max_speed) == 0.0
    assert drive(0.2, COMPACT.max_speed + 0.5) == 0.0
    assert drive(-0.2, -COMPACT.max_reverse_speed, -1.0) == 0.0
    # Locked wheels of a sliding car do not spin.
    assert drive(2.9, 0.0) == drive(2.9, 2.9)


AUTOMATIC = 0.4  # m/s^2


def closed(vehicle: Vehicle, hold: float, pedal: float, speed: float) -> float:
    asked = [jnp.array(x, jnp.float32) for x in (hold, pedal, speed)]
    return float(close_hold(vehicle, *asked, 0.01))


def test_the_hold_closes_where_a_slow_car_is_not_driven_on(compact: Vehicle):
    for way in (1, -1):
        for speed in (0.0, 0.05, 0.29):
            assert closed(compact, 0.0, way * 0.04, way * speed) > 0.0  # no pedal
        assert closed(compact, 0.0, -way * 0.2, way * 0.29) > 0.0
        assert closed(compact, 0.0, way * 0.2, way * 0.29) == 0.0
        # A faster car coasts and brakes without it.
        for pedal in (0.0, -0.2, 0.2):
            assert closed(compact, 0.0, way * pedal, way * HOLD_SPEED) == 0.0
    hold = 0.0
    for _ in range(500):
        hold = closed(compact, hold, 0.0, 0.0)
    assert hold == COMPACT.hold_deceleration


def test_a_hold_stays_until_the_pedal_drives_the_car_along_its_motion(compact: Vehicle):
    full = COMPACT.hold_deceleration
    for speed in (0.5, 8.0):  # slides, wheels locked
        for way in (1, -1):
            assert closed(compact, full, 0.0, way * speed) == full
            assert closed(compact, full, -way * 1.0, way * speed) == full
            assert closed(compact, full, way * 0.05, way * speed) == 0.0
    # Half closed it goes on closing, though the car has become faster.
    assert closed(compact, 0.5, 0.0, 0.5) > 0.5
    # A slope may pull the car back before the drive takes over.
    for speed in (-0.2, -0.01, 0.0, 0.01):
        assert closed(compact, full, 0.5, speed) == full


def test_the_hold_takes_over_what_the_pedal_brakes_with(compact: Vehicle):
    for pedal in (0.06, 0.3, 1.0):
        hold = closed(compact, 0.0, -pedal, 0.29)
        braked = float(hold_braking(compact, jnp.array(hold), jnp.array(0.29)))
        eased = hold + np.sqrt(2 * 3.0 * 0.29)
        service = pedal * COMPACT.max_deceleration
        # It also closes for the substep of 10 ms, by less than 0.1 m/s^2.
        assert min(service, eased) - 1e-4 <= braked <= min(service + 0.1, eased) + 1e-4


def test_the_hold_eases_off_as_the_car_comes_to_rest(compact: Vehicle):
    speed = jnp.array([HOLD_SPEED, 0.2, 0.1, 0.05, 0.01, 0.0])
    braked = np.asarray(hold_braking(compact, jnp.array(0.3), speed))
    assert (np.diff(braked) < 0).all()
    assert braked[-1] == pytest.approx(0.3, abs=1e-5)
    full = hold_braking(compact, jnp.array(COMPACT.hold_deceleration), speed)
    assert full == pytest.approx(COMPACT.hold_deceleration)
    assert not hold_braking(compact, jnp.array(0.0), speed).any()


def test_cars_start_on_their_hold_and_without_it_where_they_roll(compact: Vehicle):
    start = init_actuators(compact)
    assert start.hold == COMPACT.hold_deceleration
    assert roll_freely(start, jnp.array(0.0)).hold == COMPACT.hold_deceleration
    for speed in (-1.0, 0.1):
        assert roll_freely(start, jnp.array(speed)).hold == 0.0


def idling(vehicle: Vehicle, drive: float, hold: float, pedal: float, speed: float):
    """Acceleration by the drive [m/s^2], hold and brake of an automatic 10 ms later."""
    creeping = dataclasses.replace(vehicle, creep=jnp.array(AUTOMATIC))
    before = Actuators(jnp.zeros(()), jnp.array(drive), jnp.array(hold))
    pressed, now = jnp.array(pedal, jnp.float32), jnp.array(speed, jnp.float32)
    after, brake = press_pedal(creeping, before, pressed, now, now, 0.01)
    to_torque = COMPACT.mass * COMPACT.wheel_radius
    return float(after.drive) / to_torque, float(after.hold), float(brake)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_an_automatic_creeps_while_no_brake_is_pressed(compact: Vehicle, way: float):
    half = CREEP_SPEED / 2
    for drive, pedal, speed, expected in [
        (100.0, 0.0, 0.0, AUTOMATIC),  # the way of the last drive, from rest
        (100.0, 0.0, half, AUTOMATIC / 2),
        (0.0, 0.0, half, AUTOMATIC / 2),  # the way it rolls, after the brake
        (100.0, 0.0, -0.2, AUTOMATIC),  # against a slope that pulls it back
        (100.0, 0.0, CREEP_SPEED, 0.0),
        (0.0, 0.06, 0.0, AUTOMATIC),  # more than a light pedal asks
        (0.0, 0.5, 0.0, 1.0),  # less than this one
    ]:
        got, hold, brake = idling(compact, way * drive, 0.0, way * pedal, way * speed)
        assert got == pytest.approx(way * expected, abs=1e-5)
        assert hold == brake == 0.0


def test_a_brake_ends_the_creep_and_holds_the_car(compact: Vehicle):
    assert idling(compact, 100.0, 0.0, -0.5, 1.0)[0] == 0.0  # the service brake
    drive, hold, brake = idling(compact, 100.0, 0.0, -0.5, 0.2)
    assert hold > 0.0  # closes, and stays when the pedal is released
    assert brake > 0.0
    drive, after, brake = idling(compact, 0.0, hold, 0.0, 0.1)
    assert (drive, after > hold) == (0.0, True)
    start = COMPACT.hold_deceleration  # a car begins held
    assert idling(compact, 0.0, start, 0.0, 0.0)[:2] == (0.0, start)
