"""Reward terms by hand, over whole episodes, and in any frame."""

import dataclasses
import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.lanes import BLOCK
from helpers.paying import GOAL, LIMITS, MAX_STEPS, events, step, terms
from helpers.scenes import cars, lot, moved, moved_cars
from helpers.states import HandPhysics, hand_cars
from helpers.transitions import no_events, no_terms, transition

from carpark_mj.config import (
    REWARDS,
    WORLD_UNIT,
    EnvConfig,
    MetricsConfig,
    RewardConfig,
)
from carpark_mj.geometry.obstacles import Discs, Movers, ObstacleKind
from carpark_mj.layouts.routes import make_routes
from carpark_mj.mdp.metrics import init_stats, update_stats
from carpark_mj.mdp.people import HARD_BRAKING
from carpark_mj.mdp.progress import NEARER, goal_potential, is_nearer
from carpark_mj.mdp.rewards import NEAR, STANDS, reward_terms

PUBLISHED = RewardConfig(  # Tanner 2022, table C.9
    park=1.0,
    crash=1.0,
    time=0.2,
    progress=0.0,
    alignment=0.0,
    closeness=0.0,
    extra={"approach": 0.15, "smoothness": 0.05, "reverse": 0.1},
)
SHAPED = REWARDS["shaped"]


def test_every_term_of_a_hand_worked_step():
    weights = {"park": 4.0, "crash": 1.5, "time": 1.0, "progress": 0.2}
    config = dataclasses.replace(PUBLISHED, alignment=0.5, **weights)
    # Agent 0 comes 1 m nearer on the axis at a third of its 3 m/s; agent 1 reverses
    # from 3 m to 5 m, turning from along the bay to 60 deg across it, with half the
    # possible steering change.
    before = cars([(4.0, 0.0, 0.0), (13.0, 0.0, 0.0)], steering=[0.1, 0.0])
    after = cars(
        [(5.0, 0.0, 0.0), (15.0, 0.0, math.pi / 3)],
        steering=[0.1, -0.042],
        speed=[1.0, -1.0],
    )
    got = terms(config, before, after, GOAL, events(2, parked=[0], crashed=[1]))
    expected = {
        "park": [4.0, 0.0],
        "crash": [0.0, -1.5],
        "time": [-1.0 / 200, -1.0 / 200],
        # 0.2 a metre; and the misalignment gained at 5 m.
        "progress": [0.2, -0.4 - 0.5 * math.pi / 3 * math.exp(-5 / 4)],
        "approach": [0.15 / 200, -0.15 / 200],
        "smoothness": [0.0, -0.05 / 200 * 0.5],
        "reverse": [0.0, -0.1 / 200],
        "closeness": [0.0, 0.0],
    }
    assert got.keys() == expected.keys()
    for name, value in expected.items():
        # float32 sums of numbers up to 4.
        np.testing.assert_allclose(got[name], value, atol=1e-6, err_msg=name)


def test_closeness_is_of_the_nearest_agent_within_range():
    config = RewardConfig(closeness=10.0)
    size = np.asarray(cars([(0.0, 0.0, 0.0)]).size[0], np.float64)
    # In a row, nose to tail with gaps of 1.5 m and 2.99 m; the fourth stands alone.
    x = [0.0, size[0] + 1.5, 2 * size[0] + 4.49, 60.0]
    state = cars([(value, 0.0, 0.0) for value in x])
    got = terms(config, state, state, GOAL)["closeness"]
    near, far = -10 / 200 * 0.5, -10 / 200 * (1 - 2.99 / 3)
    np.testing.assert_allclose(got, [near, near, far, 0.0], atol=1e-6)
    # It is paid for where a step ends.
    apart = cars([(0.0, 0.0, 0.0), (60.0, 0.0, 0.0), (120.0, 0.0, 0.0), (180.0, 0, 0)])
    np.testing.assert_array_equal(terms(config, apart, state, GOAL)["closeness"], got)
    np.testing.assert_array_equal(terms(config, state, apart, GOAL)["closeness"], 0.0)
    alone = cars([(0.0, 0.0, 0.0)])
    assert terms(config, alone, alone, GOAL)["closeness"] == 0.0


