"""Scenarios to and from other programs' files: what comes back, and what does not."""

import dataclasses
import math
from pathlib import Path
from xml.etree import ElementTree

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import yaml
from helpers.programs import assert_refused, exit_code
from map_texts import TURN, TURNED, commonroad

from carpark_formats.commonroad import commonroad_text, read_commonroad, solution_text
from carpark_formats.openscenario import openscenario_text, read_openscenario
from carpark_mj.geometry import to_local, to_world
from carpark_mj.suite.scenario import make_scenario, read_scenario

LOT = "square_compact"
CASE = {
    "lot": LOT,
    "start": [-10.0, -8.5, 0.1],
    "goal": 6,
    "speed": -0.5,
    "parked": [3, 5],
    "seconds": 40.0,
}
MOVERS = [
    {"between": [7, 8], "speed": 1.5, "near": 6.0},
    {"kind": "cart", "start": [0, 0], "to": [3, 1], "slowing": 0.1, "ahead": 5.0},
    {
        "kind": "car",
        "start": [0, 5],
        "path": [[5, 5, 2], [5, 9, 1], [0, 9, 0.5]],
        "returns": True,
        "pause": 2.0,
        "after": 3.0,
    },
    {"kind": "car", "start": [-5, 8], "heading": 0.4, "size": [4.0, 1.6]},
    {"kind": "car", "start": [-5, 0], "to": [-9, 0], "backwards": True},
]


TIMES = np.linspace(0.0, 40.0, 401)


def way(script, clocks=TIMES):
    """(times, 3) of a script so many seconds after it set out."""
    state = script.init(jax.random.key(0), None)
    place = jax.vmap(lambda t: dataclasses.replace(state, clock=t).pose)
    return np.asarray(place(jnp.asarray(clocks, jnp.float32)))


def triggers(script):
    return script.near, script.trigger, script.after


def write(path, text):
    path.write_text(text)
    return path


