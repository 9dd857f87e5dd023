import dataclasses
import math
from typing import Annotated

import numpy as np
import pytest
from helpers.bounds import beyond_bounds

from carpark_mj.config import (
    LAYOUTS,
    EnvConfig,
    EpisodeConfig,
    FleetConfig,
    GivingWayConfig,
    GoalConfig,
    GoalRewards,
    MetricsConfig,
    ParkedRule,
    RewardConfig,
    SimConfig,
    SpawnConfig,
    insert,
)
from carpark_mj.config.checks import Bounds, CheckedConfig, require_type
from carpark_mj.layouts import layout_config
from carpark_mj.layouts.base import FAMILIES
from carpark_mj.observations import ContinuousObservation
from carpark_mj.physics.mjx import MjxPhysics
from carpark_mj.policy.networks import NetworkConfig
from carpark_mj.training.ppo.config import CurriculumConfig, PPOConfig

NAN, INF = math.nan, math.inf
WRONG = {
    SimConfig: {
        "sim_dt": (1e-12,),
        "ctrl_dt": (INF, 0.205, 0.004),
        "trace_dt": (0.005,),
        "steering_delay": (0.015,),
        "ramp": ((2.0, 1.0, 0.1), (1.0, 2.0), (0.0, 1.0, NAN)),
        "grade_x": (1.0,),
    },
    SpawnConfig: {
        "conflict_ratio": (0.9,),
        "reverse_ratio": (0.9,),
        "misaligned_ratio": (0.9,),
        "relocation": ("nearest",),
    },
    EpisodeConfig: {"wheel_stops": (0.9,), "parked_rule": ("lax",)},
    RewardConfig: {
        "extra": (
            *({"hurry": 1.0}, {"park": 1.0}, {"bad_goal": 1.0}, {"reverse": -1.0}),
            *({"reverse.x": 1.0}, {"smoothness.by_speed": 1}),
        )
    },
    EnvConfig: {
        "occupancy": ((0.1, 0.2, 0.3), (0.3, 0.2)),
        "reward": ("tanner",),
        "layout": ("ring",),
    },
    GivingWayConfig: {"scheme": ("G,L,X",), "bad_goal": (-0.1,)},
    MetricsConfig: {"extra": (("calm",),)},
}
IMPOSSIBLE = [
    (cls, {name: value})
    for cls, fields in WRONG.items()
    for name, values in fields.items()
    for value in values
]
IMPOSSIBLE += [
    (SimConfig, {"ramp": (0.0, 1.0, 0.5), "grade_x": 0.6}),
    (ParkedRule, {}),
    (ParkedRule, {"speed": 0.1, "slack": -0.1}),
]


@pytest.mark.parametrize(("make", "change"), IMPOSSIBLE)
def test_impossible_settings_raise_one_sentence(make, change):
    with pytest.raises(ValueError, match=r"^[^\n]+$") as caught:
        make(**change)
    words = [*change, *map(str, change.values()), "parked rule", "by_speed", "reverse"]
    words += map(str, change.get("extra", ()))
    assert any(word in str(caught.value) for word in words)


@pytest.mark.parametrize(
    ("bounds", "within", "beyond"),
    [
        (Bounds(ge=0.0), (0.0, 1e30), (-1e-3,)),
        (Bounds(gt=0.0), (1e-30,), (0.0, -1.0)),
        (Bounds(ge=0.0, lt=1.0), (0.0, 0.999), (1.0, -0.1)),
        (Bounds(gt=-1.0, le=2.0), (-0.999, 2.0), (-1.0, 2.001)),
        (Bounds(ge=1), (1, (1, 2)), (0, (1, 0))),
        (Bounds(), (-1e30, 0.0), (math.inf, math.nan, 1e39)),
    ],
)
def test_bounds_hold_for_every_number(bounds, within, beyond):
    @dataclasses.dataclass(frozen=True)
    class Config(CheckedConfig):
        value: Annotated[float | tuple[float, ...], bounds]

    for value in within:
        assert Config(value).value == value
    for value in beyond:
        with pytest.raises(ValueError, match="value must"):
            Config(value)


