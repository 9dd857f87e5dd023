r"""Brush tyres: bristle states per wheel, forces through `qfrc_applied`.

The contact patch is one bristle per direction (a transient brush model: Fiala's
steady state with relaxation). With the contact patch sliding at (v_x, v_y) in the
wheel plane and the patch twisting at w_z,

    du/dt   = v_x - |v_hub| u / sigma_x,     v_x = v_hub - omega r
    dw/dt   = v_y - |v_hub| w / sigma_y
    dphi/dt = w_z - |v_hub| phi / sigma_t

    F = -(k_x u, k_y w) (1 - s/3 + s^2/27) - damping,  s = |(k_x u, k_y w)| / (mu F_z)

limited to mu F_z; s is held at 3, where the whole patch slides. k_y sigma_y is the
cornering stiffness, k_x sigma_x the slip stiffness. At standstill the bristles are
true springs: no creep, exact hold up to the friction limit. Vertically a spring and
damper per corner carries the car. No contacts and no solver rows are involved.

The wheel spin is integrated explicitly by MuJoCo, and dt^2 k_x r^2 / I_w is near 4 at
10 ms for an ordinary wheel, the limit of stability. The longitudinal force is
therefore computed implicitly in the spin, with brake and rolling resistance as
exact Coulomb torques, and the bristle is advanced with the spin that results.

References: Pacejka, Tyre and Vehicle Dynamics, ch. 3 (brush model) and 7 (single
contact point transient model); Fiala 1954.
"""

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj.vehicle.drive import WheelTorques
from carpark_mj.vehicle.vehicle import Vehicle

_SLIDING = 3.0  # s at which the whole contact patch slides
_TINY = 1e-12
_MIN_LOAD = 1.0  # N, keeps a lifted wheel's slip finite


@struct.dataclass
class TyreState:
    """Bristle deflections of the four wheels of a car.

    Attributes:
        longitudinal: (..., 4) u [m].
        lateral: (..., 4) w [m].
        twist: (..., 4) phi [rad].
    """

    longitudinal: jax.Array
    lateral: jax.Array
    twist: jax.Array


@struct.dataclass
class TyreForces:
    """What the tyres do to the car in one substep.

    Attributes:
        force_w: (4, 3) force on the car at each contact patch, world frame [N].
        aligning: (4,) torque about the vertical at each wheel [N m].
        spin: (4,) net torque on each wheel's spin [N m].
    """

    force_w: jax.Array
    aligning: jax.Array
    spin: jax.Array


@struct.dataclass
class WheelMotion:
    """Kinematics of the four wheels, the input of the tyre model.

    Attributes:
        heading_w: (4, 2) unit vector along each wheel's plane, on the ground.
        velocity: (4, 2) velocity of the wheel's contact point if it did not spin,
            along and left of the wheel's plane [m/s].
        yaw_rate: (4,) of the wheel about the vertical [rad/s].
        spin: (4,) [rad/s], forwards positive.
        sink: (4,) how far the hub is below its radius above the ground [m].
        sink_rate: (4,) [m/s].
    """

    heading_w: jax.Array
    velocity: jax.Array
    yaw_rate: jax.Array
    spin: jax.Array
    sink: jax.Array
    sink_rate: jax.Array


def init_tyres(dtype: jnp.dtype | None = None) -> TyreState:
    """Relaxed tyres of one car."""
    zero = jnp.zeros(4, dtype)
    return TyreState(longitudinal=zero, lateral=zero, twist=zero)