def test_openscenario_comes_back(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("case.yaml").write_text(yaml.safe_dump(CASE | {"movers": MOVERS}))
    there = ["export", "case.yaml", "--out", "case.xosc"]
    back = ["import", "case.xosc", "--lot", LOT, "--out", "back.yaml"]
    for arguments in (there, back):
        assert exit_code("scenario", arguments) == 0, capsys.readouterr().err
    root = ElementTree.parse("case.xosc").getroot()
    assert root.find("RoadNetwork/LogicFile").get("filepath") == "case.xodr"
    assert ElementTree.parse("case.xodr").getroot().tag == "OpenDRIVE"
    one, other = map(read_scenario, (Path("case.yaml"), Path("back.yaml")))
    for name in ("start", "goal", "speed", "parked", "seconds", "vehicle"):
        assert getattr(other, name) == getattr(one, name), name
    assert len(other.scripts) == len(MOVERS)
    for script, again in zip(one.scripts, other.scripts, strict=True):
        off = way(again) - way(script)
        # A stop is a step of a millimetre, a bend is off by as much.
        assert np.abs(off[:, :2]).max() < 3e-3
        assert np.cos(off[:, 2]).min() > 0.9999
        np.testing.assert_allclose(again.size, script.size, atol=1e-6)
        assert triggers(again) == triggers(script)
        assert not again.yields  # lost


def test_entities_have_the_middle_of_the_car_as_origin():
    text = openscenario_text(make_scenario(CASE), "lot.xodr")
    root = ElementTree.fromstring(text)
    for entity in root.iterfind("Entities/ScenarioObject"):
        centre = entity.find(".//Center")
        assert (centre.get("x"), centre.get("y")) == ("0", "0")
        axles = [float(axle.get("positionX")) for axle in entity.find(".//Axles")]
        assert axles[0] > 0.0 > axles[1]


def commonroad_back(case):
    """A scenario by CommonRoad and back, and what the commands printed."""
    Path("case.yaml").write_text(yaml.safe_dump(case))
    there = ["export", "case.yaml", "--out", "case.xml"]
    back = ["import", "case.xml", "--out", "back.yaml", "--vehicle", "compact"]
    assert [exit_code("scenario", flags) for flags in (there, back)] == [0, 0]
    return map(read_scenario, (Path("case.yaml"), Path("back.yaml")))


def in_bay(scenario, poses):
    """Poses (n, 3) in the frame of the goal."""
    bay = np.asarray(scenario.layout.bay_pose)[scenario.goal_bay]
    return np.asarray(to_local(bay, np.asarray(poses, np.float32)))


def test_commonroad_comes_back(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    rule = {"distance": 0.1, "heading": 0.04, "speed": 0.06}
    later = [mover | {"after": 2.5} for mover in MOVERS[:2]]
    one, other = commonroad_back(CASE | {"rule": rule, "movers": later + MOVERS[2:]})
    said = capsys.readouterr().out
    assert "sets out at once" not in said
    assert "left out" not in said  # two ends are one bay
    for name in ("speed", "seconds", "vehicle"):
        assert getattr(other, name) == getattr(one, name), name
    starts = [in_bay(made, [made.start])[0] for made in (one, other)]
    np.testing.assert_allclose(*starts, atol=1e-4)
    sizes = [made.layout.bay_size[made.goal_bay] for made in (one, other)]
    np.testing.assert_allclose(*sizes, atol=1e-4)
    assert other.rule.heading == pytest.approx(0.04, abs=1e-5)
    assert other.rule.speed == pytest.approx(0.06)
    for script, again in zip(one.scripts, other.scripts, strict=True):
        ways = [
            in_bay(made, way(x, np.maximum(TIMES - (x.after or 0.0), 0.0)))
            for made, x in ((one, script), (other, again))
        ]
        # It cuts a corner between two steps of 0.1 s, at 2 m/s at most.
        assert np.abs(ways[0] - ways[1])[:, :2].max() < 0.1
        np.testing.assert_allclose(again.size, script.size, atol=1e-4)
    # Lost: other bays, the distance; parked cars have become walls.
    assert other.layout.bay_mask.sum() == 1
    assert other.rule.distance == pytest.approx(sizes[0].min() / 2, abs=1e-4)
    bay = other.layout.bay_pose[other.goal_bay]
    for pose in in_bay(one, one.layout.parked_pose[np.array(one.parked)]):
        there = to_local(other.layout.wall_pose, to_world(bay, pose))
        assert (np.abs(there[:, :2]) < other.layout.wall_size / 2).all(axis=1).any()


@pytest.mark.parametrize("end", ["nose_first", "tail_first"])
def test_commonroad_keeps_the_end_and_says_what_it_cannot(
    end, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    goal = {"pose": [2.0, -3.0, 3.0], "size": [5.2, 2.4], "end": end}
    _, other = commonroad_back(CASE | {"goal": goal, "movers": MOVERS[:1]})
    assert other.goal.end == end
    assert "movers[0] sets out at once" in capsys.readouterr().out


FOREIGN = """<OpenSCENARIO><ParameterDeclarations><ParameterDeclaration name="Pace"
 parameterType="double" value="1.25"/></ParameterDeclarations><Entities>
<ScenarioObject name="Ego"><Vehicle name="mine"><BoundingBox><Center x="1.3" y="0"
 z="0.7"/><Dimensions width="1.8" length="4.3" height="1.4"/></BoundingBox></Vehicle>
</ScenarioObject><ScenarioObject name="Adult"><CatalogReference catalogName="People"
 entryName="adult"/></ScenarioObject></Entities><Storyboard><Init><Actions>
<Private entityRef="Ego"><PrivateAction><TeleportAction><Position>
<WorldPosition x="-10" y="-8.5"/></Position></TeleportAction></PrivateAction></Private>
<Private entityRef="Adult"><PrivateAction><TeleportAction><Position>
<WorldPosition x="2" y="1" h="1.5707963"/></Position></TeleportAction></PrivateAction>
</Private></Actions></Init><Story><Act><ManeuverGroup><Actors><EntityRef
 entityRef="Adult"/></Actors><Maneuver><Event name="walk"><Action><PrivateAction>
<LongitudinalAction><SpeedAction><SpeedActionTarget><AbsoluteTargetSpeed value="$Pace"/>
</SpeedActionTarget></SpeedAction></LongitudinalAction></PrivateAction></Action>
<StartTrigger><ConditionGroup><Condition name="near"><ByEntityCondition>
<TriggeringEntities><EntityRef entityRef="Ego"/></TriggeringEntities><EntityCondition>
<RelativeDistanceCondition entityRef="Adult" value="7" freespace="true"
 relativeDistanceType="cartesianDistance"/></EntityCondition></ByEntityCondition>
</Condition></ConditionGroup><ConditionGroup><Condition name="stand">
<ByEntityCondition><EntityCondition><StandStillCondition duration="3"/>
</EntityCondition></ByEntityCondition></Condition></ConditionGroup></StartTrigger>
</Event></Maneuver></ManeuverGroup></Act></Story></Storyboard></OpenSCENARIO>"""


def test_a_foreign_openscenario_file_is_read(tmp_path):
    """Its origin is the rear axle; a speed, of a parameter, leads straight on."""
    found, notes = read_openscenario(write(tmp_path / "a.xosc", FOREIGN))
    np.testing.assert_allclose(found["start"], [-8.7, -8.5, 0.0])
    (adult,) = found["movers"]
    assert adult["near"] == 7.0
    assert adult["speed"] == pytest.approx(1.25)
    np.testing.assert_allclose(adult["to"], [2.0, 101.0], atol=1e-5)
    assert len(notes) == 2
    assert "near" in notes[0]
    assert "stand" in notes[1]
    assert "goal" not in found


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("WorldPosition x", "LanePosition x"), "must have a WorldPosition"),
        (('x="-10"', 'x="ten"'), "must be a number"),
        (("Vehicle", "MiscObject"), "no vehicle has a start"),
        (("<OpenSCENARIO>", "<OpenSCENARIO><"), "not XML"),
        (("OpenSCENARIO>", "OpenDRIVE>"), "outermost"),
        (("x", "x"), "lacks goal"),
    ],
)
def test_faulty_files_are_refused(change, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write(Path("a.xosc"), FOREIGN.replace(*change))
    flags = ["import", "a.xosc", "--lot", LOT, "--out", "a.yaml"]
    assert_refused(capsys, "scenario", flags, said)
    assert not Path("a.yaml").exists()


def exact(**values):
    return "".join(f"<{k}><exact>{v}</exact></{k}>" for k, v in values.items())


def problem():
    """CommonRoad's lot of the tests of maps, with a goal's limits and one who walks."""
    named = "<commonRoad timeStepSize='0.2' benchmarkID='ZAM_X-1_1_T-1' "
    text = commonroad().replace("<commonRoad ", named)
    limits = (
        f"<orientation><intervalStart>{TURN + math.pi / 2 - 0.1}</intervalStart>"
        f"<intervalEnd>{TURN + math.pi / 2 + 0.1}</intervalEnd></orientation><time>"
        "<intervalStart>0</intervalStart><intervalEnd>150</intervalEnd></time></goalState>"
    )
    text = text.replace("</goalState>", limits)
    states = ""
    for step, xy in enumerate(
        [(4.0, -1.0)] * 3 + [(4.0, -0.5), (4.0, 0.0), (4.5, 0.0)]
    ):
        x, y = (np.array(xy) @ TURNED + (3000.0, -500.0)).tolist()
        at = f"<position><point><x>{x!r}</x><y>{y!r}</y></point></position>"
        tag = "state" if step else "initialState"
        states += f"<{tag}>{at}{exact(orientation=0.0, time=step)}</{tag}>"
        states += "<trajectory>" * (step == 0)
    walker = (
        "<dynamicObstacle id='99'><type>pedestrian</type><shape><circle><radius>0.3"
        f"</radius></circle></shape>{states}</trajectory></dynamicObstacle>"
    )
    return text.replace("<planningProblem", f"{walker}<planningProblem", 1)


def test_a_commonroad_problem_becomes_a_scenario(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = write(Path("problem.xml"), problem())
    assert exit_code("scenario", ["import", "problem.xml", "--out", "p.yaml"]) == 0
    made = read_scenario(Path("p.yaml"))
    # In the drawing the car starts at (2, 0), heading to -x, and bay 0 is above it:
    # its own frame, x out of the bay and down, has the start ahead and to the left.
    bay = made.layout.bay_pose[made.goal_bay]
    local = np.asarray(to_local(bay, np.array(made.start)))
    assert local[0] == pytest.approx(5.5, abs=0.05)
    assert abs(local[1]) == pytest.approx(0.75, abs=0.05)
    assert np.cos(local[2]) == pytest.approx(0.0, abs=1e-3)
    # A heading into the bay: nose first, which turns the parked car's pose.
    assert made.goal.end == "nose_first"
    assert made.rule.heading == pytest.approx(0.1, abs=1e-3)
    assert made.seconds == pytest.approx(30.0)
    (walker,) = made.movers
    # It waits for two steps, then walks at 2.5 m/s, a metre along y and half along x.
    assert walker.after == pytest.approx(0.4)
    length = np.linalg.norm(np.diff(walker.points, axis=0), axis=1)
    np.testing.assert_allclose(length, [1.0, 0.5], atol=5e-3)
    np.testing.assert_allclose([row[2] for row in walker.path], 2.5, atol=0.02)
    start = np.asarray(to_local(np.array(made.start), np.array([*walker.start, 0.0])))
    np.testing.assert_allclose(start[:2], [-2.0, 1.0], atol=5e-3)
    assert path.exists()


def test_a_drive_becomes_a_solution_in_the_frame_of_its_problem(tmp_path):
    path = write(tmp_path / "problem.xml", problem())
    found, _, _ = read_commonroad(path)
    track = np.array([[*found["start"], 0.0, 0.0], [0.0, 0.0, 0.5, 0.1, 1.0]])
    track[1, :2] = track[0, :2] + [0.3, 0.4]
    text = solution_text(path, np.array([0.0, 1.0]), track)
    root = ElementTree.fromstring(text)
    assert root.get("benchmark_id") == "KS2:SM1:ZAM_X-1_1_T-1:2020a"
    states = root.findall("ksTrajectory/ksState")
    assert [state.findtext("time") for state in states] == list("012345")
    first = [float(states[0].findtext(tag)) for tag in ("x", "y", "orientation")]
    x, y = np.array([2.0, 0.0]) @ TURNED + (3000.0, -500.0)
    np.testing.assert_allclose(first[:2], [x, y], atol=1e-4)
    assert math.cos(first[2] - TURN - math.pi) == pytest.approx(1.0, abs=1e-6)
    ends = [[float(one.findtext(t)) for t in ("x", "y")] for one in states]
    steps = np.linalg.norm(np.diff(ends, axis=0), axis=1)
    np.testing.assert_allclose(steps, 0.1, atol=1e-4)
    assert float(states[-1].findtext("velocity")) == 1.0


def test_commonroad_io_reads_a_solution(tmp_path):
    solution = pytest.importorskip("commonroad.common.solution")
    path = write(tmp_path / "problem.xml", problem())
    track = np.column_stack([np.zeros((3, 3)), np.zeros(3), np.ones(3)])
    text = solution_text(path, np.array([0.0, 0.2, 0.4]), track)
    read = solution.CommonRoadSolutionReader.fromstring(text)
    [own] = read.planning_problem_solutions
    assert len(own.trajectory.state_list) == 3


def test_commonroad_io_reads_a_scenario(tmp_path):
    reader = pytest.importorskip("commonroad.common.file_reader")
    made = make_scenario(CASE | {"movers": MOVERS})
    text, _ = commonroad_text(made)
    path = write(tmp_path / "case.xml", text)
    read, problems = reader.CommonRoadFileReader(str(path)).open()
    assert len(read.dynamic_obstacles) == len(MOVERS)
    assert len(read.static_obstacles) == len(made.parked)
    [problem] = problems.planning_problem_dict.values()
    np.testing.assert_allclose(problem.initial_state.position, made.start[:2])
    goals = problem.goal.state_list
    bay = made.layout.bay_pose[made.goal_bay]
    assert {goal.time_step.end for goal in goals} == {400}
    middles = [np.mean(goal.position.vertices[:4], axis=0) for goal in goals]
    np.testing.assert_allclose(middles, [bay[:2]] * 2, atol=1e-5)
    assert {goal.orientation.contains(float(bay[2])) for goal in goals} == {True, False}
