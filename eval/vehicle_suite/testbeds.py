"""Testbeds: they drive runs on a tyre model and return the cars' tracks."""

import dataclasses
import functools
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from carpark_mj.physics.coordinates import (
    CarIndex,
    init_tyres,
    pack_coordinates,
    pack_tyres,
    unpack_coordinates,
    unpack_tyres,
)
from carpark_mj.physics.forces import roll
from carpark_mj.physics.newton_euler import advance, mass_properties
from carpark_mj.precision import full_float32
from carpark_mj.vehicle import Vehicle, make_vehicle
from carpark_mj.vehicle.contact_wheels import (
    TIMESTEP,
    add_contact_wheels,
    set_contact_options,
)
from carpark_mj.vehicle.drive import WheelTorques, ackermann
from carpark_mj.vehicle.mjcf import WHEELS, add_car
from carpark_mj.vehicle.parameters import GRAVITY, VehicleParameters
from carpark_mj.vehicle.vehicle import wheels_of
from vehicle_suite.formulas import front_wheel_angles
from vehicle_suite.track import INDEX, Run, Track, gravity_of

CHUNK = 100  # substeps of one call of the compiled program
# A locked axle is an integral servo on its wheels' difference in speed.
AXLE_GAIN = 40.0  # N m s/rad per substep; a wheel and its tyre yield about 1/200 of it
HOLD_LIMIT = 0.3  # g, the most that holding a speed may ask for
WIDTH = 16  # cars of one call; fewer are filled up


@dataclasses.dataclass(frozen=True)
class BrushTestbed:
    """The `mjx` back end with brush tyres, by default in substeps `dt` [s]."""

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
        starts = [np.stack(x) for x in zip(*(r.start() for r in cars), strict=True)]
        vehicles = jax.tree.map(lambda *x: jnp.stack(x), *map(vehicle_of, cars))
        locked = jnp.array([locked_wheels(run) for run in cars], dtype)
        tyres = jax.tree.map(
            lambda x: jnp.broadcast_to(x, (WIDTH, 4)), init_tyres(dtype)
        )
        qpos, qvel = (jnp.array(x, dtype) for x in starts)
        carry = qpos, qvel, tyres, jnp.zeros(WIDTH, dtype)
        rows = []
        for first in range(0, length, CHUNK):
            part = table[first : first + CHUNK]
            gravity = jnp.array(gravity_of(part[..., 5]), dtype)
            carry, seen = _program(self.x64)(
                carry, vehicles, locked, jnp.array(part, dtype), gravity, dtype.type(dt)
            )
            rows.append(jax.device_get(seen))
        seen = [np.concatenate(x).astype(float) for x in zip(*rows, strict=True)]
        tracks = []
        for i, run in enumerate(runs):
            qpos, qvel, load, torque = (x[: len(signals[i]), i] for x in seen)
            qpos, qvel = (
                np.vstack([starts[0][i], qpos]),
                np.vstack([starts[1][i], qvel]),
            )
            tracks.append(Track(run, dt, qpos, qvel, load, torque))
        return tracks


@functools.cache
def _program(x64: bool):
    """Compiles `CHUNK` substeps of `WIDTH` cars; call it with x64 switched to match."""
    del x64  # a key of the cache

    def substep(carry, vehicle: Vehicle, locked, signal, gravity, dt):
        qpos, qvel, tyres, couple = carry
        ctrl, drive, brake = controls(vehicle, signal, qpos, qvel)
        drive = drive + locked * couple
        at = unpack_coordinates(INDEX, qpos, qvel)
        torques = [WheelTorques(*pair) for pair in zip(drive, brake, strict=True)]
        wheels, bristles = wheels_of(vehicle), unpack_tyres(tyres)
        forces, bristles = roll(wheels, at, bristles, torques, dt)
        masses, tyres = mass_properties(vehicle), pack_tyres(bristles)
        at = advance(masses, at, forces, tuple(ctrl), tuple(gravity), dt)
        qpos, qvel = pack_coordinates(INDEX, at)
        apart = jnp.sum(locked * qvel[INDEX.spin_dof])
        couple = couple - AXLE_GAIN * apart
        seen = (qpos, qvel, jnp.stack(forces.load), drive)
        return (qpos, qvel, tyres, couple), seen

    batched = jax.vmap(substep, in_axes=(0, 0, 0, 0, 0, None))

    @jax.jit
    @full_float32
    def run(carry, vehicles, locked, signals, gravity, dt):
        def step(carry, row):
            signal, pull = row
            return batched(carry, vehicles, locked, signal, pull, dt)

        return jax.lax.scan(step, carry, (signals, gravity))

    return run


