"""Deep Q-learning at many junctions as one program."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from carpark_mj.evaluation.keys import training_key
from carpark_papers.cederle.dqn.config import DQNConfig
from carpark_papers.cederle.dqn.update import (
    Learner,
    Report,
    Training,
    Transition,
    make_buffer,
    make_network,
    make_optimizer,
    to_agents,
    to_learners,
    update,
)
from carpark_papers.cederle.junction import JunctionEnv
from carpark_papers.cederle.junction.evaluation import (
    Outcomes,
    evaluate,
    evaluation_env,
)
from carpark_papers.cederle.junction.rules import ACTIONS


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
