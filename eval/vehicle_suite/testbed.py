"""Test tracks: a `Testbed` drives runs and returns the cars' tracks.

The brush testbed steps MJX with the shipped tyres, all cars of a batch at once. Time
step, slope and car are data: one compiled program serves every run of a precision.
"""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Protocol

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.physics.car import apply_torques
from carpark_mj.physics.mjx import mjx  # pyright: ignore[reportAttributeAccessIssue]
from carpark_mj.physics.tyres import init_tyres
from carpark_mj.precision import full_float32
from carpark_mj.vehicle import COMPACT, Vehicle, make_vehicle
from carpark_mj.vehicle.drive import WheelTorques, ackermann
from carpark_mj.vehicle.mjcf import car_model
from carpark_mj.vehicle.parameters import GRAVITY
from vehicle_suite.runs import INDEX, Run, gravity_of
from vehicle_suite.tracks import Track

CHUNK = 100  # substeps of one call of the compiled program
# A locked axle is an integral servo on its wheels' difference in speed.
AXLE_GAIN = 40.0  # N m s/rad per substep; a wheel and its tyre yield about 1/200 of it
HOLD_LIMIT = 0.3  # g, the most that holding a speed may ask for
WIDTH = 16  # cars of one call; fewer are filled up


class Testbed(Protocol):
    """Drives runs: a tyre model on an engine."""

    @property
    def tyres(self) -> str:
        """Name of the tyre model."""
        ...

    @property
    def dt(self) -> float:
        """Substep [s] unless a manoeuvre asks for another."""
        ...

    def drive(self, runs: Sequence[Run], dt: float | None = None) -> list[Track]:
        """Drives the runs at a substep [s] (its own by default)."""
        ...


