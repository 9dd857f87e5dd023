"""PPO where actions are choices: training, checkpoint, evaluation, pictures."""

import dataclasses

import jax
import numpy as np
import pytest

from carpark_mj.cli import evaluate
from carpark_mj.config import WORLD_UNIT
from carpark_mj.env import ParkingEnv
from carpark_mj.mdp.actions import ActionSpec
from carpark_mj.policy.loading import load_policy
from carpark_mj.policy.networks import NetworkConfig
from carpark_mj.registry import environment
from carpark_mj.rendering.web import LiveLot
from carpark_mj.training.ppo.learner import Learner
from carpark_mj.training.ppo.parts import PRESETS
from carpark_mj.training.ppo.train import load_or_init, save

FIXED = environment("tanner-fixed")
QUICK = dataclasses.replace(FIXED.spawn, conflict_ratio=0.0)  # to compile
TINY = dataclasses.replace(
    PRESETS["tanner-fixed"],
    num_lots=2,
    unroll_length=8,
    num_minibatches=2,
    num_epochs=2,
    num_steps=64,
    networks=NetworkConfig((16,), (16,)),
    env=dataclasses.replace(
        FIXED,
        num_agents=2,
        num_parked_cars=3,
        spawn=QUICK,
        episode=dataclasses.replace(FIXED.episode, max_steps=10),
    ),
)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """Folder, states before and after two updates, what they reported, networks."""
    folder = tmp_path_factory.mktemp("run")
    learner = Learner(TINY)
    update = learner.compile()
    state = learner.init()
    start = jax.device_get(state)
    state, first = update(state)
    state, second = update(state)
    assert update._cache_size() == 1  # no weak type recompiled it
    save(folder, TINY, state)
    states = start, jax.device_get(state)
    return folder, states, [first, second], learner.networks


def test_updates_on_the_grid_are_finite_and_change_the_policy(trained):
    _, (start, state), reports, _ = trained
    assert int(state.skipped) == 0
    for metrics in reports:
        assert all(np.isfinite(value) for value in metrics.values())
        assert metrics["episode/invalid_actions"] == 0
        # At the start all 5 x 7 actions are about as likely: spreads 1.4 and 2. The
        # least of a minibatch is below (measured 0.97 and 1.02).
        assert 0.9 < metrics["loss/policy_dist_min_std"] < 1.5
        assert 1.8 < metrics["loss/policy_dist_max_std"] < 2.3
    moved = jax.tree.map(lambda a, b: np.abs(a - b).max(), state.policy, start.policy)
    assert max(jax.tree.leaves(moved)) > 1e-4


def test_a_loaded_policy_chooses_indices_by_mode_or_by_chance(trained):
    folder, (_, state), _, networks = trained
    best, drawn = (load_policy(folder, deterministic=d) for d in (True, False))
    assert best.env == TINY.env
    observation = np.asarray(state.env.obs)
    logits = networks.policy_network.apply(state.normalizer, state.average, observation)
    action, _ = best.policy(observation, jax.random.key(0))
    assert action.dtype == np.int32
    np.testing.assert_array_equal(action[:, 0], np.argmax(logits[:, :5], axis=-1))
    np.testing.assert_array_equal(action[:, 1], np.argmax(logits[:, 5:], axis=-1))
    many = np.repeat(observation, 50, axis=0)
    action, _ = drawn.policy(many, jax.random.key(0))
    assert set(np.unique(action[:, 0])) == set(range(5))
    assert set(np.unique(action[:, 1])) == set(range(7))


def test_it_is_evaluated_and_watched(trained, tmp_path):
    folder = trained[0]
    config = evaluate.EvaluateConfig(
        run=str(folder), episodes=8, stochastic=True, out=str(tmp_path)
    )
    assert evaluate.main(config).summary["episodes"] == 8
    loaded = load_policy(folder)
    live = LiveLot(ParkingEnv(loaded.env), loaded.policy, seed=0)
    assert live.step()
    assert live.seconds == pytest.approx(0.2)


def test_cars_that_steer_cannot_start_from_it(trained):
    other = dataclasses.replace(
        TINY,
        warm_start=str(trained[0]),
        env=dataclasses.replace(TINY.env, physics="bicycle"),
    )
    with pytest.raises(ValueError, match="was trained for other actions"):
        load_or_init(Learner(other), [trained[0].with_name("other")])


def test_baselines_drive_in_named_environments(tmp_path):
    def run(name, environment):
        config = evaluate.EvaluateConfig(
            run=name, environment=environment, episodes=7, out=str(tmp_path)
        )
        return evaluate.main(config).summary

    still = run("zero", "tanner-fixed")
    assert still["timed_out"]["rate"] == 1.0
    # 200 steps of time and of not getting nearer: -0.2 - 0.15, table C.9.
    assert still["episode_return"] == pytest.approx(-0.35, abs=1e-4)
    with pytest.raises(ValueError, match="unknown environment 'tokyo'"):
        run("zero", "tokyo")


def test_a_car_of_the_study_s_grid_drives_as_its_table_says():
    alone = dataclasses.replace(FIXED.observation, tracked_cars=0)
    env = ParkingEnv(
        dataclasses.replace(FIXED, num_agents=1, num_parked_cars=0, observation=alone)
    )
    assert env.action_spec == ActionSpec(0, (5, 7))
    step = jax.jit(env.step)
    state, _ = jax.jit(env.reset)(jax.random.key(0))
    moved, turned = [], []
    for action in ([4, 3], [4, 3], [4, 6], [0, 3], [0, 3], [0, 3], [0, 0]):
        before = np.asarray(state.motion.pose_w[0])
        state, timestep = step(state, np.array([action], np.int32))
        after = np.asarray(timestep.motion.pose_w[0])
        along = (after - before)[:2] @ [np.cos(after[2]), np.sin(after[2])]
        moved.append(along / WORLD_UNIT)
        turned.append(np.degrees(before[2] - after[2]))
    # Up to 1 world unit a step forwards, 0.5 in reverse, to the nearest of 16 points.
    np.testing.assert_allclose(moved, [0.5, 1, 1, 0.5, 0, -0.5, -0.5], atol=0.05)
    right = np.array([0, 0, 45, 0, 0, 0, -45])
    np.testing.assert_allclose((np.array(turned) + 180) % 360 - 180, right, atol=0.01)
