"""Scenarios: what the file says happens, repetitions keep to their spreads."""

import dataclasses
import math
import re
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
import yaml
from helpers.pages import ROOT, code
from helpers.programs import assert_refused, layouts, rows_of

from carpark_mj.cli.settings.tables import ScenarioConfig
from carpark_mj.geometry import to_local
from carpark_mj.layouts import make_layout
from carpark_mj.layouts.files import read_json
from carpark_mj.layouts.types import BayEnd
from carpark_mj.registry import FIRST
from carpark_mj.suite import actors, evaluation, scenario
from carpark_mj.suite.levels import find_level, pick_cases
from carpark_mj.suite.scenario import make_scenario, read_scenario

CHILD = ROOT / "examples" / "scenarios" / "child.yaml"
LOT = "square_compact"
LEAST = {"lot": LOT, "start": [0.0, 0.0, 0.0], "goal": 6}
WALKER = {"kind": "person", "start": [0.0, 0.0], "to": [0.0, 5.0]}


def test_repetitions_keep_to_their_spreads():
    child = read_scenario(CHILD)
    cases = child.pick(slice(None))
    pose, (script,) = np.asarray(cases.start.options.pose)[:, 0], cases.start.movers
    np.testing.assert_allclose(pose[0], child.start)
    off = np.abs(pose - child.start)
    assert (off[1:].max(axis=0) < [0.1001, 0.1001, 0.0201]).all()
    assert (off[1:].max(axis=0) > [0.09, 0.09, 0.018]).all()  # all of the range
    assert np.ptp(script.near) == pytest.approx(2.0, abs=0.1)
    assert (script.near[0], script.speed[0]) == (6.0, 1.5)
    assert np.ptp(script.start, axis=0).max() == 0.0  # has no spread
    # The first repetitions do not depend on how many follow.
    fewer = dataclasses.replace(child, repetitions=3).pick(slice(1, 3))
    np.testing.assert_array_equal(fewer.start.options.pose[:, 0], pose[1:3])


def test_a_mover_between_bays_walks_out_of_their_gap():
    layout = make_layout(LOT)
    data = LEAST | {"movers": [{"between": [3, 4], "speed": 2.0}]}
    (walker,) = make_scenario(data).scripts
    script = walker.init(jax.random.key(0), layout)
    for bay, side in ((3, -1.0), (4, 1.0)):
        local = np.asarray(to_local(layout.bay_pose[bay], script.start))
        length, width = np.asarray(layout.bay_size[bay])
        assert local[1] == pytest.approx(side * width / 2, abs=1e-4)
        assert local[0] == pytest.approx(length / 2 - actors.BEHIND, abs=1e-4)
    moved = dataclasses.replace(script, clock=jnp.float32(1.0)).pose - script.start
    out = layout.bay_pose[3, 2]
    np.testing.assert_allclose(
        moved[:2], 2.0 * np.array([np.cos(out), np.sin(out)]), atol=1e-5
    )


def test_a_goal_of_its_own_is_one_more_bay():
    pose = [1.0, 2.0, 0.5]
    made = make_scenario(LEAST | {"goal": {"pose": pose, "end": "tail_first"}})
    before, after = make_layout(LOT), made.layout
    assert made.goal_bay == before.num_bays
    np.testing.assert_allclose(after.bay_pose[-1], pose)
    assert after.bay_end[-1] == BayEnd.TAIL_FIRST
    assert not after.bay_end[:-1].any()
    np.testing.assert_array_equal(after.bay_pose[:-1], before.bay_pose)
    assert after.goal_mask[-1]


