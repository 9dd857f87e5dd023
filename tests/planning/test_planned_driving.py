"""Agents on planned paths: in the real car's physics, and in front of others."""

import math

import jax
import numpy as np
import pytest
from helpers.planned import CAR, case, drive

from carpark_mj.config import EnvConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.planning import policy as policy_module
from carpark_mj.planning import search as search_module
from carpark_mj.planning.paths import CRUISE, centre, make_path
from carpark_mj.planning.policy import (
    LOOK_AHEAD,
    MAX_PLANS,
    PACES,
    PASSING,
    PATIENCE,
    PATIENCE_MOVERS,
    Agent,
    Planner,
    Sight,
    planner_policy,
)
from carpark_mj.planning.search import Search, SearchConfig
from carpark_mj.suite.evaluation import CaseEvaluator, suite_env
from carpark_mj.suite.levels import pick_cases
from carpark_mj.vehicle import preset

NOBODY = np.zeros((0, 3)), np.zeros((0, 2))


@pytest.fixture(scope="module", autouse=True)
def ompl():
    pytest.importorskip("ompl")


def sight(pose=None, others=NOBODY, begins=False):
    start, goal, solids, extent = case("normal", 0)
    pose = start if pose is None else pose
    return Sight(begins, pose, 0.0, 0.0, goal, CAR, solids, others, extent)


def test_the_physical_car_parks_on_its_path():
    env = ParkingEnv(suite_env(EnvConfig(), "strict"))
    policy, planner = planner_policy(env)
    rows, _ = CaseEvaluator(env).drive(policy, pick_cases("complex", 2), seed=0)
    assert [row["kind"] for row in rows] == ["perpendicular", "parallel"]
    assert [row["parked"] for row in rows] == [1.0] * 2
    for lot, row in enumerate(rows):
        [found] = planner.searches(lot, 0)
        # It counts the way of the car's middle, which swings out.
        poses = [centre(CAR, segment.pose)[:, :2] for segment in found.path.segments]
        planned = sum(np.hypot(*np.diff(pose, axis=0).T).sum() for pose in poses)
        assert row["path"] == pytest.approx(planned, rel=0.1)
    assert planner.decisions == sum(row["length"] for row in rows)
    assert planner.seconds > 0


def test_a_lot_is_searched_and_driven_alone_as_in_a_batch():
    env = ParkingEnv(suite_env(EnvConfig(), "strict"))
    layouts, keys = pick_cases("normal", 2).layouts, jax.random.split(jax.random.key(0))
    state, _ = jax.jit(jax.vmap(env.reset_to_layout))(layouts, keys)
    config, actions, paths = SearchConfig(paths=1), [], []
    second, alone = (jax.tree.map(lambda x, k=k: x[k], state) for k in (slice(1, 2), 1))
    for lot, part in ((1, state), (0, second), (0, alone)):
        policy, planner = planner_policy(env, config=config)
        planner.reset(1, first_lot=1 - lot)
        actions.append(np.asarray(jax.jit(policy.act)(part)))
        segments = planner.searches(lot, 0)[0].path.segments
        paths.append(np.concatenate([segment.pose for segment in segments]))
    np.testing.assert_array_equal(paths[0], paths[1])
    np.testing.assert_array_equal(paths[0], paths[2])
    np.testing.assert_array_equal(actions[0][1:], actions[1])
    np.testing.assert_array_equal(actions[1][0], actions[2])
    assert actions[2].shape == (1, 2)


def test_no_two_searches_have_the_same_random_numbers(monkeypatch):
    lots, agents, drawn = 2, 12, []
    seen = [dict.fromkeys(range(agents), sight())] * lots
    monkeypatch.setattr(policy_module, "_sights", lambda _: seen)
    monkeypatch.setattr(search_module, "_connect", lambda *task: drawn.append(task[-1]))
    config, seeds, plans = SearchConfig(clearances=(0.02,)), 2, 2
    planner = Planner(0.2, config=config)
    for seed in range(seeds):
        planner.reset(seed)
        for _ in range(plans * PATIENCE):
            planner.act({"active": np.ones((lots, agents))})
    assert len(drawn) == seeds * lots * agents * plans * config.paths
    assert len({*drawn}) == len(drawn)


def test_an_agent_stops_for_another_one_and_plans_around_it():
    agent = Agent((0,), 0.2, SearchConfig(paths=1))
    agent.act(sight(begins=True))
    [found] = agent.searches
    # Somebody stands on the first metres of the path, past the car's outline.
    segment = found.path.segments[0]
    there = centre(CAR, segment.pose[np.searchsorted(segment.distance, 2.0)])
    reach = segment.gear * (CAR.length / 2 + 0.5)
    there = there + reach * np.array([np.cos(there[2]), np.sin(there[2]), 0.0])
    others = there[None], np.array([[0.5, 0.5]])
    for _ in range(PATIENCE - 2):
        assert agent.act(sight(others=others)) == (0.0, 0.0)
    assert len(agent.searches) == 1
    agent.act(sight(others=others))
    assert len(agent.searches) == 2


