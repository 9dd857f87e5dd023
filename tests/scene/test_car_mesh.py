"""Car bodies: closed, light, of the vehicle's size, and the same on every machine."""

import dataclasses
import importlib.util
from pathlib import Path

import mujoco
import numpy as np
import pytest
from helpers.cars import ROAD_CARS

from carpark_mj.scene import looks, parts
from carpark_mj.scene.car_mesh import car_meshes, driver_eye, standing_wheels
from carpark_mj.scene.looks import nearest_style
from carpark_mj.scene.parts import add_looks, shape_name
from carpark_mj.vehicle import COMPACT, PRESETS
from carpark_mj.vehicle.mjcf import hub_positions

ASSETS = Path(__file__).parents[2] / "assets"
TAXI = dataclasses.replace(
    COMPACT, length=4.6, width=1.75, height=1.6, wheelbase=2.8, turning_circle=11.5
)
STUB = dataclasses.replace(COMPACT, rear_overhang=COMPACT.wheel_radius, length=3.9)
CARS = ROAD_CARS | {"taxi": TAXI, "stub": STUB}
CARS = [pytest.param(params, id=name) for name, params in CARS.items()]
SEEN = "body", "cage", "glass", "headlights", "tail_lights", "trim", "tyres", "rims"


def whole(params):
    return car_meshes(params) | standing_wheels(params)


@pytest.mark.parametrize("params", CARS)
def test_every_part_is_closed_faces_outwards_and_is_light(params):
    for part, mesh in whole(params).items():
        assert mesh.is_watertight, part
        assert mesh.is_winding_consistent, part
        assert all(piece.volume > 0 for piece in mesh.split()), part
        each = 4 if part in ("tyres", "rims") else 1
        assert len(mesh.faces) <= 800 * each, part


@pytest.mark.parametrize("params", CARS)
def test_the_car_fills_its_vehicle_s_dimensions_to_the_millimetre(params):
    meshes = whole(params)
    bounds = np.stack([meshes[part].bounds for part in SEEN])
    low, high = bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)
    rear = -params.rear_overhang
    np.testing.assert_allclose(low, [rear, -params.width / 2, 0.0], atol=1e-3)
    top = [rear + params.length, params.width / 2, params.height]
    np.testing.assert_allclose(high, top, atol=1e-3)


@pytest.mark.parametrize("params", CARS)
def test_wheels_stand_on_the_ground_at_the_axles(params):
    tyre = car_meshes(params)["tyre"]
    radius, half = params.wheel_radius, params.tyre_width / 2
    np.testing.assert_allclose(tyre.bounds[:, 2], [-radius, radius], atol=1e-4)
    np.testing.assert_allclose(tyre.bounds[:, 1], [-half, half], atol=1e-4)
    tyres = np.split(standing_wheels(params)["tyres"].vertices, 4)
    for hub, piece in zip(hub_positions(params), tyres, strict=True):
        assert piece[:, 2].min() == pytest.approx(0.0, abs=1e-4)
        np.testing.assert_allclose(piece.mean(axis=0), hub, atol=1e-4)


@pytest.mark.parametrize("params", CARS)
def test_cars_are_mirrored_clear_their_wheels_and_seat_a_driver(params):
    for part in {*SEEN} - {"rims"}:  # whose spokes are where they are turned to
        points = whole(params)[part].vertices
        mirrored = points * [1.0, -1.0, 1.0]
        order = [np.lexsort(p.round(3).T) for p in (points, mirrored)]
        np.testing.assert_allclose(points[order[0]], mirrored[order[1]], atol=2e-3)
    x, _, z = car_meshes(params)["body"].vertices.T
    for axle in (0.0, params.wheelbase):
        away = np.hypot(x - axle, z - params.wheel_radius)
        assert away.min() > params.wheel_radius + 0.02
    x, y, z = driver_eye(params)  # left of the middle, under the roof
    nose = params.length - params.rear_overhang
    assert 0.2 * params.wheelbase < x < nose - 0.5
    assert 0.25 < y < params.width / 2 - 0.3
    assert 0.6 * params.height < z < params.height - 0.1


def test_files_are_what_the_script_makes_bit_for_bit(tmp_path):
    spec = importlib.util.spec_from_file_location("make_cars", ASSETS / "make_cars.py")
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    made = script.main(tmp_path)
    assert {path.name for path in made} == {
        path.name for path in (ASSETS / "cars").glob("*.obj")
    }
    for path in made:
        assert path.read_bytes() == (ASSETS / "cars" / path.name).read_bytes(), path


def test_a_car_of_one_s_own_takes_the_most_similar_style():
    assert {name: nearest_style(p) for name, p in PRESETS.items()} == {
        name: name for name in PRESETS
    }
    bus = dataclasses.replace(PRESETS["van"], length=5.3, height=2.4, width=2.0)
    assert nearest_style(bus) == "van"
    assert shape_name(COMPACT) == "compact"
    assert shape_name(dataclasses.replace(COMPACT, mass=1500.0)) == "compact"
    assert shape_name(TAXI) != shape_name(dataclasses.replace(TAXI, length=4.61))


def test_cars_of_a_shape_share_their_meshes_and_each_has_its_colour():
    spec = mujoco.MjSpec()
    looks.add_materials(spec)
    for k, params in enumerate((COMPACT, COMPACT, PRESETS["van"])):
        body = spec.worldbody.add_body(name=f"car{k}", pos=[0.0, 4.0 * k, 0.0])
        add_looks(spec, body, params, parts.WHOLE, looks.agent_colour(k))
    model = spec.compile()
    assert model.nmesh == 2 * len(whole(COMPACT))
    assert model.body_mass.sum() == 0.0  # looks weigh nothing
    painted = {
        tuple(model.geom_rgba[g].round(3).tolist())
        for g in range(model.ngeom)
        if model.mesh(model.geom_dataid[g]).name.endswith("/body")
    }
    colours = np.array([looks.agent_colour(k) for k in range(3)], np.float32)
    assert painted == {tuple(colour.round(3).tolist()) for colour in colours}
