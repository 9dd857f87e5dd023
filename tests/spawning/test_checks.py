"""Cars that cannot stand in a lot are refused; small lots have fewer agents."""

import dataclasses
import math
from contextlib import nullcontext

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import lot
from helpers.sliding import SlidePhysics

from carpark_mj.config import (
    EnvConfig,
    EpisodeConfig,
    FleetConfig,
    GoalConfig,
    JitterConfig,
    RayConfig,
)
from carpark_mj.env import ParkingEnv
from carpark_mj.layouts import LotConfig, StreetConfig, layout_config, mixture
from carpark_mj.layouts.files import layout_text
from carpark_mj.observations import ContinuousObservation
from carpark_mj.spawning.checks import check_cars, check_numbers
from carpark_mj.spawning.fleet import Fleet
from carpark_mj.types import NO_BAY
from carpark_mj.vehicle import COMPACT, PRESETS
from carpark_mj.vehicle.sheet import parameters_text

STREET = {"layout": "street", "num_parked_cars": 1}


def fleet(*names):
    """Settings of cars of several kinds."""
    sight = ContinuousObservation(own_car=True)
    return {"fleet": FleetConfig(names), "observation": sight}


# One-way aisles into which the compact, but not the van backs from a bay of 2.4 m.
NARROW = LotConfig(
    two_way=False,
    bay_width=(2.4, 2.4),
    bay_length=(5.2, 5.2),
    extra_aisle=(-3.0, -2.69),
)
WIDE = dataclasses.replace(COMPACT, width=2.9, track_width=2.6)
BAD_ENVIRONMENTS = [
    (fleet("lorry"), r"unknown vehicle 'lorry'; choose from \['city'"),
    ({"num_agents": 2, "num_parked_cars": 35}, "num_parked_cars .* 34 .* not 35"),
    ({"num_agents": 37, "num_parked_cars": 0}, "num_agents .*at most 36.* not 37"),
    (
        fleet("city", "van") | {"layout": "square_compact"},
        r"fleet.agents: the van, 4.90 m x 1.90 m, fits with 0.1 m to spare in no bay",
    ),
    (
        STREET | {"jitter": JitterConfig(scale=(1, 2))},
        r"parked cars: the compact, 8.51 m x 3.60 m, fits in no bay",
    ),
    (
        fleet("city", "van") | {"layout": NARROW},
        r"the van needs an aisle of 4.74 m .* 2.40 m wide .* up to 4.63 m wide",
    ),
    (
        {"layout": "street", "vehicle": parameters_text("float", WIDE)},
        r"the float, 2.90 m wide, cannot turn into a bay 2.74 m wide",
    ),
    ({"occupancy": (0.1, 0.9)}, r"needs num_parked_cars of at least 32, not 16"),
    (
        {"goals": GoalConfig(dynamic=True, num_tracked_bays=21)},
        r"num_tracked_bays must be at most 20 \(36 bays less 16 parked .* not 21",
    ),
    (  # fewer than no bay is free
        {"num_parked_cars": 40, "goals": GoalConfig(dynamic=True)},
        "num_tracked_bays must be at most 0 .*, not 1",
    ),
    (fleet("van") | {"physics": "scene"}, r"scene physics has cars of one"),
]


@pytest.mark.parametrize(("change", "message"), BAD_ENVIRONMENTS)
def test_impossible_fleets_are_refused_at_construction(change, message):
    with pytest.raises(ValueError, match=message):
        ParkingEnv(EnvConfig(**change))


def test_one_bay_that_a_wide_turning_car_can_enter_is_enough():
    def make(layout, vehicle="van"):
        config = EnvConfig(layout=layout, num_parked_cars=4, vehicle=vehicle)
        return ParkingEnv(config, SlidePhysics())

    make(NARROW, "suv")  # the van is refused, see above
    # One member is enough, or one of the widths that the aisles may have.
    make(mixture((NARROW, "street")))
    make(dataclasses.replace(NARROW, extra_aisle=(-3.0, -2.5)))


BUS = dataclasses.replace(
    COMPACT,
    length=12.0,
    width=2.5,
    wheelbase=6.0,
    rear_overhang=3.0,
    turning_circle=22.0,
)


def check(layout, vehicle=COMPACT, name="square", **settings):
    """Whether cars can stand in a lot drawn by hand, of a name."""
    config = EnvConfig(**({"num_agents": 1, "num_parked_cars": 0} | settings))
    check_cars(config, Fleet(config, vehicle), layout_config(name), layout)


WIDE_BAY, SHORT_BAY, SMALL_BAY = (5.0, 2.5), (4.5, 2.0), (3.8, 2.0)
VAN = PRESETS["van"]


@pytest.mark.parametrize(
    ("bays", "vehicle", "parked", "message"),
    [
        ([WIDE_BAY] * 4, BUS, 2, r"the custom car, 12.00 m x 2.50 m, fits in no bay"),
        ([WIDE_BAY] * 4, VAN, 0, None),
        ([WIDE_BAY] * 2 + [SHORT_BAY], VAN, 0, r"the van, .* only 2 of .* 3"),
        ([SMALL_BAY] * 4, PRESETS["city"], 2, None),  # too small for the design car
        ([SMALL_BAY] * 4, COMPACT, 2, r"the compact, .* fits in no bay"),
    ],
)
def test_cars_must_fit_into_the_bays_of_a_lot(bays, vehicle, parked, message):
    poses = [(4.0 * k, 8.0, -math.pi / 2) for k in range(len(bays))]
    layout = lot(poses, bay_size=bays)
    expected = pytest.raises(ValueError, match=message) if message else nullcontext()
    with expected:
        check(layout, vehicle, num_parked_cars=parked)


