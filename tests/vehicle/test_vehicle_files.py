"""Cars by file: read, estimated, kept by configs, refused in one sentence."""

import dataclasses
import json
import math
import random
import re
from pathlib import Path

import pytest
from helpers.cars import ROAD_CARS
from helpers.programs import vehicles as main

from carpark_mj.cli.driver import adapt
from carpark_mj.cli.flags import read_flags
from carpark_mj.config import EnvConfig, FleetConfig
from carpark_mj.policy.runs import from_dict
from carpark_mj.scene.looks import STYLES, nearest_style
from carpark_mj.spawning.fleet import Fleet
from carpark_mj.vehicle import COMPACT, PRESETS, VehicleParameters, make_vehicle, preset
from carpark_mj.vehicle.parameters import TyreParameters
from carpark_mj.vehicle.presets import SHEETS
from carpark_mj.vehicle.sheet import SHEET, car_of_sheet, parameters_text, read_sheet
from carpark_mj.wrappers.options import configure

GUIDE = (Path(__file__).parents[2] / "docs" / "own_lot.md").read_text()
[EXAMPLE] = re.findall(r"```yaml\n(.*?)```", GUIDE, re.DOTALL)
SIZE = {"length": 4.28, "width": 1.79, "wheelbase": 2.64}


@pytest.fixture
def file(tmp_path) -> str:
    path = tmp_path / "my_car.yaml"
    path.write_text(EXAMPLE)
    return str(path)


def test_the_car_of_the_guide_has_what_its_file_says(file):
    name, (params, estimated) = read_sheet(file)
    assert name == "my_car"
    assert (params.length, params.width, params.wheelbase) == (4.28, 1.79, 2.64)
    front, _, rear, _ = params.static_loads
    assert 2 * front == pytest.approx(830 * 9.81)
    assert 2 * (front + rear) == pytest.approx(1420 * 9.81)
    assert params.front_overhang == pytest.approx(0.86)
    # 205 mm wide, 55 % of it high, on 16 inches.
    assert params.wheel_radius == pytest.approx(0.2032 + 0.55 * 0.205)
    assert params.front_drive == 1.0
    assert "height" in estimated
    assert not {"mass", "wheel_radius", "turning_circle"} & {*estimated}


def test_a_config_keeps_the_parameters_and_not_the_path(file):
    car = preset(file)
    configs = (
        EnvConfig(vehicle=file, num_agents=1),
        read_flags(EnvConfig, ["--vehicle", file, "--num-agents", "1"]),
        adapt(EnvConfig(num_agents=1), vehicle=file),
        configure({"agents": 1, "vehicle": file}),
    )
    fleet = FleetConfig(agents=(file, "van"), parked_cars=(file,))
    Path(file).unlink()
    assert [Fleet(c, preset(c.vehicle)).agent_names for c in configs] == [
        ("my_car",)
    ] * 4
    for config in configs:
        back = from_dict(EnvConfig, json.loads(json.dumps(dataclasses.asdict(config))))
        assert back == config
        assert preset(back.vehicle) == car
        assert read_flags(EnvConfig, [], config) == config  # as a run is resumed
    kept = from_dict(FleetConfig, json.loads(json.dumps(dataclasses.asdict(fleet))))
    assert kept == fleet
    assert [preset(name) for name in kept.agents] == [car, PRESETS["van"]]


@pytest.mark.parametrize("name", ROAD_CARS)
def test_all_parameters_of_a_car_survive_their_text(name):
    assert preset(parameters_text(name, ROAD_CARS[name])) == ROAD_CARS[name]


def test_the_command_tells_estimates_and_writes_the_whole_car(file, tmp_path, capsys):
    whole = tmp_path / "whole.json"
    assert main([file, "--save", str(whole)]) == 0
    lines = capsys.readouterr().out.splitlines()
    _, (params, estimated) = read_sheet(file)
    told = {line.split()[0] for line in lines if line.endswith("estimated")}
    assert told == {*estimated}
    names = {f.name for f in dataclasses.fields(VehicleParameters)} - {"tyre"}
    names |= {f"tyre.{f.name}" for f in dataclasses.fields(TyreParameters)}
    assert names <= {line.split()[0] for line in lines}
    assert read_sheet(str(whole)) == ("my_car", (params, ()))
    assert main(["nowhere.yaml"]) == 2


@pytest.mark.parametrize("name", PRESETS)
def test_estimates_come_near_the_presets(name):
    car = PRESETS[name]
    known = ("length", "width", "height", "wheelbase", "mass", "front_drive")
    sheet = {field: getattr(car, field) for field in (*known, "wheel_radius")}
    found, estimated = car_of_sheet(sheet)
    loose = ("wheel", "knuckle", "max", "tyre.")
    for field in estimated:
        of, _, part = field.rpartition(".")
        mine, its = (getattr(x, of) if of else x for x in (found, car))
        within = 0.35 if field.startswith(loose) else 0.15
        assert getattr(mine, part) == pytest.approx(getattr(its, part), rel=within)


