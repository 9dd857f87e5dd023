"""The declared fields of observations: names, sizes, groups, what settings add."""

import dataclasses
import itertools

import pytest
from helpers.observing import BAYS, CONFIGS, observed
from helpers.scenes import cars
from helpers.states import config_of

from carpark_mj.config import (
    ContinuousObservation,
    EnvConfig,
    RayConfig,
    RingConfig,
    TannerObservation,
    ViewConfig,
)
from carpark_mj.observations import make_fields, markdown_table, observation_size


@pytest.mark.parametrize("config", CONFIGS)
def test_the_table_of_fields_describes_the_whole_vector(config):
    fields = make_fields(config_of(config))
    names = [field.name for field in fields]
    assert len(set(names)) == len(names)
    assert sum(field.size for field in fields) == observation_size(config_of(config))
    assert all(field.low < field.high and field.meaning for field in fields)
    # `observed` asserts that the vector is as long as the table says.
    named = observed(config, BAYS, cars([(0.0, 0.0, 0.0)] * 2), [0, 1], [2])
    assert list(named) == names


def test_the_markdown_table_has_a_row_for_every_field_of_the_first_car_of_a_kind():
    config = config_of(ContinuousObservation(3, 2), num_tracked_bays=4)
    rows = markdown_table(make_fields(config)).splitlines()[2:]
    once = config_of(ContinuousObservation(1, 1), num_tracked_bays=1)
    names = [field.name for field in make_fields(once)]
    assert [row.split("`")[1] for row in rows] == names


@pytest.mark.parametrize("num_tracked_bays", [0, 3])
@pytest.mark.parametrize("config", CONFIGS)
def test_the_entities_of_a_group_have_the_same_fields_side_by_side(
    config, num_tracked_bays
):
    fields = make_fields(config_of(config, num_tracked_bays))
    groups = itertools.groupby(fields, lambda field: field.group)
    counts = {}
    for group, members in groups:
        assert group not in counts  # a group is one piece of the vector
        rows = [list(row) for _, row in itertools.groupby(members, lambda f: f.index)]
        counts[group] = len(rows)
        if not group:
            counts.pop(group)
            continue
        for index, row in enumerate(rows):
            start = f"{group}_{index}_"
            assert [field.name for field in row] == [
                f.name.replace(f"{group}_0_", start) for f in rows[0]
            ]
            for field, first in zip(row, rows[0], strict=True):
                assert (field.group, field.index) == (group, index)
                assert dataclasses.replace(field, name="", index=0) == (
                    dataclasses.replace(first, name="")
                )
    expected = {"bay": num_tracked_bays}
    if isinstance(config, TannerObservation):
        expected["car"] = config.tracked_cars
    else:
        expected["agent"] = config.tracked_agents
        expected["parked_car"] = config.tracked_parked_cars
    assert counts == {group: count for group, count in expected.items() if count}


@pytest.mark.parametrize(
    ("change", "numbers"),
    [
        ({"tracked_agents": 5}, -12),  # present, 4 x 2, speed, 2 of its goal
        ({"tracked_parked_cars": 5}, +9),  # present, 4 x 2
        ({"rings": RingConfig((5.0,))}, -2),
        ({"rings": RingConfig((5.0, 6.2, 8.0), cap=1)}, 0),
        ({"rings": RingConfig((5.0, 6.2, 8.0), history=2)}, 6),
        ({"rays": RayConfig()}, -24),
        ({"rays": RayConfig(31)}, 7),
        ({"rays": RayConfig(24, reach=3.0)}, 0),
        ({"lane": True}, 4),  # present, 2 of its heading, one-way
        ({"own_car": True}, 5),  # 2 of its size, wheelbase, axle, turning radius
        ({"lines": True}, 4),  # a number for each side
        ({"view": ViewConfig(90.0, 20.0)}, 0),
        ({"global_information": True}, 3),  # nearest agent, 2 of the claim
    ],
)
def test_each_setting_adds_or_drops_its_numbers(change, numbers):
    size, default = (
        observation_size(config_of(ContinuousObservation(**settings)))
        for settings in (change, {})
    )
    assert size - default == numbers


@pytest.mark.parametrize(
    ("num_agents", "num_parked_cars", "slots"),
    [(9, 5, (6, 4)), (7, 4, (6, 4)), (6, 3, (5, 3)), (2, 1, (1, 1)), (1, 0, (1, 1))],
)
def test_there_are_as_many_slots_as_the_lot_s_cars_fill_and_at_least_one(
    num_agents, num_parked_cars, slots
):
    names = {
        field.name
        for field in make_fields(
            EnvConfig(num_agents=num_agents, num_parked_cars=num_parked_cars)
        )
    }
    for kind, count in zip(("agent", "parked_car"), slots, strict=True):
        assert f"{kind}_{count - 1}_present" in names
        assert f"{kind}_{count}_present" not in names
    assert ContinuousObservation() == ContinuousObservation(6, 4, rays=RayConfig(24))
