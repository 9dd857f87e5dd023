"""All discrete actions of an agent in one numbered list."""

import itertools

import numpy as np

from carpark_mj.mdp.actions import ActionSpec

# [est] Steering to 1/5 of its limit and the pedal to 1/3, both with a zero.
STEERS, PEDALS = 11, 7


def action_table(spec: ActionSpec) -> np.ndarray:
    """Actions (number, spec.size): steering x pedal x choices, the last fastest.

    On the grid, where all parts are choices, the list is complete.
    """
    ends = (-1.0, 1.0)
    parts = (np.linspace(*ends, STEERS), np.linspace(*ends, PEDALS))[: spec.continuous]
    indices = tuple(np.arange(n) for n in spec.choices)
    return np.array(list(itertools.product(*parts, *indices)), spec.dtype)
