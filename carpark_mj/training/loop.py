"""What all trainers do between updates: progress, Ctrl-C, the log and its curve."""

import contextlib
import csv
import itertools
import math
import signal
import sys
import time
from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich import get_console
from rich.progress import (
    BarColumn,
    Progress,
    TaskProgressColumn,
    TextColumn,
    TimeRemainingColumn,
)

from carpark_mj.cli.clock import TRAINING
from carpark_mj.cli.settings.training import RunConfig
from carpark_mj.files import drawn_axes, naming, write_csv
from carpark_mj.reading import CsvRow, read_csv
from carpark_mj.training.loggers import open_loggers
from carpark_mj.training.run_folder import list_settings

LINE_SECONDS = 20.0  # between lines of progress where there is no terminal
NAME = "learning_curve.png"
OUTCOMES = (("parked", "tab:green"), ("crashed", "tab:red"), ("timed_out", "tab:gray"))


class Loop:
    """Progress, checkpoint times, time limit and Ctrl-C of a training."""

    def __init__(
        self, title: str, config: RunConfig, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Starts the clocks; `clock` gives the time [s], `title` is that of the bar."""
        self._config, self._clock, self._asked = config, clock, False
        self._compiles = True  # until the first update
        self._started = self._saved = self._printed = clock()
        console = get_console()
        self._bar = Progress(
            TextColumn(f"[bold]{title}"),
            BarColumn(bar_width=24),
            TaskProgressColumn(),
            TextColumn("{task.description}"),
            TimeRemainingColumn(compact=True),
            TextColumn("left"),
            console=console,
            # A bar redirects what is printed. In a notebook, showing a line flushes
            # that, and so itself, for ever once a callback has printed part of a line.
            disable=console.is_jupyter,
        )

    @contextlib.contextmanager
    def over(self, total: float, done: float = 0) -> Generator[None]:
        """Shows a bar over `total`; the first Ctrl-C or SIGTERM only asks to stop.

        Without a terminal it prints a line from time to time.
        """
        self._task = self._bar.add_task(TRAINING, total=total)  # until `show`
        self._bar.update(self._task, completed=done)
        signals = (signal.SIGINT, signal.SIGTERM)
        before = {number: signal.signal(number, self._stop) for number in signals}
        try:
            with self._bar:
                yield
        finally:
            for number, handler in before.items():
                if handler is not None:  # not one of another language's
                    signal.signal(number, handler)

    def _stop(self, number: int, _: object) -> None:
        self._asked = True
        signal.signal(number, signal.default_int_handler)
        print("stopping after this update (again: at once)", file=sys.stderr)

    @property
    def seconds(self) -> float:
        """Since the start."""
        return self._clock() - self._started

    @property
    def stopping(self) -> bool:
        """Whether the time limit is reached or the user asked to stop."""
        limit = self._config.time_limit * 60
        return self._asked or 0 < limit <= self.seconds

    @property
    def checkpoint_is_due(self) -> bool:
        """Whether the last checkpoint is `checkpoint_minutes` old."""
        age = self._clock() - self._saved
        return age > self._config.checkpoint_minutes * 60

    def saved(self) -> None:
        """Records that a checkpoint was just written."""
        self._saved = self._clock()

    def show(self, done: float, text: str) -> None:
        """Moves the bar to `done` and sets the text (rich markup) beside it."""
        if self._compiles:  # the time left does not count it
            self._bar.reset(self._task)
            self._compiles = False
        self._bar.update(self._task, completed=done, description=text)
        now = self._clock()
        if self._bar.console.is_terminal or now - self._printed <= LINE_SECONDS:
            return
        self._printed = now
        left = self._bar.tasks[0].time_remaining
        if left:
            text = f"{text}  {left / 60:.1f} min left"
        self._bar.console.print(text, soft_wrap=True, highlight=False)


class MetricsLog:
    """One row per update in `metrics.csv` and the run's loggers.

    A resume removes the rows after the checkpoint: no update appears twice.
    """

    def __init__(self, folder: Path, resume_update: float, config: RunConfig) -> None:
        """Opens the log and loggers of a run that stands at `resume_update` updates."""
        self._path = folder / "metrics.csv"
        read = _read_rows(folder)
        rows = [row.cells for row in read if row.number("update") <= resume_update]
        self._columns = list(rows[0]) if rows else []
        write_csv(self._path, rows)
        self._step = int(float(rows[-1]["env_steps"])) if rows else 0
        settings = dict(list_settings(config))
        self._loggers = open_loggers(config.logger, folder, self._step, settings)
        self._file = self._path.open("a", newline="")

    def write(self, row: dict[str, float]) -> None:
        """Adds the row of an update; the first row fixes the columns."""
        writer = csv.DictWriter(self._file, self._columns or list(row))
        if not self._columns:
            self._columns = list(row)
            writer.writeheader()
        with naming(self._path):
            writer.writerow(row)
            self._file.flush()
        self._step = int(row["env_steps"])
        others = {k: x for k, x in row.items() if k not in ("update", "env_steps")}
        values = {name: x for name, x in others.items() if math.isfinite(x)}
        for logger in self._loggers:
            logger.write(self._step, values)

    def video(self, path: Path) -> None:
        """Gives the loggers the run's video."""
        for logger in self._loggers:
            logger.video(self._step, path)

    def close(self) -> None:
        """Flushes and closes all."""
        with naming(self._path):
            self._file.close()
        for logger in self._loggers:
            logger.close()


def _read_rows(folder: Path) -> list[CsvRow]:
    """Rows of `metrics.csv`, less a line that a kill left half-written."""
    path = folder / "metrics.csv"
    if not path.exists():
        return []
    rows = read_csv(path, "update", "env_steps", growing=True)
    for row in rows:
        for name in row.cells:
            row.number(name)
    return rows


def read_metrics(folder: Path) -> list[dict[str, float]]:
    """Rows of a run's `metrics.csv` as numbers."""
    rows = _read_rows(folder)
    return [{name: row.number(name) for name in row.cells} for row in rows]


def two_panels(
    folder: Path, title: str, xlabel: str
) -> contextlib.AbstractContextManager[list[Any]]:
    """Gives the axes of a tall and a low panel to draw in, then writes the picture."""
    rows: dict[str, Any] = {"nrows": 2, "sharex": True, "height_ratios": (3, 2)}
    return drawn_axes(folder / NAME, (8, 6), title, xlabel, **rows)


def plot_learning_curve(
    folder: Path,
    outcomes: Sequence[tuple[str, str]] = OUTCOMES,
    returns: str = "episode_return",
    unit: tuple[str, float] = ("agent steps [million]", 1e6),
    window: int = 21,
    switches: Sequence[float] = (),
) -> Path:
    """Draws outcome rates and return over the steps to `learning_curve.png`.

    Args:
        folder: of the run.
        outcomes: columns under `episode/` with rates, and their colours.
        returns: the column with the return.
        unit: name and size of the unit of steps.
        window: rows of the moving average.
        switches: steps at which a phase of the training ended.
    """
    rows = [row for row in read_metrics(folder) if row["episodes"] > 0]
    label, size = unit
    steps = np.array([row["env_steps"] for row in rows]) / size
    episodes = np.array([row["episodes"] for row in rows])
    title = f"{folder.name}: training episodes (stochastic policy)"
    with two_panels(folder, title, label) as (tall, low):
        curves = [(tall, *outcome) for outcome in outcomes]
        for axes, name, colour in (*curves, (low, returns, "tab:blue")):
            values = np.array([row[f"episode/{name}"] for row in rows])
            mean = smooth(values, episodes, window)
            axes.plot(steps, values, color=colour, alpha=0.2, linewidth=0.8)
            axes.plot(steps, mean, color=colour, label=name.replace("_", " "))
        dashed = {"color": "black", "linestyle": "--", "linewidth": 0.8}
        for axes, switch in itertools.product((tall, low), switches):
            axes.axvline(switch / size, **dashed)
        tall.set(ylabel="share of episodes", ylim=(0, 1))
        tall.legend(loc="center right")
        low.set(ylabel="return")
    return folder / NAME


def smooth(values: np.ndarray, weights: np.ndarray, window: int = 21) -> np.ndarray:
    """Centred moving average, weighted; narrower at the ends."""
    if not len(values):  # a run so short that no episode ended
        return values
    kernel = np.ones(min(window, len(values)))
    total = np.convolve(values * weights, kernel, mode="same")
    return total / np.maximum(np.convolve(weights, kernel, mode="same"), 1e-9)
