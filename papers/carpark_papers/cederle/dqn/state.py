"""The state of a deep Q-learning run, and its reports."""

from typing import Any

import jax
from flax import struct

from carpark_papers.cederle.dqn.update import Learner
from carpark_papers.cederle.junction.types import State


@struct.dataclass
class Training:
    """A training under way.

    Attributes:
        state: (num_junctions,) of the junctions.
        observation: (num_junctions, agents, ...).
        learners: (networks,).
        buffers: (networks,).
        steps: () int32 control steps made at each junction.
        key: randomness.
    """

    state: State
    observation: jax.Array
    learners: Learner
    buffers: Any
    steps: jax.Array
    key: jax.Array


@struct.dataclass
class Report:
    """Report of a chunk.

    Attributes:
        episodes: () int32 that ended.
        returned: () sum of their returns, of all agents.
        loss: () mean squared error of the last step, mean over networks; 0 before
            learning begins.
    """

    episodes: jax.Array
    returned: jax.Array
    loss: jax.Array