@dataclasses.dataclass(frozen=True)
class BrushTestbed:
    """MJX with brush tyres.

    Attributes:
        dt: substep [s] unless a manoeuvre asks for another.
        x64: compute in float64.
    """

    dt: float = 0.01
    x64: bool = False
    tyres: str = "brush"

    def drive(self, runs: Sequence[Run], dt: float | None = None) -> list[Track]:
        """Drives the runs, `WIDTH` at a time and the longest first."""
        step = dt or self.dt
        order = sorted(range(len(runs)), key=lambda i: -runs[i].duration)
        tracks: dict[int, Track] = {}
        with jax.enable_x64(self.x64):
            for first in range(0, len(order), WIDTH):
                group = order[first : first + WIDTH]
                driven = self._drive([runs[i] for i in group], step)
                tracks |= dict(zip(group, driven, strict=True))
        return [tracks[i] for i in range(len(runs))]

    def _drive(self, runs: list[Run], dt: float) -> list[Track]:
        cars = runs + [runs[-1]] * (WIDTH - len(runs))
        signals = [run.signals(dt) for run in cars]
        length = -(-max(map(len, signals)) // CHUNK) * CHUNK
        table = np.stack(
            [np.pad(s, ((0, length - len(s)), (0, 0)), mode="edge") for s in signals], 1
        )
        dtype = jnp.result_type(float)
        starts = [run.start() for run in cars]
        vehicles = jax.tree.map(lambda *x: jnp.stack(x), *map(vehicle_of, cars))
        locked = jnp.array([locked_wheels(run) for run in cars], dtype)
        tyres = jax.tree.map(
            lambda x: jnp.broadcast_to(x, (WIDTH, 4)), init_tyres(dtype)
        )
        carry = (
            jnp.array([s[0] for s in starts], dtype),
            jnp.array([s[1] for s in starts], dtype),
            tyres,
            jnp.zeros(WIDTH, dtype),
        )
        rows = []
        for first in range(0, length, CHUNK):
            part = table[first : first + CHUNK]
            gravity = jnp.array(gravity_of(part[..., 5]), dtype)
            carry, seen = _program(self.x64)(
                carry, vehicles, locked, jnp.array(part, dtype), gravity, dtype.type(dt)
            )
            rows.append(jax.device_get(seen))
        qpos, qvel, load, torque = (np.concatenate(x) for x in zip(*rows, strict=True))
        tracks = []
        for i, run in enumerate(runs):
            count = len(signals[i])
            tracks.append(
                Track(
                    run,
                    dt,
                    np.vstack([starts[i][0], qpos[:count, i]]).astype(float),
                    np.vstack([starts[i][1], qvel[:count, i]]).astype(float),
                    load[:count, i].astype(float),
                    torque[:count, i].astype(float),
                )
            )
        return tracks


@functools.cache
def _program(x64: bool):
    """Compiles `CHUNK` substeps of `WIDTH` cars, once for each precision.

    Arguments: carried state, cars, signs of locked wheels, signals (CHUNK, WIDTH, 6),
    gravity (CHUNK, WIDTH, 3), substep. Call it with x64 switched to match.
    """
    model = mjx.put_model(car_model(COMPACT, 0.01, (0.0, 0.0, -GRAVITY)))
    data = mjx.make_data(model)

    def substep(carry, vehicle: Vehicle, locked, signal, gravity, dt):
        qpos, qvel, tyres, couple = carry
        ctrl, drive, brake = controls(vehicle, signal, qpos, qvel)
        drive = drive + locked * couple
        qfrc, forces, tyres = apply_torques(
            INDEX, vehicle, qpos, qvel, tyres, WheelTorques(drive, brake), dt
        )
        car = model.tree_replace(
            {
                "body_mass": vehicle.body_mass,
                "body_inertia": vehicle.body_inertia,
                "body_ipos": vehicle.body_ipos,
                "body_pos": vehicle.body_pos,
                "opt.gravity": gravity,
                "opt.timestep": dt,
            }
        )
        after = mjx.step(
            car, data.replace(qpos=qpos, qvel=qvel, qfrc_applied=qfrc, ctrl=ctrl)
        )
        apart = jnp.sum(locked * after.qvel[INDEX.spin_dof])
        couple = couple - AXLE_GAIN * apart
        seen = (after.qpos, after.qvel, forces.force_w[:, 2], drive)
        return (after.qpos, after.qvel, tyres, couple), seen

    batched = jax.vmap(substep, in_axes=(0, 0, 0, 0, 0, None))

    @jax.jit
    @full_float32
    def advance(carry, vehicles, locked, signals, gravity, dt):
        def step(carry, row):
            signal, pull = row
            return batched(carry, vehicles, locked, signal, pull, dt)

        return jax.lax.scan(step, carry, (signals, gravity))

    return advance


def controls(
    vehicle: Vehicle, signal: jax.Array, qpos: jax.Array, qvel: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Servo targets (2,) [rad], drive and brake torques (4,) [N m] of the test driver.

    Args:
        vehicle: the car.
        signal: (6,) a row of `Run.signals`.
        qpos: (13,) positions.
        qvel: (12,) velocities.
    """
    steering, force, brake, target, gain, _ = signal
    w, x, y, z = qpos[3], qpos[4], qpos[5], qpos[6]
    forward = jnp.stack(
        [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)]
    )
    hold = gain * (target - forward @ qvel[:3])
    limit = HOLD_LIMIT * GRAVITY * vehicle.mass
    force = force + jnp.clip(hold, -limit, limit)
    radius = vehicle.wheel_radius
    drive = force * radius * vehicle.drive_share
    return ackermann(vehicle, steering), drive, brake * radius * vehicle.brake_share


def vehicle_of(run: Run) -> Vehicle:
    """The run's car with its factors on the cornering stiffness."""
    vehicle = make_vehicle(run.params)
    factors = jnp.repeat(jnp.array(run.stiffness), 2)
    stiffness = vehicle.tyres.lateral_stiffness * factors
    tyres = dataclasses.replace(vehicle.tyres, lateral_stiffness=stiffness)
    return dataclasses.replace(vehicle, tyres=tyres)


def locked_wheels(run: Run) -> list[float]:
    """(4,) signs of the couple between the wheels of a locked driven axle, else 0."""
    lock = float(run.locked_axle)
    front, rear = run.params.front_drive >= 0.5, run.params.front_drive < 0.5
    return [lock * front, -lock * front, lock * rear, -lock * rear]
