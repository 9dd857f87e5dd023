"""Q-networks, one per learner, and how agents are dealt out to them."""

import jax
import jax.numpy as jnp
from flax import linen as nn

from carpark_papers.cederle.dqn.config import DQNConfig
from carpark_papers.cederle.junction.actions import ACTIONS
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
