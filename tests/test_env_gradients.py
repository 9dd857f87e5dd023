"""Gradients through `ParkingEnv.step`, from rest, episodes that begin anew included."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from carpark_mj import EnvConfig, ParkingEnv
from carpark_mj.config import RewardConfig
from carpark_mj.mdp import rewards

STEPS, AGENTS = 3, 2
PROBE = 2e-2  # of an action: coordinates are rounded to 1e-6 m
SMOOTH = ("progress", "smoothness", "closeness")


@pytest.fixture(scope="module")
def drive():
    """Sums of smooth rewards, poses and observations by actions (steps, agents, 2)."""
    reward = RewardConfig(progress=10.0, closeness=5000.0, extra={"smoothness": 100.0})
    config = EnvConfig(
        physics="bicycle", num_agents=AGENTS, num_parked_cars=2, reward=reward
    )
    env = ParkingEnv(config)
    start, _ = jax.jit(env.reset)(jax.random.key(0))

    def run(actions):
        def step(state, action):
            state, timestep = env.step(state, action)
            terms = [timestep.reward_terms[name].sum() for name in SMOOTH]
            return state, (jnp.stack(terms), timestep.observation.sum())

        end, (terms, observed) = jax.lax.scan(step, start, actions)
        pose = end.motion.pose_w.sum(axis=0)
        return jnp.concatenate([pose, terms.sum(axis=0), observed.sum()[None]])

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rewards, "CLOSENESS_RANGE", 40.0)
        yield jax.jit(run), jax.jit(jax.jacrev(run))


def test_gradients_are_central_differences(drive):
    run, slopes = drive
    rng = np.random.default_rng(0)
    # To one side, for smoothness is |change|, and slower than the steering's limit.
    steer = np.linspace(0.05, 0.2, STEPS)[:, None] + rng.uniform(0, 0.02, (1, AGENTS))
    pedal = rng.uniform(0.3, 0.8, (STEPS, AGENTS))
    actions = np.float32(np.stack([steer, pedal], axis=-1))
    found = np.asarray(slopes(actions))
    assert np.isfinite(found).all()
    for row in range(len(found) - 1):  # observations have kinks
        way = np.sign(found[row])
        gained = run(actions + PROBE * way) - run(actions - PROBE * way)
        expected = pytest.approx(np.abs(found[row]).sum(), rel=1e-2)
        assert gained[row] / (2 * PROBE) == expected, row
        assert np.abs(found[row]).max() > 1e-2


def test_a_car_that_stands_has_finite_gradients(drive):
    _, slopes = drive
    assert np.isfinite(slopes(np.zeros((STEPS, AGENTS, 2), np.float32))).all()
