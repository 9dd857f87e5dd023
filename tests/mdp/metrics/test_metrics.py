import dataclasses
import math

import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import cars

from carpark_mj.mdp.metrics.episode import (
    MOVING,
    init_stats,
    step_metrics,
    update_stats,
)
from carpark_mj.types import Events


def no_events(count, **true):
    flags = {f.name: jnp.zeros(count, bool) for f in dataclasses.fields(Events)}
    return Events(**(flags | true))


def after_speeds(speeds):
    """Statistics of one car that ends its steps at the given speeds."""
    stats, standing = init_stats(1), cars([(0.0, 0.0, 0.0)])
    for speed in speeds:
        moving = cars([(0.0, 0.0, 0.0)], speed=speed)
        stats = update_stats(stats, standing, moving, jnp.zeros(1), jnp.zeros(1, bool))
    return stats


def test_return_length_and_invalid_actions_are_sums_over_steps():
    stats, standing = init_stats(2), cars([(0.0, 0.0, 0.0)] * 2)
    for reward in ([1.0, -2.0], [0.5, 0.25], [-3.0, 0.0]):
        stats = update_stats(
            stats, standing, standing, jnp.array(reward), jnp.array([True, False])
        )
    np.testing.assert_array_equal(stats.episode_return, [-1.5, -1.75])
    np.testing.assert_array_equal(stats.length, [3.0, 3.0])
    np.testing.assert_array_equal(stats.invalid_actions, [3.0, 0.0])


def test_the_path_is_measured_along_the_trace_not_as_the_crow_flies():
    before = cars([(0.0, 0.0, 0.0)])
    trace = [[(3.0, 0.0, 0.0), (3.0, 4.0, 0.0), (0.0, 4.0, 0.0), (0.0, 0.0, 0.0)]]
    after = cars([(0.0, 0.0, 0.0)], trace=trace)
    nothing = jnp.zeros(1), jnp.zeros(1, bool)
    stats = update_stats(init_stats(1), before, after, *nothing)
    np.testing.assert_allclose(stats.path, [3 + 4 + 3 + 4], rtol=1e-6)
    stats = update_stats(stats, before, after, *nothing)
    np.testing.assert_allclose(stats.path, [28.0], rtol=1e-6)


@pytest.mark.parametrize(
    ("speeds", "changes"),
    [
        ([1.0, 1.0, 2.0], 0),
        ([1.0, -1.0], 1),
        ([1.0, -1.0, 1.0, -1.0], 3),
        ([-1.0, 0.0, 0.0, 1.0], 1),  # a halt in between does not hide the change
        ([1.0, 0.0, 1.0], 0),
        ([0.0, -1.0], 0),  # the first motion is no change
        ([1.0, -0.9 * MOVING, 1.0], 0),  # rolling back a little is no direction
        ([1.0, -1.1 * MOVING, 1.0], 2),
    ],
)
def test_gear_changes_count_changes_of_the_direction_of_travel(speeds, changes):
    assert float(after_speeds(speeds).gear_changes[0]) == changes


def test_metrics_tell_how_a_car_stands_to_its_goal():
    goal = jnp.array([[3.0, 4.0, 0.0], [0.0, 0.0, math.pi / 2]])
    after = cars([(0.0, 0.0, math.pi - 0.1), (0.0, 0.5, 0.0)], speed=[-0.7, 0.2])
    events = no_events(2, crashed=jnp.array([True, False]))
    metrics = step_metrics(init_stats(2), events, after, goal)
    # float32 rounding of numbers up to 5.
    np.testing.assert_allclose(metrics["final_distance"], [5.0, 0.5], atol=1e-6)
    np.testing.assert_allclose(metrics["final_heading"], [0.1, np.pi / 2], atol=1e-6)
    np.testing.assert_allclose(metrics["final_speed"], [0.7, 0.2], atol=1e-6)
    np.testing.assert_array_equal(metrics["crashed"], [1.0, 0.0])
    np.testing.assert_array_equal(metrics["parked"], [0.0, 0.0])


def test_every_event_and_every_sum_has_a_metric_of_its_own():
    stats = after_speeds([1.0, -1.0]).replace(episode_return=jnp.array([7.0]))
    for field in dataclasses.fields(Events):
        events = no_events(1, **{field.name: jnp.ones(1, bool)})
        metrics = step_metrics(
            stats, events, cars([(0.0, 0.0, 0.0)]), jnp.zeros((1, 3))
        )
        flags = {f.name: float(metrics[f.name][0]) for f in dataclasses.fields(Events)}
        assert flags == {name: float(name == field.name) for name in flags}
    assert float(metrics["episode_return"][0]) == 7.0
    assert float(metrics["length"][0]) == 2.0
    assert float(metrics["gear_changes"][0]) == 1.0
    for value in metrics.values():
        assert value.dtype == jnp.float32


def test_every_reward_term_is_summed_up_by_name():
    nothing = dict.fromkeys(("return_park", "return_time"), jnp.zeros(2))
    stats, standing = init_stats(2, tallies=nothing), cars([(0.0, 0.0, 0.0)] * 2)
    for park, time in (([0.0, 1.0], [-0.5, -0.5]), ([3.0, 0.0], [-0.25, 0.0])):
        named = {"return_time": jnp.array(time), "return_park": jnp.array(park)}
        nobody = jnp.zeros(2), jnp.zeros(2, bool)
        stats = update_stats(stats, standing, standing, *nobody, measured=named)
    metrics = step_metrics(stats, no_events(2), standing, jnp.zeros((2, 3)))
    np.testing.assert_array_equal(metrics["return_park"], [3.0, 1.0])
    np.testing.assert_array_equal(metrics["return_time"], [-0.75, -0.5])
    assert {name for name in metrics if name.startswith("return_")} == {
        "return_park",
        "return_time",
    }
