"""A path of a car's rear axle, and the controller that drives a car along it.

The turns of Reeds and Shepp begin at once; a car's wheels take time to turn. So the
steering along a segment is averaged over `BLEND`, which moves the path by millimetres,
and the speed is limited so that the wheels can follow.

Steering is the rear-axle feedback of C. Samson, *Control of chained systems*, IEEE
Transactions on Automatic Control 40 (1995), linearised, as reviewed by Paden et al., *A
survey of motion planning and control techniques for self-driving urban vehicles*, 2016.
With d = 1 forwards and -1 backwards, e the offset to the left of the path and t the
heading error, the curvature k + dk with dk = -e / l^2 - 2 d t / l lets both die out
over a distance of about l, without oscillation. The pedal follows the path's speeds; a
segment ends on the holding brake (`carpark_mj.vehicle.drive`), released in time.
"""

import functools
import itertools
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.vehicle import COMPACT, VehicleParameters, make_vehicle
from carpark_mj.vehicle.drive import SWITCH_SPEED, close_hold, hold_braking

STEP = 0.02  # m between points of a path
BLEND = 0.8  # m, over which the steering changes
SHORTEST = 0.03  # m; shorter segments are left out
TURN = 0.02  # rad; but no more turn than this: many short ones turn a car in its place
CRUISE = 1.2  # m/s, highest speed, unless a path must be driven in less time
FASTEST = 2.0  # m/s, highest speed then
CREEP = 0.3  # m/s, below which a car without a pedal stops: the brake holds it
BRAKING = 0.5  # m/s^2, by which a car slows down
SHIFT_TIME = 0.7  # s that a change of gear takes besides the turning of the wheels


def centre(car: VehicleParameters, pose: np.ndarray) -> np.ndarray:
    """Poses (..., 3) of the footprint's centre for those of the rear axle."""
    return _ahead(pose, car.centre_offset)


def rear_axle(car: VehicleParameters, pose: np.ndarray) -> np.ndarray:
    """Poses (..., 3) of the rear axle for those of the footprint's centre."""
    return _ahead(pose, -car.centre_offset)


def _ahead(pose: np.ndarray, distance: float) -> np.ndarray:
    yaw = pose[..., 2]
    step = np.stack([np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)], axis=-1)
    return pose + distance * step


class Segment(NamedTuple):
    """A stretch in one gear; n points `STEP` apart."""

    pose: np.ndarray  # (n, 3) of the rear axle, yaw continuous
    gear: int  # 1 forwards, -1 backwards
    distance: np.ndarray  # (n,) driven since its beginning [m]
    steering: np.ndarray  # (n,) bicycle angle [rad]
    speed: np.ndarray  # (n,) highest absolute speed [m/s]; 0 at the end

    @property
    def length(self) -> float:
        """[m]."""
        return float(self.distance[-1])


class PlannedPath(NamedTuple):
    """A path of a car to its goal."""

    segments: tuple[Segment, ...]  # at least one
    # estimated driving time [s]: at the segments' speeds, and with steering while the
    # car stands
    duration: float

    @property
    def length(self) -> float:
        """[m]."""
        return sum(segment.length for segment in self.segments)

    @property
    def cruise(self) -> float:
        """Highest speed [m/s]."""
        return max(float(segment.speed.max()) for segment in self.segments)

    @property
    def shifts(self) -> int:
        """Changes of gear."""
        return len(self.segments) - 1


def make_path(pose: np.ndarray, car: VehicleParameters) -> PlannedPath | None:
    """Cuts points (n, 3) of the rear axle at changes of gear; None if too short."""
    step = np.diff(pose[:, :2], axis=0)
    kept = np.hypot(*step.T) > STEP * 1e-3
    pose = pose[np.concatenate([[True], kept])]
    step = np.diff(pose[:, :2], axis=0)
    if not len(step):
        return None
    yaw = np.unwrap(pose[:, 2])
    middle = (yaw[1:] + yaw[:-1]) / 2
    gears = np.sign(step[:, 0] * np.cos(middle) + step[:, 1] * np.sin(middle))
    cuts = np.flatnonzero(np.diff(gears)) + 1
    bounds = [0, *cuts.tolist(), len(step)]
    pose = np.column_stack([pose[:, :2], yaw])
    segments: list[Segment] = []
    for first, last in itertools.pairwise(bounds):
        points, gear = pose[first : last + 1], int(gears[first])
        length = np.hypot(*np.diff(points[:, :2], axis=0).T).sum()
        before = segments[-1].pose[-1, 2] if segments else yaw[0]
        if length < SHORTEST and abs(points[-1, 2] - before) < TURN:
            continue
        if segments and segments[-1].gear == gear:  # what lay between was left out
            points = np.concatenate([segments.pop().pose, points])
        segments.append(_segment(points, gear, car))
    return PlannedPath(tuple(segments), _duration(segments, car)) if segments else None


