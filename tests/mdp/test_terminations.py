"""How episodes end, under every rule of what "parked" means."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.registering import restore_after
from helpers.rules import LIMITS
from helpers.scenes import cars, crossing, lot, moved, moved_cars, random_lots
from helpers.states import parked_at, parked_in, state_of

from carpark_mj.config import ENDS, PARKED_RULES, End, EpisodeConfig, ParkedRule
from carpark_mj.mdp.terminations import detect_events, is_parked

detect_jit = jax.jit(detect_events, static_argnums=0)

WU = 0.5625  # m
BAY_SIZE = (6.0, 3.0)  # a car of 4 x 2 m has 1 m and 0.5 m to spare on each side
TILT = 1e-4  # what the thresholds are probed with, far above float32 rounding

# Pose in the bay's frame (m, m, deg), speed, whether it counts as parked.
CASES = {
    "tanner": [
        ((0.0, 0.0, 0.0), 0.0, True),
        ((1.001 * WU - TILT, 0.0, 0.0), 0.0, True),
        ((1.001 * WU + TILT, 0.0, 0.0), 0.0, False),
        ((0.0, -1.001 * WU + TILT, 0.0), 0.0, True),
        ((0.0, -1.001 * WU - TILT, 0.0), 0.0, False),
        ((0.56, 0.56, 0.0), 0.0, True),  # a square, not a circle
        ((0.0, 0.0, 90.0), 3.0, True),  # any heading, any speed
        ((0.5, -0.5, 45.0), -2.0, True),
    ],
    "strict": [
        ((0.0, 0.0, 0.0), 0.0, True),
        ((0.0, 0.0, 180.0), 0.0, True),  # nose out
        ((1.0 - TILT, 0.5 - TILT, 0.0), 0.0, True),  # in the corner, on the lines
        ((1.0 + TILT, 0.0, 0.0), 0.0, False),
        ((0.0, 0.5 + TILT, 0.0), 0.0, False),
        ((-1.0 - TILT, 0.0, 180.0), 0.0, False),
        ((0.0, 0.0, 4.99), 0.0, True),
        ((0.0, 0.0, 5.01), 0.0, False),
        ((0.0, 0.0, -4.99), 0.0, True),
        ((0.0, 0.0, -5.01), 0.0, False),
        ((0.0, 0.0, 184.99), 0.0, True),
        ((0.0, 0.0, 174.9), 0.0, False),
        ((0.0, 0.0, 90.0), 0.0, False),
        ((0.0, 0.0, 0.0), 0.2 - TILT, True),
        ((0.0, 0.0, 0.0), 0.2 + TILT, False),
        ((0.0, 0.0, 0.0), -0.2 + TILT, True),
        ((0.0, 0.0, 0.0), -0.2 - TILT, False),
        # Turned by 4 deg a corner leaves the lines: 2 sin 4 + cos 4 = 1.137 m half
        # width, 0.363 m to spare.
        ((0.0, 0.362, 4.0), 0.0, True),
        ((0.0, 0.364, 4.0), 0.0, False),
    ],
    "precise": [
        ((0.0, 0.0, 0.0), 0.0, True),
        ((0.0, 0.0, 180.0), 0.0, True),
        ((0.2 - TILT, 0.0, 0.0), 0.0, True),
        ((0.2 + TILT, 0.0, 0.0), 0.0, False),
        ((0.0, -0.2 - TILT, 0.0), 0.0, False),
        ((0.15, 0.15, 0.0), 0.0, False),  # a circle, not a square
        ((0.14, 0.14, 0.0), 0.0, True),
        ((0.0, 0.0, 2.99), 0.0, True),
        ((0.0, 0.0, 3.01), 0.0, False),
        ((0.0, 0.0, -177.01), 0.0, True),
        ((0.0, 0.0, -176.99), 0.0, False),
        ((0.0, 0.0, 0.0), 0.05 - TILT, True),
        ((0.0, 0.0, 0.0), 0.05 + TILT, False),
        ((0.0, 0.0, 0.0), -0.05 - TILT, False),
    ],
    # The far end lies 3 m behind the middle.
    "metadrive": [
        ((0.0, 0.0, 0.0), 0.0, True),
        ((2.0 - TILT, 0.0, 90.0), 3.0, True),  # any heading, any speed
        ((2.0 + TILT, 0.0, 0.0), 0.0, False),
        ((-8.0 + TILT, 0.0, 0.0), 0.0, True),  # 5 m beyond it
        ((-8.0 - TILT, 0.0, 0.0), 0.0, False),
        ((0.0, 1.5 - TILT, 0.0), 0.0, True),
        ((0.0, -1.5 - TILT, 0.0), 0.0, False),
    ],
}
CASES["exact"] = CASES["precise"]  # the lines are farther away; see below


# The bay lies anywhere and points anywhere; the rules are those of its own frame.
@pytest.mark.parametrize("bay", [(0.0, 0.0, 0.0), (3.0, -18.0, 1.57), (-7.0, 5.0, 2.5)])
@pytest.mark.parametrize("rule", sorted(LIMITS))
def test_parked_rules_hold_up_to_their_thresholds(rule, bay):
    local = np.array([pose for pose, _, _ in CASES[rule]])
    local[:, 2] = np.radians(local[:, 2])
    # A pose in the bay's frame is the bay's rigid motion applied to it.
    motion = cars(moved(local, bay), speed=[speed for _, speed, _ in CASES[rule]])
    got = is_parked(rule, motion, jnp.array(bay), jnp.array(BAY_SIZE))
    expected = np.array([parked for _, _, parked in CASES[rule]])
    wrong = [CASES[rule][k] for k in np.flatnonzero(np.asarray(got) != expected)]
    assert wrong == []


@pytest.mark.parametrize("rule", ["strict", "precise"])
def test_sliding_sideways_counts_as_speed(rule):
    motion = cars((0.0, 0.0, 0.0), speed=0.04, sideways=0.3)
    assert not is_parked(rule, motion, jnp.zeros(3), jnp.array(BAY_SIZE))


def test_exact_is_strict_and_precise_in_a_narrow_bay():
    draw = np.random.default_rng(0)
    pose = draw.uniform(-1.0, 1.0, (4000, 3)) * (0.25, 0.25, math.radians(6.0))
    motion = cars(pose, speed=draw.uniform(0.0, 0.08, 4000))
    strict, precise, exact = (
        is_parked(rule, motion, jnp.zeros(3), jnp.array([4.3, 2.2]))
        for rule in ("strict", "precise", "exact")
    )
    assert (strict & ~precise).any()
    assert (precise & ~strict).any()
    np.testing.assert_array_equal(exact, strict & precise)


FAR_LOT = lot([(30.0, 0.0, 0.0), (30.0, 10.0, 0.0), (30.0, 20.0, 0.0)])


def detected(
    motion, rule="strict", step=1, active=True, layout=FAR_LOT, goal=None, **config
):
    """Events of agents whose goals are bays 0, 1, …, with a parked car in bay 2."""
    count = motion.size.shape[0]
    state = state_of(
        layout,
        motion,
        jnp.arange(count) if goal is None else goal,
        parked_cars=parked_in(layout, [2]),
        step=jnp.full(count, step),
        active=jnp.broadcast_to(jnp.asarray(active), (count,)),
    )
    return detect_jit(EpisodeConfig(rule, max_steps=10, **config), state)


AWAY = (0.0, 0.0, 0.0)
IN_BAY_0 = (30.0, 0.0, 0.0)
ON_THE_PARKED_CAR = (30.0, 20.0, 0.0)


def flags(events):
    """The four exclusive outcomes of every agent, as a word each."""
    names = ("parked", "crashed", "timed_out", "diverged")
    table = np.stack([np.asarray(getattr(events, name)) for name in names], axis=1)
    assert (table.sum(axis=1) <= 1).all()
    np.testing.assert_array_equal(np.asarray(events.done), table.any(axis=1))
    return [names[row.argmax()] if row.any() else "drives on" for row in table]


BOTH = IN_BAY_0, ON_THE_PARKED_CAR
RULES = ("strict", "precise", "tanner")
LAST, LOST = {"step": 10}, {"step": 10, "finite": False}


@pytest.mark.parametrize(
    ("poses", "settings", "outcomes"),
    [
        ((IN_BAY_0, AWAY), {}, ("parked", "drives on")),
        ((IN_BAY_0, AWAY), {"goal": [1, 0]}, ("drives on",) * 2),  # another's bay
        ((IN_BAY_0,), {"speed": 1.0}, ("drives on",)),
        ((IN_BAY_0,), {"speed": 1.0, "rule": "precise,tanner"}, ("parked",)),  # either
        ((AWAY,), {"step": 9}, ("drives on",)),
        ((AWAY,), LAST, ("timed_out",)),
        (BOTH, LAST, ("parked", "crashed")),
        *((BOTH, LOST | {"rule": rule}, ("diverged",) * 2) for rule in RULES),
        (BOTH, LAST | {"active": False}, ("drives on",) * 2),  # finished before
        (BOTH, LOST | {"active": False}, ("drives on",) * 2),
        (  # of two in the goal of both the first parks
            (AWAY, IN_BAY_0, IN_BAY_0),
            {"goal": [0, 0, 0], "rule": "tanner"},
            ("drives on", "parked", "crashed"),
        ),
    ],
)
def test_what_a_step_ends_with(poses, settings, outcomes):
    about_cars = {k: v for k, v in settings.items() if k in ("speed", "finite")}
    others = {k: v for k, v in settings.items() if k not in about_cars}
    events = detected(cars(poses, **about_cars), **others)
    assert flags(events) == [*outcomes]
    if "crashed" not in outcomes:
        assert not (events.hit_agent | events.hit_parked_car | events.hit_wall).any()


@pytest.mark.parametrize(("step", "outcome"), [(9, "parked"), (10, "timed_out")])
def test_a_rule_may_put_the_timeout_first(monkeypatch, step, outcome):
    restore_after(monkeypatch, PARKED_RULES)
    PARKED_RULES.register("early", ParkedRule(speed=1.0, before_timeout=False))
    assert flags(detected(cars([IN_BAY_0]), "early", step)) == [outcome]
    assert flags(detected(cars([IN_BAY_0]), "early,strict", step)) == ["parked"]


@pytest.mark.parametrize("outcome", ["crashed", "timed_out"])
def test_ends_of_one_s_own_count_as_the_outcome_they_name(monkeypatch, outcome):
    restore_after(monkeypatch, ENDS)
    west = End(lambda state: state.motion.xy[:, 0] < 0.0, outcome)
    ENDS.register(f"{outcome}_west", west)
    two = cars([(-8.0, 20.0, 0.0), (8.0, 20.0, 0.0)])
    events = detected(two, ends=(f"{outcome}_west",))
    np.testing.assert_array_equal(getattr(events, outcome), [True, False])
    np.testing.assert_array_equal(events.done, [True, False])
    assert not events.hit_wall.any()
    with pytest.raises(ValueError, match=r"unknown end 'east'; choose from .*_west'"):
        EpisodeConfig(ends=("east",))


def test_both_agents_of_a_collision_crash_that_are_active():
    events = detected(crossing(True))
    assert flags(events) == ["crashed", "crashed"]
    np.testing.assert_array_equal(events.hit_agent, [True, True])
    assert not (events.hit_parked_car | events.hit_wall).any()
    events = detected(crossing(True), active=jnp.array([True, False]))
    assert flags(events) == ["crashed", "drives on"]  # of a finished agent and another
    # At the end of the step alone nothing is to be seen.
    assert flags(detected(crossing(False))) == ["drives on"] * 2


@pytest.mark.parametrize(
    ("rule", "outcome"),
    [("strict", "crashed"), ("precise", "crashed"), ("tanner", "parked")],
)
def test_a_car_that_touches_another_on_its_way_into_the_bay(rule, outcome):
    # Agent 0 stands in its bay now; earlier in the step it was on the parked car.
    trace = [[ON_THE_PARKED_CAR, IN_BAY_0], [AWAY, AWAY]]
    events = detected(cars([IN_BAY_0, AWAY], trace=trace), rule=rule)
    assert flags(events) == [outcome, "drives on"]
    np.testing.assert_array_equal(events.hit_parked_car, [outcome == "crashed", False])


def test_scaled_hitboxes_do_not_make_parking_harder():
    layout = lot([(0.0, 0.0, 0.0)], bay_size=(4.2, 2.2))
    state = state_of(layout, cars([(0.0, 0.0, 0.0)]), [0])
    scaled = EpisodeConfig(hitbox_scale=3.0)
    assert detect_jit(scaled, state).parked.all()
    beside = parked_at([(0.0, 2.1, 0.0)])
    events = detect_jit(scaled, state.replace(parked_cars=beside))
    assert events.hit_parked_car.all()


@functools.cache
def random_states():
    """Lots of 3 moving agents, a bay and what stands, crowded into 20 m.

    In half of them the first agent stands in the bay or almost.
    """
    rng, count = np.random.default_rng(1), 1000
    lots, motion, parked = random_lots(count, 10.0, 1, agents=3, parked=1, discs=0)
    bay = rng.uniform((-10, -10, -3.1), (10, 10, 3.1), (count, 1, 3))
    trace = np.array(motion.trace_w)
    trace[::2, 0] = bay[::2] + rng.normal(0, (0.2, 0.2, 0.04), (count // 2, 1, 3))
    speed, finite = rng.normal(0, 0.1, (count, 3)), rng.uniform(size=(count, 3)) > 0.1
    more = {"size": motion.size, "trace": trace, "finite": finite}
    motion = cars(trace[..., -1, :], speed, **more)
    step, active = rng.integers(5, 12, (count, 3)), rng.uniform(size=(count, 3)) > 0.1
    lots = lots.replace(bay_pose=jnp.asarray(bay, jnp.float32))
    return lots, motion, parked, step, active


@pytest.mark.parametrize("rule", RULES)
def test_outcomes_exclude_each_other_and_depend_on_no_frame(rule):
    lots, motion, parked, step, active = random_states()

    @jax.jit
    @jax.vmap
    def detect(layout, motion, parked, step, active):
        changes = {"parked_cars": parked, "step": step, "active": active}
        state = state_of(layout, motion, 0, **changes)
        return detect_events(EpisodeConfig(parked_rule=rule, max_steps=10), state)

    events = jax.device_get(detect(lots, motion, parked, step, active))
    outcomes = ("parked", "crashed", "timed_out", "diverged")
    count = np.stack([getattr(events, name) for name in outcomes])
    assert (count.sum(axis=0) <= 1).all()
    assert (count.sum(axis=(1, 2)) >= 10).all()  # each of them occurs
    hits = events.hit_agent | events.hit_parked_car | events.hit_wall
    np.testing.assert_array_equal(hits, events.crashed)
    shift = (12.0, -7.0, 0.9)
    poses = (lots.bay_pose, lots.wall_pose, parked.pose_w)
    bays, walls, stand = (moved(pose, shift) for pose in poses)
    there = lots.replace(bay_pose=bays, wall_pose=walls), moved_cars(motion, shift)
    there = detect(*there, parked.replace(pose_w=stand), step, active)
    for name in outcomes:
        # 3000 agents; one may lie within float32 rounding of a threshold.
        assert (getattr(events, name) != getattr(there, name)).sum() <= 1, name