def random_path(steps, seed=0):
    rng = np.random.default_rng(seed)
    return np.float32(rng.uniform([-15, -15, -3.1], [15, 15, 3.1], (steps + 1, 3)))


@pytest.mark.parametrize("closed", [False, True])
def test_progress_telescopes_and_sums_to_zero_around_a_loop(closed):
    path = random_path(300)
    path[-1] = path[0] if closed else path[-1]
    got = terms(SHAPED, cars(path[:-1]), cars(path[1:]), GOAL)["progress"]
    ends = goal_potential(SHAPED, jnp.array(path[[0, -1]]), jnp.array(GOAL))
    # 300 float32 differences of potentials of up to 6: 5e-7 each.
    assert got.sum() == pytest.approx(float(ends[1] - ends[0]), abs=2e-4)
    assert np.abs(got).sum() > 100  # though each step paid


def test_progress_can_count_the_way_along_the_lanes():
    """Out of an aisle whose neighbour has the goal: away as the crow flies."""
    before, after = cars([(-5.0, 0.0, 0.0)]), cars([(-3.0, 0.0, 0.0)])
    got = {}
    for route in (False, True):
        reward = RewardConfig(progress=0.5, alignment=0.0, route=route)
        config = EnvConfig(num_agents=1, reward=reward)
        physics = HandPhysics(hand_cars(before, **LIMITS))
        state = {"physics": physics, "routes": make_routes(BLOCK)}
        driven = transition(config, BLOCK, before, after, state)
        got[route] = float(reward_terms(config, driven)["progress"][0])
    assert got[True] == pytest.approx(0.5 * 2.0, abs=1e-5)
    assert got[False] == pytest.approx(-0.5 * (math.hypot(2, 15.5) - 15.5), abs=1e-5)


def test_near_the_goal_every_metre_of_a_maneuver_can_pay():
    """Along a circle into the bay, which its straight distance hardly pays for."""
    radius = 2.5 / math.tan(0.6)  # m, of the rear axle of `hand_cars`
    reward = RewardConfig(progress=1.0, alignment=0.0, reeds_shepp_reach=100.0)
    angle = np.array([0.0, 0.1, 0.2])  # of the rear axle about the turn's centre
    rear = radius * np.stack([np.sin(angle), 1.0 - np.cos(angle)], axis=-1)
    ahead = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    centre = rear + 1.25 * ahead  # `hand_cars`: 1.25 m ahead of the axle
    path = np.concatenate([centre, angle[:, None]], axis=-1)
    got = terms(reward, cars(path[:-1]), cars(path[1:]), path[-1])["progress"]
    np.testing.assert_allclose(got, 0.1 * radius, rtol=2e-3)


def test_far_from_the_goal_the_way_is_straight():
    way = RewardConfig(progress=1.0, alignment=0.0)
    near = dataclasses.replace(way, reeds_shepp_reach=8.0)
    far = [(-9.0, 0.5, 1.0), (-8.5, 0.5, 1.0)]
    for reward in (way, near):
        got = terms(reward, cars(far[:1]), cars(far[1:]), (0.0, 0.0, 0.0))["progress"]
        expected = math.hypot(9.0, 0.5) - math.hypot(8.5, 0.5)
        np.testing.assert_allclose(got, expected, atol=1e-5)
    x = np.linspace(-9.0, -1.0, 400)
    poses = np.stack([x, np.full_like(x, 0.5), np.full_like(x, 1.0)], axis=-1)
    steps = terms(near, cars(poses[:-1]), cars(poses[1:]), (0.0, 0.0, 0.0))["progress"]
    assert np.abs(steps).max() < 5 * (x[1] - x[0])


