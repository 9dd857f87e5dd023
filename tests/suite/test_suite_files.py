"""Results of the suite that several processes have written, read together."""

import json

import numpy as np
import pytest
from helpers import cases
from helpers.cases import drives
from helpers.disks import no_printing
from rich.console import Console

from carpark_mj.rendering.gl import choose_gl
from carpark_mj.suite.evaluation import SuiteConfig, main
from carpark_mj.suite.levels import load_held_out
from carpark_mj.suite.report import FASTER, make_videos, recording_of
from carpark_mj.suite.results import CASES_FILE, key_of, read_runs, write_run
from carpark_mj.suite.tpcap import load_tpcap


def episode(case, seed=0, level="extreme", end="timed_out", **more):
    return cases.episode(case, level, end, seed=seed, **more)


def write(folder, *rows):
    folder.mkdir()
    write_run(folder, rows, {key_of(rows[-1]): drives(round(rows[-1]["length"]))})
    return folder


def test_what_processes_wrote_is_read_together(tmp_path):
    planned = episode(1, policy="planner", planned=1.0, planned_path=float("nan"))
    first = [episode(0), planned]
    folders = [write(tmp_path / "a", *first), write(tmp_path / "b", episode(3, 1))]
    episodes, kept = read_runs(folders)
    assert episodes[0] == first[0]  # what a row lacks it lacks again
    assert episodes[1] == pytest.approx(first[1], nan_ok=True)
    assert [(row["seed"], row["case"]) for row in episodes] == [(0, 0), (0, 1), (1, 3)]
    assert list(kept) == [("planner", "extreme", 0, 1), ("x", "extreme", 1, 3)]
    for mine, read in zip(drives(7), kept["x", "extreme", 1, 3], strict=True):
        np.testing.assert_array_equal(read, mine)
    # Together again: the shorter drive is filled up, and what follows means nothing.
    (tmp_path / "c").mkdir()
    write_run(tmp_path / "c", episodes, kept)
    again, both = read_runs([tmp_path / "c"])
    assert [row["case"] for row in again] == [0, 1, 3]
    assert both["planner", "extreme", 0, 1].speed.shape == (1, 7, 1)
    recording = recording_of(again[1], both["planner", "extreme", 0, 1])
    assert recording.pose_w.shape == (5, 2, 1, 3)
    assert recording.timed_out[:, 0].tolist() == [False] * 4 + [True]
    layout = load_held_out("extreme")[0]
    np.testing.assert_array_equal(recording.layout.bay_pose, layout.bay_pose[1])
    assert recording.goal[-1].tolist() == [0]
    recording = recording_of(episode(8, level="tpcap"), drives(12))  # they begin with 1
    np.testing.assert_array_equal(recording.layout.bay_pose, load_tpcap().bay_pose[7])


def test_combining_makes_the_table_of_all(tmp_path, capsys, monkeypatch):
    rows = [episode(0), episode(1), episode(0, 1, end="parked"), episode(1, 1)]
    rows = [row | {"vehicle": "compact"} for row in rows]  # another car
    folders = [write(tmp_path / "a", *rows[:2]), write(tmp_path / "b", *rows[2:])]
    # Another device is no other version.
    second = folders[1] / CASES_FILE
    second.write_text(second.read_text().replace("cpu", "gpu"))
    out = tmp_path / "out"
    config = SuiteConfig(combine=tuple(map(str, folders)), out=str(out))
    with monkeypatch.context() as terminal:
        terminal.setattr(Console, "print", no_printing)
        with pytest.raises(BrokenPipeError):
            main(config)
    names = {"worst.npz", *(f"suite.{x}" for x in ("md", "csv", "html", "json"))}
    names.add("cases.csv")
    assert {path.name for path in out.iterdir()} == names  # before it is printed
    # A film of earlier drives is of no case here.
    old = out / "videos" / "x-extreme-0-0.mp4"
    old.parent.mkdir()
    old.write_text("film")
    (row,) = main(config)
    assert "<video" not in (out / "suite.html").read_text()
    assert (row["cases"], row["seeds"], row["parked"]) == (2, 2, 0.25)
    assert row["by seed"] == [0.0, 0.5]
    for said in ("seeds 0, 1", "vehicle compact"):
        assert said in (out / "suite.md").read_text()
    assert json.loads((out / "suite.json").read_text())["vehicle"] == "compact"
    assert len(read_runs([out])[0]) == 4
    assert "suite.html" in capsys.readouterr().out
    with pytest.raises(ValueError, match="must not be one of the combined"):
        main(SuiteConfig(combine=(str(out),), out=str(out)))


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([episode(0)], "repeats case 0 of extreme by x with seed 0"),
        ([episode(1, rule="precise")], "different rules"),
        ([episode(1, vehicle="compact")], "of different cars"),
        ([episode(1, made_with="cpu, jax 0")], "x with different versions"),
        ([episode(1, held_out="0")], "other held-out cases, '0'"),
        ([episode(1000)], "line 2: there is no case 1000 of level 'extreme'"),
        ([episode(2), episode(1, length="")], "line 3: length must be .*''"),
        ([episode(1, length=0.0)], "line 2: length must be positive"),
    ],
)
def test_results_that_do_not_fit_are_refused(rows, message, tmp_path):
    rows, last = [*rows[:-1]], rows[-1]
    good = write(tmp_path / "good", episode(0))
    bad = write(tmp_path / "bad", *rows, episode(9))
    write_run(bad, [*rows, last], {key_of(last): drives(1004)})
    with pytest.raises(ValueError, match=message):
        read_runs([good, bad])


def test_videos_are_faster_than_driving_and_each_run_has_its_own(tmp_path):
    import imageio_ffmpeg

    assert choose_gl() is None, "this machine cannot render"
    names = ("runs/a/best", "runs/b/best", "runs/b-best")
    # 4 s, and then the last picture for 1 s.
    rows = [episode(0, policy=name, length=20.0) for name in names]
    videos = make_videos(tmp_path, rows, dict.fromkeys(map(key_of, rows), drives(20)))
    assert len({*videos.values()}) == 3
    for path in videos.values():
        data = next(imageio_ffmpeg.read_frames(str(path)))
        assert data["duration"] == pytest.approx(4.0 / FASTER + 1.0, abs=0.2)
