"""Vehicle parameters: a frozen, self-validating set in SI units.

The cars themselves, with a source for every number, are in `vehicle.presets`; what has
a default here is common to them. Sources of the defaults: [cr] CommonRoad vehicle
models (road-wheel steering rate, brake bias); [gi] Gillespie, Fundamentals of Vehicle
Dynamics (tyre stiffness per load, friction); [sh] Sharp & Granger, steering torques at
parking speed (contact patch); [est] our estimate.

Examples:
    A custom car:

    >>> from dataclasses import replace
    >>> from carpark_mj import ParkingEnv
    >>> from carpark_mj.vehicle import COMPACT
    >>> taxi = replace(COMPACT, length=4.4, wheelbase=2.7, turning_circle=11.2)
    >>> env = ParkingEnv(vehicle=taxi)
"""

import dataclasses
import math
from typing import Annotated

from carpark_mj.config.checks import (
    Bounds,
    CheckedConfig,
    NonNegative,
    Positive,
    Ratio,
    require_number,
)

GRAVITY = 9.81  # m/s^2
_MAX_LOCK = math.pi / 3  # beyond 60 deg no steering linkage works

# Bounds of road vehicles, which reveal other units. Toy cars are out of bounds.
Length = Annotated[float, Bounds(ge=0.5, le=5.0, unit="m")]
Speed = Annotated[float, Bounds(ge=0.1, le=100.0, unit="m/s")]
Acceleration = Annotated[float, Bounds(ge=0.1, le=30.0, unit="m/s^2")]


@dataclasses.dataclass(frozen=True)
class TyreParameters(CheckedConfig):
    """Brush tyre, see `carpark_mj.physics.forces` for the equations.

    Attributes:
        friction: peak friction coefficient, dry asphalt [gi].
        cornering_stiffness: lateral force per slip angle and load [1/rad], [gi],
            including steering and suspension compliance.
        slip_stiffness: longitudinal force per slip and load [1], [gi].
        lateral_relaxation: lateral relaxation length [m], [est].
        longitudinal_relaxation: longitudinal relaxation length [m], [est].
        lateral_damping: bristle damping [N s/m] per wheel [est].
        longitudinal_damping: bristle damping [N s/m] per wheel [est].
        torsion_relaxation: relaxation length of the scrub torque [m], [est].
        torsion_yield: twist of the patch at which it slips [rad], [est].
        patch_radius: effective radius of the contact patch [m], [sh].
        rolling_resistance: force per load [1], [est], passenger-car radial.
        vertical_stiffness: suspension and tyre in series, per corner [N/m], [est].
        vertical_damping: per corner [N s/m], [est].
    """

    friction: Positive = 0.9
    cornering_stiffness: Positive = 12.0
    slip_stiffness: Positive = 20.0
    lateral_relaxation: Positive = 0.5
    longitudinal_relaxation: Positive = 0.35
    lateral_damping: Positive = 4000.0
    longitudinal_damping: Positive = 800.0
    torsion_relaxation: Positive = 0.08
    torsion_yield: Positive = 0.06
    patch_radius: Positive = 0.08
    rolling_resistance: Positive = 0.012
    vertical_stiffness: Positive = 28_000.0
    vertical_damping: Positive = 2200.0


def kerb_to_kerb(
    wheelbase: float, track_width: float, tyre_width: float, steering: float
) -> float:
    """Turning circle [m] swept by the outer front tyre at a bicycle angle [rad].

    The bicycle turns about a point on the rear axle at L / tan(steering) from its
    middle; the outer front wheel is half a track width farther out.
    """
    across = wheelbase / math.tan(steering) + track_width / 2
    return 2 * math.hypot(wheelbase, across) + tyre_width


