"""The buffer of a Q-network and one gradient step."""

# Extras that the type checker does without.
# pyright: reportMissingImports=false, reportUntypedFunctionDecorator=false

from typing import Any

import flashbax
import jax
import jax.numpy as jnp
import optax
import rlax
from flashbax.buffers.trajectory_buffer import TrajectoryBuffer
from flax import struct

from carpark_papers.cederle.dqn.config import DQNConfig
from carpark_papers.cederle.dqn.networks import QNetwork


@struct.dataclass
class Transition:
    """What agents (...) saw, did and got.

    Attributes:
        observation: before the step.
        action: int32.
        reward: of the step.
        discount: of what follows; 0 behind the end of an episode.
        next_observation: after the step, of the same episode.
        valid: bool; not of agents that had finished before the step.
    """

    observation: jax.Array
    action: jax.Array
    reward: jax.Array
    discount: jax.Array
    next_observation: jax.Array
    valid: jax.Array


@struct.dataclass
class Learner:
    """A Q-network that learns.

    Attributes:
        params: of the network.
        target: older ones, which give the targets.
        optimizer: state of the optimiser.
        updates: () int32 gradient steps made.
    """

    params: Any
    target: Any
    optimizer: Any
    updates: jax.Array


def make_optimizer(config: DQNConfig) -> optax.GradientTransformation:
    """The optimiser that a configuration names."""
    if config.optimizer == "adam":
        return optax.adam(config.learning_rate)
    # PyTorch's defaults, as the study's program has them.
    return optax.rmsprop(config.learning_rate, decay=0.99, eps_in_sqrt=False)


def make_buffer(config: DQNConfig) -> TrajectoryBuffer:
    """The buffer of one network."""
    random = config.random_steps * config.added // config.num_junctions
    first = max(config.batch_size, random)
    return flashbax.make_item_buffer(
        max_length=config.buffer_size,
        min_length=min(first, config.buffer_size),
        sample_batch_size=config.batch_size,
        add_batches=True,
    )


def td_errors(
    batch: Transition,
    values: jax.Array,
    next_values: jax.Array,
    next_online: jax.Array | None,
) -> jax.Array:
    """Temporal difference errors (batch,), targets taken as constants.

    Args:
        batch: transitions.
        values: (batch, actions) of the online network before the step.
        next_values: those of the target network after it.
        next_online: those of the online network after it, which choose the action of
            double Q-learning; None = plain Q-learning.
    """
    taken = (values, batch.action, batch.reward, batch.discount, next_values)
    errors: Any = (
        jax.vmap(rlax.q_learning)(*taken)
        if next_online is None
        else jax.vmap(rlax.double_q_learning)(*taken, next_online)
    )
    return errors


def update(
    config: DQNConfig, network: QNetwork, learner: Learner, batch: Transition
) -> tuple[Learner, jax.Array]:
    """One gradient step on a batch; the learner and the mean squared error."""

    def loss(params: Any) -> jax.Array:
        online = None
        values: Any = network.apply(params, batch.observation)
        after: Any = network.apply(learner.target, batch.next_observation)
        if config.double:
            online: Any = network.apply(params, batch.next_observation)
        errors = td_errors(batch, values, after, online)
        return jnp.mean(errors**2, where=batch.valid)

    error, gradient = jax.value_and_grad(loss)(learner.params)
    # A batch may consist of agents that had finished: nothing to learn.
    gradient = jax.tree.map(lambda x: jnp.where(batch.valid.any(), x, 0.0), gradient)
    step, optimizer = make_optimizer(config).update(
        gradient, learner.optimizer, learner.params
    )
    params = optax.apply_updates(learner.params, step)
    updates = learner.updates + 1
    target = optax.periodic_update(
        params, learner.target, updates, config.target_period
    )
    return Learner(params, target, optimizer, updates), error
