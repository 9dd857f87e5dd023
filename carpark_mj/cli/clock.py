"""A running clock on the terminal, so that nobody waits for a command in silence."""

import contextlib
import os
import threading
import time

SILENCE = 0.5  # s without output before the clock shows
PERIOD = 0.25  # s between its moves
# What commands do.
LOADING = "loading JAX and MuJoCo, usually 2 to 10 s"
COMPILING = "compiling, usually 10 to 60 s, fewer once it is kept, then driving"
PLACING = "compiling the start, usually 5 to 30 s, fewer once it is kept"
DRAWING = "drawing lots, usually 1 to 2 min, only the first time"
TRAINING = "compiling, usually 1 to 3 min, less once it is kept"
CLEAR = b"\r\x1b[K"


class Clock:
    """Says on a terminal's stderr what a command does, and for how long.

    A thread draws the line while nothing is printed. There is none where stderr is no
    terminal, or that of another job.
    """

    def __init__(self) -> None:
        """Shows nothing yet."""
        self.runs = False  # the thread
        self.idle = False  # a page or a window is open, which Ctrl-C ends as it should
        self._lock = threading.RLock()  # signal handlers print too
        self._what = ""
        self._drawn = False
        self._since = time.monotonic()

    def start(self, what: str) -> None:
        """Starts to run beside a command that begins with `what`."""
        self.set(what)
        self.runs = os.isatty(2) and os.environ.get("TERM") != "dumb"
        if self.runs:
            threading.Thread(target=self._run, daemon=True).start()

    def set(self, what: str) -> None:
        """From now on the command does `what`; nothing is shown if it is empty."""
        with self._lock:
            self._clear()
            self._what, self._since, self.idle = what, time.monotonic(), False

    def printed(self) -> None:
        """Clears the line: the command is about to print."""
        with self._lock:
            self._clear()
            self._what = self._what and "working"
            self._since = time.monotonic()

    @property
    def line(self) -> str:
        """What is done and for how long; empty if nothing, or only just now."""
        with self._lock:
            seconds = time.monotonic() - self._since
            shown = self._what and seconds > SILENCE
            return f"{self._what} ... {seconds:.0f} s" if shown else ""

    def _run(self) -> None:
        while True:
            time.sleep(PERIOD)
            # The terminal may be gone.
            with self._lock, contextlib.suppress(OSError):
                if (line := self.line) and _in_front():
                    width = os.get_terminal_size(2).columns or 80
                    os.write(2, f"\r{line[: width - 1]}".encode())
                    self._drawn = True

    def _clear(self) -> None:
        if self._drawn:
            self._drawn = False
            with contextlib.suppress(OSError):
                os.write(2, CLEAR)


def _in_front() -> bool:
    """Whether the terminal is not another job's."""
    try:
        return os.tcgetpgrp(2) == os.getpgrp()
    except OSError:  # nobody's: it controls no jobs
        return True


CLOCK = Clock()


def doing(what: str) -> None:
    """Says what the command does from now on: a clock on a terminal, else a line."""
    CLOCK.set(what)
    if not (CLOCK.runs and os.isatty(1)):
        print(f"{what} ...", flush=True)
        CLOCK.set(what)


def wait_for_user() -> None:
    """Shows no clock until the next `doing`: a page or a window is open."""
    CLOCK.set("")
    CLOCK.idle = True
