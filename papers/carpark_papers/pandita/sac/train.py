"""A SAC run: phase after phase, with deployments in between, and checkpoints."""

import contextlib
import dataclasses
from pathlib import Path
from typing import Any

import jax

from carpark_mj.files import write_csv
from carpark_mj.policy import checkpoints, runs
from carpark_mj.training.loop import Loop
from carpark_mj.training.metrics_log import MetricsLog
from carpark_mj.training.run_folder import read_header
from carpark_mj.training.settings import list_settings
from carpark_papers.pandita.sac import agent as agents
from carpark_papers.pandita.sac import replay
from carpark_papers.pandita.sac.agent import Agent
from carpark_papers.pandita.sac.config import SACConfig
from carpark_papers.pandita.sac.deploy import deploy_everywhere
from carpark_papers.pandita.sac.watch import Progress, Watch

SAC_ALGORITHM = "sac"  # `algorithm` in the header of a checkpoint
_FOREVER = 10**12  # transitions; `Watch` ends a phase


class Training:
    """A run under way.

    Attributes:
        config: its settings.
        folder: of the run.
        progress: steps and phases so far.
        agent: the learner.
        deployments: rows of `deploy_everywhere` so far.
    """

    def __init__(self, config: SACConfig, folder: Path) -> None:
        """Begins the run, or continues with its newest checkpoint.

        Raises:
            CheckpointError: a checkpoint to resume from is damaged.
        """
        self.config, self.folder = config, folder
        self.progress = Progress()
        self.deployments: list[dict[str, Any]] = []
        resumed = bool(runs.checkpoint_files(folder))
        path = runs.latest_checkpoint(folder) if resumed else None
        if path:
            header = read_header(path, SACConfig, progress=dict, deployments=list)
            self.progress = runs.from_dict(Progress, header["progress"])
            self.deployments = header["deployments"]
        self.agent = self._make_agent()
        if path:
            tree = agents.arrays(self.agent)
            agents.put_back(self.agent, checkpoints.load(path, tree))
            self.agent.num_timesteps = self.progress.total

    def _make_agent(self) -> Agent:
        cars = self._make_cars()
        made = agents.make_agent(
            self.config, cars, lambda _: self.progress.learning_rate(self.config)
        )
        self._make_cars(made)  # making an agent reseeds the cars
        return made

    def _make_cars(self, agent: Agent | None = None) -> Any:
        phase = min(self.progress.phase, len(self.config.phases) - 1)
        seed = agents.set_seed(self.config.seed, self.progress.total)
        layout = self.config.layout_of_phase(phase)
        cars = agents.make_cars(self.config, layout, seed)
        if agent is not None:
            agent.set_env(cars)
            agent.replay_buffer.phase = phase
        return cars

    def save(self) -> Path:
        """Writes a checkpoint with everything, the buffer as well."""
        header = {
            "algorithm": SAC_ALGORITHM,
            "config": dataclasses.asdict(self.config),
            "progress": dataclasses.asdict(self.progress),
            "deployments": self.deployments,
            "env_steps": self.progress.total,
        }
        tree = jax.device_get(agents.arrays(self.agent))
        return runs.save_checkpoint(self.folder, tree, header, self.progress.total)

    def deploy(self, phase: int) -> None:
        """Deploys the policy, unless it is done, and writes `deployments.csv`."""
        if not any(row["phase"] == phase for row in self.deployments):
            policy = self.agent.policy
            self.deployments += deploy_everywhere(
                self.config, policy.actor.apply, policy.actor_state.params, phase
            )
        write_csv(self.folder / "deployments.csv", self.deployments)

    def next_phase(self) -> None:
        """Goes on to the next phase, whose lots are others."""
        self.progress.phase += 1
        self.progress.steps = self.progress.episodes = 0
        buffer = self.agent.replay_buffer
        replay.end_episodes(buffer)
        if self.config.at_switch == "clear":
            replay.clear(buffer)
        if self.progress.phase < len(self.config.phases):
            self._make_cars(self.agent)


def train(config: SACConfig, folder: Path) -> Training | None:
    """Trains until done, stopped or at the time limit; None if it was stopped.

    Raises:
        CheckpointError: a checkpoint to resume from is damaged.
    """
    print(f"run {folder} on {jax.devices()[0].device_kind}")
    for name, value in list_settings(config):
        print(f"  {name} = {value}")
    loop = Loop("SAC", config)
    training = Training(config, folder)
    progress, phases = training.progress, len(config.phases)
    print("compiling ...", flush=True)
    training.deploy(0)
    done = min(progress.phase, phases)
    with (
        loop.over(phases, done),
        contextlib.closing(MetricsLog(folder, progress.row)) as log,
    ):
        while progress.phase < phases:
            watch = Watch(config, progress, loop, log, lambda: _ignore(training.save()))
            training.agent.learn(
                _FOREVER, watch, log_interval=_FOREVER, reset_num_timesteps=False
            )
            if progress.share(config) < 1.0:
                training.save()
                return None
            training.deploy(progress.phase + 1)
            training.next_phase()
            training.save()
            loop.saved()
            if loop.stopping and progress.phase < phases:
                return None
    return training


def _ignore(path: Path) -> None:
    del path
