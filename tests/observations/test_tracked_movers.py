"""Tracked movers: what is observed of them, and which are hidden."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import cars, lot
from helpers.states import parked_at, state_of

from carpark_mj.config import EnvConfig
from carpark_mj.geometry import rotate
from carpark_mj.geometry.obstacles import Boxes, Discs, Movers, ObstacleKind
from carpark_mj.observations import ContinuousObservation, make_fields
from carpark_mj.observations.compose import observation_sets
from carpark_mj.observations.fields import ObservationInput
from carpark_mj.observations.tracked import PACE, movers_part
from carpark_mj.policy.encoder import SetEncoder

FACING = np.array([(0.0, 0.0, np.pi / 2)])  # north
PEOPLE = Discs(
    jnp.array([[0.0, 6.0], [8.0, 0.0], [-3.0, 0.0], [0.0, 4.0]]),
    jnp.full(4, 0.3),
    jnp.array([[1.0, 0.0], [0.0, 0.0], [0.0, -1.0], [0.0, 0.0]]),
    jnp.array([True, True, True, False]),
    kind=ObstacleKind.PERSON,
)
CART = Boxes(
    jnp.array([[-9.0, 0.0, np.pi]]), jnp.array([[2.0, 1.0]]), jnp.array([[-2.0, 0.0]])
)


def see(
    count, in_sight=False, walls=(), parked=(), movers=(PEOPLE, CART), facing=FACING
):
    """Rows (count, k) of fields by name, and the fields' names, of one car."""
    state = state_of(
        lot([(30.0, 0.0, 0.0)], walls),
        cars(facing),
        0,
        parked_cars=parked_at(parked),
        movers=Movers((), tuple((group,) for group in movers)),
    )
    part = movers_part(count, in_sight)
    values = part.fill(ObservationInput.of(state))
    assert [*values]
    assert {*values} == {field.name for field in part.fields}
    for field in part.fields:
        assert values[field.name].shape == (1, field.size)
        assert (values[field.name] >= field.low - 1e-6).all()
        assert (values[field.name] <= field.high + 1e-6).all()
    return [
        {
            field.name.removeprefix(f"mover_{k}_"): np.asarray(values[field.name][0])
            for field in part.fields
            if field.index == k
        }
        for k in range(count)
    ]


def places(rows):
    """Positions [m] of the rows that are present."""
    return [tuple(np.round(r["position"] * 20.0, 3)) for r in rows if r["present"]]


def test_the_nearest_come_first_in_the_own_frame_and_padding_is_zero():
    rows = see(6)
    # North is ahead: west is left. The masked one, 4 m ahead, is not there.
    assert places(rows) == [(0, 3), (6, 0), (0, -8), (0, 9)]
    np.testing.assert_allclose(rows[0]["velocity"] * PACE, [-1, 0], atol=1e-6)
    np.testing.assert_allclose(rows[1]["velocity"] * PACE, [0, -1], atol=1e-6)
    np.testing.assert_allclose(rows[1]["size"] * 5.0, [0.6, 0.6], atol=1e-6)
    np.testing.assert_allclose(rows[3]["size"] * 5.0, [2.0, 1.0], atol=1e-6)
    np.testing.assert_allclose(rows[3]["heading"], [0, 1], atol=1e-6)
    assert [float(row["person"][0]) for row in rows] == [1, 1, 1, 0, 0, 0]
    assert all((value == 0).all() for row in rows[4:] for value in row.values())
    assert places(see(2)) == [(0, 3), (6, 0)]
    assert places(see(2, movers=())) == []


@pytest.mark.parametrize("angle", [0.7, 2.5])
def test_a_turned_lot_looks_the_same_also_with_those_who_stand(angle):
    def turn(group):
        pose = group.pose_w.at[:, :2].set(rotate(group.pose_w[:, :2], angle))
        if isinstance(group, Boxes):
            pose = pose.at[:, 2].add(angle)
        return group.replace(pose_w=pose, velocity_w=rotate(group.velocity_w, angle))

    turned = see(
        4, movers=(turn(PEOPLE), turn(CART)), facing=np.add(FACING, [0, 0, angle])
    )
    for row, other in zip(see(4), turned, strict=True):
        for name, value in row.items():
            np.testing.assert_allclose(other[name], value, atol=1e-5, err_msg=name)


def test_what_stands_behind_a_car_or_a_wall_is_hidden_if_sight_is_asked_for():
    hiding: Any = {"walls": [(0.0, 4.0, 0.0)], "parked": [(5.0, 0.0, 1.0)]}
    assert places(see(4, **hiding)) == [(0, 3), (6, 0), (0, -8), (0, 9)]
    assert places(see(4, True, **hiding)) == [(0, 3), (0, 9)]
    assert places(see(1, in_sight=True, walls=[(-1.5, 0.0, 0.0)])) == [(6, 0)]
    assert places(see(4, True)) == places(see(4))


def test_they_are_a_group_of_the_set_encoder_and_none_by_default():
    config = EnvConfig(observation=ContinuousObservation(tracked_movers=3))
    names = [field.name for field in make_fields(config)]
    plain = [field.name for field in make_fields(EnvConfig())]
    assert [name for name in names if not name.startswith("mover_")] == plain
    sets = observation_sets(make_fields(config))
    [group] = [part for part in sets.sets if part.group == "mover"]
    assert (group.count, group.mask) == (3, 0)
    encoder = SetEncoder(sets, 8, 4)
    vector = jnp.zeros((2, sets.size)).at[1, group.start].set(1.0)
    parts = sets.split(vector)
    weights = encoder.init(jax.random.key(0), parts, sets.present(parts))
    assert "mover_0" in weights["params"]
    found: Any = encoder.apply(weights, parts, sets.present(parts))
    assert np.isfinite(found).all()
