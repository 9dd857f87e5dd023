"""What a sweep is asked for: its axes, its runs, its groups, and what it refuses."""

import pytest
from helpers.programs import assert_refused

from carpark_mj import sweeps
from carpark_mj.sweeps.plan import (
    Axis,
    Plan,
    checked_runs,
    groups,
    read_axis,
    runs,
    settings_of,
)
from carpark_mj.training.ppo.parts import PRESETS


def axes(*texts, base="square"):
    return tuple(read_axis(text, PRESETS[base]) for text in texts)


@pytest.mark.parametrize(
    ("text", "field", "values"),
    [
        ("num_agents=1..3", "env.num_agents", ["1", "2", "3"]),
        ("env.num_agents=1,5..6", "env.num_agents", ["1", "5", "6"]),
        ("num-lots=-1..0", "num_lots", ["-1", "0"]),
        ("discount=0.99, 0.995", "discount", ["0.99", "0.995"]),
        ("layout=../a.json", "env.layout", ["../a.json"]),
        ("scheme=L,L,S;G,G,A", "env.giving_way.scheme", ["L,L,S", "G,G,A"]),
        ("scheme=L,L,S;", "env.giving_way.scheme", ["L,L,S"]),
    ],
)
def test_an_axis_is_a_field_and_its_values(text, field, values):
    axis = read_axis(text, PRESETS["dynamic"])
    assert axis == Axis((field,), tuple((value,) for value in values))


def test_every_combination_has_every_seed_and_its_own_folder():
    plan = Plan("square", axes("num_agents=1..3", "clip=0.1,0.2"), 2, seed=5)
    found = checked_runs(plan)
    assert len(plan) == len(found) == 3 * 2 * 2
    configs = [settings_of(run) for run in found]
    assert {(c.env.num_agents, c.clip, c.seed) for c in configs} == {
        (n, clip, seed) for n in (1, 2, 3) for clip in (0.1, 0.2) for seed in (5, 6)
    }
    assert len({run.name for run in found}) == len(found)
    assert found[0].name == "num_agents=1,clip=0.1,seed=5"


def test_settings_of_one_value_are_in_no_name():
    plan = Plan("square", axes("num_agents=2", "closeness=1"))
    [run] = checked_runs(plan)
    assert run.name == "seed=0"
    assert settings_of(run).env.num_agents == 2
    assert settings_of(run).env.reward.closeness == 1.0


def test_settings_can_change_together():
    fields = ("env.giving_way.scheme", "env.observation.global_information")
    axis = Axis(fields, (("L,L,S", "false"), ("G,G,A", "true")))
    first, second = checked_runs(Plan("dynamic", (axis,)))
    assert not settings_of(first).env.observation.global_information
    assert settings_of(second).env.giving_way.scheme == "G,G,A"


def test_runs_render_no_video_unless_they_are_asked_to():
    [run] = runs(Plan("cpu", ()))
    [other] = runs(Plan("cpu", axes("video_seconds=3")))
    assert settings_of(run).video_seconds == 0
    assert settings_of(other).video_seconds == 3


def test_groups_differ_in_seeds_and_data_only():
    swept = axes("num_agents=1,2", "discount=0.9,0.95,0.99")
    found = groups(checked_runs(Plan("square", swept, repeats=2)), 4)
    assert sorted(map(len, found)) == [2, 2, 4, 4]
    for group in found:
        assert len({settings_of(run).env.num_agents for run in group}) == 1
    alone = groups(checked_runs(Plan("cpu", (), repeats=3)), 8)  # end by the clock
    assert list(map(len, alone)) == [1, 1, 1]


BAD = [
    ("--set num_agent=1", "unknown setting 'num_agent'"),
    ("--set tyres", "FIELD=VALUES"),
    ("--set num_agents=7..1", "env.num_agents has no values"),
    ("--set num_agents=1,1", "env.num_agents has no values, or one twice"),
    ("--set clip=0.1,0.10", "clip=0.10: the same settings as clip=0.1"),
    ("--set clip=0.1 clip=0.2", "clip is given twice"),
    ("--set num_agents=1,0", "num_agents=0: num_agents"),
    ("--set num_agents=2,21", "num_agents=21: num_parked_cars"),
    ("--set discount=0.9,1.5", "discount=1.5: discount must lie in [0, 1]"),
    ("--set clip=-h,0.2", "clip takes values, not flags"),
    ("--set seed=1..3", "seed is not swept"),
    ("--name a/b", "name must be the name of one folder"),
    ("--base gpus", "unknown preset 'gpus'; choose from ['anywhere', "),
]


@pytest.mark.parametrize(("flags", "said"), BAD)
def test_a_bad_sweep_is_one_sentence_before_anything_runs(
    flags, said, capsys, monkeypatch, tmp_path
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sweeps, "run_sweep", pytest.fail)
    assert_refused(capsys, "sweep", ["--base", "cpu", *flags.split()], said)
    assert list(tmp_path.iterdir()) == []
