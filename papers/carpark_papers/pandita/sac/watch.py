"""Metrics and stopping between the steps of sbx's loop."""

# An extra that the type checker does without.
# pyright: reportMissingImports=false, reportUntypedBaseClass=false

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback

from carpark_mj.training.loop import Loop
from carpark_mj.training.metrics_log import MetricsLog
from carpark_papers.pandita.sac.config import SACConfig

ROW = 1000  # transitions between rows of metrics
_LOSSES = ("actor_loss", "critic_loss", "ent_coef")


@dataclasses.dataclass
class Progress:
    """Progress of a run.

    Attributes:
        phase: number of the phase, from 0; the number of phases after the last.
        steps: transitions made in the phase.
        episodes: that ended in the phase.
        total: transitions made in all phases.
        row: number of the latest row of metrics.
    """

    phase: int = 0
    steps: int = 0
    episodes: int = 0
    total: int = 0
    row: int = 0

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
        """Takes what it keeps up to date.

        Args:
            config: of the run.
            progress: changed in place.
            loop: of the run.
            log: of the run.
            save: writes a checkpoint.
        """
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
