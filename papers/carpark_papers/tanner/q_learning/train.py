"""Tabular Q-learning: the learner, the loop over chunks of steps, files and curves.

All agents of all lots read and write one table, one transition after the other
("independent" Q-learning of Tanner 2022). Several seeds run side by side.
"""

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from carpark_mj.env import ParkingEnv
from carpark_mj.evaluation.keys import training_key
from carpark_mj.files import write_csv
from carpark_mj.policy import checkpoints, runs
from carpark_mj.training.loop import NAME, Loop, two_panels
from carpark_mj.training.run_folder import read_header
from carpark_mj.types import OUTCOMES, State
from carpark_papers.tanner.q_learning.config import QLearningConfig
from carpark_papers.tanner.q_learning.tables import (
    action_choices,
    cardinalities,
    state_index,
)

CHUNK = 5000  # control steps between looks at the clock


@struct.dataclass
class Training:
    """One seed's training; in use with a leading dimension (num_seeds,)."""

    table: jax.Array  # (states, actions) action values
    lots: State  # environment states (num_lots,)
    observation: jax.Array  # (num_lots, num_agents, numbers)
    episodes: jax.Array  # () int32, how many have ended
    key: jax.Array  # randomness of the actions


@struct.dataclass
class Finished:
    """Episodes that ended, or not, in a step; all (num_lots, num_agents)."""

    done: jax.Array  # bool; the rest holds where it is true
    episode_return: jax.Array  # undiscounted
    length: jax.Array  # control steps
    outcome: jax.Array  # 0 parked, 1 crashed, 2 timed out or diverged


class QLearner:
    """The compiled training loop of a configuration."""

    def __init__(self, config: QLearningConfig) -> None:
        """Builds the environment."""
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
        # Without new episodes: three times as fast, and mostly enough.
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


POINTS = 1500  # of a curve in the picture


def rolling_mean(values: np.ndarray, window: int) -> np.ndarray:
    """Means (n - window + 1,) of `window` consecutive values (n,); fewer if n is."""
    total = np.concatenate([[0.0], np.cumsum(values, dtype=float)])
    window = min(window, len(values))
    return (total[window:] - total[:-window]) / window if window else total[:0]


def write_metrics(
    folder: Path, config: QLearningConfig, episodes: dict[str, np.ndarray]
) -> Path:
    """Writes `metrics.csv`: for every seed a row per `window` episodes of a phase.

    Args:
        folder: of the run.
        config: its settings.
        episodes: `Run.episodes`.
    """
    rows: list[dict[str, Any]] = []
    for seed in range(config.num_seeds):
        count = int((episodes["outcome"][seed] >= 0).sum())
        for part in _windows(config, count):
            outcome = episodes["outcome"][seed, part]
            row: dict[str, Any] = {
                "seed": seed,
                "episode": part.stop,
                "phase": "training" if part.stop <= config.episodes else "evaluation",
                "episode_return": float(episodes["episode_return"][seed, part].mean()),
                "length": float(episodes["length"][seed, part].mean()),
            }
            for number, name in enumerate(OUTCOMES):
                row[name] = float((outcome == number).mean())
            rows.append(row)
    path = folder / "metrics.csv"
    write_csv(path, rows)
    return path


def _windows(config: QLearningConfig, count: int) -> Iterator[slice]:
    """The first `count` episodes by `window`; none holds episodes of both phases."""
    trained = min(count, config.episodes)
    for begin, end in ((0, trained), (trained, count)):
        for first in range(begin, end, config.window):
            yield slice(first, min(first + config.window, end))