def _duration(segments: list[Segment], car: VehicleParameters) -> float:
    # Where the wheels turn far a car all but stands: the speeds of segments are for
    # slow changes. Of 92 drives in extreme cases that took 46 s on average it is off by
    # 2.9 s (root mean square).
    steering = np.concatenate([segment.steering for segment in segments])
    turning = float(np.abs(np.diff(steering, prepend=0.0)).sum()) / car.steering_rate
    driving = sum(
        float((2 * np.diff(s.distance) / (s.speed[1:] + s.speed[:-1])).sum())
        for s in segments
    )
    return driving + turning + SHIFT_TIME * (len(segments) - 1)


def hurry(path: PlannedPath, car: VehicleParameters, seconds: float) -> PlannedPath:
    """The path at the lowest cruising speed of at least `CRUISE` that meets a duration.

    The highest one, `FASTEST` or the car's own limit, if none does.
    """
    top = min(FASTEST, float(car.max_speed), float(car.max_reverse_speed))
    for cruise in np.arange(CRUISE + 0.1, top + 1e-6, 0.1).tolist():
        if path.duration <= seconds:
            break
        segments = [_segment(s.pose, s.gear, car, cruise) for s in path.segments]
        path = PlannedPath(tuple(segments), _duration(segments, car))
    return path


def _segment(
    pose: np.ndarray, gear: int, car: VehicleParameters, cruise: float = CRUISE
) -> Segment:
    gaps = np.hypot(*np.diff(pose[:, :2], axis=0).T)
    distance = np.concatenate([[0.0], np.cumsum(gaps)])
    curvature = gear * np.diff(pose[:, 2]) / np.maximum(gaps, STEP * 1e-3)
    curvature = np.append(curvature, curvature[-1])
    steering = np.arctan(car.wheelbase * curvature)
    steering = np.clip(steering, -car.max_steering, car.max_steering)
    steering = _average(distance, steering)
    speed = speed_limit(distance, steering, car, cruise)
    speed[-1] = 0.0
    slow_down(speed, np.diff(distance), BRAKING)
    return Segment(pose, gear, distance, steering, speed)


def speed_limit(
    distance: np.ndarray, steering: np.ndarray, car: VehicleParameters, cruise: float
) -> np.ndarray:
    """Speeds (n,) at most `cruise` at which the wheels follow the steering (n,)."""
    rate = np.abs(np.gradient(steering, distance))
    return np.clip(car.steering_rate / np.maximum(rate, 1e-6), CREEP, cruise)


def slow_down(speed: np.ndarray, gap: np.ndarray, rate: float) -> None:
    """Lowers speeds (n,), `gap` (n - 1,) apart, to those that such braking allows."""
    for k in range(len(gap) - 1, -1, -1):
        speed[k] = min(speed[k], math.sqrt(speed[k + 1] ** 2 + 2 * rate * gap[k]))


def _average(distance: np.ndarray, value: np.ndarray) -> np.ndarray:
    """The mean of values (n,) over `BLEND` about every point, less near the ends."""
    # Of a step function: its integral is piecewise linear.
    width = np.diff(distance, append=distance[-1])
    integral = np.concatenate([[0.0], np.cumsum(value * width)])[:-1]
    reach = np.minimum(BLEND / 2, np.minimum(distance, distance[-1] - distance))
    low = np.interp(distance - reach, distance, integral)
    high = np.interp(distance + reach, distance, integral)
    return np.where(reach > 0, (high - low) / np.maximum(2 * reach, 1e-9), value)


REACH = 0.8  # m, l
NEAR = 0.02  # m from the end of a segment: it is driven
WHEELS_SET = 0.03  # rad, error of the wheels with which a standing car pulls away
WHEELS_OFF = 0.15  # rad, with which a car that drives stops
STANDING = 0.02  # m/s
AHEAD = 40  # points of a segment among which the nearest one is sought
DRIVING = 0.06  # pedals below `HOLD_PEDAL` count as none
PULLING_AWAY = 0.3  # m/s^2, more than the tyres' rolling resistance


class Progress(NamedTuple):
    """Progress of a car along its path."""

    segment: int = 0  # index of the current segment; the number of segments at the end
    point: int = 0  # index of its nearest point


class Driven(NamedTuple):
    """A car's motion."""

    pose: np.ndarray  # (3,) of the rear axle
    speed: float  # signed [m/s]
    steering: float  # bicycle angle [rad]


class Command(NamedTuple):
    """The action of a control step, and the progress."""

    steer: float  # in [-1, 1]
    pedal: float  # in [-1, 1]
    progress: Progress  # input of the next step
    error: float  # distance from the path [m]


