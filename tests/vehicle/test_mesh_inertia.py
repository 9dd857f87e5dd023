import dataclasses

import numpy as np
import pytest
import trimesh

from carpark_mj.scene.car_mesh import car_meshes
from carpark_mj.vehicle import PRESETS, make_vehicle
from carpark_mj.vehicle.mesh_inertia import inertia_from_mesh

MASS = 1400.0


def test_a_box_has_the_inertia_of_the_formula():
    a, b, c = 4.2, 1.8, 1.4
    body = inertia_from_mesh(trimesh.creation.box((a, b, c)), MASS)
    expected = MASS / 12 * np.array([b * b + c * c, a * a + c * c, a * a + b * b])
    np.testing.assert_allclose(body.inertia, np.diag(expected), atol=1e-9)
    np.testing.assert_allclose(body.cg, 0.0, atol=1e-12)


def test_a_cylinder_and_a_ball_have_the_inertia_of_the_formula():
    cylinder = trimesh.creation.cylinder(radius=0.4, height=2.0, sections=256)
    body = inertia_from_mesh(cylinder, MASS)
    across = MASS * (3 * 0.4**2 + 2.0**2) / 12
    # 256 flat sides: 1e-4 less than round.
    expected = [across, across, MASS * 0.4**2 / 2]
    np.testing.assert_allclose(np.diag(body.inertia), expected, rtol=3e-4)
    ball = inertia_from_mesh(trimesh.creation.icosphere(5, 0.5), MASS)
    expected = 0.4 * MASS * 0.5**2
    np.testing.assert_allclose(np.diag(ball.inertia), expected, rtol=2e-3)


def test_shifting_a_mesh_moves_its_centre_of_gravity_only():
    box = trimesh.creation.box((2.0, 1.0, 0.5))
    before = inertia_from_mesh(box, MASS)
    after = inertia_from_mesh(box.apply_translation((1.3, 0.2, 0.6)), MASS)
    np.testing.assert_allclose(after.cg, [1.3, 0.2, 0.6])
    np.testing.assert_allclose(after.inertia, before.inertia, atol=1e-8)


def test_inertia_is_proportional_to_mass_whatever_the_density_of_the_mesh():
    box = trimesh.creation.box((2.0, 1.0, 0.5))
    one = inertia_from_mesh(box, 1.0)
    box.density = 7800.0
    heavy = inertia_from_mesh(box, MASS)
    np.testing.assert_allclose(heavy.inertia, MASS * one.inertia, rtol=1e-9)


@pytest.mark.parametrize("params", PRESETS.values(), ids=PRESETS)
def test_the_body_of_a_preset_gives_a_possible_car_close_to_it(params):
    body = inertia_from_mesh(car_meshes(params)["body"], params.mass)
    roll, pitch, yaw = np.diag(body.inertia)
    shaped = dataclasses.replace(
        params, roll_inertia=roll, pitch_inertia=pitch, yaw_inertia=yaw
    )
    assert make_vehicle(shaped).body_inertia[1].min() > 0
    # Measured -16 to +8 % (yaw) and -18 to +4 % (roll).
    assert yaw == pytest.approx(params.yaw_inertia, rel=0.17)
    assert 0.8 < roll / params.roll_inertia < 1.05


def test_meshes_and_masses_that_make_no_body_are_refused():
    box = trimesh.creation.box((1.0, 1.0, 1.0))
    for mass in (0.0, -1.0, np.nan):
        with pytest.raises(ValueError, match="mass must be positive"):
            inertia_from_mesh(box, mass)
    open_box = trimesh.Trimesh(box.vertices, box.faces[:-2])
    with pytest.raises(ValueError, match="watertight"):
        inertia_from_mesh(open_box, MASS)
    box.invert()
    with pytest.raises(ValueError, match="faces outwards"):
        inertia_from_mesh(box, MASS)
