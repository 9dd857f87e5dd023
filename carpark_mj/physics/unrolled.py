"""The car's substep unrolled: the computation of `mjx.step` in a few kernels.

`mjx.step` handles any tree of bodies with small matrices, in some hundred kernels per
substep. `carpark_mj.physics.newton_euler` writes the same equations out for this car,
elementwise over the batch.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import mujoco
from jax.custom_batching import custom_vmap

from carpark_mj.config import SimConfig
from carpark_mj.geometry.se2 import with_gradient
from carpark_mj.physics.base import run_substeps
from carpark_mj.physics.coordinates import (
    Car,
    CarDynamics,
    CarIndex,
    centre_pose,
    pack_coordinates,
    pack_tyres,
    unpack_car,
    unpacked_centre_pose,
)
from carpark_mj.physics.forces import drive_car, gravity_at
from carpark_mj.physics.newton_euler import MassProperties, advance, mass_properties
from carpark_mj.vehicle.vehicle import Vehicle, Wheel, wheels_of

Tree = TypeVar("Tree")

_WARP = 32  # threads
BLOCK = 4 * _WARP  # elements, a warp for each scheduler of a multiprocessor
_AMPERE = 8.0  # compute capability, the oldest that Triton is made for


def on_cuda(
    run: Callable[..., Tree], otherwise: Callable[..., Tree], *args: Any
) -> Tree:
    """Runs `run` in programs for CUDA GPUs that Triton supports, else `otherwise`.

    Gradients are always those of `otherwise`. Shared leaves of `args` stay shared:
    loading the wheels' common parameters four times would be a fifth slower.
    """
    if not has_triton():
        return otherwise(*args)
    rows, restore = _share(args)

    def cuda(*rows: jax.Array) -> Tree:
        return run(*restore(rows))

    def default(*rows: jax.Array) -> Tree:
        return otherwise(*restore(rows))

    def either(*rows: jax.Array) -> Tree:
        return jax.lax.platform_dependent(*rows, cuda=cuda, default=default)

    return with_gradient(either, default)(*rows)


def _share(args: Any) -> tuple[list[jax.Array], Callable[[Sequence[jax.Array]], Any]]:
    """The distinct leaves of a tree, and a function that rebuilds the tree."""
    leaves, tree = jax.tree.flatten(args)
    unique = {id(leaf): leaf for leaf in leaves}  # wheels share their car's parameters
    row = {leaf: i for i, leaf in enumerate(unique)}
    places = [row[id(leaf)] for leaf in leaves]
    return list(unique.values()), lambda rows: jax.tree.unflatten(
        tree, [rows[place] for place in places]
    )


def run_in_kernel(
    function: Callable[[Any], Tree], args: Any, interpret: bool = False
) -> Tree:
    """Evaluates an elementwise function in one kernel, also under `jax.vmap`.

    It maps a tree of arrays of one shape to a tree of floats; it may loop, must not
    index, and has no gradients, see `on_cuda`. `interpret` runs it on any device,
    slowly, for tests.
    """
    shared, restore = _share(args)
    results, result_tree = jax.tree.flatten(jax.eval_shape(function, args))

    def of_rows(rows: list[jax.Array]) -> list[jax.Array]:
        return jax.tree.leaves(function(restore(rows)))

    @custom_vmap
    def call(*rows: jax.Array) -> list[jax.Array]:
        packed = jnp.stack([x.ravel() for x in rows])
        columns = _call_kernel(of_rows, packed, len(results), interpret)
        return [columns[:, i].reshape(rows[0].shape) for i in range(len(results))]

    @call.def_vmap
    def _(size: int, batched: Any, *rows: jax.Array) -> tuple[Any, Any]:
        rows = tuple(
            x if has else jnp.broadcast_to(x, (size, *x.shape))
            for x, has in zip(rows, batched, strict=True)
        )
        return call(*rows), [True] * len(results)

    return jax.tree.unflatten(result_tree, call(*shared))


def has_triton() -> bool:
    """Whether JAX computes on a CUDA GPU that Triton supports."""
    if jax.default_backend() != "gpu":
        return False
    capability = jax.devices()[0].compute_capability
    return capability[0].isdigit() and float(capability) >= _AMPERE  # "gfx..." is AMD's


def _call_kernel(
    function: Callable[[list[jax.Array]], list[jax.Array]],
    packed: jax.Array,
    num_results: int,
    interpret: bool,
) -> jax.Array:
    """Results (n, >= num_results) for arguments (k, n).

    One load and one store for all of them: Triton compiles for half a minute if each
    array has its own. Its sizes are powers of two.
    """
    from jax.experimental import pallas as pl  # slow to import
    from jax.experimental.pallas import triton

    k, n = packed.shape
    height, width = pl.next_power_of_2(k), pl.next_power_of_2(num_results)
    blocks = pl.cdiv(n, BLOCK)
    missing = ((0, height - k), (0, blocks * BLOCK - n))

    def kernel(arguments: Any, results: Any) -> None:
        rows = jax.lax.split(arguments[...], (1,) * height, axis=0)
        columns = function([x.reshape(BLOCK) for x in rows])
        columns += columns[:1] * (width - num_results)
        results[...] = _join(columns).reshape(BLOCK, width)

    return pl.pallas_call(
        kernel,
        grid=(blocks,),
        in_specs=[pl.BlockSpec((height, BLOCK), lambda i: (0, i))],
        out_specs=pl.BlockSpec((BLOCK, width), lambda i: (i, 0)),
        out_shape=jax.ShapeDtypeStruct((blocks * BLOCK, width), packed.dtype),
        compiler_params=triton.CompilerParams(num_warps=BLOCK // _WARP, num_stages=1),
        interpret=interpret,
        name="elementwise",
    )(jnp.pad(packed, missing, mode="edge"))[:n]


def _join(columns: list[jax.Array]) -> jax.Array:
    """Stacks along new axes of two, which is all that Triton can join."""
    if len(columns) == 1:
        return columns[0]
    return jnp.stack([_join(columns[0::2]), _join(columns[1::2])], -1)


class _Fixed(NamedTuple):
    """Constants of cars (...) over a control step, an array (...) each."""

    vehicle: Vehicle
    wheels: tuple[Wheel, ...]
    masses: MassProperties
    pedals: tuple[jax.Array, jax.Array]


class UnrolledStep:
    """The unrolled control step of cars of any leading shape."""

    def __init__(self, model: mujoco.MjModel, sim: SimConfig) -> None:
        """Takes the model of `mjcf.add_car` alone in its world."""
        self._index = CarIndex(model)
        self._sim = sim

    def __call__(
        self, vehicle: Vehicle, car: CarDynamics, controls: jax.Array
    ) -> tuple[CarDynamics, jax.Array]:
        """Cars (...) after a control step, and poses (..., num_traces, 3) within it.

        The grip of `vehicle` is that of the ground.
        """
        lead = controls.ndim - 1
        fixed = _Fixed(
            # Parameters of more dimensions are unpacked in `wheels` and `masses`.
            jax.tree.map(lambda x: x if x.ndim == lead else None, vehicle),
            wheels_of(vehicle),
            mass_properties(vehicle),
            (controls[..., 0], controls[..., 1]),
        )
        start = unpack_car(self._index, car)
        end, trace = on_cuda(self._run_kernel, self._run_loop, fixed, start)
        moved = pack_coordinates(self._index, end.coordinates)
        end = CarDynamics(*moved, pack_tyres(end.tyres), end.actuators)
        return end, jnp.moveaxis(trace, 0, -2)

    def _run_loop(self, fixed: _Fixed, car: Car) -> tuple[Car, jax.Array]:
        return run_substeps(
            self._sim,
            lambda car: self._substep(fixed, car),
            car,
            lambda car: centre_pose(car.coordinates, fixed.vehicle),
        )

    def _run_kernel(self, fixed: _Fixed, car: Car) -> tuple[Car, jax.Array]:
        """`_run_loop` in one kernel; of the poses carried, the oldest makes room."""
        num_traces = self._sim.num_traces
        stride = self._sim.num_substeps // num_traces

        def control_step(args: tuple[_Fixed, Car]) -> tuple[Car, Any]:
            fixed, car = args

            def stretch(_: int, carry: tuple[Car, Any]) -> tuple[Car, Any]:
                car, poses = carry
                car = jax.lax.fori_loop(
                    0, stride, lambda _, car: self._substep(fixed, car), car
                )
                pose = unpacked_centre_pose(car.coordinates, fixed.vehicle)
                return car, (*poses[1:], pose)

            poses = (car.coordinates.position,) * num_traces
            return jax.lax.fori_loop(0, num_traces, stretch, (car, poses))

        end, poses = run_in_kernel(control_step, (fixed, car))
        return end, jnp.stack([jnp.stack(pose, -1) for pose in poses])

    def _substep(self, fixed: _Fixed, car: Car) -> Car:
        dt = self._sim.sim_dt
        x = car.coordinates.position[0]  # of the centre of gravity, on a ramp
        if self._sim.has_ramp:
            x = x + car.coordinates.rotation[0][0] * fixed.masses.com[0]
        gravity = gravity_at(self._sim, x)
        forces, targets, tyres, actuators = drive_car(
            fixed.vehicle, fixed.wheels, car, fixed.pedals, dt
        )
        at = advance(fixed.masses, car.coordinates, forces, targets, gravity, dt)
        return Car(at, tyres, actuators)
