"""Control steps by `mjx.step`: the reference of the unrolled one, and contact wheels.

The wheels of `carpark_mj.vehicle.contact_wheels` run under the same driver as brush
tyres, for cross-checks: drive torques through open differentials, brakes and rolling
resistance as dry friction of the axles, changed while it runs. They have no bristles:
`CarState.tyres` stays zero. `SimConfig.suspension` puts the car on springs.
"""

import contextlib
import io
import os

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from carpark_mj.config import SimConfig
from carpark_mj.physics.base import run_substeps
from carpark_mj.physics.coordinates import (
    CarDynamics,
    CarIndex,
    centre_pose,
    column,
    dot,
    unpack_coordinates,
)
from carpark_mj.physics.forces import gravity_at, gravity_vector, substep_forces
from carpark_mj.physics.mjx import MjxPhysics, Stepper
from carpark_mj.vehicle import drive
from carpark_mj.vehicle.contact_wheels import add_contact_wheels, set_contact_options
from carpark_mj.vehicle.mjcf import STEERED, WHEELS, add_car, spring_reference
from carpark_mj.vehicle.parameters import VehicleParameters
from carpark_mj.vehicle.presets import COMPACT
from carpark_mj.vehicle.vehicle import BODIES, Vehicle

with contextlib.redirect_stdout(io.StringIO()):
    # It prints that NVIDIA Warp, which it does not need, is missing.
    from mujoco import mjx


class MjxStep:
    """The control step of cars of any leading shape, in MJX, on brush tyres."""

    def __init__(self, model: mujoco.MjModel, sim: SimConfig) -> None:
        """Takes the model of a car; `__call__` replaces per-car parameters."""
        _require_plain_fusion()
        self.index = CarIndex(model)
        self.sim = sim
        self.model = mjx.put_model(model)
        self._data = mjx.make_data(model)

    def __call__(
        self, vehicle: Vehicle, car: CarDynamics, controls: jax.Array
    ) -> tuple[CarDynamics, jax.Array]:
        """Advances cars (...) by one control step; see `UnrolledStep`."""
        function = self._step
        for _ in range(controls.ndim - 1):
            function = jax.vmap(function)
        return function(vehicle, car, controls)

    def _step(
        self, vehicle: Vehicle, car: CarDynamics, controls: jax.Array
    ) -> tuple[CarDynamics, jax.Array]:
        model = with_masses(self.model, vehicle)

        def substep(car: CarDynamics) -> CarDynamics:
            return self.substep(model, vehicle, controls, car)

        def pose(car: CarDynamics) -> jax.Array:
            at = unpack_coordinates(self.index, car.qpos, car.qvel)
            return centre_pose(at, vehicle)

        return run_substeps(self.sim, substep, car, pose)

    def substep(
        self, model: mjx.Model, vehicle: Vehicle, controls: jax.Array, car: CarDynamics
    ) -> CarDynamics:
        """Advances one car by one substep."""
        qfrc, ctrl, tyres, actuators = substep_forces(
            self.index, vehicle, car, controls, self.sim.sim_dt
        )
        model = self.on_ramp(model, vehicle, car)
        return self.integrate(model, car, qfrc, ctrl)._replace(
            tyres=tyres, actuators=actuators
        )

    def on_ramp(
        self, model: mjx.Model, vehicle: Vehicle, car: CarDynamics
    ) -> mjx.Model:
        """The model with the gravity at one car's centre of gravity."""
        if not self.sim.has_ramp:
            return model
        at = unpack_coordinates(self.index, car.qpos, car.qvel)
        x = at.position[0] + at.rotation[0][0] * vehicle.cg[0]
        gravity = jnp.stack(gravity_at(self.sim, x))
        return model.tree_replace({"opt.gravity": gravity})

    def integrate(
        self, model: mjx.Model, car: CarDynamics, qfrc: jax.Array, ctrl: jax.Array
    ) -> CarDynamics:
        """One `mjx.step` with the forces applied (nv,) and the servo targets (2,)."""
        data = self._data.replace(
            qpos=car.qpos, qvel=car.qvel, qfrc_applied=qfrc, ctrl=ctrl
        )
        data = mjx.step(model, data)
        return car._replace(qpos=data.qpos, qvel=data.qvel)


def _require_plain_fusion() -> None:
    """Refuses flags under which XLA 0.10 aborts the process on a CPU.

    MJX's scatters share their indices; where XLA fuses such into one loop: "Check
    failed: GetNumDims() == other.GetNumResults()".
    """
    fused = "xla_cpu_use_multi_output_fusion" in os.environ.get("XLA_FLAGS", "")
    if fused and jax.default_backend() == "cpu":
        raise ValueError(
            "mjx.step, and with it contact tyres, cannot be compiled with XLA's "
            "multi-output fusion: set the environment variable XLA_FLAGS to '' "
            f"instead of {os.environ['XLA_FLAGS']!r}"
        )


def with_masses(model: mjx.Model, vehicle: Vehicle) -> mjx.Model:
    """The model with one vehicle's masses and wheel places."""
    return model.tree_replace({name: getattr(vehicle, name) for name in BODIES})


