"""Starts that are given: they are, what is drawn keeps clear, some are refused."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from helpers.scenes import polygons
from helpers.trees import same

from carpark_mj.config import EnvConfig, FleetConfig, JitterConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.layouts import make_layout
from carpark_mj.layouts.types import BayKind
from carpark_mj.observations import ContinuousObservation
from carpark_mj.spawning.reset_options import ResetOptions, check_starts
from carpark_mj.suite.metadrive import METADRIVE
from carpark_mj.types import NO_BAY

NAN = float("nan")
SMALL = EnvConfig(layout="square_compact", num_agents=3, physics="bicycle")
POSE = (1.0, -2.0, 2.5)
FIRST = ResetOptions(
    pose=jnp.array([POSE, (NAN,) * 3, (NAN,) * 3]),
    speed=jnp.array([1.5, NAN, NAN]),
    goal=jnp.array([5, NO_BAY, 7]),
)


@pytest.fixture(scope="module")
def small():
    env = ParkingEnv(SMALL)
    return env, jax.jit(env.reset)


def keys(count, seed=0):
    return jax.random.split(jax.random.key(seed), count)


@pytest.mark.parametrize(
    "config",
    [
        dataclasses.replace(SMALL, physics="mjx"),
        dataclasses.replace(  # cars of several kinds, one of which fits
            SMALL,
            occupancy=(0.2, 0.4),
            jitter=JitterConfig(along=(-0.2, 0.2)),
            fleet=FleetConfig(agents=("city", "compact"), parked_cars=("city",)),
            observation=ContinuousObservation(own_car=True),
        ),
    ],
    ids=["mjx", "fleet"],
)
def test_agents_begin_as_asked_and_the_others_are_drawn(config):
    env = ParkingEnv(config)
    state, _ = jax.jit(env.reset)(jax.random.key(0), options=FIRST)
    np.testing.assert_allclose(state.motion.pose_w[0], POSE, atol=1e-5)
    np.testing.assert_allclose(state.motion.speed, [1.5, 0.0, 0.0], atol=1e-5)
    assert (state.goal[0], state.goal[2]) == (5, 7)
    taken = [*state.goal.tolist(), *state.parked_cars.bay[state.parked_cars.present]]
    assert len({*map(int, taken)}) == len(taken)
    # It rolls on along its axis: in a control step by as much as its speed says.
    state, _ = jax.jit(env.step)(state, jnp.zeros((3, 2)))
    way = np.asarray(state.motion.pose_w[0, :2]) - POSE[:2]
    ahead = np.array([np.cos(POSE[2]), np.sin(POSE[2])])
    assert way @ ahead == pytest.approx(1.5 * 0.2, rel=0.1)
    assert abs(way[0] * ahead[1] - way[1] * ahead[0]) < 0.01


def test_giving_what_would_be_drawn_changes_nothing(small):
    _, reset = small
    drawn, observation = reset(jax.random.key(3))
    given = ResetOptions(drawn.motion.pose_w, jnp.zeros(3), drawn.goal)
    again, seen = reset(jax.random.key(3), options=given)
    np.testing.assert_allclose(seen, observation, atol=1e-5)
    assert same(again.parked_cars, drawn.parked_cars)
    nothing = ResetOptions(jnp.full((3, 3), NAN), goal=jnp.full(3, NO_BAY))
    assert same(reset(jax.random.key(3), options=nothing)[0], drawn)


@pytest.mark.parametrize("varied", [False, True])
def test_parked_cars_and_drawn_starts_keep_clear_of_given_ones(varied):
    config = dataclasses.replace(SMALL, num_parked_cars=33)
    if varied:
        config = dataclasses.replace(config, num_parked_cars=36, occupancy=(0.5, 1))
    env = ParkingEnv(config)
    layout = make_layout("square_compact")
    corner = layout.bay_pose[20] + jnp.array([1.2, 0.0, 0.3])  # over two bays
    asked = FIRST.replace(pose=FIRST.pose.at[0].set(corner))
    reset = jax.jit(jax.vmap(lambda key: env.reset(key, options=asked)[0]))
    lots = reset(keys(20))
    box = polygons(corner, lots.motion.size[0, 0])
    bays = polygons(layout.bay_pose, layout.bay_size)
    under = {*np.flatnonzero(shapely.area(shapely.intersection(bays, box)) > 1e-6)}
    assert len(under) == 2
    for goal, bay in zip(lots.goal, lots.parked_cars.bay, strict=True):
        present = [int(b) for b in bay if b != NO_BAY]
        assert not under & {*present, *goal.tolist()}
        assert not {*present} & {*goal.tolist()}
        assert len({*present}) == len(present)
        # As many as there is room for: 36 bays less two and the three goals.
        assert varied or len(present) == 31
    cars = polygons(lots.motion.pose_w, lots.motion.size)
    assert shapely.area(shapely.intersection(cars[:, 0], cars[:, 1])).max() < 1e-6


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"pose": [(NAN, 0.0, 0.0), (NAN,) * 3, (NAN,) * 3]}, "agent 0.* finite"),
        ({"pose": [(NAN,) * 3, (90.0, 0, 0), (NAN,) * 3]}, "agent 1.* outside"),
        ({"pose": [(NAN,) * 3, (16.4, 0, 0), (NAN,) * 3]}, "agent 1.* touch"),
        ({"pose": [(0, 0, 0), (1, 1, 0), (NAN,) * 3]}, "agent 0.* touch"),
        ({"speed": [NAN, 60.0, NAN]}, r"agent 1.* speed .* not 60"),
        ({"speed": [NAN, NAN, -9.0]}, r"agent 2.* speed .* not -9"),
        ({"goal": [36, NO_BAY, NO_BAY]}, "agent 0.* no bay 36: .* from 0 to 35"),
        ({"goal": [4, NO_BAY, 4]}, "agent 0.* bay 4 is also"),
        ({"goal": [1.0, 2.0, 3.0]}, "whole numbers"),
        ({"pose": [0.0, 0.0, 0.0]}, r"shape \(3, 3\)"),
    ],
)
def test_starts_that_cannot_be_are_refused(small, change, message):
    env, reset = small
    asked = {name: jnp.array(value) for name, value in change.items()}
    asked = FIRST.replace(**asked)
    with pytest.raises(ValueError, match=message):
        check_starts(env.config, asked, reset(jax.random.key(0), options=asked)[0])


def test_who_starts_in_a_bay_and_drives_out_needs_a_goal():
    env = ParkingEnv(dataclasses.replace(METADRIVE, num_agents=2, physics="bicycle"))
    layout, reset = make_layout("metadrive"), jax.jit(env.reset)
    leave = int(np.flatnonzero(np.asarray(layout.bay_kind) == BayKind.EXIT)[0])
    pose, goal = layout.bay_pose[:2], jnp.full(2, leave)  # an exit is for everybody
    with pytest.raises(ValueError, match="drive_out"):
        reset(jax.random.key(0), options=ResetOptions(pose=pose))
    asked = ResetOptions(pose=pose, goal=goal)
    state, _ = reset(jax.random.key(0), options=asked)
    check_starts(env.config, asked, state)
    np.testing.assert_array_equal(state.goal, goal)


def test_a_car_of_the_fleet_may_be_chosen():
    fleet = FleetConfig(agents=("city", "compact", "suv"))
    sight = ContinuousObservation(own_car=True)
    env = ParkingEnv(dataclasses.replace(SMALL, fleet=fleet, observation=sight))
    reset = jax.jit(jax.vmap(lambda key, kind: env.reset(key, options=kind)[0]))
    given = ResetOptions(kind=jnp.array([[2, 0, -1]] * 20))
    lots = reset(keys(20), given)
    lengths = np.array([car.length for car in env.fleet.agents])
    found = np.asarray(lots.motion.size[..., 0])
    np.testing.assert_allclose(found[:, :2], lengths[[[2, 0]] * 20], rtol=1e-6)
    assert len(np.unique(found[:, 2])) > 1
    check_starts(env.config, given, lots)
    room = jnp.take_along_axis(lots.layout.bay_size, lots.goal[..., None], axis=1)
    assert (room > lots.motion.size + env.config.episode.slack - 1e-5).all()
    # Where one bay has room for it and three agents choose it, all drive it.
    lot = env.draw_layout(keys(1)[0])
    lot = dataclasses.replace(lot, bay_size=lot.bay_size.at[1:, 0].set(4.0))
    chosen = ResetOptions(kind=jnp.full(3, 2))
    begun = jax.jit(env.reset_to_layout)(lot, keys(1)[0], None, chosen)[0]
    np.testing.assert_allclose(begun.motion.size[:, 0], lengths[2], rtol=1e-6)
    beyond = given.replace(kind=given.kind.at[3, 1].set(3))
    with pytest.raises(ValueError, match=r"agent 1 of lot 3: kind must be .* to 2"):
        check_starts(env.config, beyond, reset(keys(20), beyond))
    with pytest.raises(ValueError, match=r"options\.kind must be whole numbers"):
        env.reset(keys(1)[0], options=ResetOptions(kind=jnp.zeros(3)))
    unknown = ResetOptions(kind=jnp.zeros(3, int))
    with pytest.raises(ValueError, match=r"options\.kind needs a fleet"):
        ParkingEnv(SMALL).reset(keys(1)[0], options=unknown)
