"""The car's substep by `mjx.step`, for any model: the reference of the unrolled one."""

import contextlib
import io
import os

import jax
import jax.numpy as jnp
import mujoco

from carpark_mj.config import SimConfig
from carpark_mj.physics.base import run_substeps
from carpark_mj.physics.coordinates import (
    CarDynamics,
    CarIndex,
    centre_pose,
    unpack_coordinates,
)
from carpark_mj.physics.forces import substep_forces
from carpark_mj.physics.gravity import gravity_at
from carpark_mj.vehicle.vehicle import Vehicle

with contextlib.redirect_stdout(io.StringIO()):
    # It prints that NVIDIA Warp, which it does not need, is missing.
    from mujoco import mjx


class MjxStep:
    """The control step of cars of any leading shape, in MJX, on brush tyres."""

    def __init__(self, model: mujoco.MjModel, sim: SimConfig) -> None:
        """Takes the model of a car; `__call__` replaces per-car parameters.

        Raises:
            ValueError: under flags with which XLA cannot compile MJX.
        """
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
        self,
        model: mjx.Model,
        vehicle: Vehicle,
        controls: jax.Array,
        car: CarDynamics,
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
    """Checks that XLA on a CPU may compile MJX.

    Its scatters share their indices, and where XLA 0.10 fuses such into one loop it
    aborts the process: "Check failed: GetNumDims() == other.GetNumResults()".

    Raises:
        ValueError: the flags ask for such fusions.
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
    return model.tree_replace(
        {
            "body_mass": vehicle.body_mass,
            "body_inertia": vehicle.body_inertia,
            "body_ipos": vehicle.body_ipos,
            "body_pos": vehicle.body_pos,
        }
    )
