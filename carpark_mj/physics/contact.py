"""MJX with contact wheels: the cross-check of the brush tyres.

The wheels of `carpark_mj.vehicle.contact_wheels` under the same driver as `mjx`: drive
torques through open differentials, brakes and rolling resistance as dry friction of
the axles, changed while it runs. They have no bristles: `CarState.tyres` stays zero.
`SimConfig.suspension` puts the car on springs.

Solver settings for locked wheels in MJX; with fewer iterations the car jumps:
elliptic cone, impratio 1, 20 Newton iterations with 50 line-search steps, substeps of
at most 4 ms. The ground is a plane; a slope is tilted gravity.
"""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from carpark_mj.config import SimConfig
from carpark_mj.physics.coordinates import CarDynamics, CarIndex, unpack_coordinates
from carpark_mj.physics.gravity import gravity_vector
from carpark_mj.physics.mjx import MjxPhysics, Stepper
from carpark_mj.physics.mjx_step import MjxStep, mjx  # pyright: ignore[reportAttributeAccessIssue]
from carpark_mj.physics.vectors import column, dot
from carpark_mj.vehicle import drive
from carpark_mj.vehicle.contact_wheels import add_contact_wheels, set_contact_options
from carpark_mj.vehicle.mjcf import STEERED, WHEELS, add_car
from carpark_mj.vehicle.parameters import VehicleParameters
from carpark_mj.vehicle.presets import COMPACT
from carpark_mj.vehicle.suspension import spring_reference
from carpark_mj.vehicle.vehicle import Vehicle

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
        stiffness, damping = (
            vehicle.tyres.vertical_stiffness,
            vehicle.tyres.vertical_damping,
        )
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
        self,
        model: mjx.Model,
        vehicle: Vehicle,
        controls: jax.Array,
        car: CarDynamics,
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

    def _compile(self, sim: SimConfig) -> mujoco.MjModel:
        return contact_car_model(COMPACT, sim)

    def _make_stepper(self, model: mujoco.MjModel, sim: SimConfig) -> Stepper:
        return ContactStep(model, sim)
