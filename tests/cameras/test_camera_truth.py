"""Cameras agree with MuJoCo's own pictures of the same state."""

import jax

from cameras import ENOUGH, compare, environment


def test_depth_and_classes_are_those_that_mujoco_draws():
    # No skip without GL: CI installs it, and a silent skip would hide its loss.
    env = environment("lot")
    state = jax.jit(lambda key: env.reset(key)[0])(jax.random.key(1))
    found = compare(env, [state], meshes=False)
    assert found.pixels == 2 * 5 * 64 * 48  # of two agents with five cameras
    assert found.on_edge < 0.05 * found.pixels
    assert found.depth >= ENOUGH
    assert found.classes >= ENOUGH
