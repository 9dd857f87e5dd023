"""A SAC run: phase after phase, deployments, checkpoints, pictures and a video."""

# An extra that the type checker does without.
# pyright: reportMissingImports=false, reportUntypedBaseClass=false

import contextlib
import dataclasses
import itertools
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np
from stable_baselines3.common.callbacks import BaseCallback

from carpark_mj.config.checks import CheckedConfig
from carpark_mj.files import write_csv, write_json
from carpark_mj.policy import checkpoints, runs
from carpark_mj.policy.networks import Policy
from carpark_mj.rendering.gl import choose_gl
from carpark_mj.rendering.recording import num_frames, record, recording_stage
from carpark_mj.rendering.renderer import LotRenderer, RenderingError
from carpark_mj.rendering.video import draw_frame, frame_indices, write_video
from carpark_mj.training.loop import Loop, MetricsLog
from carpark_mj.training.run_folder import list_settings, open_run, read_header
from carpark_mj.wrappers.goal import GoalParking
from carpark_mj.wrappers.options import share
from carpark_papers.pandita.sac import agent as agents
from carpark_papers.pandita.sac.agent import Agent
from carpark_papers.pandita.sac.config import SACConfig
from carpark_papers.pandita.sac.deploy import (
    Transfer,
    choose_action,
    deploy_everywhere,
    plot_matrix,
    plot_phases,
    success_matrix,
    transfer,
)

ROW = 1000  # transitions between rows of metrics
_LOSSES = ("actor_loss", "critic_loss", "ent_coef")


@dataclasses.dataclass
class Progress(CheckedConfig):
    """Progress of a run."""

    phase: int = 0  # number of the phase, from 0; the number of phases after the last
    steps: int = 0  # transitions made in the phase
    episodes: int = 0  # that ended in the phase
    total: int = 0  # transitions made in all phases
    row: int = 0  # number of the latest row of metrics

    def share(self, config: SACConfig) -> float:
        """Of the phase that is done, in [0, 1]; 1 after the last phase."""
        if self.phase == len(config.phases):
            return 1.0
        return config.schedule[self.phase].progress(self.steps, self.episodes)

    def learning_rate(self, config: SACConfig) -> float:
        """Adam's: linear in each phase."""
        begin, end = config.learning_rate, config.learning_rate_end
        return begin + (end - begin) * self.share(config)


class Watch(BaseCallback):
    """Counts, logs and saves after every step of all cars; ends the phase."""

    def __init__(
        self,
        config: SACConfig,
        progress: Progress,
        loop: Loop,
        log: MetricsLog,
        save: Callable[[], None],
    ) -> None:
        """Takes what it keeps up to date; `save` writes a checkpoint."""
        super().__init__()
        self._config, self._progress, self._loop = config, progress, loop
        self._log, self._save = log, save
        self._ends: list[dict[str, float]] = []
        self._begun, self._first = loop.seconds, progress.total

    def _on_step(self) -> bool:
        progress, loop = self._progress, self._loop
        dones, infos = self.locals["dones"], self.locals["infos"]
        progress.steps += len(dones)
        progress.total += len(dones)
        progress.episodes += int(dones.sum())
        self._ends += [_end(infos[index]) for index in np.flatnonzero(dones)]
        done = progress.share(self._config) >= 1.0
        if done or progress.total // ROW > (progress.total - len(dones)) // ROW:
            self._write_row()
        if loop.checkpoint_is_due:
            self._save()
            loop.saved()
        return not (done or loop.stopping)

    def _write_row(self) -> None:
        progress, loop = self._progress, self._loop
        progress.row += 1
        seconds = loop.seconds - self._begun
        rate = (progress.total - self._first) / max(seconds, 1e-9)
        losses = self.logger.name_to_value
        row: dict[str, float] = {
            "update": progress.row,
            "env_steps": progress.total,
            "seconds": loop.seconds,
            "steps_per_second": rate,
            "phase": progress.phase,
            "episodes": len(self._ends),
        }
        for name in ("success", "crashed", "timed_out", "return", "length"):
            values = [end[name] for end in self._ends]
            row[f"episode/{name}"] = float(np.mean(values)) if values else np.nan
        row |= {name: losses.get(f"train/{name}", np.nan) for name in _LOSSES}
        self._log.write(row)
        success = f"{row['episode/success']:5.1%}" if self._ends else "    –"
        crashed = f"{row['episode/crashed']:5.1%}" if self._ends else "    –"
        self._ends.clear()
        phases = self._config.schedule
        loop.show(
            progress.phase + progress.share(self._config),
            f"phase {progress.phase + 1}/{len(phases)}: {phases[progress.phase]}  "
            f"{progress.total:,} steps  {rate:,.0f} steps/s  "
            f"[green]success {success}[/]  [red]crashed {crashed}[/]",
        )


