"""Phases of slots: what they say, which lots they have, and what is kept of them."""

import dataclasses
import math
import re

import jax.numpy as jnp
import numpy as np
import pytest
from helpers.programs import assert_refused, exit_code

from carpark_mj.layouts import layout_config
from carpark_papers.pandita.experiments import program as slots_study
from carpark_papers.pandita.layouts import SlotsConfig
from carpark_papers.pandita.sac import program as sac
from carpark_papers.pandita.sac.config import SAC_PRESETS, Phase, SACConfig, read_phase
from carpark_papers.pandita.sac.deploy import deploy, success_matrix, transfer

KINDS = ("slots", "slots_diagonal", "slots_parallel")


@pytest.mark.parametrize(
    ("text", "phase"),
    [
        ("slots:15000", Phase(("slots",), steps=15_000)),
        ("slots:20steps", Phase(("slots",), steps=20)),
        (
            "slots, slots_diagonal:150episodes",
            Phase(("slots", "slots_diagonal"), episodes=150),
        ),
    ],
)
def test_phases_are_read_from_text(text, phase):
    assert read_phase(text) == phase


def test_a_phase_ends_by_steps_or_by_episodes():
    assert read_phase("slots:200").progress(steps=50, episodes=7) == 0.25
    assert read_phase("slots:10episodes").progress(steps=50, episodes=7) == 0.7
    assert read_phase("slots:10episodes").progress(steps=50, episodes=12) == 1.0


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        ("--phases slots:0", "a phase needs steps or episodes, at least 1, not 0"),
        ("--phases slots:-3episodes", "at least 1, not 0 steps and -3 episodes"),
        ("--phases slots", "a phase is KINDS:STEPS or KINDS:COUNTepisodes"),
        ("--phases bays:100", "unknown layout 'bays'"),
        ("--phases square:100", "'square' is not a kind of slots; choose from slots"),
        ("--phases", "phases, deploy and hidden must have one item or more"),
        ("--at-switch balance --replay plain", "at_switch balance needs replay her"),
    ],
)
def test_impossible_settings_end_with_one_line(flags, message, capsys):
    assert re.search(message, assert_refused(capsys, sac, flags.split(), ""))


def test_the_preset_of_the_thesis_has_its_hyperparameters():
    config = SAC_PRESETS["pandita"]
    assert (config.hidden, config.batch_size) == ((512, 512, 512), 1024)
    assert (config.learning_rate, config.learning_rate_end) == (1e-3, 1e-3)
    assert (config.discount, config.tau, config.buffer_size) == (0.95, 0.05, 10**6)
    assert (config.replay, config.hindsight_goals) == ("her", 4)
    assert (config.num_cars, config.gradient_steps) == (1, 1)


def test_lots_are_those_of_the_kinds_with_the_settings_of_the_run():
    config = SACConfig(goal_slot="random", half_corridor=12.0)
    assert config.layout("slots_diagonal") == dataclasses.replace(
        layout_config("slots_diagonal"), goal_slot=None, half_corridor=12.0
    )
    assert SACConfig().layout("slots") == SlotsConfig()
    assert SACConfig().env_of(SlotsConfig()).num_parked_cars == 11
    assert SACConfig(environment="slots").env.physics == "mjx"


def test_kinds_of_a_phase_are_drawn_equally_often():
    phases = ("slots:100", "slots_diagonal:100", "slots_diagonal,slots_parallel:100")
    config = SACConfig(phases=phases, rehearsal=0.2)
    assert config.layout_of_phase(0) == SlotsConfig()
    second = config.layout_of_phase(1)
    assert second.members == (config.layout("slots_diagonal"), config.layout("slots"))
    assert second.weights == (0.8, 0.2)
    third = config.layout_of_phase(2)
    assert third.members[-1] == config.layout("slots")
    assert third.weights == (0.4, 0.4, 0.2)
    without = dataclasses.replace(config, rehearsal=0.0)
    assert without.layout_of_phase(1) == config.layout("slots_diagonal")


def rows(matrix, policy="deterministic"):
    return [
        {"phase": phase, "kind": kind, "policy": policy, "success": success}
        for phase, line in enumerate(matrix)
        for kind, success in zip(KINDS, line, strict=True)
    ]


def test_transfer_is_that_of_the_paper_and_of_the_mean_of_kinds():
    matrix = [[0.1, 0.2, 0.3], [1.0, 0.4, 0.3], [0.5, 0.9, 0.6], [0.0, 0.7, 0.8]]
    found = success_matrix(rows(matrix), KINDS)
    np.testing.assert_array_equal(found, matrix)
    phases = tuple(Phase((kind,), steps=1) for kind in KINDS)
    result = transfer(found, KINDS, phases)
    assert result.average == pytest.approx((0.0 + 0.7 + 0.8) / 3)
    assert result.backward == pytest.approx(((0.0 - 1.0) + (0.7 - 0.9)) / 2)
    assert result.forward == pytest.approx(((0.4 - 0.2) + (0.6 - 0.3)) / 2)
    matrix = success_matrix(rows([[0.0, 0.0, 0.0], [1.0, 0.5, 0.2]]), KINDS)
    result = transfer(matrix, KINDS, (Phase(KINDS[:2], steps=1),))
    assert result.average == 0.75
    assert math.isnan(result.backward)
    assert math.isnan(result.forward)


class Constant:
    """A distribution that knows one action."""

    def __init__(self, action):
        self._action = action

    def mode(self):
        return self._action

    def sample(self, seed):
        del seed
        return self._action


def pushed(pedal, vector):
    """An actor that goes straight on; its weight is the pedal."""
    zero = jnp.zeros(vector.shape[:-1])
    return Constant(jnp.stack([zero, zero + pedal], axis=-1))


def test_deployed_cars_that_stand_still_time_out():
    config = SACConfig(eval_episodes=3)
    row = deploy(config, pushed, jnp.float32(0.0), "slots", False)
    assert (row["success"], row["crashed"], row["timed_out"]) == (0.0, 0.0, 1.0)
    assert (row["steps"], row["speed"], row["episodes"]) == (150.0, 0.0, 3)
    assert row["timed_out_low"] < 1.0 == row["timed_out_high"]
    away = deploy(config, pushed, jnp.float32(1.0), "slots", True)
    assert away["timed_out"] == 1.0  # there are no walls at the sides
    assert away["speed"] > 10.0


def test_the_study_takes_one_of_its_choices(capsys):
    assert exit_code(slots_study, []) == 2
    assert exit_code(slots_study, ["--all", "--list"]) == 2
    assert exit_code(slots_study, ["--experiment", "13"]) == 2
    error = capsys.readouterr().err
    assert error.count("give one of --experiment NAME, --all and --list") == 2
    assert "unknown experiment '13'; choose from 1, 2, 3" in error
