"""The suite: one episode in every case, and what its table says of them."""

import dataclasses
import math

import jax
import numpy as np
import pytest
from helpers.cases import AMONG, episode

from carpark_mj.env import ParkingEnv
from carpark_mj.layouts import make_layout
from carpark_mj.policy.named import zero_policy
from carpark_mj.registry import ANYWHERE
from carpark_mj.suite.evaluation import CaseEvaluator, suite_env
from carpark_mj.suite.levels import load_held_out, pick_cases
from carpark_mj.suite.page import write_test_page
from carpark_mj.suite.report import (
    header,
    shown_cells,
    table_rows,
    tables_of,
    worst_first,
    write_tables,
)
from carpark_mj.suite.results import key_of


def test_every_case_gives_one_row_from_its_own_start():
    config = suite_env(ANYWHERE, "precise")
    assert config.episode.max_steps * config.sim.ctrl_dt == pytest.approx(100.0)
    short = dataclasses.replace(config.episode, max_steps=3)
    env = ParkingEnv(dataclasses.replace(config, episode=short))
    evaluator, policy = CaseEvaluator(env), zero_policy(env.action_spec)
    programs = evaluator._reset, evaluator._chunk, evaluator._choose_actions
    evaluator._choose_actions.clear_cache()  # other files have their programs in it
    rows, drives = evaluator.drive(policy, pick_cases("complex", 4), seed=0)
    assert [row["case"] for row in rows] == [0, 1, 2, 3]
    assert [row["kind"] for row in rows] == ["perpendicular", "parallel"] * 2
    assert [row["timed_out"] for row in rows] == [1.0] * 4
    # A car that stands still ends where the case starts.
    layouts = load_held_out("complex")[0]
    start = np.asarray(layouts.spawn_pose)[:4, 0]
    np.testing.assert_allclose(drives.pose_w[:, 2, 0, -1], start, atol=2e-3)
    gap = np.asarray(layouts.spawn_pose - layouts.bay_pose)[:4, 0, :2]
    expected = np.hypot(*gap.T)
    ends = [row["final_distance"] for row in rows]
    np.testing.assert_allclose(ends, expected, atol=2e-3)
    # Another level and another seed take the same programs, and so does a decision.
    assert evaluator.decision_time(policy, pick_cases("complex", 4)) > 0
    others, _ = evaluator.drive(policy, pick_cases("extreme", 4), seed=1)
    assert [row["level"] for row in others] == ["extreme"] * 4
    assert [program._cache_size() for program in programs] == [1, 1, 1]


def test_a_part_of_a_level_has_the_cases_of_the_level():
    whole, part = pick_cases("complex", 1000), pick_cases("complex", 3, first=501)
    assert part.number.tolist() == [501, 502, 503]
    assert part.kind.tolist() == ["parallel", "perpendicular", "parallel"]
    expected = jax.tree.map(lambda x: x[501:504], whole.layouts)
    jax.tree.map(np.testing.assert_array_equal, part.layouts, expected)


def test_tpcap_s_cases_go_by_their_published_numbers():
    part = pick_cases("tpcap", 3, first=6)
    assert part.number.tolist() == [7, 8, 9]
    bay = make_layout("tpcap_8").bay_pose
    np.testing.assert_allclose(part.layouts.bay_pose[1], bay, atol=1e-6)


def test_the_table_counts_by_kind_and_compares_paths():
    rows = [
        episode(0, kind="perpendicular", path=12.0),
        episode(1, end="crashed", path=3.0),
        episode(2, kind="perpendicular", path=8.0),
        episode(3, path=9.0),
    ]
    for number, length in enumerate((10.0, 10.0, 10.0, math.nan)):
        rows.append(episode(number, policy="planner", planned_path=length))
    table = {row["kind"]: row for row in table_rows("x", rows)}
    assert list(table) == ["parallel", "perpendicular", "all"]
    assert table["all"]["cases"] == 4
    assert table["all"]["parked"] == 0.75
    # Wilson, 3 of 4.
    assert table["all"]["low"] == pytest.approx(0.3006, abs=1e-4)
    assert table["parallel"]["crashed"] == 0.5
    assert table["perpendicular"]["path / planned"] == pytest.approx(1.0)
    assert math.isnan(table["parallel"]["path / planned"])
    assert table["all"]["off by [deg]"] == pytest.approx(math.degrees(0.1))
    assert table["all"]["decisions/s"] == 500.0


def test_seeds_add_episodes_and_not_cases():
    rows = [episode(n) for n in range(4)]
    rows += [episode(n, end="crashed", seed=1) for n in range(4)]
    # With this seed the planner found a path of another length.
    rows.append({**rows[0], "policy": "planner", "planned_path": 4.5})
    rows.append({**rows[4], "policy": "planner", "planned_path": 1.0})
    (row,) = table_rows("x", rows)
    assert (row["cases"], row["seeds"]) == (4, 2)
    assert (row["parked"], row["by seed"]) == (0.5, [1.0, 0.0])
    assert row["path / planned"] == pytest.approx(2.0)
    # Wilson, 2 of 4.
    assert row["low"] == pytest.approx(0.1500, abs=1e-4)


def test_the_table_says_what_cars_hit_and_how_fast():
    among = AMONG | {"least_gap": 2.0}
    person = {"hit_person": 1.0, "contact_speed": 1.5, "least_gap": 0.0}
    mover = {"hit_mover": 1.0, "contact_speed": 0.5, "least_gap": 0.0}
    rows = [
        episode(0, "busy", **among),
        episode(1, "busy", **among | {"near_miss": 1.0}),
        episode(2, "busy", "crashed", **among | person),
        episode(3, "busy", "crashed", **among | mover),
    ]
    (row,) = table_rows("x", rows)
    assert (row["hit person"], row["hit mover"], row["near miss"]) == (0.25,) * 3
    assert (row["fastest contact [m/s]"], row["least gap [m]"]) == (1.5, 1.0)
    assert "4 of busy (0 to 3)" in header(rows)[1]


def test_files_hold_the_table_the_worst_and_videos(tmp_path):
    episodes = [episode(0), episode(7, end="crashed")]
    (row,) = table_rows("x", episodes)
    files = write_tables(tmp_path, header(episodes), [row])
    assert [path.name for path in files] == ["suite.md", "suite.csv"]
    page = files[0].read_text()
    assert "2 of normal (0, 7); seed 0; on cpu." in page
    assert "| x | normal | parallel | 2 | 1 | 50.0 (9.5 … 90.5) | – |" in page
    film = tmp_path / "videos" / "x-normal-0-7.mp4"
    film.parent.mkdir()
    film.write_text("film")
    films = {key_of(episodes[1]): film}
    write_test_page(tmp_path / "suite.html", episodes, films)
    html = (tmp_path / "suite.html").read_text()
    worst = html[html.index("Worst of x, normal") :]
    assert worst.index("<td>7</td>") < worst.index("<td>0</td>")
    assert "case 7, seed 0" in worst
    assert shown_cells(row)["path found [%]"] == "–"
    assert "path found" not in html  # of no row here
    late, slow = episode(1, end="timed_out"), episode(2, length=300.0)
    order = [row["case"] for row in worst_first([slow, *episodes, late])]
    assert order == [7, 1, 2, 0]
    (cells,) = tables_of([row | {"level": "scenario:/a/b.yaml:4"}])["Results"]
    assert cells["level"] == "scenario:b.yaml:4"