def test_a_car_needs_a_start_at_which_it_touches_nothing(tmp_path):
    """Walls 2.1 m apart: the van has room along them, the bus nowhere."""
    walls = {"walls": [(0, 1.1, 0), (0, -1.1, 0)], "wall_size": (60.0, 0.1)}
    layout = lot([(4, 9, 1.57)], bay_size=(12.5, 3), spawn_size=(20.0, 0.1), **walls)
    (tmp_path / "lot.json").write_text(layout_text(layout))
    for name in ("square", str(tmp_path / "lot.json")):
        check(layout, VAN, name)
        with pytest.raises(ValueError, match=r"the custom car, .* finds no start"):
            check(layout, BUS, name)


def test_a_fleet_that_finds_too_few_goals_is_refused():
    """Two bays that the van can be parked in, and four agents."""
    layout = lot([(0.0, 4.0 * k, 0.0) for k in range(8)])
    size = layout.bay_size.at[2:].set(jnp.array([4.95, 2.5]))
    layout = layout.replace(bay_size=size)
    check(layout, num_agents=2, **fleet("van"))
    check(layout, num_agents=4, **fleet("van", "city"))
    precise = EpisodeConfig(parked_rule="precise")
    check(layout, num_agents=4, episode=precise, **fleet("van"))  # without slack
    with pytest.raises(ValueError, match=r"only 2 bays .* its 4 agents"):
        check(layout, num_agents=4, **fleet("van"))


def test_there_may_be_more_agents_than_free_bays():
    goals = GoalConfig(True, 1)
    assert ParkingEnv(EnvConfig(num_agents=4, num_parked_cars=35, goals=goals))
    assert ParkingEnv(EnvConfig(num_agents=2, num_parked_cars=34))  # a full lot
    # Or than bays, with a fleet in a fixed lot.
    changes = {"layout": "square", "num_agents": 40, "num_parked_cars": 28}
    config = dataclasses.replace(CONFIG, **changes, **fleet("city", "van"))
    assert ParkingEnv(config, SlidePhysics()).num_agents == 40


MOST, LOTS = 7, 48
STREETS = [StreetConfig(bays_per_side=(count, count)) for count in (2, 5)]
CONFIG = EnvConfig(  # streets of 4 and of 10 bays
    layout=mixture(STREETS),
    num_agents=MOST,
    min_agents=2,
    num_parked_cars=8,
    occupancy=(0.5, 0.8),
    episode=EpisodeConfig(max_steps=4),
    observation=ContinuousObservation(rays=RayConfig()),
)


def test_goals_come_first_and_parked_cars_take_what_is_left():
    """A lot has at most one agent for two bays, but one; two to seven are asked for."""
    env = ParkingEnv(CONFIG, SlidePhysics())
    keys, member = jax.random.split(jax.random.key(0), LOTS), np.arange(LOTS) % 2
    asked = np.clip(np.arange(LOTS) // 2 % (MOST + 1), 2, MOST)

    most = np.where(np.arange(LOTS) % 8, 10, 1)

    def start(key, member, asked, most):
        layout = env.draw_layout(key, "train", member)
        mask = layout.bay_mask & (jnp.arange(layout.num_bays) < most)
        return env.reset_to_layout(layout.replace(bay_mask=mask), key, asked)[0]

    state = jax.jit(jax.vmap(start))(keys, member, asked.astype(np.int32), most)
    lots = jax.device_get(state.replace(key=None))
    bays = lots.layout.bay_mask.sum(axis=1)
    np.testing.assert_array_equal(bays, np.minimum(np.where(member, 10, 4), most))
    expected = np.minimum(asked, np.maximum(bays // 2, 1))
    np.testing.assert_array_equal(lots.present, np.arange(MOST) < expected[:, None])
    np.testing.assert_array_equal(lots.active, lots.present)
    assert (expected < asked).any()
    for k in range(LOTS):
        mask, present = lots.layout.bay_mask[k], lots.present[k]
        goal, parked = lots.goal[k], lots.parked_cars.bay[k]
        assert (goal[~present] == NO_BAY).all()
        held = np.concatenate([goal[present], parked[parked != NO_BAY]])
        assert mask[held].all()
        assert len(set(held.tolist())) == len(held)
        # Of 4 bays 2 or 3 are to be taken, of 10 bays 5 to 8, as far as there are.
        bays, left = mask.sum(), mask.sum() - present.sum()
        count = (parked != NO_BAY).sum()
        assert min(0.5 * bays, left) <= count <= min(0.8 * bays, left)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"min_agents": 5}, r"min_agents must be at most 4 \(a goal bay each\), not 5"),
        ({"min_agents": None}, r"num_agents must be at most 4 .*, not 7"),
        # Without an occupancy every agent and every parked car needs its bay.
        ({"occupancy": None}, r"num_agents must be at most 4 .*, not 7"),
        (
            {"occupancy": None, "num_agents": 3},
            r"num_parked_cars must be at most 1 \(4 bays less 3 agents' goals\), not 8",
        ),
    ],
)
def test_more_agents_than_bays_need_occupancy_and_min_agents(changes, message):
    config = dataclasses.replace(CONFIG, **changes)
    with pytest.raises(ValueError, match=message):
        check_numbers(config, layout_config(config.layout))
    check_numbers(CONFIG, layout_config(CONFIG.layout))
