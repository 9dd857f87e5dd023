"""Runs put together: points, tables, pictures, the page, and what is refused."""

import dataclasses
import math
import re
from pathlib import Path
from urllib.parse import unquote, urlsplit

import numpy as np
import pytest
from helpers.disks import no_printing
from helpers.programs import assert_refused, exit_code, rows_of
from helpers.sweeping import write_run
from rich.console import Console

from carpark_mj.analysis import (
    Record,
    flat_metrics,
    group,
    read_curve,
    read_run,
    run_folders,
    run_rows,
    spread,
    spread_rows,
    videos,
)
from carpark_mj.cli.analysis import analyse
from carpark_mj.training.ppo.parts import PRESETS

BASE = PRESETS["square"]


def record(agents, seed, parked, **settings):
    settings = {"env.num_agents": agents, **settings}
    return Record(f"a{agents}-{seed}", settings, {"parked": parked}, seed)


PARKED = ((10, 0, 0.5), (10, 1, 0.49), (10, 2, 0.51), (2, 1, 0.85), (2, 0, 0.9))
RECORDS = [record(*row) for row in (*PARKED, (2, 2, 0.1))]


def make_runs(folder, counts=(1, 2), seeds=2):
    """Evaluated runs with curves."""
    for agents in counts:
        env = dataclasses.replace(BASE.env, num_agents=agents)
        for seed in range(seeds):
            run = folder / f"a{agents}-{seed}"
            config = dataclasses.replace(BASE, env=env, seed=seed)
            write_run(
                run, config, crashed=0.1 * agents + 0.01 * seed, timed_out=0.0, length=3
            )
            (run / "metrics.csv").write_text(
                "update,env_steps,episodes,episode/parked\n"
                f"1,100,0,0.0\n2,200,5,0.{agents}\n3,300,5,0.5\n4,400,"
            )
    return sorted(str(path) for path in folder.iterdir())


def test_runs_of_equal_settings_are_a_point_in_order():
    points = group({"ours": RECORDS}, ["env.num_agents"])
    assert [point.values for point in points] == [(2.0,), (10.0,)]
    assert points[0].numbers("parked") == [0.9, 0.85, 0.1]
    assert math.isnan(points[0].numbers("length")[0])


def test_published_text_and_our_numbers_are_the_same_setting():
    other = dataclasses.replace(RECORDS[0], settings={"env.num_agents": "10"})
    ours, theirs = group({"ours": RECORDS[:1], "theirs": [other]}, ["env.num_agents"])
    assert ours.values == theirs.values


def test_the_tables_have_every_run_and_every_point():
    points = group({"ours": RECORDS}, ["env.num_agents"])
    rows = spread_rows(points, ["env.num_agents"], ["parked"])
    found = [(row["env.num_agents"], row["runs"], row["median"]) for row in rows]
    assert found == [("2", 3, 0.85), ("10", 3, 0.5), ("all", 6, pytest.approx(0.505))]
    each = run_rows(points, ["env.num_agents"], ["parked"])
    assert [row["parked"] for row in each] == [0.9, 0.85, 0.1, 0.5, 0.49, 0.51]


def test_an_analysis_is_written_before_it_is_printed(tmp_path, monkeypatch):
    monkeypatch.setattr(Console, "print", no_printing)
    with pytest.raises(BrokenPipeError):
        analyse({"ours": RECORDS}, ["env.num_agents"], ["parked"], tmp_path, "gone")
    assert {"report.html", "parked.png"} <= {path.name for path in tmp_path.iterdir()}


def test_a_summary_becomes_one_number_per_name():
    summary = {"parked": {"rate": 0.5, "low": 0.4}, "length": 3, "jerk": {"p95": 2.0}}
    assert flat_metrics(summary) == {"parked": 0.5, "length": 3.0, "jerk_p95": 2.0}


def test_a_curve_skips_updates_without_episodes(tmp_path):
    make_runs(tmp_path, (1,), 1)
    assert read_curve(tmp_path / "a1-0", "episode/parked") == [(200, 0.1), (300, 0.5)]
    assert read_curve(tmp_path / "a1-0", "other") == []


def test_a_run_is_read_with_its_settings_seed_and_versions(tmp_path):
    make_runs(tmp_path)
    found = read_run(tmp_path / "a2-1")
    assert found.settings["env.num_agents"] == 2
    assert found.settings["env.reward.park"] == BASE.env.reward.park
    assert (found.seed, found.metrics["parked"]) == (1, 0.5)
    assert found.versions["jax"]


def test_the_command_leaves_tables_pictures_and_one_page(tmp_path, capsys):
    runs = make_runs(tmp_path / "runs")
    (tmp_path / "runs" / "a1-0" / "video.mp4").touch()
    out = tmp_path / "out"
    assert exit_code("analysis", [*runs, "--out", str(out)]) == 0
    assert "env.num_agents" in capsys.readouterr().out
    assert [row["env.num_agents"] for row in rows_of(out / "runs.csv")] == [*"1122"]
    for name in ("parked", "crashed", "length", "curve_parked"):
        assert (out / f"{name}.png").read_bytes()[:4] == b"\x89PNG"
    page = (out / "report.html").read_text()
    assert "Interquartile means" in page
    sources = re.findall(r'src="([^"]{11})', page)
    assert len(sources) == 5
    assert {*sources} == {"data:image/"}
    assert 'href="../runs/a1-0/video.mp4"' in page


