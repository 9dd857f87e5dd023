"""Layouts by name: one registration makes a family known everywhere."""

import dataclasses
import json

import jax
import pytest
from helpers.registering import restore_after

from carpark_mj.cli.layouts import families
from carpark_mj.config import LAYOUTS, EnvConfig, register_layout
from carpark_mj.layouts import (
    SquareConfig,
    StreetConfig,
    layout_config,
    make_layout,
    member_shares,
)
from carpark_mj.layouts.base import FAMILIES
from carpark_mj.policy.runs import from_dict


@dataclasses.dataclass(frozen=True)
class YardConfig(SquareConfig):
    """A square under another name, with settings of its own."""

    bays_per_side: int = 5
    family: str = "yard"


@pytest.fixture
def yard(monkeypatch):
    """Registers the family, for one test."""
    restore_after(monkeypatch, LAYOUTS, FAMILIES)
    return register_layout("yard", YardConfig())


def test_a_registered_layout_is_known_everywhere(yard):
    assert EnvConfig(layout="yard").layout == "yard"
    assert make_layout("yard").num_bays == 20
    assert layout_config("yard,street").members == (yard, StreetConfig())
    assert member_shares(layout_config("yard,street")) == {"yard": 0.5, "street": 0.5}
    config = EnvConfig(layout=YardConfig(bays_per_side=6))
    stored = json.loads(json.dumps(dataclasses.asdict(config)))
    assert from_dict(EnvConfig, stored) == config
    assert families()["yard"] == yard


def test_second_layouts_and_families_of_a_name_are_refused(yard):
    with pytest.raises(ValueError, match="there is a layout 'yard' already"):
        register_layout("yard", YardConfig(bays_per_side=6))

    class OtherConfig(YardConfig):
        pass

    with pytest.raises(ValueError, match="there is a family 'yard' already"):
        register_layout("other", OtherConfig())
    assert "other" not in LAYOUTS


def test_the_key_decides_and_a_member_is_a_mixtures_only():
    key = jax.random.key(3)
    for config in (StreetConfig(), layout_config("square_compact,street")):
        once, again = config.generate(key), config.generate(key)
        assert jax.tree.all(jax.tree.map(lambda a, b: (a == b).all(), once, again))
    street = layout_config("square_compact,street").generate_member(1, key)
    assert int(street.bay_mask.sum()) == int(
        StreetConfig().generate(key).bay_mask.sum()
    )
