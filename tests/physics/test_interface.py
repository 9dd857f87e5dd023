"""What every factored back end gives the task: vehicles, parked poses, placed cars."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from carpark_mj.config import EnvConfig, SimConfig
from carpark_mj.physics.mjx_step import ContactPhysics
from carpark_mj.vehicle import COMPACT, make_vehicle, preset

SUV = preset("suv")
POSE = jnp.array([[0.0, 1.0, 0.0], [5.0, -4.0, jnp.pi / 2]])
TYRES = dict.fromkeys(("mjx", "bicycle"), "brush")
TYRES["contact"] = "contact"


def vehicles(*params):
    return jax.tree.map(lambda *x: jnp.stack(x), *map(make_vehicle, params))


@pytest.fixture(params=TYRES)
def physics(request):
    sim = SimConfig(tyres=TYRES[request.param], sim_dt=0.004, ctrl_dt=0.2)
    name = "mjx" if request.param == "contact" else request.param
    config = EnvConfig(physics=name, sim=sim)
    made = config.physics_config.make(config, None, COMPACT)
    assert isinstance(made, ContactPhysics) == (request.param == "contact")
    return made


def test_parked_cars_stay_where_they_were_set(physics):
    state = physics.init(POSE, vehicles(COMPACT, COMPACT))
    parked = jnp.array([[9.0, 9.0, 1.0]])
    state = physics.set_parked_poses(state, parked)
    assert not physics.config.contacts
    np.testing.assert_array_equal(physics.parked_poses(state, parked), parked)


def test_placed_cars_are_at_rest_and_others_left_alone(physics):
    old = physics.init(POSE, vehicles(COMPACT, COMPACT))
    mask = jnp.array([True, False])
    new = physics.place(old, mask, POSE[::-1], vehicles(SUV, SUV))
    motion = physics.read(new)
    np.testing.assert_allclose(motion.pose_w[:, :2], POSE[[1, 1], :2], atol=0.3)
    np.testing.assert_array_equal(motion.speed, 0.0)
    assert new.vehicle.size.tolist() == vehicles(SUV, COMPACT).size.tolist()
    before, after = (jax.tree.map(lambda x: x[1], state) for state in (old, new))
    for a, b in zip(*map(jax.tree.leaves, (before, after)), strict=True):
        np.testing.assert_array_equal(a, b)