def track(
    path: PlannedPath,
    progress: Progress,
    car: VehicleParameters,
    driven: Driven,
    dt: float,
    pace: float = FASTEST,
) -> Command:
    """The action of a control step of `dt` [s], at a highest speed `pace` [m/s]."""
    number, point = progress
    if number >= len(path.segments):
        return Command(0.0, brake(driven.speed, car, dt), progress, 0.0)
    segment = path.segments[number]
    # The nearest point, not before the last one.
    ahead = segment.pose[point : point + AHEAD, :2] - driven.pose[:2]
    point += int(np.argmin(np.hypot(ahead[:, 0], ahead[:, 1])))
    along, error, steering = _steer(segment, point, car, driven, dt)
    left = segment.length - along
    stands = abs(driven.speed) < STANDING
    if stands and left < NEAR:
        after = Progress(number + 1, 0)
        if after.segment == len(path.segments):
            return Command(steering / car.max_steering, 0.0, after, error)
        return track(path, after, car, driven, dt, pace)
    wrong = abs(steering - driven.steering)
    wheels_off = wrong > (WHEELS_SET if stands else WHEELS_OFF)
    if wheels_off or driven.speed * segment.gear < -STANDING:
        pedal = brake(driven.speed, car, dt)
    else:
        limit = float(np.interp(along, segment.distance, segment.speed))
        limit, speed = min(limit, pace), abs(driven.speed)
        pedal = segment.gear * _pedal(speed, limit, left, car, dt)
    return Command(steering / car.max_steering, pedal, Progress(number, point), error)


def _steer(
    segment: Segment, point: int, car: VehicleParameters, driven: Driven, dt: float
) -> tuple[float, float, float]:
    """Distance driven along the segment, distance from it, and steering."""
    x, y, yaw = segment.pose[point]
    dx, dy = driven.pose[0] - x, driven.pose[1] - y
    cos, sin = math.cos(yaw), math.sin(yaw)
    along = float(segment.distance[point]) + segment.gear * (cos * dx + sin * dy)
    offset = cos * dy - sin * dx
    turn = math.remainder(driven.pose[2] - yaw, 2 * math.pi)
    # The wheels arrive at the end of the step, when the car is farther.
    there = along + abs(driven.speed) * dt
    steering = float(np.interp(there, segment.distance, segment.steering))
    change = -offset / REACH**2 - 2 * segment.gear * turn / REACH
    steering = math.atan(math.tan(steering) + car.wheelbase * change)
    lock = car.max_steering
    return along, math.hypot(dx, dy), min(max(steering, -lock), lock)


def _pedal(
    speed: float, limit: float, left: float, car: VehicleParameters, dt: float
) -> float:
    """The pedal along the path with a speed limit [m/s], so far from its end [m]."""
    target = limit
    if speed < CREEP:
        speeds, distances = hold_distances()
        if left - float(np.interp(speed, speeds, distances)) < NEAR / 2:
            return 0.0
        # The speed from which the hold, begun after this step, ends at the segment's.
        exact = float(np.interp(left, (speed + speeds) / 2 * dt + distances, speeds))
        target = min(max(limit, CREEP), exact)
    change = (target - speed) / dt
    least = PULLING_AWAY / car.max_acceleration if speed < CREEP else DRIVING
    if change < 0 and speed > SWITCH_SPEED:
        return -max(min(-change / car.max_deceleration, 1.0), DRIVING)
    return min(max(change / car.max_acceleration, least, DRIVING), 1.0)


def brake(speed: float, car: VehicleParameters, dt: float) -> float:
    """The pedal that stops a car of a signed speed, in several steps if need be."""
    change = abs(speed) - SWITCH_SPEED  # below it the pedal would shift gears
    if change <= 0.0:
        return 0.0
    pedal = change / dt / car.max_deceleration
    return -math.copysign(min(max(pedal, DRIVING), 1.0), speed)


@functools.cache
def hold_distances() -> tuple[np.ndarray, np.ndarray]:
    """Speeds (n,) up to `CREEP` and stopping distances (n,) of `compact`'s hold."""
    vehicle, dt = make_vehicle(COMPACT), 0.01

    def substep(car: tuple[jax.Array, jax.Array], _: None):
        speed, hold = car
        hold = close_hold(vehicle, hold, jnp.zeros_like(hold), speed, dt)
        after = jnp.maximum(speed - hold_braking(vehicle, hold, speed) * dt, 0.0)
        return (after, hold), (speed + after) / 2 * dt

    speeds = jnp.linspace(0.0, CREEP - 1e-6, 31)  # at `CREEP` the car would coast
    rest = speeds, jnp.zeros_like(speeds)
    _, distances = jax.jit(lambda rest: jax.lax.scan(substep, rest, length=200))(rest)
    return np.asarray(speeds, float), np.asarray(distances.sum(0), float)