def way(*path, **more):
    return {"movers": [{"start": [0.0, 0.0], "path": [*path]} | more]}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"lot": "nowhere"}, "layout 'nowhere'"),
        ({"lot": {"bays": 3}}, "lot must"),
        ({"start": [0.0, 0.0, 90.0]}, "heading of start"),
        ({"speed": 40.0}, "speed must lie in [-2, 3]"),
        ({"goal": 99}, "goal must be a bay of the lot"),
        ({"goal": {"pose": [0.0, 0.0, 0.0], "size": [4.0, 2.5]}}, "the goal's bay, 4"),
        ({"parked": [6]}, "parked must be distinct bays other than the goal"),
        ({"rule": {"distance": -1.0}}, "rule: distance"),
        ({"weather": "rain"}, "setting 'weather'"),
        ({"spread": {"place": -0.1}}, "spread: place"),
        ({"movers": [WALKER, WALKER | {"between": [1, 2]}]}, "movers[1]: a mover"),
        ({"movers": [WALKER | {"kind": "cloud"}]}, "kind 'cloud'"),
        ({"movers": [{"between": [1, 99]}]}, "between must be a bay"),
        ({"movers": [{"start": [0.0, 0.0], "near": 2.0}]}, "no trigger"),
        ({"movers": [WALKER | {"heading": 1.0}]}, "leave heading out"),
        (way([1.0]), "path must have rows"),
        (way([0.0, 0.0]), "points of a way"),
        (way([1, 2], [3, 4, 1.0, 0.1]), "all with headings or none"),
        ({"settings": {"num_agents": 3}}, "settings must leave num_agents"),
        ({"settings": {"sim.steering_delai": 0.2}}, "steering-delai"),
    ],
    ids=str,
)
def test_wrong_entries_are_refused(change, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("bad.yaml").write_text(yaml.safe_dump(LEAST | change))
    told = assert_refused(capsys, "scenario", ["bad.yaml", "zero"], said)
    assert told.startswith("scenario: bad.yaml: ")
    assert not Path("runs").exists()


def test_a_random_lot_is_that_of_the_command(tmp_path):
    path = tmp_path / "lot.json"
    assert layouts(["lot", "--seed", "3", "--save", str(path)]) == 0
    data = {"lot": "lot", "seed": 3, "start": [0.0, 0.0, 0.0], "goal": 1}
    drawn, saved = make_scenario(data).layout, read_json(path)
    np.testing.assert_allclose(
        drawn.bay_pose[drawn.bay_mask], saved.bay_pose[saved.bay_mask], atol=1e-5
    )


def poses(scripts, clocks):
    """(scripts, clocks, 3) of scripts so many seconds after they set out."""
    states = [one.init(jax.random.key(0), None) for one in scripts]
    place = [
        jax.vmap(lambda t, state=state: dataclasses.replace(state, clock=t).pose)
        for state in states
    ]
    return np.stack([np.asarray(at(jnp.asarray(clocks, jnp.float32))) for at in place])


def test_movers_go_through_their_points_at_their_speeds():
    path = [[4.0, 0.0, 2.0], [4.0, 6.0], [1.0, 6.0, 0.5]]
    walker = {"start": [0.0, 0.0], "path": path, "speed": 1.5}
    data = [walker, walker | {"kind": "car", "returns": True, "pause": 2.0}]
    scripts = make_scenario(LEAST | {"movers": data}).scripts
    line = shapely.LineString([(0, 0), *[row[:2] for row in path]])
    # 2 s for 4 m, 4 s for 6 m, 6 s for 3 m.
    clocks = np.array([0.0, 1.0, 2.0, 3.0, 6.0, 9.0, 12.0, 20.0])
    along = np.interp(clocks, [0.0, 2.0, 6.0, 12.0], [0.0, 4.0, 10.0, 13.0])
    drawn = shapely.get_coordinates(shapely.line_interpolate_point(line, along))
    there, car = poses(scripts, clocks)
    np.testing.assert_allclose(there[:, :2], drawn, atol=1e-5)
    # It turns within a metre of a corner, and is back after the pause.
    yaw = poses(scripts[:1], [1.0, 1.5, 2.0, 2.0 + 1.0 / 1.5, 5.0])[0, :, 2]
    expected = np.pi * np.array([0.0, 0.0, 0.25, 0.5, 0.5])
    np.testing.assert_allclose(yaw, expected, atol=1e-5)
    np.testing.assert_allclose(car[:7, :2], there[:7, :2], atol=1e-5)
    back = poses(scripts[1:], [14.0 + 6.0 + 1.0, 40.0])[0]
    np.testing.assert_allclose(back, [[4.0, 4.5, np.pi / 2], [0, 0, 0]], atol=1e-5)


def test_headings_of_a_path_are_those_of_its_points():
    """A car backs out of a bay and drives on."""
    path = [[0.0, 3.0, 1.0, -1.6], [4.0, 4.0, 2.0, 0.0]]
    car = {"kind": "car", "start": [0.0, 0.0], "heading": -1.6, "path": path}
    scripts = make_scenario(LEAST | {"movers": [car]}).scripts
    half = 3.0 + math.hypot(4.0, 1.0) / 4  # s
    there = poses(scripts, [0.0, 3.0, half, 9.0])[0]
    np.testing.assert_allclose(there[:, 2], [-1.6, -1.6, -0.8, 0.0], atol=1e-5)
    np.testing.assert_allclose(there[2, :2], [2.0, 3.5], atol=1e-5)


def test_spreads_turn_and_hasten_whole_paths():
    path = [[4.0, 0.0], [4.0, 6.0, 3.0]]
    walker = {
        "start": [1.0, 2.0],
        "path": path,
        "spread": {"heading": 0.3, "speed": 0.5},
    }
    made = make_scenario(LEAST | {"movers": [walker], "repetitions": 3})
    (script,) = made.pick(slice(None)).start.movers
    first, *others = (
        jax.tree.map(lambda leaf, row=row: leaf[row], script) for row in range(3)
    )
    times = jnp.array([0.5, 1.5, 3.0])

    def at(one, times):
        place = jax.vmap(lambda t: dataclasses.replace(one, clock=t).pose)
        return (np.asarray(place(times))[:, :2] - [1.0, 2.0]) @ [1, 1j]

    for one in others:
        turn = float(one.direction - first.direction)
        faster = float(one.speed / first.speed)
        assert (turn, faster) != (0.0, 1.0)
        expected = at(first, faster * times) * np.exp(1j * turn)
        np.testing.assert_allclose(at(one, times), expected, atol=1e-4)


def test_repetitions_of_a_flag_replace_those_of_the_file():
    name = f"scenario:{CHILD}"
    own, more = (find_level(level) for level in (name, f"{name}:150"))
    assert (len(own.numbers), len(more.numbers)) == (100, 150)
    few, many = (level.pick(slice(0, 3)).start.options for level in (own, more))
    np.testing.assert_array_equal(few.pose, many.pose)
    assert own.sha256 != more.sha256


def test_a_scenario_is_driven_as_written(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    ways = {"start": [-4.0, 4.0], "to": [4.0, 4.0], "speed": 2.0}
    data = LEAST | {
        "parked": [5, 7],
        "rule": {"distance": 0.1},
        "seconds": 4.0,
        "repetitions": 5,
        "movers": [WALKER | ways | {"yields": False, "after": 1.0}],
        "settings": {"physics": "bicycle"},
    }
    Path("mine.yaml").write_text(yaml.safe_dump(data))
    cases = pick_cases("scenario:mine.yaml", 2)
    evaluators = []
    made = evaluation.CaseEvaluator

    def kept(*arguments):
        evaluators.append(made(*arguments))
        return evaluators[-1]

    monkeypatch.setattr(evaluation, "CaseEvaluator", kept)
    config = ScenarioConfig("mine.yaml", ("zero",), repetitions=2, videos=0, out="out")
    rows = scenario.main(config)
    assert [(row["cases"], row["timed out"]) for row in rows] == [(2, 1.0)]  # it stands
    (evaluator,) = evaluators
    config = evaluator.env.config
    assert config.physics_config.back_end == "bicycle"
    assert config.episode.max_steps * config.sim.ctrl_dt == pytest.approx(4.0)
    keys = jax.random.split(jax.random.key(0), 2)
    state, _ = evaluator._reset(cases.layouts, keys, cases.start)
    np.testing.assert_array_equal(state.parked_cars.bay, [[5, 7], [5, 7]])
    layout = make_layout(LOT)
    np.testing.assert_allclose(
        state.parked_cars.pose_w[0], layout.parked_pose[np.array([5, 7])], atol=1e-6
    )
    np.testing.assert_allclose(state.motion.pose_w[0, 0], data["start"], atol=1e-5)
    first = rows_of(Path("out/cases.csv"))[0]
    assert first["vehicle"] == "compact"
    assert "distance-0_1" in first["rule"]


def test_other_libraries_policies_observe_as_in_their_environment(
    tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    Path("mine.yaml").write_text(yaml.safe_dump(LEAST))
    Path("still.py").write_text("def act(seen): return 0 * seen[:, :2]\n")
    seen = []

    def made(env, filmed):
        seen.append((env.config.observation, env.config.physics))
        raise InterruptedError

    monkeypatch.setattr(evaluation, "CaseEvaluator", made)
    names = ("function:still:act",)
    config = ScenarioConfig("mine.yaml", names, environment="first", out="out")
    with pytest.raises(InterruptedError):
        scenario.main(config)
    assert seen == [(FIRST.observation, FIRST.physics)]


def test_a_start_in_a_wall_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    layout = make_layout(LOT)
    wall = [float(x) for x in layout.wall_pose[0]]
    Path("wall.yaml").write_text(
        yaml.safe_dump(LEAST | {"start": wall, "settings": {"physics": "bicycle"}})
    )
    with pytest.raises(ValueError, match="impossible start"):
        scenario.main(ScenarioConfig("wall.yaml", ("zero",), out="out"))


def test_the_example_of_the_page_is_read(tmp_path, monkeypatch):
    """As the page says it is made: from a part of a map and a data sheet."""
    monkeypatch.chdir(tmp_path)
    names = "scenarios", "own_lot"
    page, own = ((ROOT / "docs" / f"{x}.md").read_text() for x in names)
    Path("my_car.yaml").write_text(code(own, "yaml")[0])
    Path("cart.yaml").write_text(code(page, "yaml")[-1])
    (crop,) = re.findall(r"^carpark_mj layouts (san_jose .*?json)  #", page, re.M)
    assert layouts(crop.split()) == 0
    made = read_scenario(Path("cart.yaml"))
    assert f"# wrote corner.json: {made.layout.num_bays} bays" in page
