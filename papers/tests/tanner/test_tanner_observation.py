"""The study's observation vector: by hand, under motions, on the grid and off it."""

import dataclasses
import functools
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import cars, fields_of, lot, moved, moved_cars, moved_lot
from helpers.states import config_of, parked_at, state_of

from carpark_mj.config import WORLD_UNIT, EnvConfig, EpisodeConfig, RingConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.layouts import make_layout
from carpark_mj.observations import make_fields, observation_size, observe
from carpark_mj.types import NO_BAY
from carpark_papers.tanner.environments import TANNER_QLEARNING
from carpark_papers.tanner.indices import IndexObservation
from carpark_papers.tanner.observation import TannerObservation, TannerShare, ViewConfig

CONFIG = TannerObservation()
CTRL_DT = 0.2
PER_LEVEL = 4 / 16 * WORLD_UNIT / CTRL_DT  # m/s: 4 points a step, 16 in a world unit
D = 74 * math.sqrt(2)  # world units
GLOBAL = TannerObservation(global_information=True)

observe_jit = jax.jit(observe, static_argnums=0)


def see(config, layout, motion, goal, parked=(), bays=None, present=True):
    """Observations (num_agents, size); parked cars are poses."""
    config = config_of(config, 0 if bays is None else np.shape(bays)[1])
    cars_there = parked_at(parked, 2.0, present)
    state = state_of(layout, motion, goal, tracked_bays=bays, parked_cars=cars_there)
    history = config.observation.rings.history
    if history:
        shape = (len(goal), history, len(config.observation.rings.diameters))
        state = state.replace(memory={"rings": jnp.zeros(shape, jnp.int32)})
    seen = observe_jit(config, state)
    assert seen.dtype == jnp.float32
    return np.asarray(seen)


def pose(x, y, degrees):
    """World units, and degrees clockwise from +y, as the study counts."""
    return (x * WORLD_UNIT, y * WORLD_UNIT, math.radians(90 - degrees))


# One bay of each row. Two walls are 4.4 world units from the origin.
LOT = lot(
    [pose(0, 32, 180), pose(-32, -6, 90), pose(12, -32, 0), pose(32, 6, 270)],
    walls=[(-3.0, 0.0, 0.0), (0.0, -3.0, 0.0)],
)
NONE = NO_BAY
PAIR = cars([pose(0, 0, 0), pose(6, 8, 90)], speed=[2 * PER_LEVEL, -PER_LEVEL])
FAR_CAR = [pose(12, -32, 0)]
GOAL_0 = math.hypot(32, 6) / D  # of agent 0, 79.4 deg to its right: heading 5 of 24
GOAL_1 = math.hypot(38, 14) / D  # of agent 1, 159.8 deg to its right: heading 11


def test_fixed_goals_by_hand():
    seen = see(CONFIG, LOT, PAIR, [3, 1], FAR_CAR)
    # Level 2 of -2 to 4; the bay is turned by 270 deg; one of two ring values; the
    # other agent is 36.9 deg to the right (heading 2) and turned by 90 deg.
    first = [4 / 7, 0.75, GOAL_0, 5 / 24, 1 / 2]
    first += [10 / D, 2 / 24, 0.25, 11 / 24, GOAL_1, 1 / 7]
    second = [1 / 7, 0.0, GOAL_1, 11 / 24, 0.0]
    second += [10 / D, 8 / 24, 0.75, 5 / 24, GOAL_0, 4 / 7]
    assert observation_size(config_of(CONFIG)) == 11
    np.testing.assert_allclose(seen, [first, second], atol=1e-6)


def test_a_parked_car_may_be_the_nearest_and_has_no_goal():
    # 6 behind agent 0 and facing away; it stands still, which is level 2 of 7.
    seen = see(CONFIG, LOT, PAIR, [3, 1], [*FAR_CAR, pose(0, -6, 180)])
    np.testing.assert_allclose(
        seen[0, 5:], [6 / D, 12 / 24, 0.5, -1, -1, 2 / 7], atol=1e-6
    )
    both = see(dataclasses.replace(CONFIG, tracked_cars=3), LOT, PAIR, [3, 1], FAR_CAR)
    np.testing.assert_allclose(both[0, 5], 10 / D, atol=1e-6)
    np.testing.assert_allclose(both[0, 11], math.hypot(12, 32) / D, atol=1e-6)
    np.testing.assert_array_equal(both[:, 17:], -1.0)  # there is no third car
    gone = see(CONFIG, LOT, PAIR, [3, 1], FAR_CAR, present=False)
    np.testing.assert_array_equal(gone, see(CONFIG, LOT, PAIR, [3, 1]))


