"""The unrolled step against `mjx.step`, in one kernel on GPUs, and its gradients."""

from functools import partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from helpers.compiling import text_for

from carpark_mj.config import RandomizationConfig, SimConfig
from carpark_mj.physics import unrolled
from carpark_mj.physics.bicycle import BicyclePhysics
from carpark_mj.physics.coordinates import (
    CarDynamics,
    CarIndex,
    init_tyres,
    pack_coordinates,
    unpack_coordinates,
)
from carpark_mj.physics.forces import CarForces, generalized_forces
from carpark_mj.physics.mjx import MjxPhysics
from carpark_mj.physics.mjx_step import ContactPhysics, MjxStep, with_masses
from carpark_mj.physics.newton_euler import advance, mass_properties
from carpark_mj.physics.unrolled import BLOCK, UnrolledStep, run_in_kernel
from carpark_mj.spawning.fleet import randomize, randomize_all
from carpark_mj.vehicle import COMPACT, PRESETS, make_vehicle
from carpark_mj.vehicle.drive import init_actuators
from carpark_mj.vehicle.mjcf import car_model
from vehicle_suite.shipped import drive

VARIED = RandomizationConfig(
    mass=(0.75, 1.25),
    cg_x=(0.9, 1.1),
    cg_height=(0.8, 1.2),
    friction=(0.6, 1.1),
    tyre_stiffness=(0.7, 1.3),
    steering_offset=(-0.03, 0.03),
    steering_lag=(0.0, 0.3),
)


def driven(stepper: str, x64: bool, **ground) -> np.ndarray:
    """Five seconds of random driving of all presets, as they are and randomized.

    Returns:
        (25, 12, 25) `qpos` and `qvel` after every control step.
    """
    with jax.enable_x64(x64):
        cars = [make_vehicle(params) for params in PRESETS.values()]
        fleet = jax.tree.map(lambda *x: jnp.stack(x), *cars)
        varied = randomize_all(VARIED, fleet, jax.random.key(0))
        fleet = jax.tree.map(lambda *x: jnp.concatenate(x), fleet, varied)
        rng, count = np.random.default_rng(0), 2 * len(cars)
        poses = rng.normal(size=(count, 3))
        controls = rng.uniform(-1, 1, (25, count, 2))
        sim = SimConfig(stepper=stepper, **ground)
        _, qpos, qvel = drive(sim, fleet, controls, pose=poses)
        return np.concatenate([qpos, qvel], -1)


@pytest.mark.parametrize(
    ("x64", "tolerance", "ground"),
    [
        # Metres, radians and their rates on paths of 2 m; wheels turn by 7 rad.
        # Measured 3e-6 and 6e-13.
        pytest.param(False, 3e-5, {}, id="float32-dry"),
        pytest.param(
            True,
            1e-11,
            {"surface": "ice", "grade_x": 0.1, "ramp": (-0.5, 0.5, 0.05)},
            id="float64-ice-slope-ramp",
        ),
    ],
)
def test_five_seconds_of_driving_agree_with_mjx(x64, tolerance, ground):
    ours, expected = (driven(name, x64, **ground) for name in ("unrolled", "mjx"))
    assert np.abs(expected[-1, :, :2] - expected[0, :, :2]).max() > 0.5  # they moved
    assert np.abs(ours - expected).max() < tolerance


def tumbling(rng: np.random.Generator, index: CarIndex):
    """A car's `qpos` (13,), `qvel` (12,) and forces; its servos hardly turn."""
    qpos, qvel = rng.normal(size=13), rng.normal(0, 3, 12)
    qpos[3:7] /= np.linalg.norm(qpos[3:7])
    qpos[index.steer_qpos] = rng.uniform(-0.6, 0.6, 2)
    qvel[index.steer_dof] = rng.uniform(-0.5, 0.5, 2)
    qvel[index.spin_dof] = rng.uniform(-60, 60, 4)
    sizes = {"force_w": (2e4, 3), "moment_b": (1e4, 3), "aligning": (200, 4)}
    sizes |= {"spin": (800, 4), "load": (1, 4)}
    drawn = {k: tuple(map(jnp.array, rng.normal(0, *n))) for k, n in sizes.items()}
    return qpos, qvel, CarForces(**drawn)


