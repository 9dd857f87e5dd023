"""Policies, and roll-outs of them in one lot or in many side by side."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
from flax import struct
from jax.tree_util import Partial

from carpark_mj.policy.networks import Policy
from carpark_mj.tasks.environment import Environment
from carpark_mj.types import State, TimeStep


@struct.dataclass
class StatePolicy:
    """A policy that acts on the true state of lots."""

    # Gives actions (..., num_agents, size) for states of lots (...).
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

    Observations are (..., num_agents, observation_size); the key is consumed.
    """
    if isinstance(policy, StatePolicy):
        return policy.act(state)
    action, _ = policy(observation.reshape(-1, observation.shape[-1]), key)
    return action.reshape(*observation.shape[:-1], -1)


# `(state, observation, memory, key) -> (action, memory)` of all agents.
Act = Callable[[State, jax.Array, Any, jax.Array], tuple[jax.Array, Any]]


def acts(policy: AnyPolicy) -> Act:
    """The acting function of a policy without memory."""

    def act(state: State, observation: jax.Array, memory: Any, key: jax.Array) -> Any:
        return choose_actions(policy, state, observation, key), memory

    return act


class Carry(NamedTuple):
    """A roll-out under way; all leaves (...), the shape of the batch of lots."""

    state: State  # of the lots
    observation: jax.Array  # (..., num_agents, size) what their agents observe
    memory: Any = None  # of the policy between steps; None = none


class Step(NamedTuple):
    """A control step."""

    before: State  # the state in which the agents acted
    observation: jax.Array  # their observation in it
    action: jax.Array  # their action
    after: State  # the next state, respawns included
    timestep: TimeStep  # its time step


def control_step(
    env: Environment, act: Act, carry: Carry, key: jax.Array
) -> tuple[Carry, Step]:
    """Makes one control step; a batch of lots is stepped with `jax.vmap`."""
    state, observation, memory = carry
    action, memory = act(state, observation, memory, key)
    step = jax.vmap(env.step) if state.active.ndim > 1 else env.step
    after, timestep = step(state, action)
    made = Step(state, observation, action, after, timestep)
    return Carry(after, timestep.observation, memory), made


def roll_out(
    env: Environment,
    act: Act,
    carry: Carry,
    keys: jax.Array,
    report: Callable[[Step], Any],
) -> tuple[Carry, Any]:
    """Makes a control step for each of the keys (steps,), as one program.

    Gives the carry after the last step, and what `report` keeps of all (steps, ...).
    """

    def step(carry: Carry, key: jax.Array) -> tuple[Carry, Any]:
        carry, made = control_step(env, act, carry, key)
        return carry, report(made)

    return jax.lax.scan(step, carry, keys)
