import dataclasses
import math
from typing import get_args

import pytest

from carpark_mj.config import (
    REWARDS,
    EnvConfig,
    EpisodeConfig,
    LayoutName,
    ObservationConfig,
    RewardConfig,
    SimConfig,
    SpawnConfig,
    reward_preset,
)
from carpark_mj.env import ParkingEnv
from carpark_mj.layouts import FAMILIES, SQUARES, StreetConfig, layout_config

IMPOSSIBLE = [
    (SimConfig, {"sim_dt": 0.0}, "sim_dt must be positive, not 0.0"),
    (SimConfig, {"sim_dt": -0.01}, "sim_dt must be positive, not -0.01"),
    (SimConfig, {"sim_dt": math.nan}, "sim_dt must be positive, not nan"),
    (SimConfig, {"ctrl_dt": math.inf}, "ctrl_dt must be positive, not inf"),
    (SimConfig, {"trace_dt": -0.05}, "trace_dt must be positive, not -0.05"),
    (SimConfig, {"ctrl_dt": 0.205}, "ctrl_dt must be a multiple of sim_dt, not 0.205"),
    (SimConfig, {"ctrl_dt": 0.004}, "ctrl_dt must be a multiple of sim_dt, not 0.004"),
    (SimConfig, {"trace_dt": 0.005}, "trace_dt must be at least sim_dt .* not 0.005"),
    (SimConfig, {"grade_x": 1.0}, "grade_x must lie within .* not 1.0"),
    (SimConfig, {"grade_y": math.nan}, "grade_y must lie within .* not nan"),
    (SpawnConfig, {"close_ratio": 1.5}, "close_ratio must lie in .* not 1.5"),
    (SpawnConfig, {"close_ratio": math.nan}, "close_ratio must lie in .* not nan"),
    (SpawnConfig, {"close_distance": -1.0}, "close_distance must be .* not -1.0"),
    (SpawnConfig, {"min_distance": math.inf}, "min_distance must be .* not inf"),
    (SpawnConfig, {"num_candidates": 0}, "num_candidates must be .* not 0"),
    (SpawnConfig, {"crash_ratio": -0.1}, "crash_ratio must lie in .* not -0.1"),
    (SpawnConfig, {"crash_ratio": 0.9}, r"close_ratio \+ crash_ratio .* 1, not 0.2 \+"),
    (SpawnConfig, {"crash_distance": math.nan}, "crash_distance must be .* not nan"),
    (SpawnConfig, {"evolution": "nearest"}, "unknown evolution 'nearest'; choose from"),
    (RewardConfig, {"final_speed": -1.0}, "final_speed must be at least 0.0, not -1.0"),
    (RewardConfig, {"halt": math.inf}, "halt must be at least 0.0, not inf"),
    (EpisodeConfig, {"parked_rule": "lax"}, "unknown parked_rule 'lax'"),
    (EpisodeConfig, {"max_steps": 0}, "max_steps must be at least 1, not 0"),
    (EpisodeConfig, {"max_steps": -5}, "max_steps must be at least 1, not -5"),
    (RewardConfig, {"crash": -1.0}, "crash must be at least 0.0, not -1.0"),
    (RewardConfig, {"park": math.nan}, "park must be at least 0.0, not nan"),
    (RewardConfig, {"alignment_range": 0.0}, "alignment_range must be positive"),
    (ObservationConfig, {"tracked_agents": -1}, "tracked_agents .* not -1"),
    (ObservationConfig, {"tracked_parked_cars": -2}, "tracked_parked_cars .* not -2"),
    (ObservationConfig, {"ring_cap": 0}, "ring_cap must be at least 1, not 0"),
    (ObservationConfig, {"rings": (5.0, 0.0)}, r"rings must be .* \(5.0, 0.0\)"),
    (ObservationConfig, {"rings": (math.nan,)}, r"rings must be .* \(nan,\)"),
    (ObservationConfig, {"rings": (5.0, 5.0)}, r"rings must be .* \(5.0, 5.0\)"),
    (EnvConfig, {"layout": "ring"}, "unknown layout 'ring'"),
    (EnvConfig, {"num_agents": 0}, "num_agents must be at least 1, not 0"),
    (EnvConfig, {"num_parked_cars": -1}, "num_parked_cars must be at least 0, not -1"),
    (reward_preset, {"name": "sparse"}, "unknown reward 'sparse'"),
]


@pytest.mark.parametrize(("make", "change", "message"), IMPOSSIBLE)
def test_impossible_settings_raise_one_sentence_naming_the_value(make, change, message):
    with pytest.raises(ValueError, match=message) as caught:
        make(**change)
    assert "\n" not in str(caught.value)


IMPOSSIBLE_LOTS = [
    ({"num_agents": 2, "num_parked_cars": 35}, "num_parked_cars .* 34 .* not 35"),
    (
        {"num_agents": 37, "num_parked_cars": 0},
        "num_agents must be at most 36.* not 37",
    ),
    ({"vehicle": "bus"}, r"unknown vehicle 'bus'; choose from \['city', 'compact'"),
]


