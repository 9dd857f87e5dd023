"""The soak: its worst cases as regression tests, and that it sees what it looks for."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import soak
from carpark_mj.config import SimConfig
from carpark_mj.physics.mjx import MjxPhysics
from carpark_mj.vehicle import PRESETS

# The cases that came closest to a limit, per preset and per pattern, in 1.04e7
# car-steps from case 0: first of hops, then of energy.
WORST = (3756, 3151, 8504, 6465, 4594, 2615, 6696, 5734, 7368, 3486)
WORST += (1770, 805, 7610, 1665, 2824, 4907, 7960, 1713, 496, 4458)
LIMITS = soak.SoakConfig(car_steps=1, num_cars=len(WORST))


@pytest.fixture(scope="module")
def soaked() -> soak.Soak:
    return soak.Soak(SimConfig())


@pytest.fixture(scope="module")
def worst(soaked: soak.Soak) -> soak.Worst:
    return jax.device_get(soaked.run(jnp.array(WORST, jnp.int32)))


def test_the_worst_cases_hold(worst):
    assert not soak.breaches(worst, LIMITS.max_hop, LIMITS.max_energy).any()
    # They are what the full soak found, close to -4.5 mm and 6.3 J/kg.
    assert -0.01 < worst.hop.max() < 0.0
    assert 5.0 < worst.energy.max() < 7.0


def test_only_the_invalid_pattern_has_actions_to_neutralise(worst):
    invalid = soak.pattern_of(np.array(WORST)) == soak.PATTERNS.index("invalid")
    np.testing.assert_array_equal(worst.invalid > 0, invalid)
    assert invalid.any()


def test_a_case_is_the_same_wherever_it_runs(soaked, worst):
    again = jax.device_get(soaked.run(jnp.array(WORST[::-1], jnp.int32)))
    for one, other in zip(jax.tree.leaves(worst), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(one, other[::-1])
    assert soaked.run._cache_size() == 1


def test_the_command_tells_a_breach_from_a_pass(soaked, monkeypatch, capsys):
    monkeypatch.setattr(soak, "Soak", lambda sim: soaked)
    assert soak.run(LIMITS) == 0
    assert "all held" in capsys.readouterr().out
    assert soak.run(dataclasses.replace(LIMITS, max_energy=0.5)) == 1
    assert "broke a limit" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("change", "bad"),
    [
        ({}, False),
        ({"broken": 1.0}, True),
        ({"hop": 0.002}, True),
        ({"energy": 8.1}, True),
        ({"hop": np.nan}, True),
        ({"energy": np.inf}, True),
    ],
)
def test_each_limit_is_looked_at(change, bad):
    fine = {"broken": 0.0, "hop": -0.02, "energy": 4.5, "invalid": 7.0}
    rows = [np.array([fine[name], (fine | change)[name]]) for name in fine]
    bad_rows = soak.breaches(soak.Worst(*rows), LIMITS.max_hop, LIMITS.max_energy)
    assert bad_rows.tolist() == [False, bad]


def test_cases_cover_every_preset_under_every_pattern():
    cases = np.arange(36)
    pairs = set(zip(soak.preset_of(cases), soak.pattern_of(cases), strict=True))
    assert len(pairs) == len(PRESETS) * len(soak.PATTERNS) == 36


def test_patterns_do_what_their_names_say(compact):
    steps = jnp.arange(soak.ROUNDS)
    draw = jax.jit(jax.vmap(soak.draw_action, (0, None, None, None)))
    actions = {
        name: np.asarray(draw(steps, jnp.array(k), compact, jax.random.key(5)))
        for k, name in enumerate(soak.PATTERNS)
    }
    for name in ("random", "held"):
        assert (np.abs(actions[name]) <= 1.0).all()
    assert len(np.unique(actions["random"])) == 2 * soak.ROUNDS
    assert len(np.unique(actions["held"])) < soak.ROUNDS
    lock = actions["lock to lock"][:, 0]
    # From lock to lock at 0.42 rad/s takes 2.84 s: 15 actions of 0.2 s.
    assert np.flatnonzero(np.diff(lock)).tolist() == [14, 29, 44]
    assert set(lock) == {-1.0, 1.0}
    assert set(actions["brake to throttle"][:, 1]) == {-1.0, 1.0}
    assert (actions["flip"][1:] == -actions["flip"][:-1]).all()
    assert np.isnan(actions["invalid"]).any()
    assert (np.abs(actions["invalid"]) > 1.0).any()


def test_heights_and_energy_are_those_of_rigid_bodies(compact):
    state = MjxPhysics(SimConfig()).init(jnp.array([3.0, -2.0, 0.7]), compact)
    np.testing.assert_allclose(soak.wheel_heights(state), 0.0, atol=1e-6)
    turn = Rotation.from_euler("ZYX", [0.7, 0.02, -0.03])
    quat = np.roll(turn.as_quat(), 1)
    qpos = state.qpos.at[2].set(0.05).at[3:7].set(quat)
    tilted = dataclasses.replace(state, qpos=qpos)
    hubs = np.pad(np.asarray(compact.hub), ((0, 0), (0, 1)))
    expected = 0.05 + turn.apply(hubs)[:, 2]
    np.testing.assert_allclose(soak.wheel_heights(tilted), expected, atol=1e-6)
    # 3 m/s with wheels rolling: v^2 / 2 and 4 wheels of 1 kg m^2 at v / r.
    qvel = state.qvel.at[0].set(3.0).at[jnp.array([7, 9, 10, 11])].set(3.0 / 0.316)
    rolling = dataclasses.replace(state, qvel=qvel)
    expected = 4.5 + 2 * (3.0 / 0.316) ** 2 / 1380.0
    assert soak.energy_per_mass(rolling) == pytest.approx(expected, rel=1e-5)
