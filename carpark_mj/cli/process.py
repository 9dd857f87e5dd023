"""The process of a command: Ctrl-C, what it prints, errors that the user can fix.

Only the standard library is imported at first: Ctrl-C is handled from the start.
"""

import contextlib
import errno
import gc
import io
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Generator
from types import FrameType
from typing import Any, NoReturn, cast

from carpark_mj.cli.clock import CLOCK, LOADING
from carpark_mj.compilation import EXTRA_OPTIONS, ONE_LOT, SHARE_LOOPS, SHARED_LOOPS
from carpark_mj.extensions import Entry, missing_extra
from carpark_mj.rendering.gl import check_gl

INTERRUPTED = 130  # exit code of a command stopped by Ctrl-C, as shells have it
PATIENCE = 1.5  # s in which an interrupted command ends by itself
USER_ERRORS = (ValueError, OSError, OverflowError, MemoryError)
_EXHAUSTED = "RESOURCE_EXHAUSTED"  # in errors of XLA
MAX_EPISODES = 1_000_000  # of an evaluation: some kilobytes each are held in memory
MAX_SECONDS = 3600  # of a recording, or an evaluation's horizon, both held in memory
# After so many new objects Python searches for garbage. Imports and tracing make many
# that stay: its own 700 take a fifth of their time.
MANY_OBJECTS = 50_000
OUTPUT_FUSION = f"{EXTRA_OPTIONS}xla_cpu_use_multi_output_fusion,{SHARED_LOOPS}"


def enter(program: str, entry: str, *arguments: Any) -> NoReturn:
    """Runs a command as this process, and ends it.

    Ctrl-C ends it with one line and exit code 130, also in compiled code, unless the
    command has its own handler; a second Ctrl-C always does. An open page or window
    ends with 0. A closed stdout, a full disk or a character that the encoding lacks
    does not stop the work.

    `program` is the name before messages on stderr. The entry, `module:function` of
    these arguments, is imported here; its value is the exit code if it is an int.
    """
    gc.set_threshold(MANY_OBJECTS)
    interrupts, stdout = Interrupts(program), _keep_printing("stdout", 1)
    _keep_printing("stderr", 2)
    CLOCK.start(LOADING)
    if CLOCK.runs:  # XLA warns of compilations above two minutes, which it shows
        os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")

    def command() -> object:
        check_gl()
        return Entry(entry).load()(*arguments)

    code: Any
    try:
        code = run_command(program, command)
    except SystemExit as end:  # after the help
        code = end.code
    except BaseException as error:
        # JAX wraps an interrupt where it calls back.
        if interrupts.taken or isinstance(error, KeyboardInterrupt):
            interrupts.end()
        raise
    if interrupts.taken:
        interrupts.end()
    CLOCK.set("")
    sys.stdout.flush()
    failed = stdout.error if stdout else None
    if failed is not None and failed.errno != errno.EPIPE and not code:
        print(f"{program}: cannot write to stdout: {failed.strerror}", file=sys.stderr)
        code = 2
    sys.exit(code)


def run_command(program: str, command: Callable[[], object]) -> int:
    """Runs a command, and returns its exit code; any value of it but an int means 0.

    Errors that the user can fix end it with 2 and one line on stderr, which `program`
    begins. A missing package of an extra is one of them.
    """
    try:
        code = command()
    except Exception as error:
        exhausted = isinstance(error, RuntimeError) and _EXHAUSTED in str(error)
        if isinstance(error, USER_ERRORS) or exhausted:
            message = one_line(error)
        elif isinstance(error, ModuleNotFoundError):
            message = missing_extra(error)
        else:
            message = _missing_device()
        if message is None:
            raise
        print(f"{program}: {message}", file=sys.stderr)
        return 2
    return code if isinstance(code, int) else 0


def one_line(error: BaseException) -> str:
    """An error as one line that names the file or the value."""
    if isinstance(error, OSError) and error.filename and error.strerror:
        return f"cannot use {error.filename}: {error.strerror}"
    if isinstance(error, OverflowError):
        return f"a number is too large: {error}"
    if isinstance(error, MemoryError) or _EXHAUSTED in str(error):
        reason = str(error).partition("\n")[0] or "allocation failed"
        return f"not enough memory, choose smaller sizes: {reason}"
    return " ".join(str(error).split())


