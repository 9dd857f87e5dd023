"""Where the study's agents see and track bays and cars."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import cars, fields_of, lot
from helpers.sliding import SlidePhysics
from helpers.states import config_of, parked_at, state_of

from carpark_mj.config import (
    ENCODERS,
    EnvConfig,
    FleetConfig,
    GivingWayConfig,
    GoalConfig,
)
from carpark_mj.env import ParkingEnv
from carpark_mj.mdp.goals import tracks
from carpark_mj.mdp.parked_cars import tracks_parked_cars
from carpark_mj.observations import observe
from carpark_mj.types import NO_BAY
from carpark_papers.tanner.indices import IndexObservation
from carpark_papers.tanner.observation import (
    TannerObservation,
    TannerShare,
    ViewConfig,
    in_view,
)

# Around (2, 1), facing north: ahead, left, right, behind, at 4, 5, 6, 3 m.
AROUND = jnp.array([(2.0, 5.0), (-3.0, 1.0), (8.0, 1.0), (2.0, -2.0)])
BAYS = lot([(x, y, 0.0) for x, y in AROUND.tolist()])
DYNAMIC = GoalConfig(dynamic=True)


@pytest.mark.parametrize(
    ("field_of_view", "diameter", "expected"),
    [
        (360.0, None, [1, 1, 1, 1]),
        (360.0, 10.1, [1, 1, 0, 1]),
        (360.0, 7.9, [0, 0, 0, 1]),
        (359.0, None, [1, 1, 1, 0]),
        (181.0, None, [1, 1, 1, 0]),
        (179.0, None, [1, 0, 0, 0]),
        (181.0, 10.1, [1, 1, 0, 0]),
        (1.0, 7.9, [0, 0, 0, 0]),
    ],
)
def test_the_view_is_a_sector_about_the_heading(field_of_view, diameter, expected):
    config = ViewConfig(field_of_view, diameter)
    own = jnp.array([(2.0, 1.0, math.pi / 2)])
    np.testing.assert_array_equal(in_view(config, own, AROUND)[0], expected)
    np.testing.assert_array_equal(in_view(config, own, AROUND[None])[0], expected)
    # And so are the bays that can be tracked, by where the car truly is.
    state = state_of(BAYS, cars(own), NO_BAY)
    bays = TannerObservation(view=config).bays_in_view(state)
    if config.is_limited:
        np.testing.assert_array_equal(bays[0], expected)
    else:
        assert bays is None


def test_cars_and_bays_out_of_view_are_not_tracked():
    poses = [(2.0, 1.0, math.pi / 2), *((x, y, 0.0) for x, y in AROUND.tolist())]
    wide = TannerObservation(tracked_cars=4)
    narrow = dataclasses.replace(wide, view=ViewConfig(181.0, 10.1))
    state = state_of(
        BAYS,
        cars(poses),
        [NO_BAY, 0, 1, 2, 3],
        tracked_bays=[[0, 1, 2, 3]] * 5,
        parked_cars=parked_at(),
    )

    def present(observation, kind):
        config = config_of(observation, 4)
        named = fields_of(jax.jit(observe, static_argnums=0)(config, state), config)
        return [named[f"{kind}_{k}_distance"][0, 0] >= 0.0 for k in range(4)]

    for kind, left in (("car", [1, 1, 0, 0]), ("bay", [1, 1, 0, 0])):
        assert (present(wide, kind), present(narrow, kind)) == ([1] * 4, left), kind
    matrix = tracks(config_of(narrow), state)
    np.testing.assert_array_equal(matrix[0], [0, 1, 1, 0, 0])


def test_the_nearest_are_tracked_in_one_list_of_all_cars():
    motion = cars([(0.0, 0.0, 0.0), (3.0, 0.0, 0.0), (9.0, 0.0, 0.0)])

    def matrices(observation, present=True):
        parked = parked_at([(0.0, 2.0, 0.0), (50.0, 0.0, 0.0)], present=[present, True])
        state = state_of(BAYS, motion, 0, parked_cars=parked)
        config = config_of(observation, physics="grid")
        return tracks(config, state), tracks_parked_cars(config, state)

    # With one list of one car agent 0 tracks the parked car, 1 and 2 an agent.
    agents, parked = matrices(TannerObservation())
    np.testing.assert_array_equal(agents, [[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    np.testing.assert_array_equal(parked, [[1, 0], [0, 0], [0, 0]])
    gone, parked = matrices(TannerObservation(), present=False)
    np.testing.assert_array_equal(gone, [[0, 1, 0], [1, 0, 0], [0, 1, 0]])
    assert not parked.any()
    for observation in (IndexObservation(), TannerObservation(tracked_cars=0)):
        assert not any(matrix.any() for matrix in matrices(observation))


def test_bays_out_of_view_are_not_tracked_in_an_environment():
    view = ViewConfig(field_of_view=90.0, diameter=40.0)
    config = EnvConfig(
        num_agents=4,
        goals=GoalConfig(dynamic=True, num_tracked_bays=3),
        observation=TannerObservation(view=view),
    )
    env = ParkingEnv(config, SlidePhysics())
    state, _ = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(4), 16))
    pose, bays = state.motion.pose_w, np.asarray(state.layout.bay_pose[0])
    offset = bays[:, :2] - pose[:, :, None, :2]
    bearing = np.arctan2(offset[..., 1], offset[..., 0]) - pose[:, :, None, 2]
    ahead = np.cos(bearing) >= np.cos(np.radians(45.0))
    seen = ahead & (np.linalg.norm(offset, axis=-1) <= 20.0)
    index, agent, slot = np.nonzero(state.tracked_bays != NO_BAY)
    assert seen[index, agent, state.tracked_bays[index, agent, slot]].all()
    # Some see fewer than they could track.
    assert 0 < len(index) < state.tracked_bays.size


LOCAL = {"giving_way": GivingWayConfig("L,L,S"), "goals": DYNAMIC}
ON_GRID = {"observation": IndexObservation(), "physics": "grid"}
HEADINGS = TannerObservation(share=TannerShare(goal_headings=True))
GLOBAL = TannerObservation(global_information=True)
FLEET = {"fleet": FleetConfig(("city", "van")), "observation": TannerObservation()}
BLIND = TannerObservation(tracked_cars=0)


@pytest.mark.parametrize(
    ("make", "settings", "message"),
    [
        (TannerShare, {"goals": False, "goal_headings": True}, "needs share.goals"),
        (TannerObservation, {"bay_parts": ("size",)}, "bay_parts .* one of .*'size'"),
        (TannerObservation, {"bay_parts": ("bearing",) * 2}, "must be different"),
        (TannerObservation, {"encoding": "indices"}, "encoding must be .tanner., not"),
        (EnvConfig, ON_GRID | {"physics": "mjx"}, "'indices' needs grid physics, not"),
        (EnvConfig, ON_GRID | {"goals": DYNAMIC}, "'indices' needs fixed goals, not"),
        (EnvConfig, {"observation": HEADINGS, "goals": DYNAMIC}, "needs fixed goals"),
        (EnvConfig, FLEET, "fleet.agents needs observation.own_car = True"),
        (EnvConfig, LOCAL | {"observation": GLOBAL}, "global_information = False, not"),
        (EnvConfig, LOCAL | {"observation": BLIND}, "tracks at least 1 agent"),
    ],
)
def test_impossible_settings_are_refused_in_a_sentence(make, settings, message):
    with pytest.raises(ValueError, match=message) as caught:
        make(**settings)
    assert "\n" not in str(caught.value)


def test_an_observation_that_fits_the_task_stays_what_was_set():
    car = {"observation": TannerObservation(6), "num_agents": 3, "num_parked_cars": 4}
    for settings in (ON_GRID, car, {"observation": GLOBAL, "goals": DYNAMIC}):
        config = EnvConfig(**settings)
        assert {name: getattr(config, name) for name in settings} == settings
    for encoder in (TannerObservation, IndexObservation):
        assert ENCODERS[encoder().encoding] is encoder
