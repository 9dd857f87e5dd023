"""Evaluations: episodes, and what is reported of them."""

import collections
import dataclasses
import functools
import json
import re
from pathlib import Path
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.disks import no_printing
from helpers.programs import rows_of
from helpers.sliding import SlidePhysics
from jax.tree_util import Partial
from rich.console import Console

from carpark_mj.cli.evaluate import EvaluateConfig, report, subfolder
from carpark_mj.config import EnvConfig, EpisodeConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.evaluation.aggregation import (
    complete_row,
    effective_episodes,
    summarize,
    wilson_interval,
)
from carpark_mj.evaluation.evaluator import allot, evaluate
from carpark_mj.evaluation.keys import evaluation_key, training_key
from carpark_mj.evaluation.report import (
    print_groups,
    print_metrics,
    print_report,
    print_table,
    write_evaluation,
)
from carpark_mj.geometry.obstacles import ObstacleKind
from carpark_mj.layouts import StreetConfig, mixture
from carpark_mj.mdp.actions import ActionSpec
from carpark_mj.policy.acting import as_argument
from carpark_mj.policy.named import random_policy, zero_policy
from carpark_mj.types import ENDINGS

SPEC = ActionSpec(2)


def act(moves, observation, key):
    """The random policy or the one that stands, in one program."""
    (drawn, _), (still, _) = (
        policy(observation, key) for policy in (random_policy(SPEC), zero_policy(SPEC))
    )
    return jnp.where(moves, drawn, still), {}


RANDOM, ZERO = (as_argument(Partial(act, np.array(moves))) for moves in (True, False))


@pytest.fixture(scope="module")
def env():
    config = EnvConfig(
        num_agents=2,
        num_parked_cars=20,
        physics="bicycle",
        episode=EpisodeConfig(max_steps=30),
    )
    return ParkingEnv(config)


@pytest.fixture(scope="module")
def run(env):
    """Evaluates in the same four lots side by side."""
    return functools.partial(evaluate, env, num_lots=4)


@pytest.fixture(scope="module")
def result(run):
    return run(RANDOM, num_episodes=20, seed=3)


def test_a_span_counts_the_episodes_that_begin_within_it(run):
    result = run(RANDOM, num_episodes=8, seed=3, horizon=8.0)  # s, 40 steps
    lengths = {}
    for row in result.episodes:
        lengths.setdefault((row["lot"], row["agent"]), []).append(row["length"])
    assert len(lengths) == 8
    for steps in lengths.values():
        assert sum(steps[:-1]) < 40 <= sum(steps)
    with pytest.raises(ValueError, match="horizon must be positive, not 0"):
        run(RANDOM, num_episodes=8, seed=3, horizon=0.0)


def test_returns_by_term_add_up(result):
    by_term = result.summary["mean_returns"]
    assert {"park", "crash", "time", "progress"} <= by_term.keys()
    for row in result.episodes:
        total = sum(row[f"return_{name}"] for name in by_term)
        # float32 sums of 30 steps.
        assert total == pytest.approx(row["episode_return"], abs=1e-4)
    for name, mean in by_term.items():
        column = [row[f"return_{name}"] for row in result.episodes]
        assert mean == pytest.approx(np.mean(column))
    assert sum(by_term.values()) == pytest.approx(
        result.summary["episode_return"], abs=1e-4
    )
    crashes = sum(row["crashed"] for row in result.episodes)
    paid = sum(row["return_crash"] for row in result.episodes)
    assert paid == pytest.approx(-2.5 * crashes)
    for row in result.episodes:  # they have one outcome and a length
        assert sum(row[name] for name in ENDINGS) == 1
        assert 1 <= row["length"] <= 30
        assert (row["length"] == 30) or not row["timed_out"]


def test_only_the_same_seed_gives_the_same_bits(run, result):
    again, other = (run(RANDOM, num_episodes=20, seed=seed) for seed in (3, 4))
    assert again.episodes == result.episodes
    assert other.episodes != result.episodes


def test_the_zero_policy_stands_until_time_is_up(run):
    found = run(ZERO, num_episodes=8, seed=0)
    assert found.summary["timed_out"]["rate"] == 1.0
    assert max(row["path"] for row in found.episodes) < 0.01  # m in 6 s on the brake


@pytest.mark.parametrize(
    ("shares", "lots", "counts"),
    [
        ([0.25] * 4, 4, [1] * 4),
        ([0.25, 0.5, 0.25], 8, [2, 4, 2]),
        ([1.0], 3, [3]),
        ([1 / 3] * 3, 10, [3, 4, 3]),
    ],
)
def test_members_of_a_mixture_get_their_shares_of_the_lots(shares, lots, counts):
    assert np.bincount(allot(shares, lots), minlength=len(shares)).tolist() == counts


