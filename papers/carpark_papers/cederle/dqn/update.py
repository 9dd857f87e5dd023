"""Q-networks, the state of a run, and one gradient step from its buffer."""

# Extras that the type checker does without.
# pyright: reportMissingImports=false, reportUntypedFunctionDecorator=false

from typing import Any

import flashbax
import jax
import jax.numpy as jnp
import optax
import rlax
from flashbax.buffers.trajectory_buffer import TrajectoryBuffer
from flax import linen as nn
from flax import struct

from carpark_papers.cederle.dqn.config import DQNConfig
from carpark_papers.cederle.junction.rules import ACTIONS
from carpark_papers.cederle.junction.types import State
from carpark_papers.cederle.training.config import VECTOR_SCALE

# Of the study's convolutional network: features, size and stride of a layer.
CONVOLUTIONS = ((32, 8, 4), (64, 4, 2), (64, 3, 1))
IMAGE_HIDDEN = 512


class QNetwork(nn.Module):
    """Q-values (..., actions) of observations.

    Attributes:
        hidden: widths of the hidden layers behind vectors.
        dueling: whether a value and advantages make the Q-values.
    """

    hidden: tuple[int, ...]
    dueling: bool

    @nn.compact
    def __call__(self, observation: jax.Array) -> jax.Array:
        """Of float vectors (..., n) or uint8 images (..., side, side, frames)."""
        if observation.dtype == jnp.uint8:
            x = observation / 255.0
            for features, size, stride in CONVOLUTIONS:
                x = nn.Conv(features, (size, size), stride, padding="VALID")(x)
                x = nn.relu(x)
            x = nn.relu(nn.Dense(IMAGE_HIDDEN)(x.reshape(*x.shape[:-3], -1)))
        else:
            x = observation / VECTOR_SCALE
            for width in self.hidden:
                x = nn.relu(nn.Dense(width)(x))
        advantage = nn.Dense(len(ACTIONS))(x)
        if not self.dueling:
            return advantage
        value = nn.Dense(1)(x)
        return value + advantage - advantage.mean(axis=-1, keepdims=True)


def make_network(config: DQNConfig) -> QNetwork:
    """The network of each learner."""
    return QNetwork(config.hidden, config.dueling)


def to_learners(x: jax.Array, networks: int) -> jax.Array:
    """Sorts arrays of agents (batch, agents, ...) by network.

    Returns:
        (networks, batch * agents / networks, ...).
    """
    if networks == 1:
        return x.reshape(1, -1, *x.shape[2:])
    return jnp.moveaxis(x, 1, 0)


def to_agents(x: jax.Array, agents: int) -> jax.Array:
    """Turns `to_learners` round: (batch, agents, ...)."""
    if x.shape[0] == 1:
        return x.reshape(-1, agents, *x.shape[2:])
    return jnp.moveaxis(x, 0, 1)


@struct.dataclass
class Transition:
    """What agents (...) saw, did and got."""

    observation: jax.Array  # before the step
    action: jax.Array  # int32
    reward: jax.Array  # of the step
    discount: jax.Array  # of what follows; 0 behind the end of an episode
    next_observation: jax.Array  # after the step, of the same episode
    valid: jax.Array  # bool; not of agents that had finished before the step


@struct.dataclass
class Learner:
    """A Q-network that learns."""

    params: Any  # of the network
    target: Any  # older ones, which give the targets
    optimizer: Any  # state of the optimiser
    updates: jax.Array  # () int32 gradient steps made


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


@struct.dataclass
class Training:
    """A training under way."""

    state: State  # (num_junctions,) of the junctions
    observation: jax.Array  # (num_junctions, agents, ...)
    learners: Learner  # (networks,)
    buffers: Any  # (networks,)
    steps: jax.Array  # () int32 control steps made at each junction
    key: jax.Array  # randomness


@struct.dataclass
class Report:
    """Report of a chunk."""

    episodes: jax.Array  # () int32 that ended
    returned: jax.Array  # () sum of their returns, of all agents
    # () mean squared error of the last step, mean over networks; 0 before
    # learning begins
    loss: jax.Array
