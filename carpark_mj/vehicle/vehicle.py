"""The per-car parameters as data: a pytree that travels in the physics state.

Fleets and randomization change these arrays, never the compiled program. Build one
with `make_vehicle`, and batches of it with `jax.tree.map`.
"""

import jax
import jax.numpy as jnp
from flax import struct
from jax.typing import ArrayLike

from carpark_mj.vehicle.mjcf import car_model, hub_positions, per_wheel
from carpark_mj.vehicle.parameters import GRAVITY, VehicleParameters


@struct.dataclass
class Tyres:
    """Brush tyre coefficients of one car; wheels in the order of `mjcf.WHEELS`.

    Attributes:
        static_load: (..., 4) vertical load at rest on level ground [N].
        friction: (...) friction coefficient.
        longitudinal_stiffness: (..., 4) bristle stiffness [N/m].
        lateral_stiffness: (..., 4) bristle stiffness [N/m].
        torsion_stiffness: (..., 4) scrub torque per twist at static load [N m/rad].
        torsion_yield: (...) twist at which the patch slips [rad].
        longitudinal_relaxation: (...) [m].
        lateral_relaxation: (...) [m].
        torsion_relaxation: (...) [m].
        longitudinal_damping: (...) [N s/m].
        lateral_damping: (...) [N s/m].
        rolling_resistance: (...) force per load.
        vertical_stiffness: (...) [N/m].
        vertical_damping: (...) [N s/m].
    """

    static_load: jax.Array
    friction: jax.Array
    longitudinal_stiffness: jax.Array
    lateral_stiffness: jax.Array
    torsion_stiffness: jax.Array
    torsion_yield: jax.Array
    longitudinal_relaxation: jax.Array
    lateral_relaxation: jax.Array
    torsion_relaxation: jax.Array
    longitudinal_damping: jax.Array
    lateral_damping: jax.Array
    rolling_resistance: jax.Array
    vertical_stiffness: jax.Array
    vertical_damping: jax.Array


@struct.dataclass
class Vehicle:
    """Parameters of one car as the physics uses them.

    Attributes:
        size: (..., 2) length and width of the footprint [m].
        centre_offset: (...) rear axle to footprint centre [m].
        wheelbase: (...) [m].
        track_width: (...) [m].
        hub: (..., 4, 2) wheel centres in the body frame [m].
        wheel_radius: (...) [m].
        wheel_inertia: (...) [kg m^2].
        mass: (...) whole car [kg].
        rated_mass: (...) mass [kg] for which the pedal asks its acceleration; the
            torques do not change with the load.
        cg: (..., 3) centre of gravity of the whole car in the body frame [m].
        ackermann: (...) Ackermann fraction.
        max_steering: (...) [rad].
        steering_rate: (...) [rad/s].
        steering_lag: (...) [s].
        steering_offset: (...) angle that is steered but not commanded [rad].
        max_acceleration: (...) [m/s^2].
        max_drive_torque: (...) all driven wheels together [N m].
        max_power: (...) [W].
        drive_lag: (...) [s].
        max_deceleration: (...) [m/s^2].
        hold_deceleration: (...) [m/s^2].
        max_speed: (...) [m/s].
        max_reverse_speed: (...) [m/s].
        speed_limit_time: (...) [s].
        drive_share: (..., 4) share of the drive torque per wheel; sums to 1.
        brake_share: (..., 4) share of the brake torque per wheel; sums to 1.
        tyres: tyre coefficients.
        body_mass: (..., 8) mass of each MuJoCo body [kg].
        body_inertia: (..., 8, 3) principal inertias [kg m^2].
        body_ipos: (..., 8, 3) centres of mass in the body frames [m].
        body_pos: (..., 8, 3) body frames in their parents [m].
        creep: (...) acceleration of an automatic whose engine idles, at rest [m/s^2];
            None = it does not creep. The back end sets it, see `SimConfig.creep`.
    """

    size: jax.Array
    centre_offset: jax.Array
    wheelbase: jax.Array
    track_width: jax.Array
    hub: jax.Array
    wheel_radius: jax.Array
    wheel_inertia: jax.Array
    mass: jax.Array
    rated_mass: jax.Array
    cg: jax.Array
    ackermann: jax.Array
    max_steering: jax.Array
    steering_rate: jax.Array
    steering_lag: jax.Array
    steering_offset: jax.Array
    max_acceleration: jax.Array
    max_drive_torque: jax.Array
    max_power: jax.Array
    drive_lag: jax.Array
    max_deceleration: jax.Array
    hold_deceleration: jax.Array
    max_speed: jax.Array
    max_reverse_speed: jax.Array
    speed_limit_time: jax.Array
    drive_share: jax.Array
    brake_share: jax.Array
    tyres: Tyres
    body_mass: jax.Array
    body_inertia: jax.Array
    body_ipos: jax.Array
    body_pos: jax.Array
    creep: jax.Array | None = None

    @property
    def length(self) -> jax.Array:
        """(...) of the footprint [m]."""
        return self.size[..., 0]

    @property
    def width(self) -> jax.Array:
        """(...) of the footprint [m]."""
        return self.size[..., 1]


