"""Statistics of hand-worked episodes, and what is reported of them."""

import dataclasses
import functools
import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import cars, lot
from helpers.states import parked_at
from helpers.transitions import no_events, no_goal_events, no_terms, transition

from carpark_mj.config import (
    METRICS,
    EnvConfig,
    GoalConfig,
    Metric,
    MetricsConfig,
    SimConfig,
    register_metric,
)
from carpark_mj.evaluation.aggregation import complete_row, summarize
from carpark_mj.evaluation.catalogue import metrics
from carpark_mj.evaluation.report import print_metrics
from carpark_mj.mdp.collisions import HORIZON, RANGE
from carpark_mj.mdp.metrics import (
    CONTEXTS,
    COUNTS,
    count_goals,
    episode_metrics,
    init_stats,
    update_stats,
)
from carpark_mj.mdp.progress import MOVING
from carpark_mj.types import NO_BAY

ONE, TWO = (EnvConfig(num_agents=count, num_parked_cars=16) for count in (1, 2))
PLAN = lot([(0, 0, 0)])
STANDING = cars([(0.0, 0.0, 0.0)])


@functools.cache
def stepped(config):
    """A compiled step, and the statistics with it."""
    terms = no_terms(config)

    @jax.jit
    def step(stats, before, after, parked, goal):
        state = {"stats": stats, "parked_cars": parked}
        happened = transition(config, PLAN, before, after, state, goal)
        return happened, update_stats(config, happened, terms)

    return step


def driven(config, states, parked=None, goal=0):
    """The last step of cars that pass through some states, and their statistics."""
    happened, stats = None, init_stats(config, PLAN)
    parked = parked_at() if parked is None else parked
    for before, after in itertools.pairwise(states):
        happened, stats = stepped(config)(stats, before, after, parked, goal)
    return happened, stats


def after_speeds(speeds):
    """Statistics of one car that ends its steps at the given speeds."""
    states = [cars([(0.0, 0.0, 0.0)], speed=speed) for speed in speeds]
    return driven(ONE, [STANDING, *states])[1]


def test_path_is_measured_along_the_trace():
    trace = [[(3.0, 0.0, 0.0), (3.0, 4.0, 0.0), (0.0, 4.0, 0.0), (0.0, 0.0, 0.0)]]
    after = cars([(0.0, 0.0, 0.0)], trace=trace)
    _, stats = driven(ONE, [STANDING, after, after])
    np.testing.assert_allclose(stats.path, [2 * (3 + 4 + 3 + 4)], rtol=1e-6)


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
    state = {"stats": first, "active": active}
    happened = transition(config, PLAN, before, after, state)
    stats = update_stats(config, happened, no_terms(config) | terms)
    for old, new in zip(jax.tree.leaves(first), jax.tree.leaves(stats), strict=True):
        assert new[0] == old[0]
    assert stats.length[1] == 1.0
    assert stats.tallies["return_time"][1] == -1.0
    assert stats.tallies["speed_sum"][1] == 2.0


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


DT = SimConfig().ctrl_dt
SAFETY, DRIVING = MetricsConfig(safety=True), MetricsConfig(driving=True)


def tally(measured, states, **more):
    """Tallies of the first of the cars that pass through some states."""
    config = EnvConfig(num_agents=states[0].size.shape[0], metrics=measured)
    _, stats = driven(config, states, **more)
    found = {name: float(value[0]) for name, value in stats.tallies.items()}
    return {name: x for name, x in found.items() if not name.startswith("return_")}


def test_braking_gives_hand_worked_deceleration_and_jerk():
    # 0.6, then 1.2 and 1.2 m/s less per step of 0.2 s: 3, 6, 6 m/s2, then none; the
    # jerk is 3 / 0.2 = 15 at first, then 15, 0 and 6 / 0.2 = 30 m/s3.
    assert DT == 0.2
    speeds = (3.0, 2.4, 1.2, 0.0, 0.0)
    found = tally(SAFETY, [cars([(0, 0, 0.7)], speed=speed) for speed in speeds])
    expected = {
        "acceleration_sum": 3 + 6 + 6,
        "peak_acceleration": 6.0,
        "jerk_sum": 15 + 15 + 0 + 30,
        "peak_jerk": 30.0,
    }
    # float32: 1e-6 m/s over 0.04 s2.
    assert {name: found[name] for name in expected} == pytest.approx(expected, abs=1e-4)