@pytest.mark.parametrize("config", [SHAPED, PUBLISHED])
def test_a_diverged_car_gets_nothing(config):
    before = cars([(0.0, 0.0, 0.0)] * 2)
    after = cars([(5.0, 0.0, 1.0)] * 2, speed=-1.0, steering=0.05)
    got = terms(config, before, after, GOAL, events(2, diverged=[0]))
    assert not any(term[0] for term in got.values())
    lost = cars([(math.nan, 0.0, 1.0)], speed=math.inf, steering=math.nan)
    alone = terms(config, cars(np.zeros((1, 3))), lost, GOAL, events(1, diverged=[0]))
    assert not any(term.any() for term in alone.values())
    assert all(np.isfinite(term).all() for term in got.values())
    assert got["time"][1] < 0.0


@pytest.mark.parametrize("config", [SHAPED, PUBLISHED])
def test_rewards_do_not_depend_on_the_frame(config):
    path = random_path(200, seed=1)
    goals = random_path(199, seed=2)
    rng = np.random.default_rng(3)
    speed, steering = rng.normal(0, 1, 200), rng.uniform(-0.04, 0.04, (2, 200))
    before = cars(path[:-1], steering=steering[0])
    after = cars(path[1:], speed, steering[1])
    happened = events(200, parked=range(0, 20), crashed=range(20, 50))
    here = terms(config, before, after, goals, happened)
    motion = (6.0, -11.0, 1.9)
    there = terms(
        config,
        moved_cars(before, motion),
        moved_cars(after, motion),
        moved(goals, motion),
        happened,
    )
    for name, term in here.items():
        # float32 distances of 40 m: 4e-6 m; axis angles: 1e-6 rad.
        np.testing.assert_allclose(there[name], term, atol=1e-5, err_msg=name)


def test_nearer_on_the_grid_is_exactly_what_whole_numbers_say():
    """Moves of up to 16 points; ties of x^2 + y^2 abound."""
    rng = np.random.default_rng(0)
    goal = rng.integers(-512, 513, (20_000, 2))
    reach = np.where(rng.random((20_000, 1)) < 0.5, 24, 1100)
    before = goal + rng.integers(-reach, reach + 1, (20_000, 2))
    after = before + rng.integers(-16, 17, (20_000, 2))
    # Some swap their coordinates about the goal: exactly as far as before.
    after[:3000] = goal[:3000] + (before[:3000] - goal[:3000])[:, ::-1]
    metres = [jnp.float32(points * WORLD_UNIT / 16) for points in (before, after, goal)]
    far, near = ((before - goal) ** 2).sum(axis=1), ((after - goal) ** 2).sum(axis=1)
    assert (far == near).sum() > 3000
    np.testing.assert_array_equal(is_nearer(*metres), near < far)


def test_nearer_is_by_more_than_rounding():
    rng = np.random.default_rng(1)
    angle = rng.uniform(-math.pi, math.pi, (2, 5000))
    distance = rng.uniform(0.1, 30.0, 5000)
    gained = rng.choice([-1, 1], 5000) * 10 ** rng.uniform(-3, -1, 5000)  # m

    def place(angle, distance):
        xy = np.stack([np.cos(angle), np.sin(angle)], axis=-1) * distance[:, None]
        return jnp.float32(xy)

    target = jnp.zeros(2)
    before = place(angle[0], distance)
    after = place(angle[1], np.maximum(distance - gained, 0.0))
    np.testing.assert_array_equal(is_nearer(before, after, target), gained > 0)
    # Going round at the same distance, close enough for float32 to resolve it.
    round_it = is_nearer(before, place(angle[1], distance), target)
    assert np.finfo(np.float32).eps < NEARER
    assert not round_it[distance < 1.0].any()
    assert not is_nearer(before, before, target).any()  # standing still