def plot_returns(
    folder: Path, config: QLearningConfig, episodes: dict[str, np.ndarray]
) -> Path:
    """Draws rolling return and share parked of every seed to `learning_curve.png`."""
    title = (
        f"{config.preset}: means over {config.window} episodes "
        f"({config.episodes} training, {config.eval_episodes} evaluation)"
    )
    with two_panels(folder, title, "episode") as (returns, shares):
        for seed in range(config.num_seeds):
            outcome = episodes["outcome"][seed]
            done = outcome >= 0
            for axes, values in (
                (returns, episodes["episode_return"][seed][done]),
                (shares, (outcome[done] == 0).astype(float)),
            ):
                mean = rolling_mean(values, config.window)
                stride = max(1, len(mean) // POINTS)
                at = np.arange(len(mean))[::stride] + min(config.window, len(values))
                label = f"seed {seed}"
                axes.plot(
                    at, mean[::stride], f"C{seed % 10}", linewidth=1.0, label=label
                )
        for axes in (returns, shares):
            axes.axvline(
                config.episodes, color="black", linestyle="--", label="end of training"
            )
        returns.legend(loc="best", fontsize="small")
        returns.set(ylabel="return")
        shares.set(ylabel="share parked", ylim=(-0.02, 1.02))
    return folder / NAME


def summary(config: QLearningConfig, episodes: dict[str, np.ndarray]) -> list[str]:
    """A line per seed about its last episodes: the evaluation, or a window without."""
    last = config.eval_episodes or config.window
    lines = []
    for seed in range(config.num_seeds):
        done = np.flatnonzero(episodes["outcome"][seed] >= 0)[-last:]
        if not len(done):
            continue
        outcome = episodes["outcome"][seed, done]
        rates = ", ".join(
            f"{name.replace('_', ' ')} {(outcome == number).mean():.1%}"
            for number, name in enumerate(OUTCOMES)
        )
        mean = episodes["episode_return"][seed, done].mean()
        lines.append(
            f"seed {seed}: last {len(done)} episodes: return {mean:.2f}, {rates}"
        )
    return lines


@dataclasses.dataclass
class Run:
    """A training and its results so far."""

    training: Training  # of all seeds
    # by name (num_seeds, total_episodes): `episode_return` float32, `length`
    # int32 and `outcome` int8, -1 where there is none yet
    episodes: dict[str, np.ndarray]
    chunks: int  # how often `QLearner.advance` has run

    @property
    def counts(self) -> np.ndarray:
        """(num_seeds,) episodes recorded."""
        return (self.episodes["outcome"] >= 0).sum(axis=1)

    def add(self, finished: Finished) -> None:
        """Appends the episodes of a chunk, (CHUNK, num_seeds, num_lots, num_agents)."""
        for seed, start in enumerate(self.counts):
            done = np.asarray(finished.done)[:, seed]
            for name, record in self.episodes.items():
                ended = np.asarray(getattr(finished, name))[:, seed][done]
                part = record[seed, start : start + len(ended)]
                part[:] = ended[: len(part)]


def load_or_init(learner: QLearner, folder: Path) -> Run:
    """The newest checkpoint of the run, or a fresh start if it has none."""
    config = learner.config
    shape = (config.num_seeds, config.total_episodes)
    episodes = {
        "episode_return": np.zeros(shape, np.float32),
        "length": np.zeros(shape, np.int32),
        "outcome": np.full(shape, -1, np.int8),
    }
    if not runs.checkpoint_files(folder):
        return Run(learner.init(), episodes, 0)
    path = runs.latest_checkpoint(folder)
    template = vars(jax.eval_shape(learner.init)) | {"history": episodes}
    header = read_header(path, type(config), chunks=int)
    tree = checkpoints.load(path, template)
    episodes = {name: np.array(record) for name, record in tree.pop("history").items()}
    training = Training(**jax.device_put(tree))
    return Run(training, episodes, header["chunks"])


def save(folder: Path, config: QLearningConfig, run: Run) -> None:
    """Writes checkpoint, metrics and plot."""
    counts = run.counts
    recent = [
        run.episodes["episode_return"][seed, max(count - config.window, 0) : count]
        for seed, count in enumerate(counts)
    ]
    means = [part.mean() if len(part) else -np.inf for part in recent]
    steps = run.chunks * CHUNK * config.num_lots * config.env.num_agents
    header: dict[str, Any] = {
        "algorithm": "q_learning",
        "config": dataclasses.asdict(config),
        "chunks": run.chunks,
        "env_steps": steps * config.num_seeds,
        "best": int(np.argmax(means)),
    }
    tree = vars(jax.device_get(run.training)) | {"history": run.episodes}
    runs.save_checkpoint(folder, tree, header, header["env_steps"])
    write_metrics(folder, config, run.episodes)
    plot_returns(folder, config, run.episodes)


def train(config: QLearningConfig, learner: QLearner, folder: Path) -> bool:
    """Trains until done, stopped or out of time; True when done."""
    states, actions = learner.table_shape
    print(f"run {folder}: {config.num_seeds} tables of {states} x {actions}")
    print("compiling ...", flush=True)
    loop = Loop("Q-learning", config)
    run = load_or_init(learner, folder)
    with loop.over(config.total_episodes, int(run.counts.min())):
        while True:
            count = int(run.counts.min())
            recent = run.episodes["episode_return"][:, max(0, count - config.window) :]
            returned = recent[:, : config.window].mean() if count else np.nan
            loop.show(count, f"{count:,} episodes  [green]return {returned:6.2f}[/]")
            finished = count == config.total_episodes
            leaving = finished or loop.stopping
            if leaving or loop.checkpoint_is_due:
                save(folder, config, run)
                loop.saved()
            if leaving:
                break
            run.training, ended = learner.advance(run.training)
            run.add(jax.device_get(ended))
            run.chunks += 1
    print("\n".join(summary(config, run.episodes)))
    return finished
