"""Tables of Q-learning as policies: the best action for every combination of integers.

That of a checkpoint is the table with the highest return in the last episodes before
it; tables are always deterministic.
"""

import math
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config import EnvConfig
from carpark_mj.mdp.actions import action_spec
from carpark_mj.observations import make_fields
from carpark_mj.policy.networks import Policy


def cardinalities(config: EnvConfig) -> tuple[int, ...]:
    """How many values each number of the observation can have, for tables."""
    fields = make_fields(config)
    if not all(field.is_whole and field.low == 0 for field in fields):
        raise ValueError(
            "a table needs an observation of whole numbers, not the encoding "
            f"{config.observation.encoding!r}"
        )
    return tuple(int(field.high) + 1 for field in fields for _ in range(field.size))


class Tables:
    """Policies of checkpoints, see `carpark_mj.policy.runs.ALGORITHMS`."""

    def shapes(self, header: dict[str, Any], env: EnvConfig) -> dict[str, Any]:
        """Shapes of the tables of all seeds."""
        num_seeds = header["config"]["num_seeds"]
        if not 0 <= header["best"] < num_seeds:
            raise ValueError(f"best must be below {num_seeds}, not {header['best']}")
        states = math.prod(cardinalities(env))
        shape = (num_seeds, states, math.prod(action_spec(env).choices))
        return {"table": jax.ShapeDtypeStruct(shape, np.float32)}

    def policy(self, parameters: Any, header: dict[str, Any], env: EnvConfig) -> Policy:
        """The policy of the best table."""
        table = jnp.asarray(parameters["table"][header["best"]])
        return make_table_policy(table, cardinalities(env), action_spec(env).choices)


TABLES = Tables()


def state_index(observation: jax.Array, sizes: Sequence[int]) -> jax.Array:
    """Rows (...) int32 of a table for observations (..., n) of integers.

    `sizes` are the `cardinalities`; outside its range a number has the nearest row.
    """
    strides = np.cumprod([1, *sizes[:0:-1]])[::-1]
    most = jnp.array(sizes) - 1
    number = jnp.clip(observation.astype(jnp.int32), 0, most)
    return jnp.sum(number * jnp.array(strides, jnp.int32), axis=-1)


def action_choices(action: jax.Array, choices: Sequence[int]) -> jax.Array:
    """Indices (..., n) int32 into the branches of an action (...), the last fastest."""
    return jnp.stack(jnp.unravel_index(action, tuple(choices)), axis=-1)


def make_table_policy(
    table: jax.Array, sizes: Sequence[int], choices: Sequence[int]
) -> Policy:
    """A policy that takes the action of highest value, the first of equals.

    `table` is (states, actions), `sizes` the `cardinalities`, `choices` the choices of
    `ActionSpec`.
    """
    best = action_choices(jnp.argmax(table, axis=-1), choices)

    def policy(observation: jax.Array, key: jax.Array):
        del key
        return best[state_index(observation, sizes)], {}

    return policy