def test_each_step_of_automatic_braking_costs_its_weight():
    config = EnvConfig(num_agents=3, reward=RewardConfig(extra={BRAKING: 0.25}))
    motion = cars([(0.0, 0.0, 0.0), (6.0, 0.0, 0.0), (12.0, 0.0, 0.0)])
    braked = jnp.array([True, False, True])
    made = dataclasses.replace(step(config, motion, motion), braked=braked)
    np.testing.assert_array_equal(
        reward_terms(config, made)[BRAKING], [-0.25, 0, -0.25]
    )
    without = dataclasses.replace(made, braked=None)
    np.testing.assert_array_equal(reward_terms(config, without)[BRAKING], 0.0)


ON_A_LINE = [(0.0, 0.0, 0.0), (6.0, 0.0, 0.0), (12.0, 0.0, 0.0)]
BRAKING = "automatic_braking"
REWARD = RewardConfig(time=1.0, extra={"yielding": 1.0})


def refund(speed, pose=ON_A_LINE, happened=None, reward=REWARD):
    """Refunds of a step, as shares of its time penalty."""
    motion = cars(pose, speed=speed)
    got = terms(reward, motion, motion, GOAL, happened)
    return got["yielding"] * MAX_STEPS / reward.time


@pytest.mark.parametrize(
    ("speed", "expected"),
    [
        ((0.0, 1.0, 0.0), (1, 0, 1)),
        ((0.0, 0.0, -1.0), (0, 1, 0)),  # the first is 12 m from the one that reverses
        ((0.0, 0.0, 0.0), (0, 0, 0)),  # nobody who stands is waited for
        ((1.0, 2.0, 3.0), (0, 0, 0)),
        ((-0.9 * STANDS, 1.1 * STANDS, 0.0), (1, 0, 1)),
    ],
)
def test_who_stands_is_paid_while_another_drives_nearby(speed, expected):
    np.testing.assert_allclose(refund(speed), expected, rtol=1e-6)


def test_nearby_ends_at_its_range():
    for gap, expected in ((NEAR - 0.1, 1.0), (NEAR + 0.1, 0.0)):
        found = refund([0.0, 1.0], [(0.0, 0.0, 0.0), (0.0, gap, 2.0)])
        np.testing.assert_allclose(found, [expected, 0.0], rtol=1e-6)


def test_who_has_just_finished_neither_waits_nor_is_waited_for():
    for name in ("parked", "crashed", "timed_out", "diverged"):
        found = refund([0.0, 1.0, 0.0], happened=events(3, **{name: [1]}))
        np.testing.assert_array_equal(found, 0.0)
        found = refund([0.0, 1.0, 0.0], happened=events(3, **{name: [0]}))
        np.testing.assert_allclose(found, [0, 0, 1], rtol=1e-6)
    # Nor is an absent agent waited for.
    motion = cars(ON_A_LINE, speed=[0.0, 1.0, 0.0])
    config = EnvConfig(num_agents=3, reward=REWARD)
    made = step(config, motion, motion)
    before = dataclasses.replace(made.before, active=jnp.array([True, False, True]))
    got = reward_terms(config, dataclasses.replace(made, before=before))
    np.testing.assert_array_equal(got["yielding"], 0.0)


PEOPLE_LOT = lot([(30.0, 0.0, 0.0)])
RADIUS = 0.3
PEOPLE_METRICS = tuple(MetricsConfig.everything().extra)
PEOPLE_CONFIG = EnvConfig(
    num_agents=1,
    movers=("pedestrians:number=1",),
    reward=RewardConfig(extra={"person": 10.0, "comfort": 1.0}),
    metrics=MetricsConfig(extra=PEOPLE_METRICS),
)


