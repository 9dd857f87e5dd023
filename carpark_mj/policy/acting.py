"""Acting policies: most act on observations, some on the state of the lot."""

from collections.abc import Callable

import jax
from flax import struct
from jax.tree_util import Partial

from carpark_mj.policy.networks import Policy
from carpark_mj.types import State


@struct.dataclass
class StatePolicy:
    """A policy that acts on the true state of lots.

    Attributes:
        act: gives actions (..., num_agents, size) for states of lots (...).
    """

    act: Callable[[State], jax.Array] = struct.field(pytree_node=False)


AnyPolicy = Policy | StatePolicy


def as_argument(policy: AnyPolicy) -> AnyPolicy:
    """A policy as a pytree of its parameters, to be passed to a jitted function.

    If the function closed over the policy, its weights would be constants of the
    program, which would recompile for every checkpoint.
    """
    return policy if isinstance(policy, Partial | StatePolicy) else Partial(policy)


def choose_actions(
    policy: AnyPolicy, state: State, observation: jax.Array, key: jax.Array
) -> jax.Array:
    """Actions (..., num_agents, size) in lots (...).

    Args:
        policy: any kind.
        state: of the lots.
        observation: (..., num_agents, observation_size).
        key: randomness, consumed.
    """
    if isinstance(policy, StatePolicy):
        return policy.act(state)
    action, _ = policy(observation.reshape(-1, observation.shape[-1]), key)
    return action.reshape(*observation.shape[:-1], -1)
