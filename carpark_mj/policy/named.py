"""Untrained policies by name: baselines, planners, recorded actions, others' own."""

from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.env import ParkingEnv
from carpark_mj.extensions import FORMATS, Entry, Registry
from carpark_mj.mdp.actions import ActionSpec
from carpark_mj.policy import host
from carpark_mj.policy.acting import AnyPolicy, StatePolicy
from carpark_mj.policy.networks import Policy
from carpark_mj.reading import read_csv

# Makes the policy for an environment, or raises `ValueError`.
Maker = Callable[[ParkingEnv], AnyPolicy]
POLICIES: Registry[Maker] = Registry("policy", "carpark_mj.planning.policy")


def zero_policy(action: ActionSpec) -> Policy:
    """Takes the middle of every range; a standing car stays where it is."""

    def policy(observation: jax.Array, key: jax.Array):
        del key
        shape = (*observation.shape[:-1], action.size)
        return jnp.broadcast_to(action.middle, shape), {}

    return policy


def random_policy(action: ActionSpec) -> Policy:
    """Draws every number and every index of an action uniformly."""

    def policy(observation: jax.Array, key: jax.Array):
        lead, keys = observation.shape[:-1], (key, key)
        if action.choices:
            keys = jax.random.split(key)
        shape = (*lead, action.continuous)
        numbers = jax.random.uniform(keys[0], shape, minval=-1.0, maxval=1.0)
        counts = jnp.array(action.choices, jnp.int32)
        indices = jax.random.randint(keys[1], (*lead, len(counts)), 0, counts)
        parts = [part.astype(action.dtype) for part in (numbers, indices)]
        return jnp.concatenate(parts, axis=-1), {}

    return policy


RECORDED = "actions:"  # before the file of recorded actions
COLUMNS = ("steer", "pedal")


def recorded_actions(env: ParkingEnv, path: Path) -> StatePolicy:
    """Repeats the actions of a CSV file, a row each control step, then the zero action.

    Raises:
        ValueError: the file has no such rows, or the environment other actions.
        OSError: it cannot be read.
    """
    rows = [[row.number(name) for name in COLUMNS] for row in read_csv(path, *COLUMNS)]
    if not rows or not np.isfinite(rows).all():
        raise ValueError(f"{path} must have rows of finite numbers")
    if env.action_spec.size != len(COLUMNS):
        raise ValueError(
            f"{path} has {', '.join(COLUMNS)}: the actions here are others"
        )
    actions = jnp.asarray([*rows, [0.0, 0.0]], jnp.float32)
    return StatePolicy(lambda state: actions[jnp.minimum(state.step, len(rows))])


# What makes policies, by the word before the colon in names such as `torch:FILE`.
READERS: Registry[Callable[[str], Maker]] = Registry("kind of policy")
_given: dict[str, Maker] = {}


def _imported(home: str) -> host.Act:
    try:
        return Entry(home).load()
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(
            f"function:{home} must be function:MODULE:NAME of what can be imported: "
            f"{error}"
        ) from error


def name_of(make: Maker) -> str:
    """A name for a policy of this process, by which `find_named` finds it."""
    own = getattr(make, "name", None) or getattr(make, "__name__", "policy")
    _given[own] = make
    return f"function:{own}"


def find_named(name: str) -> Maker | None:
    """What makes a policy of `POLICIES` or `READERS`; None for other names."""
    kind, _, rest = name.partition(":")
    if rest and (kind in READERS or kind in FORMATS["kind of policy"]):
        return READERS[kind](rest)
    if name in POLICIES:
        return POLICIES[name]
    return None


POLICIES.register("zero", lambda env: zero_policy(env.action_spec))
POLICIES.register("random", lambda env: random_policy(env.action_spec))
READERS.register("actions", lambda x: lambda env: recorded_actions(env, Path(x)))
READERS.register("sb3", lambda files: host.from_sb3(*files.split(",", 1)))
READERS.register("torch", host.from_torch)
READERS.register(
    "function", lambda home: _given.get(home) or host.from_function(_imported(home))
)