DYNAMIC = GoalConfig(dynamic=True)
BLIND = ContinuousObservation(tracked_agents=0)
GIVES_WAY = GivingWayConfig("L,L,S")
CONTRADICTIONS = [
    (
        {"episode": EpisodeConfig(hitbox_scale=1.2), "physics": "scene"},
        "episode.hitbox_scale must be 1 in scene physics, not 1.2",
    ),
    (
        {"giving_way": GIVES_WAY, "goals": DYNAMIC, "observation": BLIND},
        "'L,L,S' needs an observation that tracks at least 1 agent",
    ),
    ({"fleet": FleetConfig(("city",))}, "fleet.agents needs .*own_car = True"),
    ({"giving_way": GIVES_WAY}, "'L,L,S' needs dynamic goals"),
]


@pytest.mark.parametrize(("change", "message"), CONTRADICTIONS)
def test_settings_that_contradict_each_other_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        EnvConfig(**change)


@pytest.mark.parametrize(
    ("sim_dt", "ctrl_dt", "trace_dt", "expected"),
    [
        (0.01, 0.2, 0.05, 4),
        (0.01, 0.2, 0.03, 10),  # 3 substeps do not divide 20, 2 do
        (0.01, 0.2, 0.01, 20),
        (0.01, 0.2, 1.0, 1),
        (0.01, 0.07, 0.05, 7),  # 7 is prime: every substep
        (0.02, 0.1, 0.05, 5),
        (0.1, 0.3, 0.3, 1),
    ],
)
def test_traces_are_the_fewest_that_respect_their_longest_time(
    sim_dt, ctrl_dt, trace_dt, expected
):
    sim = SimConfig(sim_dt=sim_dt, ctrl_dt=ctrl_dt, trace_dt=trace_dt)
    assert sim.num_substeps == round(ctrl_dt / sim_dt)  # 0.3 / 0.1 is below 3
    assert sim.num_traces == expected
    assert sim.num_substeps % sim.num_traces == 0
    # 1e-9: decimal fractions are not exact in binary.
    assert sim.ctrl_dt / sim.num_traces <= sim.trace_dt + 1e-9


def test_only_tyres_need_fine_substeps():
    coarse = SimConfig(sim_dt=0.04, trace_dt=0.05)
    for physics in ("mjx", "scene"):
        with pytest.raises(ValueError, match=r"at most 0\.02 s with brush"):
            EnvConfig(sim=coarse, physics=physics)
        assert EnvConfig(sim=SimConfig(sim_dt=0.02), physics=physics)
    with pytest.raises(ValueError, match=r"at most 0\.02 s"):
        MjxPhysics(coarse)
    assert EnvConfig(sim=coarse, physics="bicycle").sim == coarse


def test_every_layout_has_a_known_family():
    for name, config in LAYOUTS.items():
        assert layout_config(EnvConfig(layout=name).layout) is config
        assert FAMILIES[config.family] is type(config)
    for name, family in FAMILIES.items():
        assert name == "from_file" or family().family == name


def test_values_are_inserted_with_what_follows_from_them():
    config = EnvConfig()
    assert (config.physics_config.back_end, config.varies) == ("mjx", False)
    values = {"reward.park": 3.0, "physics": "bicycle", "occupancy": (0.1, 0.2)}
    new = insert(config, values)
    assert new.reward == dataclasses.replace(config.reward, park=3.0)
    assert (new.physics_config.back_end, new.varies) == ("bicycle", True)
    assert (config.physics_config.back_end, config.varies) == ("mjx", False)
    assert config == EnvConfig()


@pytest.mark.parametrize(
    ("path", "close"),
    [
        ("rewards.park", "'reward'"),
        ("reward.parking", "'park'"),
        ("reward.park.x", "'x'"),
        ("reward.", "'park'"),
    ],
)
def test_misspelt_paths_are_refused(path, close):
    with pytest.raises(ValueError, match=close):
        insert(EnvConfig(), {path: 1.0})


def config_classes(cls, found):
    """A config's class and those of all configs in it."""
    found.add(cls)
    for field in dataclasses.fields(cls):
        value = getattr(cls(), field.name)
        if dataclasses.is_dataclass(value) and type(value) not in found:
            config_classes(type(value), found)
    return found


