"""Elementwise functions in one kernel against the same functions outside."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from carpark_mj.config import SimConfig
from carpark_mj.physics import unrolled
from carpark_mj.physics import unrolled as kernel
from carpark_mj.physics.mjx import MjxPhysics
from carpark_mj.physics.unrolled import run_in_kernel
from carpark_mj.vehicle import PRESETS, make_vehicle

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


@pytest.mark.parametrize("shape", [(), (5,), (kernel.BLOCK,), (3, kernel.BLOCK + 1)])
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
    monkeypatch.setattr(kernel, "has_triton", lambda: True)
    traced = jax.jit(jax.vmap(physics.step)).trace(state, controls)
    for platform, kernels in (("cuda", 1), ("cpu", 0)):
        text = traced.lower(lowering_platforms=(platform,)).as_text()
        assert text.count("triton") == kernels
        assert ("stablehlo.while" in text) == (not kernels)


@pytest.mark.parametrize("wrap", [jax.jit, lambda f: jax.jit(jax.vmap(f))])
def test_what_arguments_share_is_handed_to_the_kernel_once(monkeypatch, wrap):
    monkeypatch.setattr(kernel, "has_triton", lambda: True)
    seen = []

    def on_gpu(args):
        seen.append(len({id(leaf) for leaf in jax.tree.leaves(args)}))
        return sum(jax.tree.leaves(args))

    def elsewhere(args):
        return sum(jax.tree.leaves(args))

    def four_times(x, y):
        return kernel.on_cuda(on_gpu, elsewhere, {"wheels": [x] * 4, "car": y})

    x, y = jnp.arange(3.0), jnp.ones(3)
    assert wrap(four_times)(x, y).tolist() == (4 * x + y).tolist()
    assert seen
    assert set(seen) == {2}
