"""Ends of episodes and rewards at the junction."""

import dataclasses

import jax
import jax.numpy as jnp
import junctions
import numpy as np
import pytest
import shapely

from carpark_mj.geometry import box_corners
from carpark_papers.cederle.junction.config import RewardRules
from carpark_papers.cederle.junction.rules import (
    Events,
    collide,
    detect_events,
    pay_progress,
    reward,
)

ENV = junctions.env(scenario="2av-hd")
WEST, EAST, SOUTH = np.pi, 0.0, -np.pi / 2
APART = [[20.0, 1.65, WEST], [-20.0, -1.65, EAST], [1.65, -20.0, np.pi / 2]]
detected = jax.jit(detect_events, static_argnums=1)
overlap = jax.jit(collide)


def events(*poses, step=1):
    """Names of the events of both agents, the rest standing apart."""
    state = junctions.with_poses(junctions.begin(ENV), [*poses, *APART[len(poses) :]])
    state = dataclasses.replace(state, step=jnp.array(step))
    flags = vars(detected(state, 75))
    return [{name for name, flag in flags.items() if flag[k]} for k in range(2)]


def test_events_of_places_on_the_road_and_off_it():
    assert events() == [set(), set()]  # in their lanes
    # Agent 0 ends where the south arm does, at (-1.65, -39.02); within 2 m it is there.
    assert events([-1.65, -37.1, SOUTH])[0] == {"arrived"}
    assert events([-1.65, -36.9, SOUTH])[0] == set()
    # Its front is beyond the end of the arm, where the road goes on.
    assert events([-1.65, -39.0, SOUTH])[0] == {"arrived"}
    # Leaving the road is seen first by a corner, then by the centre.
    assert events([20.0, 2.6, WEST])[0] == {"on_shoulder"}
    assert events([20.0, 3.4, WEST])[0] == {"on_shoulder", "off_road", "off_route"}
    assert events([20.0, -1.0, WEST])[0] == {"off_route"}
    assert events([20.0, 1.65, EAST])[0] == {"wrong_way"}
    assert events([2.0, 0.9, SOUTH - 0.5])[0] == set()  # 61 deg, while it turns


def test_time_is_up_for_those_who_have_not_arrived():
    late = events([-1.65, -38.0, SOUTH], step=75)
    assert late == [{"arrived"}, {"timed_out"}]
    assert events(step=74) == [set(), set()]


def test_a_crash_is_that_of_both_and_who_has_left_hits_nobody():
    state = junctions.begin(ENV)
    state = junctions.with_poses(state, [APART[0], APART[1], [-17.0, -1.65, 0.0]])
    assert overlap(state).tolist() == [False, True, True]
    left = dataclasses.replace(state, present=jnp.array([True, True, False]))
    assert overlap(left).tolist() == [False, False, False]


def test_crashes_are_overlaps_of_boxes_at_any_traced_instant():
    draw = np.random.default_rng(0)
    state = junctions.begin(ENV)
    shape = state.motion.trace_w.shape
    found, expected = [], []
    for _ in range(60):
        trace = draw.uniform(-4, 4, shape).astype(np.float32)
        motion = dataclasses.replace(state.motion, trace_w=jnp.array(trace))
        found.append(overlap(dataclasses.replace(state, motion=motion)).tolist())
        corners = box_corners(trace, np.asarray(state.motion.size)[:, None])
        boxes = shapely.polygons(np.asarray(corners))
        hit = shapely.intersects(boxes[:, None], boxes[None]).any(axis=-1)
        expected.append((hit & ~np.eye(3, dtype=bool)).any(axis=1).tolist())
    assert found == expected
    assert 0.1 < np.mean(expected) < 0.95


def test_a_car_that_diverged_is_truncated_even_in_the_last_step():
    state = junctions.begin(ENV)
    motion = dataclasses.replace(state.motion, finite=jnp.array([False, True, True]))
    state = dataclasses.replace(state, motion=motion, step=jnp.array(75))
    found = detected(state, 75)
    assert found.diverged.tolist() == [True, False]
    assert found.timed_out.tolist() == [False, True]
    assert not found.terminal.any()


def test_who_has_finished_has_no_events():
    state = junctions.with_poses(junctions.begin(ENV), [[20.0, 9.0, 0.0], *APART[1:]])
    state = dataclasses.replace(state, active=jnp.array([False, True]))
    assert not any(flag[0] for flag in vars(detected(state, 75)).values())


NAMES = tuple(Events.__dataclass_fields__)


def events_of(*of_agents):
    flags = {n: jnp.array([n in names for names in of_agents]) for n in NAMES}
    return Events(**flags)


def test_way_is_paid_in_pieces_of_more_than_half_a_metre():
    paid, unpaid = pay_progress(jnp.array([0.3, 0.5, 0.6, 1.5]))
    np.testing.assert_allclose(paid, [0, 0, 0.6, 1.5])
    np.testing.assert_allclose(unpaid, [0.3, 0.5, 0, 0])


@pytest.mark.parametrize(
    ("happened", "added", "replaced"),
    [
        ((), 1.4, 1.4),
        (("crashed",), -8.6, -10.0),
        (("arrived",), 11.4, 10.0),
        (("off_road", "on_shoulder", "off_route"), -8.6, -10.0),
        (("on_shoulder",), -8.6, -10.0),
        (("off_road",), -8.6, -10.0),
        (("off_route",), -8.6, -10.0),
        (("wrong_way",), -8.6, -10.0),
        (("crashed", "arrived"), 1.4, -10.0),
        (("timed_out",), 1.4, 1.4),
    ],
)
def test_events_are_added_in_the_text_and_replace_the_way(happened, added, replaced):
    for rule, value in (("added", added), ("replaced", replaced)):
        found = reward(
            RewardRules(rule), jnp.array([1.4, 0.7]), events_of(happened, ())
        )
        np.testing.assert_allclose(found, [value, 0.7], rtol=1e-6)


def test_the_joint_reward_is_the_sum_for_everybody():
    found = reward(
        RewardRules(joint=True), jnp.array([1.4, 0.7]), events_of(("crashed",), ())
    )
    np.testing.assert_allclose(found, [-7.9, -7.9], rtol=1e-6)