def test_one_substep_of_a_tumbling_car_is_that_of_mujoco():
    """Of randomized cars in C; at a servo's limit MJX stays implicit in its damping."""
    dt, gravity, rng = 0.01, (0.7, -1.1, -9.6), np.random.default_rng(3)
    model = car_model(COMPACT, dt, gravity)
    index, data = CarIndex(model), mujoco.MjData(model)
    with jax.enable_x64(True):
        nominal, step = make_vehicle(COMPACT), MjxStep(model, SimConfig())
        judge = jax.jit(partial(step.integrate, with_masses(step.model, nominal)))

        @jax.jit
        def ours(vehicle, qpos, qvel, forces, targets):
            at, masses = unpack_coordinates(index, qpos, qvel), mass_properties(vehicle)
            after = advance(masses, at, forces, tuple(targets), gravity, dt)
            return pack_coordinates(index, after)

        for trial in range(20):
            vehicle = randomize(VARIED, nominal, jax.random.key(trial))
            qpos, qvel, forces = tumbling(rng, index)
            targets = qpos[index.steer_qpos] + rng.uniform(-0.015, 0.015, 2)
            for name in ("body_mass", "body_inertia", "body_ipos", "body_pos"):
                getattr(model, name)[:] = getattr(vehicle, name)
            data.qpos[:], data.qvel[:], data.ctrl[:] = qpos, qvel, targets
            data.qfrc_applied[:] = generalized_forces(index, forces)
            mujoco.mj_step(model, data)
            found = ours(vehicle, qpos, qvel, forces, targets)
            # Velocities up to 88; measured 9e-13.
            assert found[0] == pytest.approx(data.qpos, abs=1e-11)
            assert found[1] == pytest.approx(data.qvel, abs=1e-11)
        rest = init_tyres(), init_actuators(nominal)
        qpos, qvel, forces = tumbling(rng, index)
        car = CarDynamics(jnp.array(qpos), jnp.array(qvel), *rest)
        for asked in ((1.5, -1.5), (-1.5, 1.5)):  # asks for 40 times the limit
            targets = jnp.array(asked)
            found = ours(nominal, qpos, qvel, forces, targets)
            expected = judge(car, generalized_forces(index, forces), targets)
            for x, y in zip(found, expected[:2], strict=True):
                assert x == pytest.approx(np.asarray(y), abs=1e-11)


def test_brush_tyres_are_stepped_unrolled_by_default():
    steps = {"auto": UnrolledStep, "unrolled": UnrolledStep, "mjx": MjxStep}
    for stepper, kind in steps.items():
        assert isinstance(MjxPhysics(SimConfig(stepper=stepper))._step, kind)
    contact = SimConfig(sim_dt=0.004, tyres="contact")
    assert isinstance(ContactPhysics(contact)._step, MjxStep)


# One kernel


AGENTS = 7


def powers(args):
    """Iterates x, y = a x + b y, 2 y + x for ten times."""
    (a, b), start = args
    return jax.lax.fori_loop(
        0,
        10,
        lambda _, v: {"x": a * v["x"] + b * v["y"], "y": 2 * v["y"] + v["x"]},
        start,
    )


def interpreted(function, args):
    return run_in_kernel(function, args, interpret=True)


def moving_cars(lots: int):
    """Cars (lots, AGENTS) of all presets after a control step from rest."""
    cars = [make_vehicle(params) for params in PRESETS.values()]
    fleet = jax.tree.map(lambda *x: jnp.stack(x), *cars)
    which = np.arange(lots * AGENTS).reshape(lots, AGENTS) % len(cars)
    rng = np.random.default_rng(0)
    physics = MjxPhysics(SimConfig())
    poses = jnp.array(rng.normal(size=(lots, AGENTS, 3)), jnp.float32)
    state = physics.init(poses, jax.tree.map(lambda x: x[which], fleet))
    controls = jnp.array(rng.uniform(-1, 1, (2, lots, AGENTS, 2)), jnp.float32)
    return physics, jax.jit(physics.step)(state, controls[0]), controls[1]


@pytest.mark.parametrize("shape", [(), (5,), (BLOCK,), (3, BLOCK + 1)])
def test_a_kernel_gives_what_its_function_gives(shape):
    a, b, x = np.random.default_rng(0).uniform(-1, 1, (3, *shape)).astype(np.float32)
    args = (a, b), {"x": x, "y": x}
    ours, expected = interpreted(powers, args), powers(args)
    jax.tree.map(lambda u, v: np.testing.assert_allclose(u, v, 1e-5), ours, expected)


