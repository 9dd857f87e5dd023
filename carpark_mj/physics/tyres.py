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

from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj.vehicle.drive import WheelTorques
from carpark_mj.vehicle.vehicle import Tyres
from carpark_mj.vehicle.wheel import Wheel

_SLIDING = 3.0  # s at which the whole contact patch slides
_TINY = 1e-12
_MIN_LOAD = 1.0  # N, keeps a lifted wheel's slip finite


@struct.dataclass
class TyreState:
    """Bristle deflections of wheels; any shape, in `CarState` (..., 4).

    Attributes:
        longitudinal: u [m].
        lateral: w [m].
        twist: phi [rad].
    """

    longitudinal: jax.Array
    lateral: jax.Array
    twist: jax.Array


class WheelMotion(NamedTuple):
    """Motion of wheels (...), the input of the tyre model.

    Attributes:
        forward: velocity of the contact point along the wheel's plane if the wheel did
            not spin [m/s].
        left: velocity of the contact point left of the wheel's plane [m/s].
        yaw_rate: of the wheel about the vertical [rad/s].
        spin: [rad/s], forwards positive.
        sink: how far the hub is below its radius above the ground [m].
        sink_rate: [m/s].
    """

    forward: jax.Array
    left: jax.Array
    yaw_rate: jax.Array
    spin: jax.Array
    sink: jax.Array
    sink_rate: jax.Array


class TyreForces(NamedTuple):
    """Forces of tyres (...) on the car in one substep.

    Attributes:
        forward: force on the car along the wheel's plane [N].
        left: force on the car left of the wheel's plane [N].
        load: force on the car upwards [N].
        aligning: torque about the vertical [N m].
        spin: net torque on the wheel's spin, drive and brake included [N m].
    """

    forward: jax.Array
    left: jax.Array
    load: jax.Array
    aligning: jax.Array
    spin: jax.Array


def init_tyres(dtype: jnp.dtype | None = None) -> TyreState:
    """Relaxed tyres (4,) of one car."""
    zero = jnp.zeros(4, dtype)
    return TyreState(longitudinal=zero, lateral=zero, twist=zero)


def tyre_forces(
    wheel: Wheel,
    motion: WheelMotion,
    state: TyreState,
    torques: WheelTorques,
    dt: float | jax.Array,
) -> tuple[TyreForces, TyreState]:
    """One substep of tyres; elementwise, for wheels of any shape.

    Args:
        wheel: parameters of the wheels.
        motion: of the wheels at the start of the substep.
        state: bristles at the start of the substep.
        torques: of drive and brakes.
        dt: substep [s].

    Returns:
        Forces over the substep and the bristles at its end.
    """
    tyre, (drive, brake) = wheel.tyre, torques
    radius, inertia = wheel.radius, wheel.inertia
    load = jnp.maximum(
        tyre.static_load
        + tyre.vertical_stiffness * motion.sink
        + tyre.vertical_damping * motion.sink_rate,
        0.0,
    )
    limit = tyre.friction * jnp.maximum(load, _MIN_LOAD)
    rolling = jnp.abs(motion.forward)

    # Bristles at the end of the substep, implicit in their decay, spin held.
    slip = motion.forward - motion.spin * radius
    decay_x = 1.0 + dt * rolling / tyre.longitudinal_relaxation
    decay_y = 1.0 + dt * rolling / tyre.lateral_relaxation
    u = (state.longitudinal + dt * slip) / decay_x
    w = (state.lateral + dt * motion.left) / decay_y
    sliding, shape, _ = _saturation(tyre, limit, u, w)
    u_rate = (u - state.longitudinal) / dt
    w_rate = (w - state.lateral) / dt
    stuck = jnp.where(sliding, 0.0, 1.0)
    force_x = -(
        tyre.longitudinal_stiffness * u * shape
        + tyre.longitudinal_damping * u_rate * stuck
    )
    force_y = -(
        tyre.lateral_stiffness * w * shape + tyre.lateral_damping * w_rate * stuck
    )

    # Implicit in the spin: the force falls by gain/dt I_w/r per unit of spin gained.
    gain = (
        (tyre.longitudinal_stiffness * shape * dt + tyre.longitudinal_damping * stuck)
        * radius**2
        * dt
        / (inertia * decay_x)
    )
    resistance = brake + tyre.rolling_resistance * load * radius
    momentum = inertia * motion.spin / dt
    stop = -(momentum * (1.0 + gain) + drive - radius * force_x)
    torque = drive + jnp.clip(stop, -resistance, resistance)
    force_x = (force_x + gain * torque / radius) / (1.0 + gain)

    # Friction circle, then the Coulomb torque that belongs to the final force.
    share = jnp.minimum(1.0, limit / jnp.sqrt(force_x**2 + force_y**2 + _TINY))
    force_x, force_y = force_x * share, force_y * share
    free = drive - radius * force_x
    spin_torque = free + jnp.clip(-(momentum + free), -resistance, resistance)

    # The bristle moves with the spin at the end of the substep.
    u = u - dt * radius * (dt * spin_torque / inertia) / decay_x
    _, _, keep = _saturation(tyre, limit, u, w)

    twist_limit = tyre.torsion_yield * load / tyre.static_load
    twist = (state.twist + dt * motion.yaw_rate) / (
        1.0 + dt * rolling / tyre.torsion_relaxation
    )
    twist = jnp.clip(twist, -twist_limit, twist_limit)
    aligning = -tyre.torsion_stiffness * twist
    forces = TyreForces(force_x, force_y, load, aligning, spin_torque)
    return forces, TyreState(longitudinal=u * keep, lateral=w * keep, twist=twist)


def _saturation(
    tyre: Tyres, limit: jax.Array, u: jax.Array, w: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Sliding flag, brush shape factor F / (k u), and the scale that caps bristles."""
    stretch = (tyre.longitudinal_stiffness * u) ** 2 + (tyre.lateral_stiffness * w) ** 2
    s = jnp.sqrt(stretch + _TINY) / limit
    capped = jnp.minimum(s, _SLIDING)
    keep = capped / s
    shape = (1.0 - capped / 3.0 + capped**2 / 27.0) * keep
    return s > _SLIDING, shape, keep