class Watched(ParkingEnv):
    """Records the splits from which programs draw its lots."""

    asked: ClassVar[list[str]] = []

    def reset(self, key, split="train", *lot, **options):
        self.asked.append(split)
        return super().reset(key, split, *lot, **options)


def test_families_of_held_out_lots_are_summed_up_apart_and_add_up():
    street = StreetConfig(bays_per_side=(3, 4))
    config = EnvConfig(
        layout=mixture(["square_compact", street], [2, 1]),
        num_agents=1,
        num_parked_cars=1,
        episode=EpisodeConfig(max_steps=5),
    )
    env = Watched(config, SlidePhysics())
    run = functools.partial(evaluate, env, RANDOM, num_episodes=6, seed=3)
    mixed = run()
    of_lot = {row["lot"]: row["family"] for row in mixed.episodes}
    assert of_lot == dict(enumerate(["square_compact"] * 4 + ["street"] * 2))
    assert list(mixed.families) == ["square_compact", "street"]
    for name, summary in mixed.families.items():
        rows = [row for row in mixed.episodes if row["family"] == name]
        assert summary["episodes"] == len(rows)
        for outcome in ENDINGS:
            rate = summary[outcome]
            assert rate["count"] == sum(row[outcome] for row in rows)
            trials = effective_episodes(outcome, rows)
            expected = wilson_interval(rate["rate"] * trials, trials)
            assert (rate["low"], rate["high"]) == expected
    for outcome in ENDINGS:
        total = sum(summary[outcome]["count"] for summary in mixed.families.values())
        assert mixed.summary[outcome]["count"] == total
    assert run().episodes == mixed.episodes
    assert Watched.asked == ["test"]


@pytest.fixture(scope="module")
def run_crowds():
    """Evaluates in a mixture with rare members, with one or two agents."""
    config = EnvConfig(
        layout=mixture(["square", "square_compact", "street"], [47, 2, 1]),
        num_agents=2,
        min_agents=1,
        num_parked_cars=1,
        episode=EpisodeConfig(max_steps=1),
    )
    env = ParkingEnv(config, SlidePhysics())
    return functools.partial(evaluate, env, RANDOM, seed=0)


@pytest.fixture(scope="module")
def crowds(run_crowds):
    # The rarest member needs 2 of 100 lots for both numbers, which makes 150 agents.
    return run_crowds(num_episodes=700, num_lots=4)


@pytest.mark.parametrize("episodes", [1, 40])
def test_rare_members_get_lots_of_every_number_of_agents(episodes, run_crowds):
    found = run_crowds(num_episodes=episodes)
    driven = {(row["family"], row["agents_present"]) for row in found.episodes}
    assert len(driven) == 3 * 2


def test_every_number_of_agents_gets_the_same_number_of_lots(crowds):
    of_lot = {row["lot"]: row["agents_present"] for row in crowds.episodes}
    family = {row["lot"]: row["family"] for row in crowds.episodes}
    assert of_lot == dict(enumerate([1, 2] * 50))
    names = ["square"] * 94 + ["square_compact"] * 4 + ["street"] * 2
    assert family == dict(enumerate(names))
    counts = collections.Counter((row["lot"], row["agent"]) for row in crowds.episodes)
    present = {(lot, agent) for lot, n in of_lot.items() for agent in range(int(n))}
    assert counts == dict.fromkeys(present, 5)  # 700 over 150 agents, rounded up


def test_numbers_of_agents_are_summed_up_apart_and_add_up(crowds, result):
    parts = crowds.agent_counts
    assert [(n, part["episodes"]) for n, part in parts.items()] == [(1, 250), (2, 500)]
    assert crowds.summary["crashed"]["count"] > 0
    for outcome in ENDINGS:
        total = sum(part[outcome]["count"] for part in parts.values())
        assert crowds.summary[outcome]["count"] == total
    assert list(result.agent_counts) == [2]
    assert {row["agents_present"] for row in result.episodes} == {2}


def test_no_training_shares_its_key_with_an_evaluation():
    training, held_out = (
        {tuple(np.asarray(jax.random.key_data(key(seed)))) for seed in range(50)}
        for key in (training_key, evaluation_key)
    )
    assert len(training) == len(held_out) == 50
    assert not training & held_out


# Reports


BICYCLES = EnvConfig(physics="bicycle")


