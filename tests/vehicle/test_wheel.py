import jax
import jax.numpy as jnp
import numpy as np
import pytest

from carpark_mj.vehicle import COMPACT, PRESETS, Vehicle, make_vehicle
from carpark_mj.vehicle.parameters import GRAVITY
from carpark_mj.vehicle.vehicle import wheels_of


def test_wheels_share_weight_and_torques_of_the_car():
    for params in PRESETS.values():
        wheels = wheels_of(make_vehicle(params))
        load = sum(float(wheel.tyre.static_load) for wheel in wheels)
        assert load == pytest.approx(params.mass * GRAVITY, rel=1e-6)
        for share in ("drive_share", "brake_share"):
            assert sum(float(getattr(wheel, share)) for wheel in wheels) == (
                pytest.approx(1.0, abs=1e-6)
            )


def test_wheels_stand_at_the_corners_in_the_order_fl_fr_rl_rr(compact: Vehicle):
    x, y = COMPACT.wheelbase, COMPACT.track_width / 2
    hubs = [(float(w.hub[0]), float(w.hub[1])) for w in wheels_of(compact)]
    corners = [(x, y), (x, -y), (0.0, y), (0.0, -y)]
    assert np.array(hubs) == pytest.approx(np.array(corners), rel=1e-6)


def test_every_leaf_has_the_leading_shape_of_the_cars(compact: Vehicle):
    fleet = jax.tree.map(lambda x: jnp.broadcast_to(x, (2, 3, *x.shape)), compact)
    for wheel in wheels_of(fleet):
        assert {leaf.shape for leaf in jax.tree.leaves(wheel)} == {(2, 3)}