def test_turning_is_acceleration_towards_the_centre():
    speed, turn = 3.0, 0.1  # m/s, rad per step
    found = tally(SAFETY, [cars([(0, 0, k * turn)], speed=speed) for k in range(4)])
    # Chords: of the velocity's turn, and of the acceleration's, which turns as well.
    chord = 2 * speed * np.sin(turn / 2) / DT
    assert chord == pytest.approx(speed * turn / DT, rel=1e-3)
    assert found["peak_acceleration"] == pytest.approx(chord, rel=1e-5)
    assert found["acceleration_sum"] == pytest.approx(3 * chord, rel=1e-5)
    assert found["peak_jerk"] == pytest.approx(chord / DT, rel=1e-5)  # at the start
    steady = 2 * chord * np.sin(turn / 2) / DT
    assert found["jerk_sum"] == pytest.approx(chord / DT + 2 * steady, rel=1e-4)
    assert found["min_clearance_wall"] == RANGE
    assert found["min_collision_time_agent"] == HORIZON


def test_least_clearance_and_time_are_of_the_worst_step():
    # Towards a parked car 4 m long at 20 m: gaps of 8, 6 and 9 m, at 1, 3 and -1 m/s.
    parked = parked_at([(20, 0, 0)], (4.0, 2.0))
    states = [cars([(x, 0, 0)], speed=v) for x, v in ((8, 1), (8, 1), (10, 3), (7, -1))]
    found = tally(SAFETY, states, parked=parked)
    assert found["min_clearance_parked_car"] == pytest.approx(6.0, abs=1e-5)
    assert found["min_collision_time_parked_car"] == pytest.approx(2.0, abs=1e-5)
    absent = parked_at([(20, 0, 0)], (4.0, 2.0), present=False)
    found = tally(SAFETY, states, parked=absent)
    assert found["min_clearance_parked_car"] == RANGE
    assert found["min_collision_time_parked_car"] == HORIZON


def test_driving_is_summed_up_as_by_hand():
    states = [
        cars([(10.0, 0, 0)]),
        cars([(9.0, 0, 0)], speed=-1.5, steering=0.1, yaw_rate=-0.2),
        cars([(9.0, 0, 0)], speed=0.5, steering=-0.1, yaw_rate=0.3),
        cars([(8.5, 0, 0)], speed=0.25, steering=-0.1),
    ]
    parked = parked_at([(9, 3, 0), (9, 1, 0)], present=[True, False])
    found = tally(DRIVING, states, parked=parked)
    assert found == pytest.approx(
        {
            "speed_sum": 2.25,
            "yaw_rate_sum": 0.5,
            "steering_rate_sum": (0.1 + 0.2) / DT,
            "goal_steps": 3.0,
            "towards_goal_steps": 2.0,  # the second step stays where it was
            "nearest_car_sum": 3.0 + 3.0 + np.hypot(0.5, 3.0),
            "nearest_car_steps": 3.0,
        }
    )


def test_the_nearest_car_may_be_another_agent():
    states = [cars([(0, 0, 0), (3.0, 4.0, 0)])] * 2
    found = tally(DRIVING, states, parked=parked_at([(6.0, 0.0, 0.0)]))
    assert found["nearest_car_sum"] == pytest.approx(5.0)
    # Steps without goal or other car do not count.
    states = [cars([(5.0, 0, 0)]), cars([(4.0, 0, 0)])]
    found = tally(DRIVING, states, goal=NO_BAY)
    for name in ("goal_steps", "towards_goal_steps", "nearest_car_steps"):
        assert found[name] == 0.0
    assert found["nearest_car_sum"] == 0.0  # not inf


BAYS = lot([(10.0, 0.0, 0.0), (-10.0, 0.0, 0.0), (0.0, 10.0, 0.0)])


