"""Progress, checkpoints and stopping between updates, for every training loop."""

import contextlib
import signal
import sys
import time
from collections.abc import Callable, Generator
from typing import Any

from rich import get_console
from rich.progress import (
    BarColumn,
    Progress,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from carpark_mj.training.run_folder import RunConfig

LINE_SECONDS = 20.0  # between lines of progress where there is no terminal


class StopRequest:
    """Turns the first Ctrl-C or SIGTERM into a request to stop after the update."""

    SIGNALS = (signal.SIGINT, signal.SIGTERM)

    def __init__(self) -> None:
        """Installs the handlers."""
        self.requested = False
        self._old: list[tuple[int, Any]] = [
            (number, signal.signal(number, self._handle)) for number in self.SIGNALS
        ]

    def _handle(self, number: int, frame: object) -> None:
        del frame
        self.requested = True
        signal.signal(number, signal.default_int_handler)
        print("stopping after this update (again: at once)", file=sys.stderr)

    def close(self) -> None:
        """Restores the previous handlers."""
        for number, handler in self._old:
            if handler is not None:  # not one of another language's
                signal.signal(number, handler)


class Loop:
    """Progress, checkpoint times, time limit and Ctrl-C of a training."""

    def __init__(
        self,
        title: str,
        config: RunConfig,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Starts the clocks.

        Args:
            title: of the bar.
            config: `time_limit` and `checkpoint_minutes` count.
            clock: gives the time [s].
        """
        self._config = config
        self._clock = clock
        self._started = self._saved = self._printed = clock()
        console = get_console()
        self._bar = Progress(
            TextColumn(f"[bold]{title}"),
            BarColumn(bar_width=24),
            TaskProgressColumn(),
            TextColumn("{task.description}"),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            console=console,
            # A bar redirects what is printed. In a notebook, showing a line flushes
            # that, and so itself, for ever once a callback has printed part of a line.
            disable=console.is_jupyter,
        )

    @contextlib.contextmanager
    def over(self, total: float, done: float = 0) -> Generator[None]:
        """Shows a bar over `total` and turns Ctrl-C into a request to stop.

        Without a terminal it prints a line from time to time.
        """
        self._stop = StopRequest()
        self._task = self._bar.add_task("", total=total)
        self._bar.update(self._task, completed=done)
        try:
            with self._bar:
                yield
        finally:
            self._stop.close()

    @property
    def seconds(self) -> float:
        """Since the start."""
        return self._clock() - self._started

    @property
    def stopping(self) -> bool:
        """Whether the time limit is reached or the user asked to stop."""
        limit = self._config.time_limit * 60
        return self._stop.requested or 0 < limit <= self.seconds

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
        self._bar.update(self._task, completed=done, description=text)
        now = self._clock()
        if self._bar.console.is_terminal or now - self._printed <= LINE_SECONDS:
            return
        self._printed = now
        left = self._bar.tasks[0].time_remaining
        if left:
            text = f"{text}  {left / 60:.1f} min left"
        self.say(text)

    def say(self, text: str) -> None:
        """Prints a line (rich markup) above the bar."""
        self._bar.console.print(text, soft_wrap=True, highlight=False)
