"""The level `busy` of the suite: lots, starts and scripts of the held-out cases."""

import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config import EnvConfig, MetricsConfig
from carpark_mj.geometry import norm
from carpark_mj.mdp.reset_options import ResetOptions
from carpark_mj.movers.pedestrians import Pedestrians
from carpark_mj.studies.busy import held_out
from carpark_mj.studies.busy.aisle import BusyAisle, aisle_lot
from carpark_mj.studies.busy.scripts import (
    WAITS,
    Script,
    ScriptedBox,
    ScriptedPerson,
)
from carpark_mj.studies.hope.suite_levels import (
    EXTRA_LEVELS,
    Cases,
    CaseStart,
    ExtraLevel,
)

NAME = "busy"
PARKED = 14  # cars
CLEAR = 4.0  # m about the middle of the car that nobody stands in at first
CROWD = Pedestrians(number=12)
PERSON, BOX = ScriptedPerson(), ScriptedBox()
BY_PERSON, BY_BOX = ("crossing", "dart_out"), ("backing_out", "cart")
EXTRA = ("near_misses", "min_person_gap", "person_speed", "hard_braking", "waiting")


def busy_env(env: EnvConfig) -> EnvConfig:
    """An environment of the suite with the busy aisle and all that gets in the way."""
    return dataclasses.replace(
        env,
        layout=BusyAisle(),
        num_parked_cars=PARKED,
        movers=(PERSON, BOX, CROWD),
        metrics=MetricsConfig(safety=True, extra=EXTRA),
    )


def pick(which: slice) -> Cases:
    """Cases that follow each other."""
    number = np.arange(held_out.CASES)[which]
    columns = {name: x[which] for name, x in held_out.load_held_out().items()}
    group = number % len(held_out.GROUPS)
    layouts, start = _begin(columns, number, group)
    return Cases(NAME, number, np.array(held_out.GROUPS)[group], layouts, start)


@functools.partial(jax.jit)
def _begin(columns: Any, number: jax.Array, group: jax.Array) -> Any:
    return jax.vmap(_case)(columns, number, group)


def _case(columns: Any, number: jax.Array, group: jax.Array) -> Any:
    """The layout and the start of a case."""
    case = {
        name: x * jnp.asarray(held_out.unit(name, x.shape[0]), jnp.float32)
        for name, x in columns.items()
    }

    def single(name: str) -> jax.Array:
        return case[name][0]

    key = jax.random.key(number)
    layout = aisle_lot(single("aisle"), columns["absent"][0])
    present = [
        jnp.isin(group, jnp.array([held_out.GROUPS.index(x) for x in names]))
        for names in (BY_PERSON, BY_BOX, ("crowded_aisle",))
    ]
    names = ("direction", "distance", "speed", "slowing", "pause", "trigger")
    script = Script(
        start=case["start"],
        **{name: single(name) for name in names},
        returns=single("returns") > 0,
        size=case["size"],
        present=present[0],
        clock=jnp.float32(WAITS),
        velocity=jnp.zeros(2),
    )
    crowd = CROWD.init(jax.random.fold_in(key, 1), layout)
    away = norm(crowd.xy - case["pose"][:2]) > CLEAR
    movers = (
        script,
        dataclasses.replace(script, present=present[1]),
        dataclasses.replace(crowd, present=crowd.present & away & present[2]),
    )
    options = ResetOptions(pose=case["pose"][None], goal=columns["goal"])
    return layout, CaseStart(key, options, movers)


EXTRA_LEVELS.register(
    NAME,
    ExtraLevel(range(held_out.CASES), held_out.SHA256, pick, busy_env),
)