def test_an_agent_alone_in_an_empty_lot_has_nothing_to_track():
    config = EnvConfig(
        physics="grid", num_agents=1, num_parked_cars=0, observation=CONFIG
    )
    env = ParkingEnv(config)
    state, seen = jax.jit(env.reset)(jax.random.key(0))
    _, timestep = jax.jit(env.step)(state, jnp.zeros((1, 2), jnp.int32))
    for observation in (seen, timestep.observation):
        np.testing.assert_array_equal(observation[0, 5:], [-1.0] * 6)
        assert (observation[0, :5] >= 0.0).all()


@pytest.mark.parametrize(
    ("goal", "seen_of_1", "own"),
    [
        ([NONE, NONE], 0.0, (0.0, 0.0)),  # both explore
        ([NONE, 3], 1 / 3, (0.0, 1 / 2)),  # agent 0 tracks that bay, agent 1 too
        ([3, 1], 2 / 3, (1 / 2, 2 / 2)),  # agent 0 does not track that bay
    ],
)
def test_dynamic_goals_by_hand(goal, seen_of_1, own):
    bays = [[3], [3]]
    seen = see(CONFIG, LOT, PAIR, goal, FAR_CAR, bays)
    first = [4 / 7, 0.75, GOAL_0, 5 / 24, 1 / 2]
    first += [10 / D, 2 / 24, 0.25, seen_of_1, 1 / 7, own[0]]
    assert observation_size(config_of(CONFIG, 1)) == len(first) == 11
    np.testing.assert_allclose(seen[0], first, atol=1e-6)
    assert seen[1, -1] == own[1]


def test_several_bays_are_numbered_and_absent_ones_are_minus_one():
    bays = [[1, NONE, 3], [3, 2, 1]]
    seen = see(CONFIG, LOT, PAIR, [3, 3], FAR_CAR, bays)
    named = fields_of(seen, config_of(CONFIG, 3))
    for part in ("heading", "distance", "bearing"):
        assert named[f"bay_1_{part}"][0] == -1.0
        assert named[f"bay_1_{part}"][1] > 0.0 or part == "heading"
    np.testing.assert_allclose(named["bay_2_distance"][0], GOAL_0, atol=1e-6)
    # Bay 3 is agent 0's third and agent 1's first: of 4 own values and of 5 of others.
    np.testing.assert_allclose(named["goal_choice"], [[3 / 4], [1 / 4]])
    np.testing.assert_allclose(named["car_0_goal"], [[3 / 5], [1 / 5]])


@pytest.mark.parametrize(
    ("goal", "claim"),
    [([NONE, NONE], -1.0), ([3, 1], GOAL_0), ([3, 3], math.hypot(26, 2) / D)],
)
def test_global_information_by_hand(goal, claim):
    seen = see(GLOBAL, LOT, PAIR, goal, FAR_CAR, [[3], [3]])
    assert observation_size(config_of(GLOBAL, 1)) == seen.shape[1] == 13
    # Agent 1 is nearer to the bay at (32, 6) than agent 0, whatever its goal.
    block = [0.75, GOAL_0, 5 / 24, math.hypot(26, 2) / D, claim]
    np.testing.assert_allclose(seen[0, 1:6], block, atol=1e-6)


def test_the_options_add_and_drop_what_they_say():
    def names(num_tracked_bays=0, **change):
        config = config_of(TannerObservation(**change), num_tracked_bays)
        return [field.name for field in make_fields(config)]

    assert names()[1:4] == ["goal_heading", "goal_distance", "goal_bearing"]
    least: dict[str, Any] = dict(
        tracked_cars=0, rings=RingConfig(), bay_parts=("bearing",)
    )
    assert names(**least) == ["speed", "goal_bearing"]  # that of the Q-learning
    silent = TannerShare(speeds=False)
    assert set(names()) - set(names(share=silent)) == {"car_0_speed"}
    secret = TannerShare(goals=False)
    assert [n for n in names() if n not in names(share=secret)] == [
        "car_0_goal_bearing",
        "car_0_goal_distance",
    ]
    assert "car_0_goal" in names(1)
    assert "car_0_goal" not in names(1, share=secret)
    headings = TannerObservation(share=TannerShare(goal_headings=True))
    three = see(headings, LOT, PAIR, [3, 1])
    # Of each other's goals: the bays are turned by 270 and by 0 deg from the agents.
    np.testing.assert_allclose(three[:, -2], [0.0, 0.75], atol=1e-6)


