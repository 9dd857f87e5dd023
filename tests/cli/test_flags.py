"""Flags: a bad one is a sentence; those given change the environment of a run."""

import dataclasses
import io
import re
import sys
from typing import Literal

import jax
import pytest

from carpark_mj.cli.driver import adapt, find_driver, with_settings
from carpark_mj.cli.flags import read_flags
from carpark_mj.cli.process import run_command
from carpark_mj.config import EnvConfig, FleetConfig
from carpark_mj.config.checks import Range
from carpark_mj.env import ParkingEnv
from carpark_mj.observations import ContinuousObservation
from carpark_mj.registry import ANYWHERE
from carpark_mj.suite.metadrive import METADRIVE


@dataclasses.dataclass(frozen=True)
class Eye:
    reach: float = 1.0
    kind: Literal["near", "far"] = "near"

    def __post_init__(self) -> None:
        if self.reach > 10:
            raise ValueError(f"reach must be at most 10, not {self.reach}")


@dataclasses.dataclass(frozen=True)
class Settings:
    """Settings.

    Attributes:
        count: how many there are.
        eye: what is seen.
        span: from where to where.
        part: of the span.
        size: of the eye.
        at: x, y and z.
    """

    count: int = 3
    eye: Eye = dataclasses.field(default_factory=Eye)
    span: Range = (0.0, 1.0)
    part: Range | None = None
    size: float | None = None
    at: tuple[float, float, float] | None = None


def test_flags_change_the_default():
    assert read_flags(Settings, ["--eye.reach", "2"]).eye == Eye(2.0)
    far = Settings(eye=Eye(kind="far"))
    assert read_flags(Settings, ["--eye.reach", "8"], far).eye == Eye(8.0, "far")


WIDE = "x" * 300
BAD = {
    "value": (["--count", "1.5"], "--count takes a whole number, not '1.5'"),
    "value or none": (["--size", "a"], "--size: no type matching {None}|FLOAT"),
    "refused": (["--eye.reach", "11"], "reach must be at most 10, not 11.0"),
    "choice": (["--eye.kind", "none"], "invalid choice 'none' for argument"),
    "near miss": (["--siz", "3"], "Unrecognized options: --siz, 3; perhaps you meant"),
    "of another command": (["--from-state"], "Unrecognized options: --from-state"),
    "wide": (["--eye.kind", WIDE], f"invalid choice '{WIDE}' for argument"),
}


@pytest.mark.parametrize("encoding", ["utf-8", "ascii"])  # of the frames tyro draws
@pytest.mark.parametrize("case", sorted(BAD))
def test_a_bad_flag_is_one_sentence(case, encoding, monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(io.BytesIO(), encoding))
    arguments, message = BAD[case]
    with pytest.raises(ValueError, match=re.escape(message)) as caught:
        read_flags(Settings, arguments, Settings())
    told = str(caught.value)
    assert told.startswith(message)
    assert not re.search(r"[\n│╭─]|---|helptext", told)


def test_a_range_is_two_numbers():
    read = read_flags(Settings, ["--span", "-1", "2", "--part", "0.5", "1"])
    assert (read.span, read.part) == ((-1.0, 2.0), (0.5, 1.0))
    assert read_flags(Settings, ["--part", "None"], read).part is None
    for words in (["1"], ["1", "a"]):
        with pytest.raises(ValueError, match="--span"):
            read_flags(Settings, ["--span", *words])


def test_what_the_user_can_mend_is_one_line_and_exit_code_2(capsys):
    def fail(error):
        raise error

    for error, line in (
        (ValueError("a\n b"), "name: a b\n"),
        (MemoryError(), "name: not enough memory, choose smaller sizes"),
        (FileNotFoundError(2, "No such file", "x"), "name: cannot use x: No such"),
    ):
        assert run_command("name", lambda error=error: fail(error)) == 2
        told = capsys.readouterr().err
        assert told.startswith(line)
        assert told.count("\n") == 1
    assert run_command("name", lambda: None) == 0
    assert run_command("name", lambda: 1) == 1
    for error in (KeyError("x"), KeyboardInterrupt()):  # ours, and that of `enter`
        with pytest.raises(type(error)):
            run_command("name", lambda error=error: fail(error))