def _end(info: dict[str, Any]) -> dict[str, float]:
    """How an episode ended."""
    return {
        "success": info["is_success"],
        "crashed": info["crashed"],
        "timed_out": info["TimeLimit.truncated"],
        "return": info["episode"]["r"],
        "length": info["episode"]["l"],
    }


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
        """Begins the run, or continues with its newest checkpoint."""
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
        agents.end_episodes(buffer)
        if self.config.at_switch == "clear":
            agents.clear(buffer)
        if self.progress.phase < len(self.config.phases):
            self._make_cars(self.agent)


def train(config: SACConfig, folder: Path) -> Training | None:
    """Trains until done, stopped or at the time limit; None if it was stopped."""
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
        contextlib.closing(MetricsLog(folder, progress.row, config)) as log,
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


FPS = 10.0
SIZE = (960, 540)
STILL = 1.0  # s for which the end of an episode is shown


def write_drives(training: Training, path: Path) -> Path:
    """Renders the deterministic policy; every kind has its share of the time."""
    config, policy = training.config, training.agent.policy
    missing_gl = choose_gl()
    if missing_gl:
        raise RenderingError(missing_gl)
    seconds = config.video_seconds / len(config.kinds)

    def act(vector: jax.Array, key: jax.Array) -> tuple[jax.Array, dict[str, Any]]:
        params = policy.actor_state.params
        return choose_action(policy.actor.apply, False, params, vector, key), {}

    def pictures() -> Iterator[np.ndarray]:
        for kind in config.kinds:
            env = share(GoalParking, config.env_of(config.layout(kind)))
            yield from _draw(env, act, seconds, config.seed)

    frames = pictures()
    first = next(frames)
    write_video(path, itertools.chain([first], frames), FPS)
    return path


def _draw(
    env: GoalParking, act: Policy, seconds: float, seed: int
) -> Iterator[np.ndarray]:
    """Frames of an episode, till `STILL` after its end."""
    num_steps = max(1, round(seconds / env.config.sim.ctrl_dt))
    recording = record(env, act, num_steps, seed)
    shown = recording.active.any(axis=1).sum() + round(STILL / recording.ctrl_dt)
    frames = round(num_frames(recording) * min(1.0, shown / num_steps))
    renderer = LotRenderer(recording_stage(env, recording), "topdown", SIZE)
    try:
        for index in frame_indices(recording, FPS)[0]:
            if index < frames:
                yield draw_frame(recording, renderer, index)
    finally:
        renderer.close()


def finish(training: Training) -> None:
    """Learning curve, success matrix, transfer and a video."""
    config, folder = training.config, training.folder
    print(f"wrote {plot_phases(folder)}")
    rows, phases = training.deployments, config.schedule
    matrices = {
        policy: success_matrix(rows, config.kinds, policy)
        for policy in ("deterministic", "sampled")
    }
    names = ["untrained", *map(str, phases)]
    path = folder / "success_matrix.png"
    print(f"wrote {plot_matrix(path, matrices['deterministic'], names, config.kinds)}")
    found = {
        policy: vars(transfer(matrix, config.kinds, phases))
        for policy, matrix in matrices.items()
    }
    last = [row for row in rows if row["phase"] == len(phases)]
    write_json(folder / "evaluation.json", {"transfer": found, "kinds": last})
    for row in last:
        print(
            f"{row['kind']}, {row['policy']}: success {row['success']:.1%} "
            f"({row['success_low']:.1%} to {row['success_high']:.1%}), crashed "
            f"{row['crashed']:.1%}, timed out {row['timed_out']:.1%}"
        )
    if len(phases) > 1:
        print(_words(Transfer(**found["deterministic"])))
    if config.video_seconds:
        from carpark_mj.rendering.renderer import RenderingError

        try:
            print(f"wrote {write_drives(training, folder / 'video.mp4')}")
        except RenderingError as error:
            print(f"no video: {error}", file=sys.stderr)


def _words(found: Transfer) -> str:
    return (
        f"backward transfer {found.backward:+.2f}, forward transfer "
        f"{found.forward:+.2f}, average success {found.average:.1%}"
    )


def train_run(config: SACConfig) -> tuple[Path, bool]:
    """Trains and finishes a run; returns its folder and whether it is finished."""
    with open_run(config) as folder:
        training = train(config, folder)
        if training:
            finish(training)
    return folder, training is not None