def test_speeds_and_headings_are_not_rounded_but_bearings_are():
    # 10 deg left of up at 1 m/s, the goal 28.6 deg to the right of the car.
    one = cars([pose(0, 0, -10)], speed=1.0)
    layout = lot([pose(10 * math.sin(0.325), 10 * math.cos(0.325), 0)])
    named = fields_of(see(CONFIG, layout, one, [0], FAR_CAR), config_of(CONFIG))
    np.testing.assert_allclose(named["speed"], [[(1 / PER_LEVEL + 2) / 7]], rtol=1e-6)
    np.testing.assert_allclose(named["goal_heading"], [[10 / 360]], atol=1e-6)
    np.testing.assert_allclose(named["goal_bearing"], [[2 / 24]], rtol=1e-6)
    # Almost the same heading, on the other side, is not almost a full turn.
    seen = see(CONFIG, lot([pose(0, 10, -10.001)]), one, [0], FAR_CAR)
    np.testing.assert_allclose(seen[:, 1], 0.0, atol=1e-5)


@functools.cache
def scene(count=6):
    """Cars anywhere in a `square` lot, tracked bays, and two parked-car poses each."""
    rng = np.random.default_rng(0)
    low, high = (-15, -15, -3.1), (15, 15, 3.1)
    motion = cars(rng.uniform(low, high, (count, 3)), rng.uniform(-1, 3, count))
    layout = make_layout("square")
    bays = rng.permutation(36)
    parked = np.asarray(layout.bay_pose)[bays[:10]]
    tracked = np.stack([rng.permutation(bays[10:16])[:2] for _ in range(count)])
    goal = np.array([bays[10], NO_BAY, *bays[10 : 10 + count - 2]])
    return layout, motion, goal, parked, tracked


RICH = dataclasses.replace(
    GLOBAL,
    tracked_cars=4,
    rings=RingConfig((4.0, 9.0), cap=3, cars=True, history=1),
    view=ViewConfig(field_of_view=250.0, diameter=24.0),
)


@pytest.mark.parametrize("shift", [(3.0, -7.0, math.pi / 12), (0.0, 9.0, -1.2)])
def test_a_motion_of_the_whole_lot_changes_nothing(shift):
    layout, motion, goal, parked, tracked = scene()
    for bays in (None, tracked):
        fixed = np.where(goal == NO_BAY, 0, goal) if bays is None else goal
        here = see(RICH, layout, motion, fixed, parked, bays)
        there = (moved_lot(layout, shift), moved_cars(motion, shift))
        there = see(RICH, *there, fixed, moved(parked, shift), bays)
        # float32 at 30 m, divided by 59 m, and sums of rounded angles by 2 pi.
        np.testing.assert_allclose(there, here, atol=1e-6)
        assert (here == -1.0).any()
        assert len(np.unique(here)) > 40


def test_the_order_of_other_cars_changes_nothing():
    layout, motion, goal, parked, tracked = scene()
    order, mixed = (
        np.array([0, 4, 2, 5, 1, 3]),
        np.random.default_rng(1).permutation(10),
    )
    shuffled = jax.tree.map(lambda x: x[order], motion)
    here = see(RICH, layout, motion, goal, parked, tracked)
    there = see(RICH, layout, shuffled, goal[order], parked[mixed], tracked[order])
    np.testing.assert_array_equal(there, here[order])


