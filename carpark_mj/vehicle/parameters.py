"""Vehicle parameters: one frozen set per preset, SI units, a source for every number.

Sources: [golf] VW Golf VII press data (length, width, height, wheelbase); [ct]
published kerb-to-kerb turning circle of 10.9 m; [cr] CommonRoad vehicle models
(road-wheel steering rate, brake bias); [od] openpilot's scaling rule for the yaw
inertia (0.2346 m L^2); [gi] Gillespie, Fundamentals of Vehicle Dynamics (tyre
stiffness per load, friction); [sh] Sharp & Granger, steering torques at parking speed
(contact patch); [est] our estimate.
"""

import dataclasses
import math

GRAVITY = 9.81  # m/s^2


def _require_positive(config: object, zero: tuple[str, ...] = ()) -> None:
    for field in dataclasses.fields(config):  # pyright: ignore[reportArgumentType]
        value = getattr(config, field.name)
        if not isinstance(value, int | float):
            continue
        good = value >= 0 if field.name in zero else value > 0
        if not (good and math.isfinite(value)):
            raise ValueError(f"{field.name} must be positive and finite, not {value}")


@dataclasses.dataclass(frozen=True)
class TyreParameters:
    """Brush tyre, see `carpark_mj.physics.tyres` for the equations.

    Attributes:
        friction: peak friction coefficient, dry asphalt [gi].
        cornering_stiffness: lateral force per slip angle and load [1/rad] [gi],
            including steering and suspension compliance.
        slip_stiffness: longitudinal force per slip and load [1] [gi].
        lateral_relaxation: lateral relaxation length [m] [est].
        longitudinal_relaxation: longitudinal relaxation length [m] [est].
        lateral_damping: bristle damping [N s/m] per wheel [est].
        longitudinal_damping: bristle damping [N s/m] per wheel [est].
        torsion_relaxation: relaxation length of the scrub torque [m] [est].
        torsion_yield: twist of the patch at which it slips [rad] [est].
        patch_radius: effective radius of the contact patch [m] [sh].
        rolling_resistance: force per load [1] [est], passenger-car radial.
        vertical_stiffness: suspension and tyre in series, per corner [N/m] [est].
        vertical_damping: per corner [N s/m] [est].
    """

    friction: float = 0.9
    cornering_stiffness: float = 12.0
    slip_stiffness: float = 20.0
    lateral_relaxation: float = 0.5
    longitudinal_relaxation: float = 0.35
    lateral_damping: float = 4000.0
    longitudinal_damping: float = 800.0
    torsion_relaxation: float = 0.08
    torsion_yield: float = 0.06
    patch_radius: float = 0.08
    rolling_resistance: float = 0.012
    vertical_stiffness: float = 28_000.0
    vertical_damping: float = 2200.0

    def __post_init__(self) -> None:
        _require_positive(self)