def person(gap, speed=0.0):
    """A person so far before the bumper of a car of 4 m at the origin."""
    xy, away = jnp.array([[2.0 + gap + RADIUS, 0.0]]), jnp.array([[speed, 0.0]])
    disc = Discs(xy, jnp.array([RADIUS]), away, kind=ObstacleKind.PERSON)
    return Movers((), ((disc,),))


def made(was, now, stats=None, hit=False):
    """A step between two gaps [m] and own speeds [m/s]."""
    pose = [(0.0, 0.0, 0.0)]
    before, after = (cars(pose, speed=speed) for _, speed in (was, now))
    events = no_events(1, crashed=[hit], hit_person=[hit])
    step = transition(PEOPLE_CONFIG, PEOPLE_LOT, before, after, events=events)
    stats = step.before.stats if stats is None else stats
    before = step.before.replace(movers=person(was[0]), stats=stats)
    return step.replace(before=before, after=step.after.replace(movers=person(now[0])))


@jax.jit
def update(step):
    return update_stats(PEOPLE_CONFIG, step, no_terms(PEOPLE_CONFIG))


def episode(*instants, hit=False):
    """Tallies of an episode through gaps and speeds."""
    stats = init_stats(PEOPLE_CONFIG, PEOPLE_LOT)
    for k, (was, now) in enumerate(itertools.pairwise(instants)):
        last = k == len(instants) - 2
        stats = update(made(was, now, stats, hit and last))
    return {name: float(stats.tallies[name][0]) for name in PEOPLE_METRICS}


def test_a_contact_costs_more_and_passing_close_costs_by_speed():
    terms = reward_terms(PEOPLE_CONFIG, made((0.5, 2.0), (0.0, 1.0), hit=True))
    assert terms["person"] == pytest.approx(-10.0)
    terms = reward_terms(PEOPLE_CONFIG, made((5.0, 3.0), (1.0, 3.0)))
    # Half of the 2 m are missing at 3 m/s, of a weight for the whole episode.
    cost = 1.5**2 / PEOPLE_CONFIG.episode.max_steps
    assert float(terms["comfort"][0]) == pytest.approx(-cost)
    assert terms["person"] == 0.0
    far = reward_terms(PEOPLE_CONFIG, made((5.0, 2.0), (2.1, 3.0)))
    assert far["comfort"] == 0.0


def test_a_near_miss_is_counted_once_when_it_begins():
    # At 2 m/s the time to a person 4 m ahead is 2 s, to one 2 m ahead 1 s.
    assert episode((4.0, 2.0), (2.0, 2.0), (1.8, 2.0))["near_misses"] == 1
    assert episode((4.0, 2.0), (2.0, 2.0), (4.0, 0.0), (2.0, 2.0))["near_misses"] == 2
    assert episode((9.0, 0.0), (0.4, 0.0), (0.4, 0.1))["near_misses"] == 0
    assert episode((9.0, -2.0), (0.4, -2.0))["near_misses"] == 1  # close and fast


def test_the_least_gap_comes_with_the_speed_at_it():
    found = episode((9.0, 2.0), (4.0, 1.5), (1.0, 0.7), (2.0, 1.9))
    assert found["min_person_gap"] == pytest.approx(1.0, abs=1e-5)
    assert found["person_speed"] == pytest.approx(0.7, abs=1e-5)
    assert found["peak_contact_speed"] == 0.0
    found = episode((1.0, 2.0), (0.0, 1.0), hit=True)
    assert found["peak_contact_speed"] == pytest.approx(2.0)


def test_hard_braking_and_waiting():
    lost = HARD_BRAKING * PEOPLE_CONFIG.sim.ctrl_dt
    found = episode((9.0, 3.0), (9.0, 3.0 - 1.1 * lost), (9.0, 3.0 - 2.0 * lost))
    assert found["hard_braking"] == 1
    found = episode((7.0, 1.0), (7.0, 0.0), (7.0, 0.0), (9.0, 0.0))
    assert found["waiting"] == pytest.approx(0.4)
