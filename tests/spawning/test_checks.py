"""Cars that cannot stand in a lot are refused; small lots have fewer agents."""

import dataclasses
import json
import math

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
from carpark_mj.evaluation.evaluator import evaluate
from carpark_mj.layouts import LotConfig, StreetConfig, layout_config, mixture
from carpark_mj.mdp.actions import ActionSpec
from carpark_mj.observations import ContinuousObservation
from carpark_mj.policy.named import random_policy
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
    ({"vehicle": "bus"}, r"unknown vehicle 'bus'"),
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
    *(  # no bay is free, or fewer than none
        (
            {"num_parked_cars": parked, "goals": GoalConfig(dynamic=True)},
            "num_tracked_bays must be at most 0 .*, not 1",
        )
        for parked in (36, 40)
    ),
    (fleet("van") | {"physics": "scene"}, r"scene physics has cars of one"),
]


@pytest.mark.parametrize(("change", "message"), BAD_ENVIRONMENTS)
def test_impossible_fleets_are_refused_at_construction(change, message):
    with pytest.raises(ValueError, match=message):
        ParkingEnv(EnvConfig(**change))


def test_wide_turning_car_is_refused_if_no_bay_can_be_entered():
    def make(layout, vehicle="van"):
        config = EnvConfig(layout=layout, num_parked_cars=4, vehicle=vehicle)
        return ParkingEnv(config, SlidePhysics())

    with pytest.raises(ValueError, match="the van needs an aisle"):
        make(NARROW)
    make(NARROW, "suv")
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


def drawn(tmp_path, *bays, spawn=(20.0, 1.0), walls=()):
    """A lot drawn by hand: bays (length, width) in a row along an aisle."""
    rows = [
        {"pose": [4.0 * k, 3.0 + length / 2, -math.pi / 2], "size": [length, width]}
        for k, (length, width) in enumerate(bays)
    ]
    walls = [{"pose": [0, y, 0], "size": [60, 0.1]} for y in walls]
    spawns, path = [{"pose": [0, 0, 0], "size": spawn}], tmp_path / "lot.json"
    lot = {"format": "carpark_mj layout 1", "bays": rows, "walls": walls}
    path.write_text(json.dumps(lot | {"spawns": spawns, "extent": [40, 20]}))
    return str(path)


WIDE = (5.0, 2.5)


@pytest.mark.parametrize(
    ("bays", "vehicle", "parked", "message"),
    [
        ([(4.5, 2.0)] * 4, "van", 0, r"the van, 4.90 m .* 4.50 m long and 2.00 m"),
        ([WIDE] * 4, BUS, 2, r"the custom car, 12.00 m x 2.50 m, fits in no bay"),
        ([WIDE] * 4, PRESETS["van"], 0, None),
        ([WIDE, WIDE, (4.5, 2.0)], PRESETS["van"], 0, r"the van, .* only 2 of .* 3"),
        ([(3.8, 2.0)] * 4, "city", 2, None),  # too small for the design car
        ([(3.8, 2.0)] * 4, "compact", 2, r"the compact, .* fits in no bay"),
    ],
)
def test_cars_must_fit_into_the_bays_of_a_lot_drawn_by_hand(
    bays, vehicle, parked, message, tmp_path
):
    named = isinstance(vehicle, str)
    config = EnvConfig(
        layout=drawn(tmp_path, *bays),
        vehicle=vehicle if named else "compact",
        num_agents=1,
        num_parked_cars=parked,
    )

    def make():
        car = None if named else vehicle
        return ParkingEnv(config, SlidePhysics(), car)

    if message is None:
        assert make().num_agents == 1
        return
    with pytest.raises(ValueError, match=message):
        make()


def test_a_car_needs_a_start_at_which_it_touches_nothing(tmp_path):
    """Walls 2.0 m apart: the van has room along them, the bus nowhere."""
    made = drawn(tmp_path, *[(12.5, 3.0)] * 2, walls=(-1.1, 1.1), spawn=(20.0, 0.1))
    config = EnvConfig(layout=made, num_agents=1, num_parked_cars=0)
    with pytest.raises(ValueError, match=r"the custom car, .* finds no start"):
        ParkingEnv(config, SlidePhysics(), BUS)
    assert ParkingEnv(config, SlidePhysics(), PRESETS["van"]).num_agents == 1


def test_a_fleet_that_finds_too_few_goals_is_refused():
    """Two bays that the van can be parked in, and four agents."""
    layout = lot([(0.0, 4.0 * k, 0.0) for k in range(8)])
    size = layout.bay_size.at[2:].set(jnp.array([4.95, 2.5]))
    layout, square = layout.replace(bay_size=size), layout_config("square")

    def check(names, num_agents, rule="strict"):
        config = EnvConfig(
            num_agents=num_agents,
            num_parked_cars=0,
            **fleet(*names),
            episode=EpisodeConfig(parked_rule=rule),
        )
        check_cars(config, Fleet(config, COMPACT), square, layout)

    with pytest.raises(ValueError, match=r"only 2 bays .* its 4 agents"):
        check(("van",), 4)
    check(("van",), 2)
    check(("van", "city"), 4)
    check(("van",), 4, "precise")  # 4.90 m by 1.90 m without slack


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


@pytest.fixture(scope="module")
def env():
    return ParkingEnv(CONFIG, SlidePhysics())


def test_goals_come_first_and_parked_cars_take_what_is_left(env):
    """A lot has at most one agent for two bays; two to seven are asked for."""
    keys, member = jax.random.split(jax.random.key(0), LOTS), np.arange(LOTS) % 2
    asked = np.clip(np.arange(LOTS) // 2 % (MOST + 1), 2, MOST)

    def start(key, member, asked):
        return env.reset(key, "train", member, asked)[0]

    state = jax.jit(jax.vmap(start))(keys, member, asked.astype(np.int32))
    lots = jax.device_get(state.replace(key=None))
    bays = lots.layout.bay_mask.sum(axis=1)
    np.testing.assert_array_equal(bays, np.where(member, 10, 4))
    expected = np.minimum(asked, bays // 2)
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


def test_evaluation_counts_the_agents_that_lots_have(env):
    found = evaluate(env, random_policy(ActionSpec(2)), 24, seed=0, num_lots=12)
    rows = found.episodes
    present = {row["lot"]: (row["family"], row["agents_present"]) for row in rows}
    # Two to seven agents in turn in six lots of each family.
    assert [count for _, count in present.values()] == [2] * 6 + [2, 3, 4, 5, 5, 5]
    assert {n: part["episodes"] for n, part in found.agent_counts.items()} == {
        n: n * lots for n, lots in zip(range(2, 6), (7, 1, 1, 3), strict=True)
    }


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