def test_giving_up_a_goal_in_a_context_is_giving_way():
    # Four agents in the context, one outside; losing a goal is not letting go of it.
    events = no_goal_events(
        5,
        change_goal=[True, False, False, False, True],
        stop_goal=[False, True, False, False, False],
        continue_goal=[False, False, True, True, False],
        lost_taken=[False, False, False, True, False],
        local_any=[True, True, True, True, False],
        global_any=[True] * 5,
    )
    config = EnvConfig(num_agents=5, goals=GoalConfig(dynamic=True))
    before, after = cars(np.zeros((5, 3))), cars([(1.0, 0.0, 0.0)] * 5)
    tracked = {"tracked_bays": jnp.zeros((5, 1), jnp.int32)}
    step = transition(config, BAYS, before, after, tracked, goal_events=events)
    counts = count_goals(step)
    assert not {*COUNTS} & {*init_stats(TWO, BAYS).tallies}  # of fixed goals
    tallies = init_stats(config, BAYS).tallies
    assert not any(tallies[name].any() for name in COUNTS)
    assert tuple(counts) == COUNTS
    found = {name: np.asarray(count, float).tolist() for name, count in counts.items()}
    assert found["towards_bay_steps"] == [0, 1, 0, 0, 0]  # without a goal alone
    assert found["met_local_any"] == [1, 1, 1, 1, 0]
    assert found["gave_way_local_any"] == [1, 1, 0, 0, 0]
    assert found["met_global_any"] == [1, 1, 1, 1, 1]
    assert found["gave_way_global_any"] == [1, 1, 0, 0, 1]
    for name in set(CONTEXTS) - {"local_any", "global_any"}:
        assert found[f"met_{name}"] == found[f"gave_way_{name}"] == [0] * 5


POOLS = {"count": "mean", "pace": "steps", "min_pace": "least", "peak_pace": "most"}


@pytest.fixture
def registered(monkeypatch):
    """Metrics of the signed speed, one for every way to add up."""
    monkeypatch.setattr(METRICS, "_parts", dict(METRICS._parts))
    for name, pool in POOLS.items():
        value = lambda config, step: step.after.motion.speed  # noqa: E731
        register_metric(Metric(name, "m/s", "speed", pool, value=value))


def episode(extra):
    """Metrics of two cars after two steps."""
    config = EnvConfig(num_agents=2, metrics=MetricsConfig(extra=extra))
    speeds = [(0.0, 0.0), (3.0, -1.0), (1.0, -2.0)]
    states = [cars([(0.0, 0.0, 0.0)] * 2, speed=speed) for speed in speeds]
    found = episode_metrics(*driven(config, states))
    return {name: np.asarray(value).tolist() for name, value in found.items()}


def test_metrics_are_pooled_over_an_episode(registered):
    found = episode(tuple(POOLS))
    assert found["count"] == found["pace_sum"] == [4.0, -3.0]
    assert found["min_pace"] == [1.0, -2.0]
    assert found["peak_pace"] == [3.0, -1.0]  # not 0, where it began


def test_what_is_not_asked_for_is_not_measured(registered):
    assert "count" not in episode(())
    assert {"count", "pace_sum"} & {*episode(("pace",))} == {"pace_sum"}
    assert {*POOLS} <= {*MetricsConfig.everything().extra}


def test_evaluations_have_it_in_their_rows_summaries_and_tables(registered, capsys):
    found = episode(tuple(POOLS))
    each = ({name: value[k] for name, value in found.items()} for k in range(2))
    rows = [complete_row(row, 0.2) for row in each]
    assert [row["pace"] for row in rows] == [2.0, -1.5]
    summary = summarize(rows)
    assert summary["pace"] == pytest.approx(0.25)
    assert summary["count"] == pytest.approx(0.5)
    assert summary["min_pace"]["min"] == -2.0
    assert summary["peak_pace"]["max"] == 3.0
    assert {*POOLS} <= {metric.name for metric in metrics()}
    print_metrics(summary)
    assert "peak pace" in capsys.readouterr().out
