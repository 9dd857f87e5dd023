"""Lane following: from a route and a target speed to steer and pedal.

Steering is pure pursuit (R. C. Coulter, "Implementation of the Pure Pursuit Path
Tracking Algorithm", CMU-RI-TR-92-01, 1992): the rear axle is led on the circle through
a point of the path some way ahead. The look-ahead grows with the speed (as in J. M.
Snider, CMU-RI-TR-09-08, 2009, section 2.2). The pedal is a proportional-integral
controller of the speed, whose integral stands still while the pedal is at an end.
"""

import jax
import jax.numpy as jnp

from carpark_mj.geometry import move_forward, norm, rotate
from carpark_mj.types import Motion
from carpark_mj.vehicle.drive import HOLD_SPEED
from carpark_mj.vehicle.vehicle import Vehicle
from carpark_papers.cederle.junction.routes import Routes, point_at, project

# Tuned on the six routes of the junction with the preset `city`.
LOOKAHEAD, LOOKAHEAD_TIME = 2.0, 0.3  # m, s
GAIN, INTEGRAL_GAIN = 3.0, 0.6  # 1/s, 1/s^2


def steer(routes: Routes, motion: Motion, vehicle: Vehicle) -> jax.Array:
    """Steering (cars,) in [-1, 1] that leads cars along their routes.

    Args:
        routes: (cars,).
        motion: (cars,).
        vehicle: parameters (cars,).
    """
    yaw = motion.pose_w[..., 2]
    rear = move_forward(motion.pose_w, -vehicle.centre_offset)[..., :2]
    along, _ = project(routes, rear)
    ahead = LOOKAHEAD + LOOKAHEAD_TIME * jnp.maximum(motion.speed, 0.0)
    target = rotate(point_at(routes, along + ahead) - rear, -yaw)
    reach = norm(target)
    curvature = 2.0 * target[..., 1] / (reach * reach)
    angle = jnp.arctan(vehicle.wheelbase * curvature)
    return jnp.clip(angle / vehicle.max_steering, -1.0, 1.0)


def control_speed(
    speed: jax.Array,
    target_speed: jax.Array,
    integral: jax.Array,
    vehicle: Vehicle,
    dt: float,
) -> tuple[jax.Array, jax.Array]:
    """Pedals (cars,) in [-1, 1] that bring cars to their target speeds.

    Args:
        speed: (cars,) [m/s].
        target_speed: (cars,) [m/s], not negative.
        integral: (cars,) of the speed's error so far [m].
        vehicle: parameters (cars,).
        dt: control step [s].

    Returns:
        The pedals, and the integrals after the step.
    """
    error = target_speed - speed
    summed = integral + error * dt
    wanted = GAIN * error + INTEGRAL_GAIN * summed
    most = jnp.where(wanted < 0.0, vehicle.max_deceleration, vehicle.max_acceleration)
    pedal = jnp.clip(wanted / most, -1.0, 1.0)
    summed = jnp.where(jnp.abs(wanted) > most, integral, summed)
    # No pedal holds a car that stands; against its motion it would reverse.
    holds = (target_speed < HOLD_SPEED) & (speed < HOLD_SPEED)
    return jnp.where(holds, 0.0, pedal), jnp.where(holds, 0.0, summed)
