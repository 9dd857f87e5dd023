"""The process of a command: Ctrl-C, what it prints, the environment it finds.

It imports the standard library only, so that Ctrl-C is handled from the start.
"""

import contextlib
import errno
import functools
import importlib
import io
import os
import signal
import sys
import threading
import time
from collections.abc import Generator
from types import FrameType, TracebackType
from typing import Any, NoReturn, cast

from carpark_mj.cli.common import run_command
from carpark_mj.rendering.gl import check_gl

INTERRUPTED = 130  # exit code of a command stopped by Ctrl-C, as shells have it
PATIENCE = 1.5  # s in which an interrupted command ends by itself


def enter(program: str, entry: str) -> NoReturn:
    """Runs a command as this process, and ends it.

    Ctrl-C ends it with one line and exit code 130, also in compiled code, unless the
    command has its own handler; a second Ctrl-C always does. A closed stdout, a full
    disk or a character that the encoding lacks does not stop the work.

    Args:
        program: name before messages on stderr.
        entry: `module:function` that is the command, imported here; its value is the
            exit code if it is an int.
    """
    interrupts, printed = prepare(program)

    def command() -> object:
        module, _, function = entry.partition(":")
        return getattr(importlib.import_module(module), function)()

    code: Any
    try:
        code = run_command(program, command)
    except SystemExit as end:  # after the help
        code = end.code
    if interrupts.taken:
        interrupts.end()
    sys.stdout.flush()
    failed = printed.error if printed else None
    if failed is not None and failed.errno != errno.EPIPE and not code:
        print(f"{program}: cannot write to stdout: {failed.strerror}", file=sys.stderr)
        code = 2
    sys.exit(code)


@functools.cache
def prepare(program: str) -> tuple["Interrupts", "_Output | None"]:
    """Prepares this process for a command: the first part of `enter`.

    Raises:
        SystemExit: JAX or MuJoCo cannot be imported in this environment.
    """
    found = Interrupts(program), keep_printing()
    try:
        check_gl()
        check_jax()
    except ValueError as error:
        print(f"{program}: {error}", file=sys.stderr)
        sys.exit(2)
    return found


class _Output(io.FileIO):
    """A descriptor to write to; from the first failure on nothing is written.

    Attributes:
        error: that failure.
    """

    error: OSError | None = None

    def write(self, data: Any, /) -> int:
        """Writes, or drops what cannot be written."""
        if self.error is None:
            try:
                return super().write(data)
            except OSError as error:
                self.error = error
        return len(data)


def keep_printing() -> _Output | None:
    """Makes stdout and stderr never raise; returns stdout's descriptor.

    A failed print must not lose the work behind it. None: stdout does not belong to the
    process any more.
    """
    found: dict[str, _Output] = {}
    for name, descriptor in (("stdout", 1), ("stderr", 2)):
        old: Any = getattr(sys, name)
        if old is None:  # it was closed: let no file take its number
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115
        elif old is getattr(sys, f"__{name}__"):
            raw = found[name] = _Output(descriptor, "w", closefd=False)
            text = io.TextIOWrapper(
                cast(Any, raw) if old.write_through else io.BufferedWriter(raw),
                encoding=old.encoding,
                errors="replace",
                line_buffering=old.line_buffering,
                write_through=old.write_through,
            )
            setattr(sys, name, text)
    return found.get("stdout")


def check_jax() -> None:
    """Refuses a value of `JAX_NUM_CPU_DEVICES` with which JAX fails.

    Raises:
        ValueError: it is not a number of devices.
    """
    count = os.environ.get("JAX_NUM_CPU_DEVICES", "1")
    if not (count.isdecimal() and int(count) >= 1):
        raise ValueError(
            f"JAX_NUM_CPU_DEVICES must be a whole number, at least 1, not {count!r}"
        )


class Interrupts:
    """Ctrl-C in a command: `KeyboardInterrupt`, and a guaranteed end.

    The exception alone is not enough: it waits for compiled code to return, destructors
    and callbacks swallow it, and JAX dies when the interpreter ends beside a running
    program. A thread therefore ends the process if the command does not.

    Attributes:
        taken: whether the exception has been raised.
    """

    def __init__(self, program: str) -> None:
        """Installs the handler, unless the process was told to ignore Ctrl-C."""
        self._program = program
        self._ends = self.taken = False
        if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
            return
        sys.excepthook = self._uncaught
        sys.unraisablehook = self._unraisable
        came, comes = os.pipe()
        os.set_blocking(comes, False)
        threading.Thread(target=self._watch, args=(came,), daemon=True).start()
        signal.signal(signal.SIGINT, self._interrupt)
        signal.set_wakeup_fd(comes, warn_on_full_buffer=False)

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        self.taken = True
        if not self._ends:
            raise KeyboardInterrupt

    def _watch(self, came: int) -> None:
        """Ends the process after one Ctrl-C; after two if the command handles one."""
        count = 0
        while True:
            count += os.read(came, 1)[0] == signal.SIGINT
            handled = signal.getsignal(signal.SIGINT) != self._interrupt
            if count > handled:
                time.sleep(PATIENCE)
                self.end()

    def _uncaught(
        self,
        kind: type[BaseException],
        error: BaseException,
        trace: TracebackType | None,
    ) -> None:
        # Whatever comes of an interrupt: JAX wraps it where it calls back.
        if self.taken or issubclass(kind, KeyboardInterrupt):
            self.end()
        sys.__excepthook__(kind, error, trace)

    def _unraisable(self, unraisable: Any) -> None:
        if issubclass(unraisable.exc_type, KeyboardInterrupt):  # else nobody sees it
            self.end()
        sys.__unraisablehook__(unraisable)

    def end(self) -> NoReturn:
        """Ends the process with one line.

        `sys.exit` is not used: the interpreter would destroy running programs.
        """
        self._ends = True
        if threading.current_thread() is threading.main_thread():
            with contextlib.suppress(Exception):
                sys.stdout.flush()
        # Not `print`, whose lock the main thread may hold.
        os.write(2, f"{self._program}: interrupted\n".encode())
        os._exit(INTERRUPTED)


@contextlib.contextmanager
def patient_interrupts() -> Generator[None]:
    """Inside, a first Ctrl-C is a `KeyboardInterrupt` that leaves time to save."""
    handler = signal.getsignal(signal.SIGINT)
    if handler is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