IMPRATIO = 1.0
ITERATIONS, LS_ITERATIONS = 20, 50
TOLERANCE = 1e-8  # float32 has no use for less


def contact_car_model(params: VehicleParameters, sim: SimConfig) -> mujoco.MjModel:
    """Compiles the car with its steering servos on contact wheels and a plane."""
    spec = mujoco.MjSpec()
    set_contact_options(spec)
    spec.option.timestep = sim.sim_dt
    spec.option.gravity = gravity_vector(sim)
    spec.option.impratio = IMPRATIO
    spec.option.iterations, spec.option.ls_iterations = ITERATIONS, LS_ITERATIONS
    spec.option.tolerance = TOLERANCE
    spec.worldbody.add_geom(
        name="ground",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0.0, 0.0, 1.0],
        contype=0,
        conaffinity=0,
    )
    add_car(spec.worldbody, spec, params, prefix="", suspension=sim.suspension)
    add_contact_wheels(spec, params, "", "ground", sim.suspension)
    return spec.compile()


def axle_friction(vehicle: Vehicle, brake: jax.Array) -> jax.Array:
    """Dry friction (4,) [N m] of the wheels for brake torques (4,) [N m]."""
    rolling = vehicle.tyres.rolling_resistance * vehicle.tyres.static_load
    return brake + rolling * vehicle.wheel_radius


class WheelIndex:
    """Addresses of a car's tyres, unsprung bodies and springs, looked up once."""

    def __init__(self, model: mujoco.MjModel) -> None:
        """Looks them up by name; `travel` is empty without a suspension."""
        self.tyres = np.array([model.geom(f"tyre_{wheel}").id for wheel in WHEELS])
        self.bodies = np.array([model.body(f"wheel_{wheel}").id for wheel in WHEELS])
        self.knuckles = np.array([model.body(f"knuckle_{w}").id for w in STEERED])
        slides = model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE
        self.travel = np.flatnonzero(slides)  # in the order of `WHEELS`
        self.travel_qpos = model.jnt_qposadr[slides]
        self.travel_dof = model.jnt_dofadr[slides]


def with_wheels(
    model: mjx.Model,
    index: CarIndex,
    wheels: WheelIndex,
    vehicle: Vehicle,
    brake: jax.Array,
) -> mjx.Model:
    """The model with one vehicle's tyres, springs and brake torques (4,) [N m]."""
    loss = model.dof_frictionloss.at[index.spin_dof].set(axle_friction(vehicle, brake))
    grip = model.pair_friction.at[:, :2].set(vehicle.tyres.friction)
    size = model.geom_size.at[wheels.tyres, 0].set(vehicle.wheel_radius)
    change = {"dof_frictionloss": loss, "pair_friction": grip, "geom_size": size}
    if wheels.travel.size:
        stiffness = vehicle.tyres.vertical_stiffness
        damping = vehicle.tyres.vertical_damping
        unsprung = vehicle.body_mass[wheels.bodies]
        unsprung = unsprung.at[:2].add(vehicle.body_mass[wheels.knuckles])
        rest = spring_reference(vehicle.tyres.static_load, unsprung, stiffness)
        change |= {
            "jnt_stiffness": model.jnt_stiffness.at[wheels.travel].set(stiffness),
            "dof_damping": model.dof_damping.at[wheels.travel_dof].set(damping),
            "qpos_spring": model.qpos_spring.at[wheels.travel_qpos].set(rest),
        }
    return model.tree_replace(change)


class ContactStep(MjxStep):
    """The control step of cars on contact wheels."""

    def __init__(self, model: mujoco.MjModel, sim: SimConfig) -> None:
        """Takes the model of a car on contact wheels."""
        super().__init__(model, sim)
        self._wheels = WheelIndex(model)

    def substep(
        self, model: mjx.Model, vehicle: Vehicle, controls: jax.Array, car: CarDynamics
    ) -> CarDynamics:
        """Advances one car by one substep."""
        index = self.index
        at = unpack_coordinates(index, car.qpos, car.qvel)
        spin = jnp.stack(at.spin)
        actuators, ctrl, brake = drive.actuate(
            vehicle,
            car.actuators,
            (controls[0], controls[1]),
            dot(column(at.rotation, 0), at.velocity),
            vehicle.wheel_radius * jnp.sum(spin * vehicle.drive_share),
            self.sim.sim_dt,
        )
        model = with_wheels(
            model, index, self._wheels, vehicle, brake * vehicle.brake_share
        )
        torque = actuators.drive * vehicle.drive_share
        qfrc = jnp.zeros_like(car.qvel).at[index.spin_dof].set(torque)
        model = self.on_ramp(model, vehicle, car)
        car = self.integrate(model, car, qfrc, jnp.stack(ctrl))
        return car._replace(actuators=actuators)


class ContactPhysics(MjxPhysics):
    """MJX with contact wheels behind the `Physics` interface."""

    def _compile(self, sim: SimConfig) -> tuple[mujoco.MjModel, Stepper]:
        return contact_car_model(COMPACT, sim), ContactStep
