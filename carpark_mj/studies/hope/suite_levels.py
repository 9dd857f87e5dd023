"""Levels of the suite beyond HOPE's and TPCAP's, by name: those of other packages.

A level is a fixed list of cases that a package stores. It may change the suite's
environment, and say how its cases begin: with movers, given starts and goals.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

from carpark_mj.config import EnvConfig
from carpark_mj.extensions import Registry
from carpark_mj.layouts import Layout
from carpark_mj.mdp.reset_options import ResetOptions


class CaseStart(NamedTuple):
    """How n cases begin.

    Attributes:
        key: (n,) keys, each of a case: of what moves and where others park.
        options: (n, ...) starts and goals.
        movers: (n, ...) states of the environment's movers.
    """

    key: jax.Array
    options: ResetOptions
    movers: tuple[Any, ...]


class Cases(NamedTuple):
    """Some cases of a level.

    Attributes:
        level: its name.
        number: (n,) which of the level's.
        kind: (n,) str, `parallel`, `perpendicular`, or `published` of TPCAP's.
        layouts: (n, ...) of the same shapes in all of HOPE's levels.
        start: how they begin; None = at the spawn region's middle.
    """

    level: str
    number: np.ndarray
    kind: np.ndarray
    layouts: Layout
    start: CaseStart | None = None


@dataclasses.dataclass(frozen=True)
class ExtraLevel:
    """A level.

    Attributes:
        numbers: of its cases.
        sha256: of the data of its cases.
        pick: its cases whose places in `numbers` are in a slice.
        env: its environment, from that of the suite.
    """

    numbers: range
    sha256: str
    pick: Callable[[slice], Cases]
    env: Callable[[EnvConfig], EnvConfig]


EXTRA_LEVELS: Registry[ExtraLevel] = Registry("level of the suite")
