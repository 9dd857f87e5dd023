"""Deep Q-learning at many junctions as one program: networks, updates, steps."""

# pyright: reportMissingImports=false, reportUntypedFunctionDecorator=false

import dataclasses
from typing import Any

import flashbax
import jax
import jax.numpy as jnp
import optax
import rlax
from flashbax.buffers.trajectory_buffer import TrajectoryBuffer
from flax import linen as nn
from flax import struct

from carpark_mj.evaluation.keys import training_key
from carpark_papers.cederle.dqn.config import DQNConfig
from carpark_papers.cederle.junction import JunctionEnv
from carpark_papers.cederle.junction.evaluation import (
    Outcomes,
    evaluate,
    evaluation_env,
)
from carpark_papers.cederle.junction.rules import ACTIONS, State
from carpark_papers.cederle.training.config import VECTOR_SCALE

# Extras that the type checker does without.


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
    """Agents (batch, agents, ...) by network, (networks, batch * agents / n, ...)."""
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
    next_observation: jax.Array  # after the step, of this episode
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

    Values (batch, actions) come from the online network before the step, the target
    network after it, and the online network after it, which choose the action of double
    Q-learning; None = plain Q-learning.
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


class DQNLearner:
    """The programs of a configuration; all constants, no state."""

    def __init__(self, config: DQNConfig) -> None:
        """Builds the environments."""
        self.config = config
        self.env = JunctionEnv(config.junction)
        self._network = make_network(config)
        self._buffer = make_buffer(config)
        self._evaluation_env = evaluation_env(config.junction, config.eval_jitter)
        self.init = jax.jit(self._init)
        self.advance = jax.jit(self._advance, donate_argnums=0)
        self.evaluate = jax.jit(self._evaluate)

    def _init(self) -> Training:
        """A fresh training."""
        config = self.config
        key, reset_key, net_key = jax.random.split(training_key(config.seed), 3)
        reset_keys = jax.random.split(reset_key, config.num_junctions)
        state, observation = jax.vmap(self.env.reset)(reset_keys)
        seen = observation[0, :1]

        def learner(key: jax.Array) -> Learner:
            params = self._network.init(key, seen)
            optimizer = make_optimizer(config).init(params)
            return Learner(params, params, optimizer, jnp.zeros((), jnp.int32))

        transition = Transition(
            observation=seen[0],
            action=jnp.zeros((), jnp.int32),
            reward=jnp.zeros(()),
            discount=jnp.zeros(()),
            next_observation=seen[0],
            valid=jnp.zeros((), bool),
        )
        buffer = self._buffer.init(transition)
        buffers = jax.tree.map(lambda x: jnp.stack([x] * config.networks), buffer)
        learners = jax.vmap(learner)(jax.random.split(net_key, config.networks))
        steps = jnp.zeros((), jnp.int32)
        return Training(state, observation, learners, buffers, steps, key)

    def greedy(self, params: Any, observation: jax.Array) -> jax.Array:
        """The best actions (batch, agents) for observations (batch, agents, ...)."""
        seen = to_learners(observation, self.config.networks)
        values: Any = jax.vmap(self._network.apply)(params, seen)
        return to_agents(values.argmax(axis=-1), self.env.num_agents)

    def _evaluate(self, params: Any) -> Outcomes:
        """Episodes with greedy actions."""
        return evaluate(
            self._evaluation_env,
            lambda observation: self.greedy(params, observation[None])[0],
            self.config.evaluation_keys(),
        )

    def _advance(self, training: Training) -> tuple[Training, Report]:
        """`config.chunk` control steps of all junctions."""
        training, reports = jax.lax.scan(
            lambda training, _: self._step(training), training, length=self.config.chunk
        )
        report = jax.tree.map(lambda x: x.sum(axis=0), reports)
        return training, dataclasses.replace(report, loss=reports.loss[-1])

    def _step(self, training: Training) -> tuple[Training, Report]:
        """One control step of all junctions, then `config.updates` updates."""
        config, before = self.config, training.state
        key, act_key, learn_key = jax.random.split(training.key, 3)
        done = training.steps * config.num_junctions / config.epsilon_steps
        epsilon = jnp.clip(1.0 - done * (1.0 - config.epsilon_end), config.epsilon_end)
        action = self._explore(training, epsilon, act_key)
        state, timestep = jax.vmap(self.env.step)(before, action)
        transition = Transition(
            observation=training.observation,
            action=action,
            reward=timestep.reward,
            discount=jnp.where(timestep.terminated, 0.0, config.discount),
            next_observation=timestep.final_observation,
            valid=before.active,
        )
        added = jax.tree.map(lambda x: to_learners(x, config.networks), transition)
        buffers = jax.vmap(self._buffer.add)(training.buffers, added)
        learners, loss = jax.lax.cond(
            self._buffer.can_sample(jax.tree.map(lambda x: x[0], buffers)),
            lambda learners: self._learn(learners, buffers, learn_key),
            lambda learners: (learners, jnp.zeros(())),
            training.learners,
        )
        returned = timestep.returns.sum(axis=-1)
        report = Report(
            episodes=timestep.over.sum(),
            returned=jnp.where(timestep.over, returned, 0.0).sum(),
            loss=loss,
        )
        training = Training(
            state, timestep.observation, learners, buffers, training.steps + 1, key
        )
        return training, report

    def _explore(
        self, training: Training, epsilon: jax.Array, key: jax.Array
    ) -> jax.Array:
        """Greedy actions, a share of them replaced by random ones."""
        whether_key, action_key = jax.random.split(key)
        best = self.greedy(training.learners.params, training.observation)
        explores = jax.random.bernoulli(whether_key, epsilon, best.shape)
        drawn = jax.random.randint(action_key, best.shape, 0, len(ACTIONS))
        return jnp.where(explores, drawn, best)

    def _learn(
        self, learners: Learner, buffers: Any, key: jax.Array
    ) -> tuple[Learner, jax.Array]:
        """All updates after a step; every network samples its own batches."""

        def one(learners: Learner, key: jax.Array) -> tuple[Learner, jax.Array]:
            keys = jax.random.split(key, self.config.networks)
            batch = jax.vmap(self._buffer.sample)(buffers, keys).experience
            return jax.vmap(
                lambda learner, part: update(self.config, self._network, learner, part)
            )(learners, batch)

        keys = jax.random.split(key, self.config.updates)
        learners, losses = jax.lax.scan(one, learners, keys)
        return learners, losses[-1].mean()