def tyre_forces(
    vehicle: Vehicle,
    motion: WheelMotion,
    state: TyreState,
    torques: WheelTorques,
    dt: float | jax.Array,
) -> tuple[TyreForces, TyreState]:
    """One substep of the four tyres of one car.

    Args:
        vehicle: the car.
        motion: wheel kinematics at the start of the substep.
        state: bristles at the start of the substep.
        torques: of drive and brakes.
        dt: substep [s].

    Returns:
        Forces over the substep and the bristles at its end.
    """
    tyres, (drive, brake) = vehicle.tyres, torques
    radius, inertia = vehicle.wheel_radius, vehicle.wheel_inertia
    load = jnp.maximum(
        tyres.static_load
        + tyres.vertical_stiffness * motion.sink
        + tyres.vertical_damping * motion.sink_rate,
        0.0,
    )
    limit = tyres.friction * jnp.maximum(load, _MIN_LOAD)
    rolling = jnp.abs(motion.velocity[:, 0])

    # Bristles at the end of the substep, implicit in their decay, spin held.
    slip = motion.velocity[:, 0] - motion.spin * radius
    decay_x = 1.0 + dt * rolling / tyres.longitudinal_relaxation
    decay_y = 1.0 + dt * rolling / tyres.lateral_relaxation
    u = (state.longitudinal + dt * slip) / decay_x
    w = (state.lateral + dt * motion.velocity[:, 1]) / decay_y
    sliding, shape, _ = _saturation(tyres, limit, u, w)
    u_rate = (u - state.longitudinal) / dt
    w_rate = (w - state.lateral) / dt
    stuck = jnp.where(sliding, 0.0, 1.0)
    force_x = -(
        tyres.longitudinal_stiffness * u * shape
        + tyres.longitudinal_damping * u_rate * stuck
    )
    force_y = -(
        tyres.lateral_stiffness * w * shape + tyres.lateral_damping * w_rate * stuck
    )

    # Implicit in the spin: the force falls by gain/dt I_w/r per unit of spin gained.
    gain = (
        (tyres.longitudinal_stiffness * shape * dt + tyres.longitudinal_damping * stuck)
        * radius**2
        * dt
        / (inertia * decay_x)
    )
    resistance = brake + tyres.rolling_resistance * load * radius
    momentum = inertia * motion.spin / dt
    stop = -(momentum * (1.0 + gain) + drive - radius * force_x)
    torque = drive + jnp.clip(stop, -resistance, resistance)
    force_x = (force_x + gain * torque / radius) / (1.0 + gain)

    # Friction circle, then the Coulomb torque that belongs to the final force.
    scale = jnp.minimum(1.0, limit / jnp.sqrt(force_x**2 + force_y**2 + _TINY))
    force_x, force_y = force_x * scale, force_y * scale
    free = drive - radius * force_x
    spin_torque = free + jnp.clip(-(momentum + free), -resistance, resistance)

    # The bristle moves with the spin at the end of the substep.
    u = u - dt * radius * (dt * spin_torque / inertia) / decay_x
    _, _, keep = _saturation(tyres, limit, u, w)

    twist_limit = tyres.torsion_yield * load / tyres.static_load
    twist = (state.twist + dt * motion.yaw_rate) / (
        1.0 + dt * rolling / tyres.torsion_relaxation
    )
    twist = jnp.clip(twist, -twist_limit, twist_limit)

    cos, sin = motion.heading_w[:, 0], motion.heading_w[:, 1]
    force_w = jnp.stack(
        [force_x * cos - force_y * sin, force_x * sin + force_y * cos, load], axis=-1
    )
    forces = TyreForces(
        force_w=force_w, aligning=-tyres.torsion_stiffness * twist, spin=spin_torque
    )
    return forces, TyreState(longitudinal=u * keep, lateral=w * keep, twist=twist)


def _saturation(
    tyres, limit: jax.Array, u: jax.Array, w: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Sliding flag, brush shape factor F / (k u), and the scale that caps bristles."""
    s = (
        jnp.sqrt(
            (tyres.longitudinal_stiffness * u) ** 2
            + (tyres.lateral_stiffness * w) ** 2
            + _TINY
        )
        / limit
    )
    capped = jnp.minimum(s, _SLIDING)
    keep = capped / s
    shape = (1.0 - capped / 3.0 + capped**2 / 27.0) * keep
    return s > _SLIDING, shape, keep