def test_it_agrees_with_the_indices_where_they_overlap():
    rng = np.random.default_rng(2)
    level = rng.integers(-1, 2, 60)
    xy = rng.uniform(-14, 14, (60, 2))
    yaw = rng.integers(0, 8, (60, 1)) * (math.pi / 4)
    motion = cars(np.concatenate([xy, yaw], 1), level * WORLD_UNIT / CTRL_DT)
    layout = make_layout("square")
    rings = RingConfig((8.0, 5.0), cap=2, cars=True, history=2)
    history = jnp.array(rng.integers(0, 3, (60, 2, 2)), jnp.int32)
    state = state_of(
        layout,
        motion,
        rng.integers(0, 36, 60),
        parked_cars=parked_at(layout.bay_pose[:9], 2.0),
        memory={"rings": history},
    )
    indices, tanner = (
        np.asarray(
            observe_jit(
                dataclasses.replace(TANNER_QLEARNING, observation=observation), state
            )
        )
        for observation in (
            IndexObservation(rings),
            TannerObservation(0, bay_parts=("bearing",), rings=rings),
        )
    )
    # 3 levels, 8 headings, 3 counts of 2 rings at 3 times.
    np.testing.assert_allclose(tanner * np.array([3, 8] + [3] * 6), indices, atol=1e-5)
    np.testing.assert_array_equal(
        np.asarray(indices[:, 4:]), np.asarray(history).reshape(60, 4)
    )
    assert len(np.unique(indices, axis=0)) > 40


@functools.cache
def rollout():
    """Observations (steps, lots, agents, size) on the grid, last ones, who ended."""
    observation = dataclasses.replace(
        CONFIG, rings=RingConfig((12.0,), cap=2, cars=True, history=2)
    )
    episode = EpisodeConfig("tanner", max_steps=20, final_observation=True)
    env = ParkingEnv(
        EnvConfig(
            vehicle="tanner",
            num_agents=3,
            num_parked_cars=4,
            physics="grid",
            episode=episode,
            observation=observation,
        )
    )

    def step(state, key):
        action = jax.random.randint(key, (3, 2), 0, jnp.array([5, 7]))
        # Forwards and about straight ahead, to get somewhere.
        action = action.at[:, 0].add(1).clip(0, 4)
        after, timestep = env.step(state, action)
        last = timestep.final_observation
        return after, (timestep.observation, last, timestep.events.done)

    def run(key):
        state, first = env.reset(key)
        return first, jax.lax.scan(step, state, jax.random.split(key, 50))[1]

    return env.config, *jax.jit(jax.vmap(run))(jax.random.split(jax.random.key(0), 4))


def test_rings_remember_the_counts_of_the_episode_only():
    config, first, (seen, last, done) = jax.device_get(rollout())
    now, one_ago, two_ago = (
        np.concatenate([fields_of(x, config)[name] for x in (first[:, None], seen)], 1)
        for name in ("ring_12m", "ring_12m_ago_1", "ring_12m_ago_2")
    )
    assert done.sum() > 10
    assert len(np.unique(now)) == 3
    np.testing.assert_array_equal(one_ago[:, 0], 0.0)
    goes_on = ~done[..., None]
    np.testing.assert_array_equal(one_ago[:, 1:], np.where(goes_on, now[:, :-1], 0.0))
    np.testing.assert_array_equal(
        two_ago[:, 1:], np.where(goes_on, one_ago[:, :-1], 0.0)
    )
    # The last observation of an episode still has its past.
    named = fields_of(last, config)
    np.testing.assert_array_equal(named["ring_12m_ago_1"], now[:, :-1])
    np.testing.assert_array_equal(named["ring_12m_ago_2"], one_ago[:, :-1])


def test_what_the_grid_shows_is_on_its_raster_and_in_range():
    config, _, (seen, _, _) = jax.device_get(rollout())
    named = fields_of(seen, config)
    for field in make_fields(config):
        value = named[field.name]
        assert value.min() >= field.low - 1e-6, field
        assert value.max() <= field.high + 1e-6, field
    raster = {"speed": 7, "goal_heading": 24, "car_0_heading": 24, "car_0_bearing": 24}
    for name, values in raster.items():
        whole = named[name][named[name] >= -0.01] * values
        np.testing.assert_allclose(whole, np.round(whole), atol=1e-4)
        # All that there are: 7 levels, 24 headings, never 24 itself.
        assert set(np.round(whole)) == set(range(values)), name


def test_physical_cars_can_be_seen_as_in_the_study():
    env = ParkingEnv(EnvConfig(physics="bicycle", observation=CONFIG))
    _, seen = jax.jit(env.reset)(jax.random.key(0))
    assert seen.shape == (2, env.observation_size) == (2, 11)
    np.testing.assert_allclose(seen[:, 0], 2 / 7, rtol=1e-6)  # at rest
