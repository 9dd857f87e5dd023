"""Policies of other libraries act in a roll-out as they do at home."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import carpark_mj
from carpark_mj.cli.driver import find_driver
from carpark_mj.config import EpisodeConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.evaluation.evaluator import evaluate
from carpark_mj.mdp.actions import action_table
from carpark_mj.policy.host import from_function, from_sb3, from_torch
from carpark_mj.policy.named import find_named
from carpark_mj.registry import FIRST

SHORT = dataclasses.replace(FIRST, episode=EpisodeConfig(max_steps=20))
SIZE = 14  # of its observation


def towards(observation):
    """Steers to the goal ahead."""
    return observation[..., 3:5] * np.array([0.0, 1.0]) + np.array([0.3, 0.0])


@pytest.fixture(scope="module")
def env():
    return ParkingEnv(SHORT)


@pytest.fixture(scope="module")
def seen():
    return np.random.default_rng(0).normal(size=(5, SIZE)).astype(np.float32)


def acts(make, env, observation):
    """What a policy does in a compiled program."""
    return np.asarray(jax.jit(make(env))(observation, jax.random.key(0))[0])


def test_a_function_drives_as_the_same_policy_in_jax(env):
    def in_jax(observation, key):
        return jnp.asarray(towards(observation), jnp.float32), {}

    one, other = (
        evaluate(env, policy, num_episodes=8, seed=0).episodes
        for policy in (from_function(towards)(env), in_jax)
    )
    assert len(one) >= 8
    for row, expected in zip(one, other, strict=True):
        assert row == pytest.approx(expected, abs=1e-3, nan_ok=True)


def test_integers_are_numbers_of_rows_of_the_table(env, seen):
    found = acts(from_function(lambda seen: 70 + np.arange(len(seen))), env, seen)
    np.testing.assert_array_equal(found, action_table(env.action_spec)[70:75])


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (lambda seen: seen, r"actions \(1, 2\) of one, not \(1, 14\)"),
        (lambda seen: seen @ np.zeros((3, 2)), r"fails on .* \(1, 14\): matmul"),
    ],
)
def test_functions_of_other_shapes_are_refused_before_driving(env, act, message):
    with pytest.raises(ValueError, match=message):
        from_function(act)(env)


def test_a_torch_module_acts_the_same_from_its_file(env, seen, tmp_path):
    torch = pytest.importorskip("torch")
    module = torch.nn.Sequential(torch.nn.Linear(SIZE, 2), torch.nn.Tanh())
    some = {0: torch.export.Dim("some")}
    example = torch.zeros(3, SIZE)
    exported = torch.export.export(module, (example,), dynamic_shapes=(some,))
    torch.export.save(exported, tmp_path / "m.pt2")
    expected = module(torch.tensor(seen)).detach().numpy()
    for make in (from_torch(module), find_named(f"torch:{tmp_path / 'm.pt2'}")):
        np.testing.assert_allclose(acts(make, env, seen), expected, atol=1e-6)


@pytest.mark.parametrize("kind", ["PPO", "DQN", "SAC"])
def test_a_model_of_stable_baselines_predicts(kind, env, seen, tmp_path):
    sb3 = pytest.importorskip("stable_baselines3")
    from stable_baselines3.common.vec_env import VecNormalize

    from carpark_mj.wrappers.sb3 import ParkVecEnv

    given = {"config": SHORT, "discrete": kind == "DQN"}
    lots = VecNormalize(ParkVecEnv("carpark_mj/Park-v0", 2, **given))
    model = getattr(sb3, kind)("MlpPolicy", lots, seed=1, device="cpu")
    lots.obs_rms.mean, lots.obs_rms.var = np.full(SIZE, 0.2), np.full(SIZE, 4.0)
    model.save(tmp_path / "model.zip")
    lots.save(tmp_path / "normal.pkl")
    expected = model.predict((seen - 0.2) / 2.0, deterministic=True)[0]
    if kind == "DQN":
        expected = action_table(env.action_spec)[expected]
    files = tmp_path / "model.zip", tmp_path / "normal.pkl"
    for make in (from_sb3(model, files[1]), find_named(f"sb3:{files[0]},{files[1]}")):
        np.testing.assert_allclose(acts(make, env, seen), expected, atol=1e-5)
    assert np.abs(acts(from_sb3(files[0]), env, seen) - expected).max() > 1e-3


def test_policies_of_other_libraries_are_named(monkeypatch, tmp_path):
    """They keep the observation of their environment in another."""
    (tmp_path / "my_policy.py").write_text("def act(seen): return seen[:, :2]\n")
    monkeypatch.syspath_prepend(tmp_path)
    driver = find_driver("function:my_policy:act", "first")
    assert driver.env == FIRST
    assert acts(driver.policy, ParkingEnv(driver.env), np.ones((3, SIZE))).all()
    make = from_function(towards, env=FIRST)
    monkeypatch.setitem(carpark_mj.policy.named._given, "mine", make)
    there = find_driver("function:mine", "square").env
    assert (there.observation, there.num_agents) == (FIRST.observation, 7)


@pytest.mark.parametrize("home", ["no_such_module:act", "json:no_such", "json"])
def test_a_function_that_cannot_be_imported_is_refused(home):
    with pytest.raises(ValueError, match=f"function:{home}"):
        find_named(f"function:{home}")