def test_vmapped_kernels_are_one_with_every_element():
    a, x = np.random.default_rng(0).uniform(-1, 1, (2, 3, 5)).astype(np.float32)
    b = np.float32(0.5)  # the same for all

    def call(run):
        def one(a, x):
            return run(powers, ((a, b), {"x": x, "y": a}))

        return jax.vmap(jax.vmap(one), in_axes=(0, 1))(a, x.T)

    ours, expected = call(interpreted), call(lambda function, args: function(args))
    jax.tree.map(lambda u, v: np.testing.assert_allclose(u, v, 1e-5), ours, expected)
    program = jax.make_jaxpr(lambda: call(interpreted))()
    assert str(program).count("pallas_call[") == 1


def test_cars_move_in_the_kernel_as_outside(monkeypatch):
    physics, state, controls = moving_cars(lots=5)
    expected = jax.jit(jax.vmap(physics.step))(state, controls)
    monkeypatch.setattr(unrolled, "on_cuda", lambda run, _, *args: run(*args))
    monkeypatch.setattr(unrolled, "run_in_kernel", interpreted)
    ours = jax.jit(jax.vmap(physics.step))(state, controls)
    moved = np.abs(expected.trace_w[..., -1, :2] - state.trace_w[..., -1, :2])
    assert moved.max() > 0.05
    for name in ("qpos", "qvel", "trace_w"):
        a, b = getattr(ours, name), getattr(expected, name)
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-5, err_msg=name)
    assert ours.finite.all()


def test_a_cuda_program_is_one_kernel_without_loops(monkeypatch):
    physics, state, controls = moving_cars(lots=2)
    monkeypatch.setattr(unrolled, "has_triton", lambda: True)
    for platform, kernels in (("cuda", 1), ("cpu", 0)):
        text = text_for(platform, jax.vmap(physics.step), state, controls)
        assert text.count("triton") == kernels
        assert ("stablehlo.while" in text) == (not kernels)


@pytest.mark.parametrize("wrap", [jax.jit, lambda f: jax.jit(jax.vmap(f))])
def test_what_arguments_share_is_handed_to_the_kernel_once(monkeypatch, wrap):
    monkeypatch.setattr(unrolled, "has_triton", lambda: True)
    seen = []

    def on_gpu(args):
        seen.append(len({id(leaf) for leaf in jax.tree.leaves(args)}))
        return sum(jax.tree.leaves(args))

    def elsewhere(args):
        return sum(jax.tree.leaves(args))

    def four_times(x, y):
        return unrolled.on_cuda(on_gpu, elsewhere, {"wheels": [x] * 4, "car": y})

    x, y = jnp.arange(3.0), jnp.ones(3)
    assert wrap(four_times)(x, y).tolist() == (4 * x + y).tolist()
    assert seen
    assert set(seen) == {2}


# Gradients


PROBE = 1e-5  # of the controls
CONTROLS = np.array([[0.3, 0.6], [-0.2, 0.5]])  # 0.4 s, pulling away


@pytest.mark.parametrize(
    "physics", [BicyclePhysics, pytest.param(MjxPhysics, marks=pytest.mark.slow)]
)
def test_gradients_of_the_final_pose_are_central_differences(physics, compact):
    with jax.enable_x64(True):
        cars = physics(SimConfig())
        vehicle = jax.tree.map(lambda x: jnp.asarray(x, jnp.float64), compact)
        start = cars.init(jnp.array([1.0, 2.0, 0.5]), vehicle)

        @jax.jit
        def end(controls):
            def step(state, control):
                return cars.step(state, control), None

            pose = cars.read(jax.lax.scan(step, start, controls)[0]).pose_w
            return jnp.dot(pose, jnp.array([1.0, 2.0, 3.0]))

        found = jax.jit(jax.grad(end))(jnp.array(CONTROLS))
        for entry in np.ndindex(CONTROLS.shape):
            step = np.zeros_like(CONTROLS)
            step[entry] = PROBE
            gained = end(CONTROLS + step) - end(CONTROLS - step)
            assert found[entry] == pytest.approx(float(gained) / (2 * PROBE), abs=1e-8)
        assert abs(found[0, 1]) > 0.1  # m for the whole pedal


def test_the_kernel_for_gpus_has_the_gradient_of_the_loop(monkeypatch, compact):
    monkeypatch.setattr(unrolled, "has_triton", lambda: True)
    cars = MjxPhysics(SimConfig())
    start = cars.init(jnp.zeros(3), compact)

    def end(controls):
        return cars.step(start, controls).trace_w.sum()

    traced = jax.jit(jax.grad(end)).trace(jnp.zeros(2))
    assert "triton" not in traced.lower(lowering_platforms=("cuda",)).as_text()
