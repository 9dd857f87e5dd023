"""Tabular Q-learning as one compiled loop: acting, stepping the lots, updating.

All agents of all lots read and write one table, one transition after the other
("independent" Q-learning of Tanner 2022). Several seeds run side by side.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj.env import ParkingEnv
from carpark_mj.evaluation.keys import training_key
from carpark_mj.observations import cardinalities
from carpark_mj.policy.q_table import action_choices, state_index
from carpark_mj.training.memory import num_bytes
from carpark_mj.types import State
from carpark_papers.tanner.q_learning.config import QLearningConfig

CHUNK = 5000  # control steps between looks at the clock


@struct.dataclass
class Training:
    """One seed's training; in use with a leading dimension (num_seeds,).

    Attributes:
        table: (states, actions) action values.
        lots: environment states (num_lots,).
        observation: (num_lots, num_agents, numbers).
        episodes: () int32, how many have ended.
        key: randomness of the actions.
    """

    table: jax.Array
    lots: State
    observation: jax.Array
    episodes: jax.Array
    key: jax.Array


@struct.dataclass
class Finished:
    """Episodes that ended, or not, in a step; all (num_lots, num_agents).

    Attributes:
        done: bool; the rest holds where it is true.
        episode_return: undiscounted.
        length: control steps.
        outcome: 0 parked, 1 crashed, 2 timed out or diverged.
    """

    done: jax.Array
    episode_return: jax.Array
    length: jax.Array
    outcome: jax.Array


class QLearner:
    """The compiled training loop of a configuration."""

    def __init__(self, config: QLearningConfig) -> None:
        """Builds the environment.

        Raises:
            ValueError: it cannot be built, or its observations are not integers.
        """
        self.config = config
        if not config.env.episode.respawn:
            raise ValueError("Q-learning needs env.episode.respawn = True")
        if len(config.env.agent_counts) > 1:
            raise ValueError(
                "Q-learning needs the same number of agents in all lots, "
                f"env.min_agents = None, not {config.env.min_agents}"
            )
        episode = dataclasses.replace(config.env.episode, final_observation=True)
        self.env = ParkingEnv(dataclasses.replace(config.env, episode=episode))
        # The same without new episodes: three times as fast, and mostly enough.
        still = dataclasses.replace(episode, respawn=False)
        self._still_env = ParkingEnv(dataclasses.replace(config.env, episode=still))
        self.choices = config.env.physics_config.choices
        self.sizes = cardinalities(config.env)
        self.advance = jax.jit(self._advance)

    @property
    def table_shape(self) -> tuple[int, int]:
        """States and actions."""
        states = actions = 1
        for size in self.sizes:
            states *= size
        for size in self.choices:
            actions *= size
        return states, actions

    def least_memory(self) -> int:
        """Bytes that training needs at least: state, episodes, a chunk."""
        config = self.config
        agents = config.num_lots * config.env.num_agents
        steps = config.num_seeds * CHUNK * agents
        episodes = config.num_seeds * config.total_episodes
        # A return (4), a length (4) and an outcome (1), with `done` (1) in a chunk.
        return num_bytes(jax.eval_shape(self.init)) + 9 * episodes + 10 * steps

    def init(self) -> Training:
        """All seeds at the start; tables are zero."""
        config = self.config
        keys = jax.random.split(training_key(config.seed), config.num_seeds)
        return jax.jit(jax.vmap(self._init))(keys)

    def _init(self, key: jax.Array) -> Training:
        key, lot_key = jax.random.split(key)
        keys = jax.random.split(lot_key, self.config.num_lots)
        lots, observation = jax.vmap(self.env.reset)(keys)
        return Training(
            table=jnp.zeros(self.table_shape, jnp.float32),
            lots=lots,
            observation=observation,
            episodes=jnp.zeros((), jnp.int32),
            key=key,
        )

    def rates(self, episodes: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Learning rate and share of random actions after a number of episodes.

        Both fall linearly over the training episodes. In the evaluation episodes no
        action is random, and learning continues at the last rate.
        """
        config = self.config
        share = jnp.minimum(episodes / config.episodes, 1.0)
        alpha = config.alpha + (config.alpha_min - config.alpha) * share
        epsilon = config.epsilon + (config.epsilon_min - config.epsilon) * share
        return alpha, jnp.where(episodes < config.episodes, epsilon, 0.0)

    def _advance(self, training: Training) -> tuple[Training, Finished]:
        return jax.lax.scan(self._step, training, None, length=CHUNK)

    def _step(self, training: Training, _: Any) -> tuple[Training, Finished]:
        """One control step of all seeds (num_seeds,)."""
        training, state, action = jax.vmap(self._act)(training)
        before, choices = training.lots, action_choices(action, self.choices)
        after = jax.vmap(jax.vmap(self._still_env.step))(before, choices)
        # A condition on all seeds at once is a branch, one for each would not be.
        lots, timestep = jax.lax.cond(
            jnp.any(after[1].events.done),
            lambda: jax.vmap(jax.vmap(self.env.step))(before, choices),
            lambda: after,
        )
        following = state_index(timestep.final_observation, self.sizes)
        terminated = timestep.terminated
        transitions = (state, action, timestep.reward, following, terminated)
        table = jax.vmap(self._learn)(training, transitions)
        events = timestep.events
        outcome = jnp.where(events.parked, 0, jnp.where(events.crashed, 1, 2))
        finished = Finished(
            done=events.done,
            episode_return=timestep.metrics["episode_return"],
            length=timestep.metrics["length"],
            outcome=outcome.astype(jnp.int8),
        )
        training = dataclasses.replace(
            training,
            table=table,
            lots=lots,
            observation=timestep.observation,
            episodes=training.episodes + jnp.sum(events.done, axis=(1, 2)),
        )
        return training, finished

    def _act(self, training: Training) -> tuple[Training, jax.Array, jax.Array]:
        """One seed's states and actions (num_lots, num_agents), with its keys renewed.

        The lots' keys come from here: what they hold depends on the branch taken.
        """
        key, random_key, which_key, lot_key = jax.random.split(training.key, 4)
        state = state_index(training.observation, self.sizes)
        best = jnp.argmax(training.table[state], axis=-1)
        drawn = jax.random.randint(which_key, best.shape, 0, self.table_shape[1])
        _, epsilon = self.rates(training.episodes)
        explores = jax.random.uniform(random_key, best.shape) < epsilon
        keys = jax.random.split(lot_key, self.config.num_lots)
        lots = dataclasses.replace(training.lots, key=keys)
        training = dataclasses.replace(training, lots=lots, key=key)
        return training, state, jnp.where(explores, drawn, best)

    def _learn(self, training: Training, transitions: Any) -> jax.Array:
        """One seed's table after its transitions, each (num_lots, num_agents).

        Parking and crashing are terminal, unless `bootstrap_terminals`; after a timeout
        the next state's value is bootstrapped.
        """
        alpha, _ = self.rates(training.episodes)
        running = training.episodes < self.config.total_episodes

        def learn(table: jax.Array, transition: Any):
            state, action, reward, following, terminated = transition
            future = jnp.max(table[following])
            if not self.config.bootstrap_terminals:
                future = jnp.where(terminated, 0.0, future)
            error = reward + self.config.gamma * future - table[state, action]
            error = jnp.where(running, error, 0.0)
            return table.at[state, action].add(alpha * error), None

        flat = jax.tree.map(lambda x: x.reshape(-1), transitions)
        return jax.lax.scan(learn, training.table, flat)[0]
