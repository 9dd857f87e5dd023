"""The car, its physics, the task and the environments of Pandita 2022.

The back end `highway` is the kinematic bicycle as highway-env's car integrates it. The
equations equal `bicycle`'s, but the axles stand at the bumpers, steering and
acceleration follow the action at once, forwards and backwards alike, and a substep is
explicit Euler: everything moves with the speed and heading at its start. Beyond a
speed limit the car slows down by as many m/s^2 as it is too fast in m/s. It uses the
footprint, `max_steering`, `max_acceleration` and the speed limits of a car's
parameters; the preset `highway` has highway-env 1.12's, `sim_dt` is 1 / 15 s.

Where the thesis and its program differ this is the program: the power of the norm is
0.5 (2 in the text), the goal is reached below 0.08 (0.09 and 0.10), the penalty of a
crash is added to the norm, and the steering angle is not observed. A timeout is no
terminal state here, though it was one there.
"""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp

from carpark_mj.config import (
    ENCODERS,
    PARKED_RULES,
    PHYSICS,
    REWARDS,
    EnvConfig,
    EpisodeConfig,
    ObservationConfig,
    ParkedRule,
    PhysicsConfig,
    SimConfig,
    SpawnConfig,
)
from carpark_mj.geometry import wrap_angle
from carpark_mj.observations import Field
from carpark_mj.observations.sensors import observed
from carpark_mj.physics.bicycle import BicyclePhysics, BicycleState, Carry, slip_angle
from carpark_mj.registry import ENVIRONMENTS
from carpark_mj.tasks.goal_pose import FEATURES, car_features, goal_features, near
from carpark_mj.types import Motion, State
from carpark_mj.vehicle import COMPACT, register_vehicle
from carpark_mj.vehicle.parameters import kerb_to_kerb
from carpark_mj.vehicle.vehicle import Vehicle


@dataclasses.dataclass(frozen=True)
class HighwayConfig(PhysicsConfig):
    """highway-env's car, without lag and with a road's speed limits."""

    back_end: str = "highway"
    actuated = False
    randomized = False
    keeps_ranges = False

    def make(self, config: EnvConfig, layout: Any, vehicle: Any) -> Any:
        """Builds it; it has no ground but a plane."""
        del layout, vehicle
        return HighwayPhysics(config.sim)

    def largest_turn(self, vehicle: Any, ctrl_dt: float) -> Any:
        """From lock to lock."""
        del ctrl_dt
        return 2.0 * vehicle.max_steering


PHYSICS.register("highway", HighwayConfig())


class HighwayPhysics(BicyclePhysics):
    """highway-env's car behind the `Physics` interface."""

    config = PHYSICS["highway"]

    def read(self, state: BicycleState) -> Motion:
        """The motion; velocities leave the slip angle out, as in highway-env."""
        speed, vehicle = state.speed, state.vehicle
        return dataclasses.replace(
            super().read(state),
            velocity_b=jnp.stack([speed, jnp.zeros_like(speed)], axis=-1),
            yaw_rate=_yaw_rate(vehicle, speed, state.actuators.steering),
        )

    def ahead(self, vehicle: Vehicle) -> jax.Array:
        """None: the footprint's centre is the middle between the axles."""
        return jnp.zeros_like(vehicle.wheelbase)

    def substep(self, vehicle: Vehicle, controls: jax.Array, carry: Carry) -> Carry:
        """Cars (...) after a substep; see `BicyclePhysics.substep`."""
        dt, (steer, pedal) = self.sim.sim_dt, jnp.unstack(controls, axis=-1)
        pose, speed, actuators = carry
        steering = steer * vehicle.max_steering
        course = pose[..., 2] + slip_angle(steering)
        x = pose[..., 0] + speed * jnp.cos(course) * dt
        y = pose[..., 1] + speed * jnp.sin(course) * dt
        yaw = wrap_angle(pose[..., 2] + _yaw_rate(vehicle, speed, steering) * dt)
        pose = jnp.stack([x, y, yaw], axis=-1)
        wanted = pedal * vehicle.max_acceleration
        headroom = vehicle.max_speed - speed
        back = -vehicle.max_reverse_speed - speed
        wanted = jnp.where(headroom < 0.0, jnp.minimum(wanted, headroom), wanted)
        wanted = jnp.where(back > 0.0, jnp.maximum(wanted, back), wanted)
        actuators = dataclasses.replace(actuators, steering=steering)
        return pose, speed + wanted * dt, actuators


def _yaw_rate(vehicle: Vehicle, speed: jax.Array, steering: jax.Array) -> jax.Array:
    """Yaw rates (...) [rad/s]."""
    return speed * jnp.sin(slip_angle(steering)) / (vehicle.size[..., 0] / 2)


register_vehicle(
    "highway",
    dataclasses.replace(
        COMPACT,
        length=5.0,
        width=2.0,
        rear_overhang=(5.0 - COMPACT.wheelbase) / 2,
        turning_circle=kerb_to_kerb(
            COMPACT.wheelbase, COMPACT.track_width, COMPACT.tyre_width, math.pi / 4
        ),
        max_acceleration=5.0,
        max_deceleration=5.0,
        max_speed=40.0,
        max_reverse_speed=40.0,
        steering_rate=1000.0,  # at once
    ),
)


GOAL_FEATURES = tuple(
    dataclasses.replace(field, name=f"goal_{field.name}", reveals_goal=True)
    for field in FEATURES
)


@dataclasses.dataclass(frozen=True)
class PanditaObservation(ObservationConfig):
    """Features of the own car and of its goal."""

    encoding: str = "pandita"

    def fields(self, env: EnvConfig) -> Sequence[Field]:
        """See `ObservationConfig.fields`."""
        del env
        return FEATURES + GOAL_FEATURES

    def values(self, env: EnvConfig, state: State) -> dict[str, jax.Array]:
        """See `ObservationConfig.values`."""
        del env
        seen = car_features(observed(state)), goal_features(state)
        parts = [part for six in seen for part in jnp.split(six, 3, axis=-1)]
        names = (field.name for field in FEATURES + GOAL_FEATURES)
        return dict(zip(names, parts, strict=True))


ENCODERS.register("pandita", PanditaObservation)
REWARD = REWARDS.register("pandita", dataclasses.replace(REWARDS["pose"], crash=4.0))
# A goal reached in the last step is a timeout.
PARKED_RULES.register("pandita", ParkedRule(test=near(0.08), before_timeout=False))


# Pandita 2022: highway-env's car in a lot where all other slots are taken; 150 steps at
# 5 Hz.
PANDITA = EnvConfig(
    layout="slots",
    vehicle="highway",
    num_agents=1,
    num_parked_cars=11,
    physics="highway",
    sim=SimConfig(sim_dt=1 / 15, trace_dt=1 / 15),
    spawn=SpawnConfig(close_ratio=0.0),
    episode=EpisodeConfig(parked_rule="pandita", max_steps=150),
    reward=REWARD,
    observation=PanditaObservation(),
)
# With physical cars.
SLOTS = dataclasses.replace(PANDITA, vehicle="compact", physics="mjx", sim=SimConfig())

ENVIRONMENTS.register("pandita", PANDITA)
ENVIRONMENTS.register("slots", SLOTS)