CLASSES = config_classes(EnvConfig, {ParkedRule})
CLASSES |= {family for name, family in FAMILIES.items() if name != "from_file"}
CLASSES |= {NetworkConfig, CurriculumConfig, PPOConfig}
JUNK = (object(), b"x", 1j, [1], {"a": 1}, (object(),), np.zeros(2), range(3), 10**400)


@pytest.mark.parametrize("cls", sorted(CLASSES, key=lambda cls: cls.__name__))
def test_no_field_takes_another_type_or_a_number_beyond_its_bounds(cls):
    for field in dataclasses.fields(cls):
        for junk in JUNK:
            if isinstance(junk, dict) and (cls, field.name) == (RewardConfig, "extra"):
                continue  # unknown terms
            with pytest.raises(ValueError, match=rf"\b{field.name}\b.* not "):
                cls(**{field.name: junk})
    for name, value in beyond_bounds(cls):
        with pytest.raises(ValueError, match=rf"\b{name}\b"):
            cls(**{name: value})


def test_tuples_have_their_length_and_truth_is_no_number():
    for value, kind in (
        ((0.1, 0.2, 0.3), tuple[float, float]),
        ((0.1,), tuple[float, float]),
        (True, float),
        (True, int),
        (1, bool),
    ):
        with pytest.raises(ValueError, match="x must be"):
            require_type("x", value, kind)
    require_type("x", (0.1, 0.2), tuple[float, float])
    config = SimConfig(ctrl_dt=np.float32(0.25), sim_dt=np.float64(0.05))
    assert config.num_substeps == 5
    assert EnvConfig(num_agents=np.int32(3)).num_agents == 3


BAD_REWARDS = [
    ({"continue_explore": 0.0}, "continue_explore must be negative .* not 0.0"),
    ({"change_goal": 0.1}, "change_goal at most 0, .* and 0.1"),
    ({"stop_goal": -0.06}, r"change_goal = stop_goal \+ .* -0.05 = -0.06 \+ 0.0"),
    ({"stop_explore": 0.1, "stop_goal": -0.05}, "change_goal = stop_goal"),
]


@pytest.mark.parametrize(("change", "message"), BAD_REWARDS)
def test_rewards_that_break_the_constraints_are_refused(change, message):
    reward = RewardConfig(goals=GoalRewards(**change))
    EnvConfig(reward=reward)  # nobody is paid for fixed goals
    with pytest.raises(ValueError, match=message):
        EnvConfig(goals=DYNAMIC, reward=reward)


def test_rewards_that_obey_the_constraints_to_rounding_are_taken():
    pay = GoalRewards(stop_explore=-0.1, stop_goal=-0.2, change_goal=-0.1 - 0.2)
    assert EnvConfig(goals=DYNAMIC, reward=RewardConfig(goals=pay)).goals.dynamic
    # Changing goals may cost nothing, as in a run of the study.
    pay = GoalRewards(change_goal=0.0)
    reward = EnvConfig(goals=DYNAMIC, reward=RewardConfig(goals=pay)).reward
    assert reward.goals.stop == 0.0  # by rule (3.5)


@pytest.mark.parametrize(
    ("scheme", "information", "context"),
    [
        ("L,L,S", False, "local_same"),
        ("L,L,A", False, "local_any"),
        ("G,L,S", True, "local_same"),
        ("G,L,A", True, "local_any"),
        ("G,G,S", True, "global_same"),
        ("G,G,A", True, "global_any"),
        (None, False, None),
    ],
)
def test_schemes_say_what_is_known_and_what_is_enforced(scheme, information, context):
    config = GivingWayConfig(scheme)
    assert (config.global_information, config.context) == (information, context)
    seen, other = (
        dataclasses.replace(EnvConfig().observation, global_information=given)
        for given in (information, not information)
    )
    settings = {"goals": DYNAMIC, "giving_way": config}
    assert EnvConfig(**settings, observation=seen)
    if scheme:
        said = f"{scheme}.*global_information = {information}"
        with pytest.raises(ValueError, match=said):
            EnvConfig(**settings, observation=other)