def test_what_is_written_adds_up_to_what_is_written(everything, tmp_path, capsys):
    table, data = write_evaluation(tmp_path, everything, {})
    words = ("family", "vehicle")
    rows = [
        {name: float(x) for name, x in row.items() if name not in words}
        for row in rows_of(table)
    ]
    stored = json.loads(data.read_text())
    assert json.dumps(summarize(rows)) == json.dumps(stored["summary"])  # NaN like NaN
    assert "families" not in stored  # of a single lot
    assert {row["family"] for row in everything.episodes} == {"square"}
    print_metrics(everything.summary)
    printed = capsys.readouterr().out
    for name in ("nearest car", "min collision time agent", "worst 5 %"):
        assert name in printed


def test_every_crash_stands_in_a_row_of_what_was_hit(capsys):
    hits = [f"hit_{kind.label}" for kind in ObstacleKind]
    nothing = {"length": 10.0, **dict.fromkeys((*ENDINGS, *hits), 0.0), "crashed": 1.0}
    rows = [complete_row(nothing | {hit: 1.0}, 0.2) for hit in hits]
    print_table(summarize(rows), "crowded")
    printed = capsys.readouterr().out
    found = re.findall(r"│ +(hit [a-z ]+?) +│.* (\d+) │", printed)
    assert found == [(hit.replace("_", " "), "1") for hit in hits]
    assert "more hits" not in printed
    both = complete_row(nothing | {"hit_wall": 1.0, "hit_person": 1.0}, 0.2)
    print_table(summarize([*rows, both]), "crowded")
    assert "1 more hits" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("part", "stem", "column", "names"),
    [
        ("families", "families", "family", ("square_compact", "street")),
        ("agent_counts", "agents_present", "agents_present", (1, 2)),
        ("vehicles", "vehicles", "vehicle", ("city", "van")),
    ],
)
def test_parts_have_summaries_and_a_printed_table(
    part, stem, column, names, everything, tmp_path, capsys
):
    thirds = (everything.episodes[:60], everything.episodes[60:])
    parts = dict(zip(names, map(summarize, thirds), strict=True))
    result = dataclasses.replace(everything, **{part: parts})
    write_evaluation(tmp_path, result, {})
    stored = json.loads((tmp_path / "evaluation.json").read_text())[stem]
    found = {name: part["episodes"] for name, part in stored.items()}
    assert found == {str(names[0]): 60, str(names[1]): 30}
    for part in stored.values():
        rates = [part[outcome]["rate"] for outcome in ENDINGS]
        assert sum(rates) == pytest.approx(1.0)
        assert part["parked"]["low"] <= rates[0] <= part["parked"]["high"]
    print_report(result, "a title")
    assert f"by {column.replace('_', ' ')}" in capsys.readouterr().out


def test_an_evaluation_is_written_before_it_is_printed(
    everything, tmp_path, monkeypatch
):
    monkeypatch.setattr(Console, "print", no_printing)
    with pytest.raises(BrokenPipeError):
        report(EvaluateConfig("zero"), BICYCLES, tmp_path, everything)
    assert (tmp_path / "evaluation.csv").exists()
    stored = json.loads((tmp_path / "evaluation.json").read_text())
    assert stored["settings"]["policy"] == "zero"


@pytest.mark.parametrize(
    ("flags", "name"),
    [
        ({"num_agents": 1, "seed": 3}, "num_agents-1_seed-3"),
        (
            {"rule": "strict", "layout": "street,my/yard.json"},
            "layout-street,my%2Fyard.json_rule-strict",
        ),
        ({"episodes": 4096, "horizon": 100.0}, "episodes-4096_horizon-100.0"),
        ({"layout": "my-yard.json"}, "layout-my-yard.json"),
        ({"movers": ("cart", "drivers:number=4")}, "movers-cart+drivers:number=4"),
    ],
)
def test_results_of_other_tasks_are_in_folders_by_flags(flags, name):
    found = subfolder(EvaluateConfig(run="runs/a", **flags))
    assert found == Path("evaluations") / name


def test_folders_of_long_flags_differ_and_can_be_made(tmp_path):
    layouts = [",".join(["street"] * 60 + [last]) for last in ("lot", "angled")]
    found = {subfolder(EvaluateConfig("runs/a", layout=name)) for name in layouts}
    assert len(found) == 2
    for folder in found:
        (tmp_path / folder).mkdir(parents=True)


def test_names_are_printed_as_they_are(everything, capsys):
    name = "x[/red][b]"
    print_table(everything.summary, name)
    print_groups("family", {name: everything.summary, "all": everything.summary})
    printed = capsys.readouterr().out
    assert f"{name}:" in printed
    assert f"│ {name} " in printed