def test_a_sheet_may_be_given_as_it_is_printed():
    sheet: dict = {"length": "4,584 mm", "width": "1.80 m", "wheelbase": "2,70 m"}
    sheet |= {"kerb_weight": "1,650 kg", "power": "150 kW (204 PS)"}
    sheet |= {"max_speed": "18 km/h", "turning_circle": 11.2}
    sheet |= {"track_front": "1540 mm", "track_rear": "155 cm"}
    sheet |= {"tyre_front": "225/45 R18 95 Y", "tyre_rear": "235/45 R18"}
    car, estimated = car_of_sheet(sheet)
    assert (car.length, car.width, car.wheelbase) == (4.584, 1.8, 2.7)
    assert car.mass == 1650 + 75  # and a driver
    assert (car.max_power, car.max_speed) == (150e3, 5.0)
    assert car.track_width == pytest.approx(1.545)
    assert car.tyre_width == pytest.approx(0.230)
    assert car.wheel_radius == pytest.approx(0.2286 + 0.45 * 0.230)
    assert not {"mass", "max_power", "track_width", "tyre_width"} & {*estimated}


def test_steered_rear_wheels_turn_the_body_as_they_do_in_the_real_car():
    base, front, rear = 3.1, math.radians(35), math.radians(8)
    track, tyre = 1.55, 0.2
    # The car turns about the point where the lines through both axles' wheels meet.
    radius = base / (math.tan(front) + math.tan(rear))
    behind = radius * math.tan(rear)  # the real rear axle, of that point
    outer = math.hypot(base - behind, radius + track / 2)
    sheet = {"length": 5.1, "width": 1.9, "wheelbase": base, "rear_overhang": 1.0}
    sheet |= {"track_width": track, "tyre_width": tyre, "rear_steering": rear}
    car = car_of_sheet(sheet | {"turning_circle": 2 * outer + tyre}).params
    assert car.turning_radius == pytest.approx(radius)
    assert car.max_steering == pytest.approx(front)
    assert car.rear_overhang == pytest.approx(1.0 + behind)
    assert car.front_overhang == pytest.approx(1.0)


def test_a_steering_ratio_gives_rate_and_circle():
    car = car_of_sheet(SIZE | {"steering_ratio": 16.0, "steering_turns": 3.0}).params
    # Of the steering wheel: a turn a second, 1.5 turns to either side.
    assert 16.0 * car.steering_rate == pytest.approx(2 * 3.14159265)
    assert 16.0 * car.max_steering == pytest.approx(3 * 3.14159265)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"wheelbase": None}, "wheelbase missing"),
        ({"wheel_base": 2.7}, "did you mean 'wheelbase'"),
        ({"mass": "heavy"}, "mass must be a number above 0, .* not 'heavy'"),
        ({"length": "4.28 kg"}, "text with m, cm, mm, in, ft, not '4.28 kg'"),
        ({"tyre_front": "205/55 R16", "tyre_rear": "255/55 R18"}, "contradicts"),
        (
            {"mass": 1400, "front_axle_load": 830, "rear_axle_load": 700},
            "mass 1400 contradicts axle loads",
        ),
        ({"tyre_size": "big"}, "tyre_size must be as in 205/55 R16, not 'big'"),
        ({"drive": "both"}, "unknown drive 'both'; choose from"),
    ],
)
def test_contradictions_are_refused_with_file_and_value(change, message, tmp_path):
    sheet = {k: v for k, v in (SIZE | change).items() if v is not None}
    path = tmp_path / "car.json"
    path.write_text(json.dumps(sheet))
    with pytest.raises(ValueError, match=f"{re.escape(str(path))}: .*{message}"):
        EnvConfig(vehicle=str(path))


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("car.yaml", "length: [4", "not YAML .*line 1"),
        ("car.yaml", "", "must have lines as"),
        ("car.yaml", "!!python/object/apply:os.getcwd []", "not YAML"),
        ("car.json", "{", "is not JSON"),
        ("car.toml", "", r"must end in one of \.json, \.yaml, \.yml, not"),
    ],
)
def test_files_that_are_none_are_refused_in_one_sentence(name, text, message, tmp_path):
    (tmp_path / name).write_text(text)
    with pytest.raises(ValueError, match=message):
        preset(str(tmp_path / name))


def test_a_damaged_file_is_a_car_or_refused_in_one_sentence(tmp_path):
    dice, path = random.Random(0), tmp_path / "car.yaml"
    for _ in range(300):
        text = [*EXAMPLE]
        for _ in range(dice.randint(1, 4)):
            text[dice.randrange(len(text))] = dice.choice("0.9-:\n {}[]&*!#'\"x\t")
        path.write_text("".join(text))
        assert "\n" not in refusal_of(path)


def refusal_of(path) -> str:
    """Why a file is no car; empty if it is one."""
    try:
        make_vehicle(preset(str(path)))
    except ValueError as error:
        return str(error)
    return ""


def test_every_quantity_of_a_sheet_is_on_the_page():
    for name in SHEET:
        assert f"`{name}`" in GUIDE


def test_the_cars_of_data_sheets_are_drawn_as_the_most_similar_preset():
    for name in SHEETS:
        assert nearest_style(preset(name)) in STYLES
        assert preset(name) != COMPACT