@pytest.mark.parametrize(("change", "message"), IMPOSSIBLE_LOTS)
def test_an_environment_that_cannot_be_built_raises(change, message):
    with pytest.raises(ValueError, match=message) as caught:
        ParkingEnv(EnvConfig(**change))
    assert "\n" not in str(caught.value)


def test_a_full_lot_is_allowed():
    assert ParkingEnv(EnvConfig(num_agents=2, num_parked_cars=34)).num_agents == 2


@pytest.mark.parametrize(
    ("make", "known"),
    [
        (lambda: EnvConfig(layout="x"), sorted(get_args(LayoutName))),
        (lambda: EpisodeConfig(parked_rule="x"), ["precise", "strict", "tanner"]),
        (lambda: reward_preset("x"), ["shaped", "tanner"]),
    ],
)
def test_unknown_names_are_answered_with_the_known_ones(make, known):
    with pytest.raises(ValueError, match="choose from") as caught:
        make()
    assert str(known) in str(caught.value)


@pytest.mark.parametrize(
    ("sim_dt", "ctrl_dt", "trace_dt", "expected"),
    [
        (0.01, 0.2, 0.05, 4),
        (0.005, 0.2, 0.05, 4),
        (0.01, 0.2, 0.03, 10),  # 3 substeps do not divide 20, 2 do
        (0.01, 0.2, 0.01, 20),
        (0.01, 0.2, 1.0, 1),
        (0.01, 0.07, 0.05, 7),  # 7 is prime: every substep
        (0.01, 0.1, 0.05, 2),
        (0.02, 0.1, 0.05, 5),
        (0.1, 0.3, 0.3, 1),
    ],
)
def test_num_traces_is_the_fewest_that_respect_trace_dt(
    sim_dt, ctrl_dt, trace_dt, expected
):
    sim = SimConfig(sim_dt=sim_dt, ctrl_dt=ctrl_dt, trace_dt=trace_dt)
    assert sim.num_traces == expected
    assert sim.num_substeps % sim.num_traces == 0
    # 1e-9: decimal fractions are not exact in binary.
    assert sim.ctrl_dt / sim.num_traces <= sim.trace_dt + 1e-9


def test_num_substeps_is_the_whole_number_of_substeps():
    assert SimConfig(sim_dt=0.005, ctrl_dt=0.2).num_substeps == 40
    # 0.3 / 0.1 is 2.9999999999999996.
    assert SimConfig(sim_dt=0.1, ctrl_dt=0.3, trace_dt=0.1).num_substeps == 3


CONFIGS = [
    SimConfig,
    SpawnConfig,
    EpisodeConfig,
    RewardConfig,
    ObservationConfig,
    EnvConfig,
]


@pytest.mark.parametrize("config", CONFIGS)
def test_configs_are_hashable_and_equal_configs_hash_the_same(config):
    assert config() == config()
    assert len({config(), config()}) == 1


@pytest.mark.parametrize("config", CONFIGS)
def test_configs_cannot_be_changed(config):
    one = config()
    name = dataclasses.fields(one)[0].name
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(one, name, getattr(one, name))


def test_the_tanner_reward_preset_has_the_numbers_of_table_c9():
    # Tanner 2022, table C.9 (PPO): sums over an episode, paid a share each step.
    weights = dataclasses.asdict(reward_preset("tanner"))
    del weights["alignment_range"]  # without effect at an alignment weight of 0
    del weights["closeness_range"]  # likewise
    del weights["goals"]  # of dynamic goals, `test_dynamic_goals`
    assert weights == {
        "park": 1.0,
        "crash": 1.0,
        "time": 0.2,
        "approach": 0.15,
        "smoothness": 0.05,
        "reverse": 0.1,
        "progress": 0.0,
        "alignment": 0.0,
        "closeness": 0.0,
        "wrong_way": 0.0,
        "final_speed": 0.0,
        "final_heading": 0.0,
        "halt": 0.0,
        "smoothness_by_speed": False,
    }


def test_tanners_dense_rewards_are_negative_on_any_path():
    # His constraint m < t: moving towards the goal earns less than time costs.
    weights = REWARDS["tanner"]
    assert weights.approach < weights.time


def test_the_default_reward_is_the_shaped_preset():
    assert EnvConfig().reward == reward_preset("shaped")


def test_every_layout_name_of_the_config_has_a_generator():
    names = get_args(LayoutName)
    assert set(names) == {*SQUARES, *FAMILIES} - {"from_file"}
    for name in names:
        config = layout_config(EnvConfig(layout=name).layout)
        assert FAMILIES[config.family].config is type(config)
    with pytest.raises(ValueError, match=str(sorted(names)).replace("[", r"\[")):
        EnvConfig(layout="none")


def test_a_layout_is_a_name_a_file_or_a_config():
    assert EnvConfig(layout=StreetConfig()).layout == StreetConfig()
    assert EnvConfig(layout="yard.json").layout == "yard.json"  # read by ParkingEnv
    with pytest.raises(ValueError, match="layout must be a name or a config, not 3"):
        EnvConfig(layout=3)
