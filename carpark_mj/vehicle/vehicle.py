"""Parameters of cars as JAX arrays, of their wheels, and under other conditions."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax.typing import ArrayLike

from carpark_mj.config import SimConfig, Surface
from carpark_mj.vehicle.mjcf import CHASSIS, WHEELS, car_model, hub_positions, per_wheel
from carpark_mj.vehicle.parameters import GRAVITY, TyreParameters, VehicleParameters

STIFFNESSES = ("longitudinal_stiffness", "lateral_stiffness", "torsion_stiffness")
BODIES = ("body_mass", "body_inertia", "body_ipos", "body_pos")  # of MuJoCo's model


@struct.dataclass
class Tyres:
    """Brush tyre coefficients of one car; wheels in the order of `mjcf.WHEELS`."""

    static_load: jax.Array  # (..., 4) vertical load at rest on level ground [N]
    friction: jax.Array  # (...) friction coefficient
    longitudinal_stiffness: jax.Array  # (..., 4) bristle stiffness [N/m]
    lateral_stiffness: jax.Array  # (..., 4) bristle stiffness [N/m]
    # (..., 4) scrub torque per twist at static load [N m/rad]
    torsion_stiffness: jax.Array
    torsion_yield: jax.Array  # (...) twist at which the patch slips [rad]
    longitudinal_relaxation: jax.Array  # (...) [m]
    lateral_relaxation: jax.Array  # (...) [m]
    torsion_relaxation: jax.Array  # (...) [m]
    longitudinal_damping: jax.Array  # (...) [N s/m]
    lateral_damping: jax.Array  # (...) [N s/m]
    rolling_resistance: jax.Array  # (...) force per load
    vertical_stiffness: jax.Array  # (...) [N/m]
    vertical_damping: jax.Array  # (...) [N s/m]


@struct.dataclass
class Vehicle:
    """Parameters of one car as the physics uses them."""

    size: jax.Array  # (..., 2) length and width of the footprint [m]
    centre_offset: jax.Array  # (...) rear axle to footprint centre [m]
    wheelbase: jax.Array  # (...) [m]
    track_width: jax.Array  # (...) [m]
    hub: jax.Array  # (..., 4, 2) wheel centres in the body frame [m]
    wheel_radius: jax.Array  # (...) [m]
    wheel_inertia: jax.Array  # (...) [kg m^2]
    mass: jax.Array  # (...) whole car [kg]
    # (...) mass [kg] for which the pedal asks its acceleration; the torques do not
    # change with the load
    rated_mass: jax.Array
    cg: jax.Array  # (..., 3) centre of gravity of the whole car in the body frame [m]
    ackermann: jax.Array  # (...) Ackermann fraction
    max_steering: jax.Array  # (...) [rad]
    steering_rate: jax.Array  # (...) [rad/s]
    steering_lag: jax.Array  # (...) [s]
    steering_offset: jax.Array  # (...) angle that is steered but not commanded [rad]
    max_acceleration: jax.Array  # (...) [m/s^2]
    max_drive_torque: jax.Array  # (...) all driven wheels together [N m]
    max_power: jax.Array  # (...) [W]
    drive_lag: jax.Array  # (...) [s]
    max_deceleration: jax.Array  # (...) [m/s^2]
    hold_deceleration: jax.Array  # (...) [m/s^2]
    max_speed: jax.Array  # (...) [m/s]
    max_reverse_speed: jax.Array  # (...) [m/s]
    speed_limit_time: jax.Array  # (...) [s]
    drive_share: jax.Array  # (..., 4) share of the drive torque per wheel; sums to 1
    brake_share: jax.Array  # (..., 4) share of the brake torque per wheel; sums to 1
    tyres: Tyres  # tyre coefficients
    body_mass: jax.Array  # (..., 8) mass of each MuJoCo body [kg]
    body_inertia: jax.Array  # (..., 8, 3) principal inertias [kg m^2]
    body_ipos: jax.Array  # (..., 8, 3) centres of mass in the body frames [m]
    body_pos: jax.Array  # (..., 8, 3) body frames in their parents [m]
    # (...) acceleration of an automatic whose engine idles, at rest [m/s^2]; None = it
    # does not creep. The back end sets it, see `SimConfig.creep`.
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
    """The arrays of one car, by NumPy, as JAX would compile programs."""
    model = car_model(params, sim_dt=0.01, gravity=(0.0, 0.0, -GRAVITY))
    vehicle = Vehicle(
        size=_array([params.length, params.width]),
        hub=_array(hub_positions(params)[:, :2]),
        rated_mass=_array(params.mass),
        cg=_array([params.cg_to_rear_axle, 0.0, params.cg_height]),
        steering_offset=_array(0.0),
        drive_share=_array(per_wheel(params.front_drive)),
        brake_share=_array(per_wheel(params.front_brake)),
        tyres=_make_tyres(params),
        **_same(Vehicle, params),
        **{name: _array(getattr(model, name)) for name in BODIES},
    )
    return jax.device_put(vehicle)


def _make_tyres(params: VehicleParameters) -> Tyres:
    tyre = params.tyre
    load = _array(params.static_loads)
    # Scrub torque of a uniformly loaded disc: M = 2/3 mu Fz R_patch (Sharp & Granger).
    torque_limit = tyre.friction * (2 / 3) * tyre.patch_radius * load
    slip = tyre.slip_stiffness * load
    lateral = tyre.cornering_stiffness * load
    # XLA, too, multiplies by reciprocals: results stay the same to the bit.
    return Tyres(
        static_load=load,
        longitudinal_stiffness=slip * (1 / _array(tyre.longitudinal_relaxation)),
        lateral_stiffness=lateral * (1 / _array(tyre.lateral_relaxation)),
        torsion_stiffness=torque_limit * (1 / _array(tyre.torsion_yield)),
        **_same(Tyres, tyre),
    )


def _same(arrays: type, params: VehicleParameters | TyreParameters) -> dict[str, Any]:
    """Numbers of the parameters by the fields that have their names."""
    names = [field.name for field in dataclasses.fields(arrays)]
    values = {name: getattr(params, name, None) for name in names}
    return {k: _array(v) for k, v in values.items() if v is not None}


def _array(value: ArrayLike | Sequence[float]) -> Any:
    """Of JAX's default float (float64 only under x64)."""
    return np.array(value, jnp.result_type(float))


