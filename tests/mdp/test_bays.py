"""Who fits into which bay, and bays drawn at random."""

import jax
import jax.numpy as jnp
import numpy as np
from helpers.scenes import lot

from carpark_mj.config import EnvConfig, EpisodeConfig, FleetConfig
from carpark_mj.layouts import Maxima, make_layout, pad_layout
from carpark_mj.mdp.parked_cars import BayFits, bay_fits, fits, free_bays, marked
from carpark_mj.observations import ContinuousObservation
from carpark_mj.spawning.fleet import Wanted, draw_bays, shuffled_bays
from carpark_mj.types import NO_BAY

ROW = lot([(10.0 * k, 0.0, 0.0) for k in range(4)])


def keys(count, seed=0):
    return jax.random.split(jax.random.key(seed), count)


def test_a_bay_must_leave_the_slack_in_length_and_in_width():
    bays = jnp.array([[5.0, 2.5], [4.4, 2.5], [5.0, 1.9], [4.3, 1.8]])
    car = jnp.array([4.3, 1.8])
    np.testing.assert_array_equal(fits(bays, car), [True] * 4)
    np.testing.assert_array_equal(fits(bays, car, 0.05), [True, True, True, False])
    np.testing.assert_array_equal(fits(bays, car, 0.3), [True, False, False, False])
    both = fits(bays, jnp.array([[4.3, 1.8], [4.9, 2.0]]))
    np.testing.assert_array_equal(both[1], [True, False, False, False])


def test_only_agents_of_a_fleet_need_the_slack_of_the_parked_rule():
    size = jnp.array([[4.95, 2.4]])
    layout = ROW.replace(bay_size=jnp.full((4, 2), 5.0).at[0, 0].set(4.9))
    assert bay_fits(EnvConfig(), layout, size, size) == BayFits()
    some = EnvConfig(occupancy=(0.2, 0.4))  # all of one kind: any bay is a goal
    found = bay_fits(some, layout, size, size)
    assert found.agents is None
    np.testing.assert_array_equal(found.parked_cars, [[False, True, True, True]])
    for rule, agents in (
        ("strict", [False] * 4),
        ("tanner", [False, True, True, True]),
    ):
        fleet = EnvConfig(
            fleet=FleetConfig(agents=("city", "van")),
            observation=ContinuousObservation(own_car=True),
            episode=EpisodeConfig(parked_rule=rule),
        )
        found = bay_fits(fleet, layout, size, size)
        np.testing.assert_array_equal(found.agents, [agents])
        np.testing.assert_array_equal(found.parked_cars, [[False, True, True, True]])


def test_no_bay_marks_nothing_and_padding_is_never_free():
    layout = pad_layout(ROW, Maxima(6, 1, 1, 0, 1))
    bays = jnp.array([2, NO_BAY], jnp.int32)
    assert free_bays(layout, bays).tolist() == [True, True, False, True, False, False]
    assert marked(layout, bays).tolist() == [False, False, True, False, False, False]


def test_shuffled_bays_are_all_bays_in_any_order_with_the_padding_last():
    layout = pad_layout(make_layout("square"), Maxima(40, 8, 0, 0, 1))
    order = np.asarray(jax.vmap(lambda key: shuffled_bays(layout, key))(keys(3600)))
    assert order.dtype == np.int32
    np.testing.assert_array_equal(np.sort(order[:, :36], axis=1), [range(36)] * 3600)
    np.testing.assert_array_equal(
        np.sort(order[:, 36:], axis=1), [range(36, 40)] * 3600
    )
    # Binomial with mean 100 and deviation 10: five of them, in the first place and in
    # the last.
    for place in (0, 35):
        count = np.bincount(order[:, place], minlength=36)[:36]
        np.testing.assert_allclose(count, 100, atol=50)


def draw_many(wanted, free, count=4000):
    draw = jax.jit(jax.vmap(lambda key: draw_bays(wanted, jnp.array(free), key)))
    return map(np.asarray, draw(keys(count)))


def test_kinds_are_drawn_by_weight_among_those_that_fit_into_a_free_bay():
    # Kind 0 fits everywhere, kind 1 in bay 2 only, kind 2 in bay 0, which is taken.
    fit = jnp.array([[True] * 4, [False, False, True, False], [True, *[False] * 3]])
    wanted = Wanted(
        fits=jnp.stack([fit, fit]),
        weights=jnp.array([1.0, 3.0, 5.0]),
        cars=jnp.ones(2, bool),
        anywhere=False,
    )
    kind, bay = draw_many(wanted, [False, True, True, True])
    assert (bay[:, 0] != bay[:, 1]).all()
    assert (bay > 0).all()
    # Deviation of a share of 4,000 at most 0.8 %: five of them.
    np.testing.assert_allclose((kind == 1).mean(axis=0)[0], 0.75, atol=0.04)
    assert not (kind == 2).any()
    assert (bay[kind == 1] == 2).all()
    second = bay[:, 0] == 2  # then no bay is left for kind 1
    assert (kind[second, 1] == 0).all()


def test_who_finds_no_bay_that_fits_gets_none_or_any():
    fit = jnp.array([[[False, False, False, True]]] * 3)
    for anywhere in (False, True):
        wanted = Wanted(fit, jnp.ones(1), jnp.array([True, False, True]), anywhere)
        _, bay = draw_many(wanted, [True] * 4, count=50)
        assert (bay[:, 0] == 3).all()
        assert (bay[:, 1] == NO_BAY).all()  # wants none
        assert set(bay[:, 2]) == ({0, 1, 2} if anywhere else {NO_BAY})