def steering_for_circle(
    wheelbase: float, track_width: float, tyre_width: float, turning_circle: float
) -> float:
    """Bicycle angle [rad] of a kerb-to-kerb circle [m]; `ValueError` beyond 60 deg."""
    smallest = kerb_to_kerb(wheelbase, track_width, tyre_width, _MAX_LOCK)
    if not turning_circle > smallest:
        raise ValueError(
            f"turning_circle must be more than {smallest:.2f} m, which takes 60 deg of "
            f"steering, not {turning_circle}"
        )
    reach = (turning_circle - tyre_width) / 2
    across = math.sqrt(reach**2 - wheelbase**2)
    return math.atan2(wheelbase, across - track_width / 2)


@dataclasses.dataclass(frozen=True, kw_only=True)
class VehicleParameters(CheckedConfig):
    """A passenger car. Lengths [m], masses [kg], inertias [kg m^2] unless said.

    Attributes:
        length: overall length.
        width: body width without mirrors.
        height: overall height.
        wheelbase: distance between the axles.
        track_width: distance between the wheels of an axle, front and rear alike.
        rear_overhang: rear axle to rear bumper.
        mass: with driver.
        cg_to_front_axle: centre of gravity behind the front axle.
        cg_height: centre of gravity above the ground.
        roll_inertia: whole car about its centre of gravity.
        pitch_inertia: whole car about its centre of gravity.
        yaw_inertia: whole car about its centre of gravity.
        wheel_radius: rolling radius.
        tyre_width: nominal section width.
        turning_circle: published diameter kerb to kerb; fixes `max_steering`.
        front_drive: share of the drive torque at the front axle: 1 = front-driven,
            0 = rear-driven, between = all-wheel drive.
        max_drive_torque: at the driven wheels together, in first gear [N m].
        max_power: at the wheels [W].
        wheel_mass: wheel, tyre and brake disc [est].
        wheel_inertia: one wheel about its axle, with its share of the driveline [est].
        wheel_tilt_inertia: one wheel about a diameter [est].
        knuckle_mass: steered knuckle without the wheel [est].
        knuckle_inertia: knuckle about any axis through its centre [est].
        steering_rate: [rad/s]; 0.42 lies between [cr] 0.40 and Apollo's MKZ 0.44.
        steering_lag: time constant of the steering's approach to its target, within
            the rate [s]; 0 = none. Power steering: about 0.1 [est].
        ackermann: 1 = exact Ackermann geometry, 0 = parallel wheels. Shop manuals give
            0.41 (Camry) to 0.85 (Galant).
        max_acceleration: drive at full pedal [m/s^2], a comfortable parking driver
            [est]; torque and power may allow less.
        drive_lag: time constant of the drive torque [s]; 0 = none. An engine: about
            0.2, a motor 0.05 [est]. Brakes act at once.
        max_deceleration: brake at full pedal [m/s^2], service braking [est].
        max_speed: forwards limit of the pedal [m/s], a car park's walking pace.
        max_reverse_speed: reverse limit of the pedal [m/s].
        speed_limit_time: time constant of the speed limiter [s], [est].
        front_brake: share of the brake torque at the front axle [cr].
        hold_deceleration: torque of the holding brake, as m/s^2 on the car [est]; the
            tyres lock first.
        tyre: tyre parameters.
    """

    length: Annotated[float, Bounds(ge=1.0, le=25.0, unit="m")]
    width: Length
    height: Length
    wheelbase: Annotated[float, Bounds(ge=0.5, le=20.0, unit="m")]
    track_width: Length
    rear_overhang: Positive
    mass: Annotated[float, Bounds(ge=50.0, le=60_000.0, unit="kg")]
    cg_to_front_axle: Positive
    cg_height: Positive
    roll_inertia: Positive
    pitch_inertia: Positive
    yaw_inertia: Positive
    wheel_radius: Annotated[float, Bounds(ge=0.1, le=1.0, unit="m")]
    tyre_width: Positive
    turning_circle: Annotated[float, Bounds(ge=2.0, le=100.0, unit="m")]
    front_drive: Ratio
    max_drive_torque: Positive
    max_power: Annotated[float, Bounds(ge=1e3, le=2e6, unit="W")]
    wheel_mass: Positive = 20.0
    wheel_inertia: Positive = 1.0
    wheel_tilt_inertia: Positive = 0.6
    knuckle_mass: Positive = 10.0
    knuckle_inertia: Positive = 0.25
    steering_rate: Positive = 0.42
    steering_lag: NonNegative = 0.0
    ackermann: Ratio = 1.0
    max_acceleration: Acceleration = 2.0
    drive_lag: NonNegative = 0.0
    max_deceleration: Acceleration = 4.0
    max_speed: Speed = 3.0
    max_reverse_speed: Speed = 2.0
    speed_limit_time: Positive = 0.4
    front_brake: Ratio = 0.68
    hold_deceleration: Positive = 9.0
    tyre: TyreParameters = TyreParameters()

    def __post_init__(self) -> None:
        super().__post_init__()
        wheel = Bounds(ge=self.wheel_radius, unit="m, a wheel's radius")
        limits = {
            "front_overhang": wheel,
            "rear_overhang": wheel,
            "track_width": Bounds(le=self.width - self.tyre_width, unit="m"),
            "wheel_radius": Bounds(lt=self.height / 2, unit="m, half the height"),
            "cg_height": Bounds(lt=self.height, unit="m, the height"),
            "cg_to_front_axle": Bounds(lt=self.wheelbase, unit="m, the wheelbase"),
            "wheel_inertia": Bounds(le=2 * self.wheel_tilt_inertia, unit="kg m^2"),
        }
        for name, bounds in limits.items():
            require_number(name, getattr(self, name), bounds)
        inertias = (self.roll_inertia, self.pitch_inertia, self.yaw_inertia)
        if 2 * max(inertias) > sum(inertias):
            raise ValueError(
                f"roll_inertia, pitch_inertia and yaw_inertia must obey the triangle "
                f"inequality, none above the sum of the others, not {inertias} kg m^2"
            )
        _ = self.max_steering  # refuses an impossible turning circle

    @property
    def max_steering(self) -> float:
        """Largest angle of the bicycle model's wheel [rad], from `turning_circle`."""
        return steering_for_circle(
            self.wheelbase, self.track_width, self.tyre_width, self.turning_circle
        )

    @property
    def turning_radius(self) -> float:
        """Radius of the rear axle's centre on full lock [m]."""
        return self.wheelbase / math.tan(self.max_steering)

    @property
    def front_overhang(self) -> float:
        """Front axle to front bumper [m]."""
        return self.length - self.wheelbase - self.rear_overhang

    @property
    def centre_offset(self) -> float:
        """Rear axle to footprint centre along the car's axis [m]."""
        return self.length / 2 - self.rear_overhang

    @property
    def cg_to_rear_axle(self) -> float:
        """Centre of gravity ahead of the rear axle [m]."""
        return self.wheelbase - self.cg_to_front_axle

    @property
    def static_loads(self) -> tuple[float, float, float, float]:
        """Loads of the wheels at rest on level ground [N]: two front, two rear."""
        weight = self.mass * GRAVITY / self.wheelbase / 2
        front, rear = weight * self.cg_to_rear_axle, weight * self.cg_to_front_axle
        return front, front, rear, rear


# Settings that are lengths [m].
LENGTHS = (
    *("length", "width", "height", "wheelbase", "track_width", "rear_overhang"),
    *("cg_to_front_axle", "cg_height", "wheel_radius", "tyre_width", "turning_circle"),
)


def scaled(params: VehicleParameters, factor: float) -> VehicleParameters:
    """The car enlarged by a factor, for pictures; masses do not change."""
    if abs(factor - 1.0) < 1e-6:  # float32 has been there
        return params
    lengths = {name: factor * getattr(params, name) for name in LENGTHS}
    return dataclasses.replace(params, **lengths)