def test_text_in_the_page_is_escaped(tmp_path):
    bad = [dataclasses.replace(RECORDS[0], name="<b>&")]
    page = analyse({"<i>": bad}, [], ["parked"], tmp_path, "a<b").read_text()
    assert "<b>&" not in page
    assert "<i>" not in page
    assert "&lt;b&gt;&amp;" in page


def test_two_sources_and_settings_that_are_words_can_be_drawn(tmp_path):
    words = [record("few", 0, 0.3), record("many", 0, 0.4), record("many", 1, math.nan)]
    sources = {"ours": words, "published": words[:1]}
    analyse(sources, ["env.num_agents"], ["parked"], tmp_path, "words")
    assert (tmp_path / "parked.png").exists()


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        ("nowhere", "nowhere is neither a run nor a sweep"),
        ("a1-0 --by env.colour", "no run has a setting 'env.colour'"),
        ("a1-0 --metrics joy", "no run has a metric 'joy'; there are"),
        ("a1-0 --out a1-0/config.json", "cannot use a1-0/config.json"),
    ],
)
def test_bad_input_is_one_sentence(flags, said, tmp_path, monkeypatch, capsys):
    make_runs(tmp_path)
    monkeypatch.chdir(tmp_path)
    assert_refused(capsys, "analysis", flags.split(), said)


def test_a_run_that_is_given_twice_counts_once(tmp_path):
    names = make_runs(tmp_path / "runs", (1,), 2)
    (tmp_path / "sweep.json").write_text('{"swept": []}')
    again = [tmp_path, *names, f"{names[0]}/../a1-0", names[1]]
    assert sorted(run_folders([*map(Path, again)])) == [*map(Path, names)]


DAMAGED = [
    ("config.json", '{"config": []}', "config.json has no 'config'"),
    ("evaluation.json", '{"summary": {"parked": {"rate": "x"}}}', "could not convert"),
    ("evaluation.json", None, "no evaluation.json in"),
]


@pytest.mark.parametrize(("file", "text", "said"), DAMAGED)
def test_a_damaged_run_is_named_and_left_out(file, text, said, tmp_path, capsys):
    runs = make_runs(tmp_path)
    if text is None:
        (tmp_path / "a1-0" / file).unlink()
    else:
        (tmp_path / "a1-0" / file).write_text(text)
    assert exit_code("analysis", [*runs, "--out", str(tmp_path / "out")]) == 0
    told = capsys.readouterr().out
    assert f"{tmp_path / 'a1-0'}" in told
    assert said in told


def test_links_lead_to_files_whatever_their_names(tmp_path):
    folder = tmp_path / "layout=a%2Fb.json,seed=0#?"
    folder.mkdir()
    (folder / "video.mp4").touch()
    run = dataclasses.replace(RECORDS[0], folder=folder)
    [link] = re.findall('href="([^"]*)"', videos(tmp_path / "a.html", [run]))
    assert urlsplit(link)[3:] == ("", "")  # neither a query nor a fragment
    assert tmp_path / unquote(link) == folder / "video.mp4"


RNG = np.random.default_rng(7)


def test_the_interquartile_mean_is_that_of_the_middle_half():
    values = [100.0, -20.0, 2.0, 3.0, 4.0, -50.0, 5.0, 60.0]
    assert spread([values]).iqm == pytest.approx((2 + 3 + 4 + 5) / 4)
    assert spread([[1.0, 2.0, 6.0]]).iqm == pytest.approx(3.0)


def test_a_spread_says_how_many_and_what_is_in_the_middle():
    found = spread([[1.0, 2.0, math.nan], [4.0]])
    assert (found.runs, found.median) == (3, 2.0)
    assert found.low <= found.iqm <= found.high
    found = spread([[0.5, 0.5, 0.5]])  # equal runs: no width
    assert (found.low, found.iqm, found.high) == (0.5, 0.5, 0.5)
    one = spread([[3.0]])  # no interval
    assert (one.iqm, one.median) == (3.0, 3.0)
    assert math.isnan(one.low)
    assert math.isnan(one.high)
    none = spread([[math.nan], []])
    assert none.runs == 0
    assert math.isnan(none.iqm)


def test_intervals_hold_the_truth_about_as_often_as_they_say():
    held = 0
    for _ in range(200):
        found = spread([RNG.normal(5.0, 1.0, 20)])
        held += found.low <= 5.0 <= found.high
    assert 170 <= held <= 199  # 95 %, and a bootstrap of few is a little narrow


def test_strata_keep_differences_out_of_the_interval():
    near, far = RNG.normal(0.0, 0.01, 8), RNG.normal(10.0, 0.01, 8)
    apart, mixed = spread([near, far]), spread([np.concatenate([near, far])])
    assert apart.iqm == mixed.iqm
    assert apart.high - apart.low < 0.1
    assert mixed.high - mixed.low > 3.0