def make_vehicle(params: VehicleParameters) -> Vehicle:
    """Turns a parameter set into the arrays of one car (no batch dimension)."""
    model = car_model(params, sim_dt=0.01, gravity=(0.0, 0.0, -GRAVITY))
    return Vehicle(
        size=_array([params.length, params.width]),
        centre_offset=_array(params.centre_offset),
        wheelbase=_array(params.wheelbase),
        track_width=_array(params.track_width),
        hub=_array(hub_positions(params)[:, :2]),
        wheel_radius=_array(params.wheel_radius),
        wheel_inertia=_array(params.wheel_inertia),
        mass=_array(params.mass),
        rated_mass=_array(params.mass),
        cg=_array([params.cg_to_rear_axle, 0.0, params.cg_height]),
        ackermann=_array(params.ackermann),
        max_steering=_array(params.max_steering),
        steering_rate=_array(params.steering_rate),
        steering_lag=_array(params.steering_lag),
        steering_offset=_array(0.0),
        max_acceleration=_array(params.max_acceleration),
        max_drive_torque=_array(params.max_drive_torque),
        max_power=_array(params.max_power),
        drive_lag=_array(params.drive_lag),
        max_deceleration=_array(params.max_deceleration),
        hold_deceleration=_array(params.hold_deceleration),
        max_speed=_array(params.max_speed),
        max_reverse_speed=_array(params.max_reverse_speed),
        speed_limit_time=_array(params.speed_limit_time),
        drive_share=_array(per_wheel(params.front_drive)),
        brake_share=_array(per_wheel(params.front_brake)),
        tyres=_make_tyres(params),
        body_mass=_array(model.body_mass),
        body_inertia=_array(model.body_inertia),
        body_ipos=_array(model.body_ipos),
        body_pos=_array(model.body_pos),
    )


def _array(value: ArrayLike | list[float]) -> jax.Array:
    """A strongly typed array of JAX's default float (float64 only under x64)."""
    return jnp.array(value, dtype=jnp.result_type(float))


def _make_tyres(params: VehicleParameters) -> Tyres:
    tyre = params.tyre
    load = _array(list(params.static_loads))
    # Scrub torque of a uniformly loaded disc: M = 2/3 mu Fz R_patch (Sharp & Granger).
    torque_limit = tyre.friction * (2 / 3) * tyre.patch_radius * load
    return Tyres(
        static_load=load,
        friction=_array(tyre.friction),
        longitudinal_stiffness=tyre.slip_stiffness
        * load
        / tyre.longitudinal_relaxation,
        lateral_stiffness=tyre.cornering_stiffness * load / tyre.lateral_relaxation,
        torsion_stiffness=torque_limit / tyre.torsion_yield,
        torsion_yield=_array(tyre.torsion_yield),
        longitudinal_relaxation=_array(tyre.longitudinal_relaxation),
        lateral_relaxation=_array(tyre.lateral_relaxation),
        torsion_relaxation=_array(tyre.torsion_relaxation),
        longitudinal_damping=_array(tyre.longitudinal_damping),
        lateral_damping=_array(tyre.lateral_damping),
        rolling_resistance=_array(tyre.rolling_resistance),
        vertical_stiffness=_array(tyre.vertical_stiffness),
        vertical_damping=_array(tyre.vertical_damping),
    )