def controls(
    vehicle: Vehicle, signal: jax.Array, qpos: jax.Array, qvel: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Servo targets (2,) [rad], drive and brake torques (4,) [N m] of the test driver.

    `signal` (6,) is a row of `Run.signals`.
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
    front = jnp.stack(ackermann(vehicle, steering))
    return front, drive, brake * radius * vehicle.brake_share


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


def contact_model(
    params: VehicleParameters, dt: float, suspension: bool = False
) -> mujoco.MjModel:
    """The car with its steering servos on contact wheels and a plane."""
    spec = mujoco.MjSpec()
    set_contact_options(spec)
    spec.option.timestep = dt
    spec.worldbody.add_geom(
        name="ground", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1]
    )
    add_car(spec.worldbody, spec, params, prefix="", suspension=suspension)
    add_contact_wheels(spec, params, "", "ground", suspension)
    return spec.compile()


def rigid_joints(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Where the rigid car's `qpos` (13,) and `qvel` (12,) lie in a model's."""
    slides = model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE
    positions = np.delete(np.arange(model.nq), model.jnt_qposadr[slides])
    return positions, np.delete(np.arange(model.nv), model.jnt_dofadr[slides])


@dataclasses.dataclass(frozen=True)
class ContactTestbed:
    """Plain `mujoco.mj_step`.

    Drive torques are applied to the wheels, brakes are dry friction of the axles
    beside their rolling resistance. A track leaves the travel of a suspension out.
    """

    dt: float = TIMESTEP
    suspension: bool = False
    tyres: str = "contact"

    def drive(self, runs: Sequence[Run], dt: float | None = None) -> list[Track]:
        """Drives the runs, one after the other."""
        return [self._drive(run, dt or self.dt) for run in runs]

    def _drive(self, run: Run, dt: float) -> Track:
        params = run.params
        model = contact_model(params, dt, self.suspension)
        data, (positions, velocities) = mujoco.MjData(model), rigid_joints(model)
        data.qpos[positions], data.qvel[velocities] = run.start()
        spin = CarIndex(model).spin_dof
        rolling = model.dof_frictionloss[spin].copy()
        drive_share = np.repeat([params.front_drive, 1 - params.front_drive], 2) / 2
        brake_share = np.repeat([params.front_brake, 1 - params.front_brake], 2) / 2
        most = HOLD_LIMIT * GRAVITY * params.mass
        geoms = [model.geom(i).name.removeprefix("tyre_") for i in range(model.ngeom)]
        wheels = {
            i: WHEELS.index(name) for i, name in enumerate(geoms) if name in WHEELS
        }
        signals, torques = run.signals(dt), []
        qpos, qvel = [data.qpos[positions]], [data.qvel[velocities]]
        load, rotation, contact = np.zeros((len(signals), 4)), np.zeros(9), np.zeros(6)
        for i, (steering, force, brake, target, gain, tilt) in enumerate(signals):
            mujoco.mju_quat2Mat(rotation, data.qpos[3:7])
            hold = gain * (target - rotation[::3] @ data.qvel[:3])
            force = force + np.clip(hold, -most, most)
            torques.append(force * params.wheel_radius * drive_share)
            data.qfrc_applied[spin] = torques[-1]
            brakes = brake * params.wheel_radius * brake_share
            model.dof_frictionloss[spin] = rolling + brakes
            data.ctrl = front_wheel_angles(params, float(steering))
            model.opt.gravity = gravity_of(tilt)
            mujoco.mj_step(model, data)
            qpos.append(data.qpos[positions])
            qvel.append(data.qvel[velocities])
            for c in range(data.ncon):
                mujoco.mj_contactForce(model, data, c, contact)
                pressed = [
                    wheels[geom] for geom in data.contact[c].geom if geom in wheels
                ]
                load[i, pressed] += contact[0]
        motion = np.array(qpos), np.array(qvel), load, np.array(torques)
        return Track(run, dt, *motion)


Testbed = BrushTestbed | ContactTestbed
