"""Tyre forces on the whole car, and as MuJoCo takes them."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from carpark_mj.physics.coordinates import (
    CarIndex,
    TyreState,
    rotate_by,
    unpack_coordinates,
    unpack_tyres,
)
from carpark_mj.physics.forces import CarForces, generalized_forces, roll
from carpark_mj.vehicle import COMPACT
from carpark_mj.vehicle.drive import WheelTorques
from carpark_mj.vehicle.mjcf import car_model
from carpark_mj.vehicle.parameters import GRAVITY
from carpark_mj.vehicle.vehicle import wheels_of

DT = 0.01
INDEX = CarIndex(car_model(COMPACT, DT, (0.0, 0.0, -GRAVITY)))


def random_car(seed: int) -> tuple[np.ndarray, np.ndarray, TyreState]:
    """A steered car that leans, slides and spins its wheels; heading 0."""
    rng = np.random.default_rng(seed)
    qpos, qvel = np.zeros(13), rng.normal(0, 0.3, 12)
    qpos[:3] = rng.normal(0, 0.02, 3)
    qpos[3:7] = [1.0, *rng.normal(0, 0.02, 2), 0.0]
    qpos[3:7] /= np.linalg.norm(qpos[3:7])
    qpos[INDEX.steer_qpos] = rng.uniform(-0.6, 0.6, 2)
    qvel[INDEX.spin_dof] = rng.normal(3, 2, 4)
    tyres = TyreState(*(jnp.array(rng.normal(0, 0.01, (3, 4)), jnp.float32)))
    return qpos, qvel, tyres


def test_standing_on_its_tyres_a_car_feels_its_weight(compact):
    qpos, qvel = np.zeros(13), np.zeros(12)
    qpos[3] = 1.0
    tyres = TyreState(*(jnp.zeros(4),) * 3)
    at = unpack_coordinates(INDEX, jnp.array(qpos), jnp.array(qvel))
    free = [WheelTorques(jnp.zeros(()), jnp.zeros(()))] * 4
    forces, _ = roll(wheels_of(compact), at, unpack_tyres(tyres), free, DT)
    weight = COMPACT.mass * GRAVITY
    assert np.array(forces.force_w) == pytest.approx([0, 0, weight], rel=1e-5)
    # At the centre of gravity.
    pitch = -weight * COMPACT.cg_to_rear_axle
    assert np.array(forces.moment_b) == pytest.approx([0, pitch, 0], abs=0.5)
    static = np.array(compact.tyres.static_load)
    assert np.array(forces.load) == pytest.approx(static, rel=1e-6)


def test_generalized_forces_do_the_work_of_the_tyres(compact):
    """Power q' Q against force times velocity at each contact patch, in float64."""
    with jax.enable_x64(True):
        vehicle = jax.tree.map(lambda x: jnp.array(x, jnp.float64), compact)
        for seed in range(10):
            qpos, qvel, tyres = random_car(seed)
            tyres = jax.tree.map(lambda x: jnp.array(x, jnp.float64), tyres)
            at = unpack_coordinates(INDEX, jnp.array(qpos), jnp.array(qvel))
            rotation = np.array(at.rotation)
            total = 0.0
            for i in range(4):  # the forces of one wheel at a time
                only = [
                    w if k == i else scaled_to_nothing(w)
                    for k, w in enumerate(wheels_of(vehicle))
                ]
                torques = [WheelTorques(jnp.array(0.0), jnp.array(0.0))] * 4
                forces, _ = roll(only, at, unpack_tyres(tyres), torques, DT)
                hub = np.array([*only[i].hub, 0.0], float)
                height = qpos[2] + rotation[2] @ hub
                contact = hub - height * rotation[2]
                velocity = qvel[:3] + rotation @ np.cross(qvel[3:6], contact)
                rate = qvel[5] + (qvel[INDEX.steer_dof[i]] if i < 2 else 0.0)
                power = velocity @ np.array(forces.force_w)
                power += rate * float(forces.aligning[i])
                power += qvel[INDEX.spin_dof[i]] * float(forces.spin[i])
                total += power
                found = qvel @ np.array(generalized_forces(INDEX, forces))
                assert found == pytest.approx(power, rel=1e-9, abs=1e-5)
            assert abs(total) > 1.0  # they did work


def scaled_to_nothing(wheel):
    """A wheel whose tyre applies no force: no load, no grip, no resistance."""
    nothing = jax.tree.map(lambda x: 1e-12 * x, wheel.tyre)
    names = [f"{way}_relaxation" for way in ("longitudinal", "lateral", "torsion")]
    keep = {name: getattr(wheel.tyre, name) for name in (*names, "friction")}
    return wheel.replace(tyre=nothing.replace(**keep))


def test_scenes_place_forces_by_address():
    class Shifted:
        root_dof, nv = 3, 20
        steer_dof, spin_dof = np.array([9, 11]), np.array([10, 12, 13, 14])

    def numbers(first: int, count: int) -> tuple:
        return tuple(jnp.array(float(first + i)) for i in range(count))

    forces = CarForces(
        numbers(1, 3), numbers(4, 3), numbers(7, 4), numbers(11, 4), numbers(0, 4)
    )
    qfrc = generalized_forces(Shifted, forces)
    expected = [0] * 3 + [1, 2, 3, 4, 5, 6] + [7, 11, 8, 12, 13, 14] + [0] * 5
    assert qfrc.tolist() == expected


@pytest.mark.parametrize("rate", [0.0, 1e-20, 1e-3, 1.0, 60.0])
def test_turning_integrates_as_mujoco_does(rate):
    q, angular = np.random.default_rng(0).normal(size=(2, 20, 4))
    q, angular = q / np.linalg.norm(q, axis=1, keepdims=True), rate * angular[:, :3]
    turned = np.stack(rotate_by(*map(jnp.array, (q.T, angular.T)), 0.01), -1)
    for i in range(20):
        expected = q[i].copy()
        mujoco.mju_quatIntegrate(expected, angular[i], 0.01)
        assert turned[i] == pytest.approx(expected, abs=3e-7)  # float32
    assert np.linalg.norm(turned, axis=1) == pytest.approx(np.ones(20), abs=2e-7)


def test_a_body_at_rest_turns_as_soon_as_it_is_turned():
    def yawed(rate):
        zero = jnp.zeros(())
        start = jnp.ones(()), zero, zero, zero
        return rotate_by(start, (zero, zero, rate), 0.1)[3]

    assert jax.grad(yawed)(0.0) == pytest.approx(0.05)  # the half angle, dt / 2