def _missing_device() -> str | None:
    """Message if JAX lacks a device asked for; it fails in many ways then."""
    names = ("JAX_PLATFORMS", "JAX_NUM_CPU_DEVICES")
    asked = [f"{name}={os.environ[name]}" for name in names if os.environ.get(name)]
    jax = sys.modules.get("jax")
    if not asked or jax is None:
        return None
    try:
        jax.devices()
    except Exception as error:
        reason = str(error).partition("\n")[0] or "there is none"
        return f"JAX finds no device with {', '.join(asked)}: {reason}"
    return None


class _Output(io.FileIO):
    """A descriptor to write to; nothing after its first failure, `error`."""

    error: OSError | None = None

    def write(self, data: Any, /) -> int:
        """Writes, or drops what cannot be written."""
        CLOCK.printed()
        if self.error is None:
            try:
                return super().write(data)
            except OSError as error:
                self.error = error
        return len(data)


def _keep_printing(name: str, descriptor: int) -> _Output | None:
    """Makes a stream never raise: a failed print must not lose the work behind it."""
    old: Any = getattr(sys, name)
    if old is None:  # it was closed: let no file take its number
        setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115
        return None
    if old is not getattr(sys, f"__{name}__"):
        return None
    raw = _Output(descriptor, "w", closefd=False)
    text = io.TextIOWrapper(
        cast(Any, raw) if old.write_through else io.BufferedWriter(raw),
        encoding=old.encoding,
        errors="replace",
        line_buffering=old.line_buffering,
        write_through=old.write_through,
    )
    setattr(sys, name, text)
    return raw


class Interrupts:
    """Ctrl-C in a command: `KeyboardInterrupt`, and a guaranteed end.

    The exception waits for compiled code to return, destructors and callbacks swallow
    it, and JAX dies when the interpreter ends beside a running program. A thread
    therefore ends the process if the command does not.

    Attributes:
        taken: whether the exception has been raised.
    """

    def __init__(self, program: str) -> None:
        """Installs the handler, unless the process was told to ignore Ctrl-C."""
        self._program = program
        self.taken = False
        if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
            return
        sys.unraisablehook = self._unraisable
        came, comes = os.pipe()
        os.set_blocking(comes, False)
        threading.Thread(target=self._watch, args=(came,), daemon=True).start()
        signal.signal(signal.SIGINT, self._interrupt)
        signal.set_wakeup_fd(comes, warn_on_full_buffer=False)

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        self.taken = True
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

    def _unraisable(self, unraisable: Any) -> None:
        if issubclass(unraisable.exc_type, KeyboardInterrupt):  # else it is lost
            self.end()
        sys.__unraisablehook__(unraisable)

    def end(self) -> NoReturn:
        """Ends the process with one line, or silently where only a page was open.

        `sys.exit` is not used: the interpreter would destroy running programs.
        """
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            with contextlib.suppress(Exception):
                sys.stdout.flush()
        if CLOCK.idle:
            os._exit(0)
        CLOCK.set("")
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


def enable_output_fusion() -> None:
    """Makes XLA on a CPU share results between loops, unless the user set `XLA_FLAGS`.

    Call it before JAX's first computation, when XLA reads them.
    """
    flags = os.environ.get("XLA_FLAGS", SHARE_LOOPS)
    # Those that `carpark_mj.compilation` has set are not the user's.
    for own in (SHARE_LOOPS, ONE_LOT):
        flags = flags.replace(own, OUTPUT_FUSION)
    os.environ["XLA_FLAGS"] = flags


def dispatch_synchronously() -> None:
    """Makes JAX on a CPU run programs in the thread that calls them.

    A program whose arguments are not ready yet runs in a thread of XLA's pool instead.
    On one core that is the pool's only thread, and a callback (the planner, `scene`
    physics) waits there for ever for arrays above 100 kB, which JAX copies in the pool
    (jax-ml/jax#25861). Call it before JAX's first computation.
    """
    import jax

    jax.config.update("jax_cpu_enable_async_dispatch", False)


def configure_jax() -> None:
    """One CPU device per core, over which trainers shard the lots; fused outputs."""
    import jax

    enable_output_fusion()
    cores = len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count()
    if cores == 1:
        dispatch_synchronously()
    if "JAX_NUM_CPU_DEVICES" not in os.environ:
        jax.config.update("jax_num_cpu_devices", cores or 1)