def test_an_agent_sets_out_from_a_mover_close_behind_it():
    """Nearer than it keeps from movers that it drives around."""
    agent = Agent((0,), 0.2, SearchConfig(paths=1))
    seen = sight(begins=True)
    yaw, reach = seen.pose[2], CAR.length / 2 + 0.5 * PASSING + 0.15
    there = seen.pose - reach * np.array([math.cos(yaw), math.sin(yaw), 0.0])
    mover = there[None], np.full((1, 2), 0.3), np.zeros((1, 2))
    agent.act(seen._replace(movers=mover))
    agent._stuck = PATIENCE_MOVERS
    agent.act(sight()._replace(movers=mover))
    assert len(agent.searches) == 2
    assert agent.searches[1].path is not None


def test_an_agent_without_a_path_gives_up_after_a_few_searches(monkeypatch):
    nothing = Search(None, 0.0, math.nan)
    monkeypatch.setattr(policy_module, "search", lambda *_: nothing)
    agent = Agent((0,), 0.2, SearchConfig())
    assert agent.act(sight(begins=True)) == (0.0, 0.0)
    for _ in range(PATIENCE * (MAX_PLANS + 2)):
        assert agent.act(sight()) == (0.0, 0.0)
    assert agent.searches == [nothing] * MAX_PLANS


def test_a_path_too_long_for_the_episode_is_driven_faster(monkeypatch):
    """As a van's of 60 m on `angled`, in an episode of 60 s."""
    car = preset("van")
    ahead = np.linspace(0.0, 60.0, 3001)
    # A bend of full lock first, and the last metres backwards.
    turn = np.minimum(ahead, 6.0) * math.tan(0.8 * car.max_steering) / car.wheelbase
    steps = 0.02 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    there = np.column_stack([np.cumsum(steps, axis=0), turn])
    points = np.concatenate([there, there[-2::-1][:300]])
    path = make_path(points, car)
    found = Search(path, 0.0, 0.08)
    monkeypatch.setattr(policy_module, "search", lambda *_: found)
    begins = sight(centre(car, points[0]), begins=True)._replace(car=car)
    for seconds, hurries in ((path.duration + 10.0, False), (path.duration, True)):
        agent = Agent((0,), 0.2, SearchConfig(), seconds)
        agent.act(begins)
        assert (agent._path.cruise > CRUISE) == hurries
        poses, speeds, error = drive(agent._path, car)
        assert len(speeds) / 40 * 0.2 < seconds
        assert error < 0.1
        last = path.segments[-1].pose[-1]
        assert math.dist(poses[-1, :2], last[:2]) < 0.05
    # A car that stands plans again, with less time left.
    late = Agent((0,), 0.2, SearchConfig(), path.duration + 10.0)
    for step in range(5 * PATIENCE):
        late.act(begins._replace(begins=step == 0))
    assert len(late.searches) > 1
    assert late._path.cruise > CRUISE
    late.act(begins)  # the next episode, with all its time
    assert late._path.cruise == CRUISE


def test_an_agent_slows_down_for_who_is_about_to_step_onto_its_path():
    # From beside the path: in 2 s it is crossed at 1 m/s, and not by who stands.
    agent = Agent((0,), 0.2, SearchConfig(paths=1))
    free = agent.act(sight(begins=True))
    segment = agent._path.segments[0]
    point = segment.pose[int(np.searchsorted(segment.distance, 1.0))]
    yaw = point[2]
    aside = CAR.width / 2 + 1.0
    beside = point + np.array([-aside * np.sin(yaw), aside * np.cos(yaw), 0.0])
    towards = np.array([[np.sin(yaw), -np.cos(yaw)]])
    for speed, slows in ((0.0, False), (1.0, True), (-1.0, False)):
        mover = beside[None], np.full((1, 2), 0.6), speed * towards
        seen = sight()._replace(movers=mover)
        assert (agent._pace(seen) < CRUISE) == slows, speed
    assert free != (0.0, 0.0)


def test_an_agent_creeps_up_to_who_is_on_its_path_and_can_stop():
    agent = Agent((0,), 0.2, SearchConfig(paths=1))
    agent.act(sight(begins=True))
    start, segment = sight().pose, agent._path.segments[0]
    assert segment.length > LOOK_AHEAD
    paces = []
    gaps = np.arange(0.0, 4.0, 0.1)  # m from the bumper, straight ahead
    for gap in gaps:
        reach = segment.gear * (CAR.length / 2 + gap + 0.3)
        there = start + reach * np.array([np.cos(start[2]), np.sin(start[2]), 0.0])
        mover = there[None], np.full((1, 2), 0.6), np.array([[0.0, 0.05]])
        paces.append(agent._pace(sight()._replace(movers=mover)))
    paces = np.array(paces)
    assert (np.diff(paces) >= 0.0).all()
    assert set(paces) == {0.0, *PACES}
    assert paces[0] == 0.0
    # The delay is a control step.
    stopping = paces * 0.2 + paces**2 / (2 * CAR.max_deceleration)
    assert (stopping <= gaps)[paces > 0.0].all()
