"""Rolls policies out: control steps of one lot, or of many side by side."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax

from carpark_mj.policy.acting import AnyPolicy, choose_actions
from carpark_mj.tasks.environment import Environment
from carpark_mj.types import State, TimeStep

# `(state, observation, memory, key) -> (action, memory)` of all agents.
Act = Callable[[State, jax.Array, Any, jax.Array], tuple[jax.Array, Any]]


class Carry(NamedTuple):
    """A roll-out under way; all leaves (...), the shape of the batch of lots.

    Attributes:
        state: of the lots.
        observation: (..., num_agents, size) what their agents observe.
        memory: of the policy between steps; None = none.
    """

    state: State
    observation: jax.Array
    memory: Any = None


class Step(NamedTuple):
    """A control step.

    Attributes:
        before: the state in which the agents acted.
        observation: their observation in it.
        action: their action.
        after: the next state, respawns included.
        timestep: its time step.
    """

    before: State
    observation: jax.Array
    action: jax.Array
    after: State
    timestep: TimeStep


def acts(policy: AnyPolicy) -> Act:
    """The acting function of a policy without memory."""

    def act(state: State, observation: jax.Array, memory: Any, key: jax.Array) -> Any:
        return choose_actions(policy, state, observation, key), memory

    return act


def control_step(
    env: Environment, act: Act, carry: Carry, key: jax.Array
) -> tuple[Carry, Step]:
    """Makes one control step.

    Args:
        env: the environment; a batch of lots is stepped with `jax.vmap`.
        act: acting function of all agents.
        carry: before the step.
        key: of what is random in the policy, consumed.
    """
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
    """Makes a control step for every key, as one program.

    Args:
        env: the environment.
        act: acting function of all agents.
        carry: before the first step.
        keys: (steps,), consumed.
        report: values to keep of a step.

    Returns:
        The carry after the last step, and the reports, with a leading axis (steps,).
    """

    def step(carry: Carry, key: jax.Array) -> tuple[Carry, Any]:
        carry, made = control_step(env, act, carry, key)
        return carry, report(made)

    return jax.lax.scan(step, carry, keys)