@dataclasses.dataclass(frozen=True)
class VehicleParameters:
    """A passenger car. Lengths [m], masses [kg], inertias [kg m^2] unless said.

    Attributes:
        length: overall length [golf].
        width: body width without mirrors [golf].
        height: overall height [golf].
        wheelbase: distance between the axles [golf].
        track_width: distance between the wheels of an axle [est].
        rear_overhang: rear axle to rear bumper [est].
        mass: with driver [golf].
        cg_to_front_axle: centre of gravity behind the front axle [est].
        cg_height: centre of gravity above the ground [est].
        roll_inertia: whole car about its centre of gravity [est].
        pitch_inertia: whole car about its centre of gravity [est].
        yaw_inertia: whole car about its centre of gravity [od].
        wheel_radius: rolling radius of a 205/55 R16 tyre [est].
        tyre_width: [golf].
        wheel_mass: wheel, tyre and brake disc [est].
        wheel_inertia: one wheel about its axle, with its share of the driveline [est].
        wheel_tilt_inertia: one wheel about a diameter [est].
        knuckle_mass: steered knuckle without the wheel [est].
        knuckle_inertia: knuckle about any axis through its centre [est].
        max_steering: largest angle of the bicycle model's wheel [rad], from [ct].
        steering_rate: [rad/s]; 0.42 lies between [cr] 0.40 and Apollo's MKZ 0.44.
        ackermann: 1 = exact Ackermann geometry, 0 = parallel wheels.
        front_drive: share of the drive torque at the front axle, 1 = front-driven.
        max_acceleration: drive limit [m/s^2], a comfortable parking driver [est].
        max_deceleration: brake at full pedal [m/s^2], service braking [est].
        max_speed: forwards limit of the pedal [m/s], a car park's walking pace.
        max_reverse_speed: reverse limit of the pedal [m/s].
        speed_limit_time: time constant of the speed limiter [s] [est].
        front_brake: share of the brake torque at the front axle [cr].
        hold_deceleration: torque of the holding brake, as m/s^2 on the car [est]; the
            tyres lock first.
        tyre: tyre parameters.
    """

    length: float = 4.255
    width: float = 1.799
    height: float = 1.452
    wheelbase: float = 2.637
    track_width: float = 1.54
    rear_overhang: float = 0.76
    mass: float = 1380.0
    cg_to_front_axle: float = 1.05
    cg_height: float = 0.54
    roll_inertia: float = 510.0
    pitch_inertia: float = 2180.0
    yaw_inertia: float = 2250.0
    wheel_radius: float = 0.316
    tyre_width: float = 0.205
    wheel_mass: float = 20.0
    wheel_inertia: float = 1.0
    wheel_tilt_inertia: float = 0.6
    knuckle_mass: float = 10.0
    knuckle_inertia: float = 0.25
    max_steering: float = math.radians(34.2)
    steering_rate: float = 0.42
    ackermann: float = 1.0
    front_drive: float = 1.0
    max_acceleration: float = 2.0
    max_deceleration: float = 4.0
    max_speed: float = 3.0
    max_reverse_speed: float = 2.0
    speed_limit_time: float = 0.4
    front_brake: float = 0.68
    hold_deceleration: float = 9.0
    tyre: TyreParameters = TyreParameters()

    def __post_init__(self) -> None:
        _require_positive(self, zero=("ackermann", "front_drive", "rear_overhang"))
        for name in ("ackermann", "front_drive", "front_brake"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ValueError(
                    f"{name} must lie in [0, 1], not {getattr(self, name)}"
                )
        if self.wheelbase + self.rear_overhang >= self.length:
            raise ValueError(
                f"wheelbase {self.wheelbase} m and rear overhang {self.rear_overhang} "
                f"m leave no front overhang in a length of {self.length} m"
            )
        if self.cg_to_front_axle >= self.wheelbase:
            raise ValueError(
                f"cg_to_front_axle must be less than the wheelbase "
                f"{self.wheelbase} m, not {self.cg_to_front_axle}"
            )
        if self.wheel_inertia > 2 * self.wheel_tilt_inertia:
            raise ValueError(
                f"wheel_inertia must be at most twice the wheel_tilt_inertia "
                f"{self.wheel_tilt_inertia} kg m^2, not {self.wheel_inertia}"
            )
        if self.max_steering >= math.pi / 3:
            raise ValueError(
                f"max_steering must be below 60 deg, not "
                f"{math.degrees(self.max_steering):.1f} deg"
            )

    @property
    def centre_offset(self) -> float:
        """Rear axle to footprint centre along the car's axis [m]."""
        return self.length / 2 - self.rear_overhang

    @property
    def cg_to_rear_axle(self) -> float:
        """Centre of gravity ahead of the rear axle [m]."""
        return self.wheelbase - self.cg_to_front_axle


COMPACT = VehicleParameters()
PRESETS: dict[str, VehicleParameters] = {"compact": COMPACT}


def preset(name: str) -> VehicleParameters:
    """Looks a vehicle preset up by name.

    Raises:
        ValueError: unknown name; the message lists the known ones.
    """
    if name not in PRESETS:
        raise ValueError(f"unknown vehicle {name!r}; choose from {sorted(PRESETS)}")
    return PRESETS[name]
