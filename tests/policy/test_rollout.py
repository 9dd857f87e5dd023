"""A roll-out is the steps of the environment, one after the other."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from carpark_mj.config import EnvConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.policy.acting import Carry, StatePolicy, control_step, roll_out
from carpark_mj.policy.named import find_named

STEPS = 4
DRIVE = [(0.5, 0.2), (-0.25, 0.8), (0.0, -1.0)]


@pytest.fixture(scope="module")
def env():
    return ParkingEnv(
        EnvConfig(layout="square_compact", num_parked_cars=2, physics="bicycle")
    )


def act(state, observation, memory, key):
    """Steers by the own observation, the step's noise and what was done before."""
    steer = jnp.tanh(observation[..., :1] + memory[..., None])
    pedal = jax.random.uniform(key, steer.shape)
    return jnp.concatenate([steer, pedal], axis=-1), memory + 0.1


def start(env, lots):
    """Lots at their start; memory is a number of every agent."""
    keys = jax.random.split(jax.random.key(1), lots)
    return Carry(*jax.jit(jax.vmap(env.reset))(keys), jnp.zeros((lots, env.num_agents)))


def test_a_roll_out_is_its_control_steps(env):
    keys, lots = jax.random.split(jax.random.key(2), STEPS), 2

    def report(step):
        return step.before.step, step.after.step, step.action, step.timestep.reward

    def whole(carry):
        return roll_out(env, act, carry, keys, report)

    end, reports = jax.jit(whole)(start(env, lots))
    step = jax.jit(lambda carry, key: control_step(env, act, carry, key))
    carry = start(env, lots)
    for t, key in enumerate(keys):
        before = carry
        carry, made = step(carry, key)
        np.testing.assert_array_equal(made.observation, before.observation)
        for one, all_steps in zip(report(made), reports, strict=True):
            np.testing.assert_allclose(one, all_steps[t], atol=1e-5)
    np.testing.assert_allclose(carry.observation, end.observation, atol=1e-5)
    np.testing.assert_allclose(end.memory, 0.1 * STEPS, rtol=1e-6)
    assert (np.asarray(reports[2][..., 1]) > 0).all()  # drawn with other keys
    assert len(np.unique(reports[2][..., 1])) > STEPS


def test_recorded_actions_are_repeated_then_the_car_is_left_alone(env, tmp_path):
    file = tmp_path / "drive.csv"
    file.write_text("steer,pedal\n" + "".join(f"{s},{p}\n" for s, p in DRIVE))
    make = find_named(f"actions:{file}")
    assert make is not None
    policy, (state, _) = make(env), env.reset(jax.random.key(0))
    assert isinstance(policy, StatePolicy)
    expected = [*DRIVE, (0.0, 0.0), (0.0, 0.0)]
    for count, action in enumerate(expected):
        found = policy.act(state.replace(step=jnp.array([count, 0])))
        np.testing.assert_allclose(found, [action, DRIVE[0]])


@pytest.mark.parametrize(
    "text", ["steer,pedal\n", "steer\n0\n", "steer,pedal\n0,nan\n"]
)
def test_other_recordings_are_refused(env, tmp_path, text):
    file = tmp_path / "bad.csv"
    file.write_text(text)
    with pytest.raises(ValueError, match=r"bad\.csv"):
        find_named(f"actions:{file}")(env)