@struct.dataclass
class Wheel:
    """Parameters of a wheel; all leaves have the leading shape of the cars."""

    hub: tuple[jax.Array, jax.Array]  # (x, y) of its centre in the body frame [m]
    radius: jax.Array  # [m]
    inertia: jax.Array  # about its axle [kg m^2]
    drive_share: jax.Array  # of the drive torque
    brake_share: jax.Array  # of the brake torque
    tyre: Tyres  # coefficients of its tyre


def wheels_of(vehicle: Vehicle) -> tuple[Wheel, ...]:
    """The wheels of cars (...), in the order of `mjcf.WHEELS`."""
    tyres, names = vehicle.tyres, ("static_load", *STIFFNESSES)
    varied = {name: jnp.unstack(getattr(tyres, name), axis=-1) for name in names}
    hub_x, hub_y = (
        jnp.unstack(column, axis=-1) for column in jnp.unstack(vehicle.hub, axis=-1)[:2]
    )
    drive_share = jnp.unstack(vehicle.drive_share, axis=-1)
    brake_share = jnp.unstack(vehicle.brake_share, axis=-1)
    return tuple(
        Wheel(
            hub=(hub_x[i], hub_y[i]),
            radius=vehicle.wheel_radius,
            inertia=vehicle.wheel_inertia,
            drive_share=drive_share[i],
            brake_share=brake_share[i],
            tyre=dataclasses.replace(
                tyres, **{name: wheel[i] for name, wheel in varied.items()}
            ),
        )
        for i in range(len(WHEELS))
    )


def with_mass(vehicle: Vehicle, mass: jax.Array, cg: jax.Array) -> Vehicle:
    """One car with a load: another mass () [kg] and centre of gravity (3,) [m].

    Both are of the whole car, in the body frame. Wheels and knuckles do not change; the
    chassis' inertia about its own centre grows with its mass. Static tyre loads follow,
    so that the car rests at the same height (level control), and with them the
    stiffness of the tyres, which is proportional to load. The pedal's torques stay
    (`rated_mass`).
    """
    before = vehicle.body_mass[CHASSIS]
    chassis = before + mass - vehicle.mass
    moment = before * vehicle.body_ipos[CHASSIS] + mass * cg - vehicle.mass * vehicle.cg
    axle_load = mass * GRAVITY / vehicle.wheelbase / 2
    front, rear = axle_load * cg[0], axle_load * (vehicle.wheelbase - cg[0])
    load = jnp.stack([front, front, rear, rear])
    ratio = load / vehicle.tyres.static_load
    tyres = dataclasses.replace(
        vehicle.tyres,
        static_load=load,
        **{name: getattr(vehicle.tyres, name) * ratio for name in STIFFNESSES},
    )
    return dataclasses.replace(
        vehicle,
        mass=mass,
        cg=cg,
        tyres=tyres,
        body_mass=vehicle.body_mass.at[CHASSIS].set(chassis),
        body_ipos=vehicle.body_ipos.at[CHASSIS].set(moment / chassis),
        body_inertia=vehicle.body_inertia.at[CHASSIS].multiply(chassis / before),
    )


# A car's tyre friction is that on dry asphalt; a surface scales it for every car alike.
# Dry: peak friction of passenger-car tyres on asphalt (Gillespie; sliding 0.76 +- 0.06,
# 17 studies in Bartlett); wet 0.5 to 0.6 and ice 0.1 to 0.15, textbook ranges.
SURFACES: dict[Surface, float] = {"dry": 0.9, "wet": 0.55, "ice": 0.12}


def in_conditions(vehicle: Vehicle, sim: SimConfig) -> Vehicle:
    """Cars (...) as the settings have them; the defaults change nothing."""
    if sim.surface != "dry":
        vehicle = with_grip(vehicle, SURFACES[sim.surface] / SURFACES["dry"])
    if sim.creep:
        creep = jnp.full_like(vehicle.mass, sim.creep)
        vehicle = dataclasses.replace(vehicle, creep=creep)
    return vehicle


def with_grip(vehicle: Vehicle, factor: float | jax.Array) -> Vehicle:
    """Cars (...) whose tyre friction, scrub torque included, is scaled."""
    tyres = dataclasses.replace(
        vehicle.tyres,
        friction=vehicle.tyres.friction * factor,
        torsion_stiffness=vehicle.tyres.torsion_stiffness * factor,
    )
    return dataclasses.replace(vehicle, tyres=tyres)