def test_a_platform_that_jax_does_not_have_is_one_line(monkeypatch, capsys):
    def fail():
        raise AssertionError  # all that JAX says of CUDA where there is none

    monkeypatch.setenv("JAX_PLATFORMS", "cuda")
    with pytest.raises(AssertionError):  # JAX has devices: the error is ours
        run_command("name", fail)
    monkeypatch.setattr(jax, "devices", fail)
    assert run_command("name", fail) == 2
    said = capsys.readouterr().err
    assert ("JAX_PLATFORMS=cuda" in said, said.count("\n")) == (True, 1)


RUN = EnvConfig(num_agents=5, min_agents=3)


@pytest.mark.parametrize(
    ("changes", "counts"),
    [
        ({}, [3, 4, 5]),
        ({"num_agents": 2}, [2]),
        ({"min_agents": 1}, [1, 2, 3, 4, 5]),
        ({"num_agents": 2, "min_agents": 1}, [1, 2]),
    ],
)
def test_a_number_of_agents_is_that_of_every_lot(changes, counts):
    assert list(adapt(RUN, **changes).agent_counts) == counts


def test_any_setting_of_an_environment_can_be_given():
    given = ["sim.steering_delay=0.24", "occupancy=0.2 0.5", "episode.respawn=false"]
    changed = with_settings(RUN, given)
    sim = dataclasses.replace(RUN.sim, steering_delay=0.24)
    episode = dataclasses.replace(RUN.episode, respawn=False)
    changes = {"sim": sim, "episode": episode, "occupancy": (0.2, 0.5)}
    assert changed == dataclasses.replace(RUN, **changes)
    assert with_settings(RUN, []) is RUN
    for setting in ("sim.steering_delay", "sim.steering_dely=0.2"):
        with pytest.raises(ValueError, match="steering"):
            with_settings(RUN, [setting])


@pytest.mark.parametrize(
    ("layout", "count"), [("square", 28), ("garage_row", 20), ("lot", 20)]
)
def test_an_occupancy_parks_as_many_cars_as_it_takes(layout, count):
    run = adapt(ANYWHERE, layout=layout, num_agents=1)
    assert (run.occupancy, run.num_parked_cars) == ((0.2, 0.8), count)
    assert ParkingEnv(run).num_agents == 1  # which refuses too few
    assert adapt(ANYWHERE, layout=layout, num_parked_cars=5).num_parked_cars == 5


def test_flags_change_what_they_are_about_and_nothing_else():
    other = adapt(RUN, rule="precise").episode
    assert other == dataclasses.replace(RUN.episode, parked_rule="precise")
    assert adapt(RUN).episode == RUN.episode
    # A number of parked cars is that of every lot.
    run = EnvConfig(num_parked_cars=29, occupancy=(0.2, 0.8))
    assert adapt(run, num_parked_cars=10).occupancy is None
    assert adapt(run, num_agents=3).occupancy == (0.2, 0.8)
    # A vehicle is that of all cars instead of a fleet.
    fleet = FleetConfig(agents=("city", "van"), parked_cars=("suv",))
    run = EnvConfig(fleet=fleet, observation=ContinuousObservation(own_car=True))
    alike = adapt(run, vehicle="sedan")
    assert (alike.vehicle, alike.fleet.is_on) == ("sedan", False)
    assert adapt(run).fleet == run.fleet


def test_nominal_cars_are_observed_as_they_are():
    assert ANYWHERE.sensors.is_on
    nominal = adapt(ANYWHERE, nominal=True, physics="bicycle", vehicle="compact")
    assert not nominal.sensors.is_on
    assert not nominal.randomization.is_on
    assert adapt(ANYWHERE, num_agents=2).sensors == ANYWHERE.sensors


def test_a_trained_policy_observes_another_task_as_in_training():
    env, own = find_driver("anywhere", "metadrive").env, find_driver("anywhere").env
    assert (env.observation, env.reward) == (own.observation, own.reward)
    alike = {"observation": METADRIVE.observation, "reward": METADRIVE.reward}
    assert dataclasses.replace(env, **alike) == METADRIVE
    with pytest.raises(ValueError, match=r"reward\.route"):
        find_driver("anywhere", "dynamic")
