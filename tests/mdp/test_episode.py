"""Statistics of hand-worked episodes, and what is reported of them."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import cars, lot
from helpers.transitions import no_events, no_terms, transition

from carpark_mj.config import EnvConfig, MetricsConfig
from carpark_mj.mdp.metrics import episode_metrics, init_stats, update_stats
from carpark_mj.mdp.progress import MOVING
from carpark_mj.types import Events

ONE, TWO = (EnvConfig(num_agents=count, num_parked_cars=16) for count in (1, 2))
PLAN = lot([(0, 0, 0)])
STANDING = cars([(0.0, 0.0, 0.0)])


def step(config, stats, before, after, terms=(), active=True, **more):
    """Statistics with a step added, whose reward is nothing except the terms given."""
    state = {"stats": stats, "active": jnp.asarray(active)}
    happened = transition(config, PLAN, before, after, state, **more)
    return update_stats(config, happened, no_terms(config) | dict(terms))


def after_speeds(speeds):
    """Statistics of one car that ends its steps at the given speeds."""
    stats = init_stats(ONE, PLAN)
    for speed in speeds:
        stats = step(ONE, stats, STANDING, cars([(0.0, 0.0, 0.0)], speed=speed))
    return stats


def test_return_length_and_invalid_actions_are_sums_over_steps():
    stats, standing = init_stats(TWO, PLAN), cars([(0.0, 0.0, 0.0)] * 2)
    for park, time in (
        ([1.5, -2.0], [-0.5, 0.0]),
        ([0.5, 0.0], [0.0, 0.25]),
        ([-1.0, 0.0], [-2.0, 0.0]),
    ):
        terms = {"park": jnp.array(park), "time": jnp.array(time)}
        invalid = jnp.array([True, False])
        stats = step(TWO, stats, standing, standing, terms, invalid_action=invalid)
    np.testing.assert_array_equal(stats.episode_return, [-1.5, -1.75])
    np.testing.assert_array_equal(stats.length, [3.0, 3.0])
    np.testing.assert_array_equal(stats.invalid_actions, [3.0, 0.0])


def test_the_path_is_measured_along_the_trace_not_as_the_crow_flies():
    trace = [[(3.0, 0.0, 0.0), (3.0, 4.0, 0.0), (0.0, 4.0, 0.0), (0.0, 0.0, 0.0)]]
    after = cars([(0.0, 0.0, 0.0)], trace=trace)
    stats = step(ONE, init_stats(ONE, PLAN), STANDING, after)
    np.testing.assert_allclose(stats.path, [3 + 4 + 3 + 4], rtol=1e-6)
    stats = step(ONE, stats, STANDING, after)
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


def test_the_statistics_of_finished_agents_stay_as_they_are():
    config = dataclasses.replace(TWO, metrics=MetricsConfig(driving=True, safety=True))
    before, after = (cars([(x, 0.0, 0.0), (0.0, 9.0, 0.0)], x) for x in (3.0, 2.0))
    terms = {"time": jnp.full(2, -1.0)}
    first = init_stats(config, PLAN)
    active = jnp.array([False, True])
    stats = step(config, first, before, after, terms, active=active)
    for old, new in zip(jax.tree.leaves(first), jax.tree.leaves(stats), strict=True):
        assert new[0] == old[0]
    assert stats.length[1] == 1.0
    assert stats.tallies["return_time"][1] == -1.0
    assert stats.tallies["speed_sum"][1] == 2.0


def test_lots_without_lanes_count_no_metres_against_them():
    first = init_stats(ONE, PLAN)
    assert first.wrong_way is None
    plan = dataclasses.replace(PLAN, lane_mask=jnp.ones(1, bool))
    stats = init_stats(ONE, plan)
    assert stats.wrong_way is not None
    for wrong in (True, False, True):
        happened = transition(
            ONE,
            plan,
            STANDING,
            cars([(2.0, 0, 0)]),
            {"stats": stats},
            wrong_way=jnp.array([wrong]),
        )
        stats = update_stats(ONE, happened, no_terms(ONE))
    assert stats.wrong_way.tolist() == [4.0]
    named = episode_metrics(happened, stats)
    assert (float(named["wrong_way"][0]), float(named["path"][0])) == (4.0, 6.0)


def test_metrics_tell_how_a_car_stands_to_its_goal():
    goal = jnp.array([[3.0, 4.0, 0.0], [0.0, 0.0, math.pi / 2]])
    after = cars([(0.0, 0.0, math.pi - 0.1), (0.0, 0.5, 0.0)], speed=[-0.7, 0.2])
    crashed = no_events(2, crashed=[True, False])
    happened = transition(TWO, PLAN, after, after, target_pose=goal, events=crashed)
    metrics = episode_metrics(happened, init_stats(TWO, PLAN))
    # float32 rounding of numbers up to 5.
    np.testing.assert_allclose(metrics["final_distance"], [5.0, 0.5], atol=1e-6)
    np.testing.assert_allclose(metrics["final_heading"], [0.1, np.pi / 2], atol=1e-6)
    np.testing.assert_allclose(metrics["final_speed"], [0.7, 0.2], atol=1e-6)
    np.testing.assert_array_equal(metrics["crashed"], [1.0, 0.0])
    np.testing.assert_array_equal(metrics["parked"], [0.0, 0.0])


def test_every_event_and_every_sum_has_a_metric_of_its_own():
    stats = after_speeds([1.0, -1.0]).replace(episode_return=jnp.array([7.0]))
    for field in dataclasses.fields(Events):
        events = no_events(1, **{field.name: [True]})
        happened = transition(ONE, PLAN, STANDING, STANDING, events=events)
        metrics = episode_metrics(happened, stats)
        flags = {f.name: float(metrics[f.name][0]) for f in dataclasses.fields(Events)}
        assert flags == {name: float(name == field.name) for name in flags}
    assert float(metrics["episode_return"][0]) == 7.0
    assert float(metrics["length"][0]) == 2.0
    assert float(metrics["gear_changes"][0]) == 1.0
    for value in metrics.values():
        assert value.dtype == jnp.float32


def test_every_reward_term_is_summed_up_by_name_and_memory_is_not_reported():
    config = dataclasses.replace(TWO, metrics=MetricsConfig(safety=True))
    stats, standing = init_stats(config, PLAN), cars([(0.0, 0.0, 0.0)] * 2)
    for park, time in (([0.0, 1.0], [-0.5, -0.5]), ([3.0, 0.0], [-0.25, 0.0])):
        terms = {"time": jnp.array(time), "park": jnp.array(park)}
        stats = step(config, stats, standing, standing, terms)
    happened = transition(config, PLAN, standing, standing)
    metrics = episode_metrics(happened, stats)
    np.testing.assert_array_equal(metrics["return_park"], [3.0, 1.0])
    np.testing.assert_array_equal(metrics["return_time"], [-0.75, -0.5])
    names = {f"return_{name}" for name in no_terms(config)}
    assert {name for name in metrics if name.startswith("return_")} == names
    assert "last_acceleration_x" in stats.tallies
    assert not any(name.startswith("last_") for name in metrics)


def test_a_step_keeps_the_type_of_the_statistics():
    everything = MetricsConfig(driving=True, safety=True)
    config = dataclasses.replace(TWO, metrics=everything)
    first, standing = init_stats(config, PLAN), cars([(0.0, 0.0, 0.0)] * 2)
    found = jax.eval_shape(lambda: step(config, first, standing, standing))
    assert jax.tree.structure(found) == jax.tree.structure(first)
    for leaf in jax.tree.leaves(found):
        assert (leaf.shape, leaf.dtype, leaf.weak_type) == ((2,), jnp.float32, False)
