"""Worked examples of both readings."""

import jax.numpy as jnp
import numpy as np
import pytest

from carpark_papers.cederle.junction.config import RewardRules
from carpark_papers.cederle.junction.rules import Events, pay_progress, reward

NAMES = tuple(Events.__dataclass_fields__)


def events(*of_agents):
    """Events of agents by name."""
    flags = {n: jnp.array([n in names for names in of_agents]) for n in NAMES}
    return Events(**flags)


def test_way_is_paid_in_pieces_of_more_than_half_a_metre():
    paid, unpaid = pay_progress(jnp.array([0.3, 0.5, 0.6, 1.5]))
    np.testing.assert_allclose(paid, [0, 0, 0.6, 1.5])
    np.testing.assert_allclose(unpaid, [0.3, 0.5, 0, 0])


@pytest.mark.parametrize(
    ("happened", "added", "replaced"),
    [
        ((), 1.4, 1.4),
        (("crashed",), -8.6, -10.0),
        (("arrived",), 11.4, 10.0),
        (("off_road", "on_shoulder", "off_route"), -8.6, -10.0),
        (("on_shoulder",), -8.6, -10.0),
        (("off_road",), -8.6, -10.0),
        (("off_route",), -8.6, -10.0),
        (("wrong_way",), -8.6, -10.0),
        (("crashed", "arrived"), 1.4, -10.0),
        (("timed_out",), 1.4, 1.4),
    ],
)
def test_events_are_added_in_the_text_and_replace_the_way_in_the_program(
    happened, added, replaced
):
    for rule, value in (("added", added), ("replaced", replaced)):
        found = reward(RewardRules(rule), jnp.array([1.4, 0.7]), events(happened, ()))
        np.testing.assert_allclose(found, [value, 0.7], rtol=1e-6)


def test_the_joint_reward_is_the_sum_for_everybody():
    found = reward(
        RewardRules(joint=True), jnp.array([1.4, 0.7]), events(("crashed",), ())
    )
    np.testing.assert_allclose(found, [-7.9, -7.9], rtol=1e-6)
