"""A command's process: Ctrl-C, stdout that fails, OpenGL, XLA's flags, a clock."""

import json
import os
import pty
import re
import subprocess
import sys

import pytest
from helpers.programs import ROOT, python

from carpark_mj.cli.clock import Clock
from carpark_mj.cli.process import OUTPUT_FUSION
from carpark_mj.compilation import ONE_LOT
from carpark_mj.config import SimConfig
from carpark_mj.physics.mjx import MjxPhysics
from carpark_mj.physics.mjx_step import ContactPhysics
from carpark_mj.rendering.gl import choose_gl

START = """
import ctypes, os, signal, sys, threading, time
from carpark_mj.cli.process import patient_interrupts

def interrupt(after=0.0):
    if not after:
        signal.raise_signal(signal.SIGINT)
    threading.Timer(after, signal.raise_signal, (signal.SIGINT,)).start()

def compile():  # code that returns to Python after a minute
    ctypes.CDLL(None).sleep(60)

def write(text):
    open("file", "w").write(text)

def main():
"""


@pytest.fixture
def run(tmp_path):
    """Runs a command of some lines in a folder of its own, from a shell."""

    def run(body, stdout=-1, handler="default_int_handler", streams="", **environment):
        indented = "".join(f"    {line}\n" for line in body.splitlines())
        (tmp_path / "job.py").write_text(START + indented)
        code = (
            f"import signal; signal.signal(signal.SIGINT, signal.{handler}); "
            "from carpark_mj.cli.process import enter; enter('job', 'job:main')"
        )
        done = subprocess.run(
            ["sh", "-c", f'"$@" {streams}', "sh", sys.executable, "-c", code],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(ROOT), **environment},
            stdout=stdout,
            stderr=subprocess.PIPE,
            text=True,
            timeout=50,
            check=False,
        )
        return done.returncode, done.stderr

    return run


INTERRUPTED = {
    "in Python": "interrupt(0.2)\ntime.sleep(60)",
    "in compiled code": "interrupt(0.2)\ncompile()",
    # As in JAX's callback of the garbage collector: Python prints and goes on.
    "in a destructor": """
class Thing:
    def __del__(self):
        interrupt()

Thing()
compile()""",
    "where everything is caught": """
try:
    interrupt()
except BaseException:
    compile()""",
    "where it becomes another error": """
try:
    interrupt()
except KeyboardInterrupt:
    raise RuntimeError("INTERNAL: a callback failed")""",
    "at the very end": "import atexit\natexit.register(interrupt)",
    "twice, the first being handled": """
signal.signal(signal.SIGINT, lambda *_: None)
interrupt()
interrupt(0.2)
compile()""",
}


@pytest.mark.parametrize("where", INTERRUPTED)
def test_ctrl_c_ends_a_command_with_one_line(where, run):
    assert run(INTERRUPTED[where]) == (130, "job: interrupted\n")


def test_ctrl_c_is_the_good_end_of_an_open_page(run):
    start = "from carpark_mj.cli.clock import doing, wait_for_user\nwait_for_user()\n"
    assert run(f"{start}interrupt(0.2)\ntime.sleep(60)") == (0, "")
    assert run(f"{start}doing('more')\ninterrupt()")[0] == 130


@pytest.mark.parametrize(
    ("block", "seconds"),
    [("if True", 0.0), ("with patient_interrupts()", 2.0)],  # longer than others have
)
def test_ctrl_c_leaves_time_to_clean_up_and_to_save(block, seconds, run, tmp_path):
    body = f"""
{block}:
    try:
        interrupt()
    finally:
        time.sleep({seconds})
        write("done")"""
    assert run(body) == (130, "job: interrupted\n")
    assert (tmp_path / "file").read_text() == "done"


def test_an_ignored_ctrl_c_stays_ignored(run, tmp_path):
    body = "with patient_interrupts():\n    interrupt()\nwrite('done')"
    assert run(body, handler="SIG_IGN") == (0, "")  # as in a shell's background
    assert (tmp_path / "file").read_text() == "done"


PRINT = "for _ in range(9999): print('…')\nwrite('done')\nreturn {code}"


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no device that is full")
@pytest.mark.parametrize(("code", "ends"), [(0, 2), (1, 1)])
def test_a_full_disk_under_stdout_costs_no_work(code, ends, run, tmp_path):
    with open("/dev/full", "w") as full:
        ended, said = run(PRINT.format(code=code), full)
    assert ended == ends
    assert said == (
        "job: cannot write to stdout: No space left on device\n" * (not code)
    )
    assert (tmp_path / "file").read_text() == "done"


@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_a_reader_that_leaves_costs_no_work(unbuffered, run, tmp_path):
    reading, writing = os.pipe()
    os.close(reading)
    assert run(PRINT.format(code=0), writing, PYTHONUNBUFFERED=unbuffered) == (0, "")
    os.close(writing)
    assert (tmp_path / "file").read_text() == "done"


STREAMS = (
    "import sys\nprint('…', flush=True)\nprint('y', file=sys.stderr)\nwrite('done')"
)


@pytest.mark.parametrize("closed", ["", ">&-", "2>&-", ">&- 2>&-", "2>/dev/full"])
def test_streams_that_cannot_be_written_cost_no_work(closed, run, tmp_path):
    # An encoding without one of the characters.
    code, said = run(STREAMS, streams=closed, PYTHONIOENCODING="ascii")
    assert (code, "Traceback" in said) == (0, False)
    assert (tmp_path / "file").read_text() == "done"


COUNT = "JAX_NUM_CPU_DEVICES"


@pytest.mark.parametrize(
    ("name", "value"), [("MUJOCO_GL", "junk"), (COUNT, "x"), (COUNT, "0")]
)
def test_an_environment_that_nothing_can_run_in_is_refused(name, value, run, tmp_path):
    code, said = run("import jax\njax.devices()\nwrite('done')", **{name: value})
    assert code == 2
    assert said.startswith("job: ")
    assert name.lower() in said.lower()
    assert (value in said, said.count("\n")) == (True, 1)
    assert not (tmp_path / "file").exists()


# Runs a script that finds no policy. Says what it has set when MuJoCo is first imported
# and after it, and whether a program compiled then is fused.
SCRIPT = """
import contextlib, json, os, runpy, sys

class Watch:
    gl = None
    def find_spec(self, name, path=None, target=None):
        if name == "mujoco":
            Watch.gl = os.environ.get("MUJOCO_GL", "")

sys.meta_path.insert(0, Watch())
script = sys.argv[1]
sys.argv, sys.path[0] = [script, "./nobody"], os.path.dirname(script)
with contextlib.suppress(SystemExit), contextlib.redirect_stdout(sys.stderr):
    runpy.run_path(script, run_name="__main__")
import jax, jax.numpy as jnp
twice = jax.jit(lambda x: (jnp.exp(x) + x, jnp.exp(x) - x))
text = twice.lower(jnp.ones(9)).compile().as_text()
print(json.dumps({
    "gl": Watch.gl,
    "flags": os.environ.get("XLA_FLAGS"),
    "fused": "(f32[9]{0}, f32[9]{0}) fusion(" in text,
    "asynchronous": jax.config.values["jax_cpu_enable_async_dispatch"],
}))
"""


@pytest.mark.parametrize(
    ("script", "flags"), [("render", ONE_LOT), ("evaluate", OUTPUT_FUSION)]
)
def test_a_script_sets_up_what_it_needs(script, flags):
    assert choose_gl() is None, "this machine cannot render"
    script = ROOT / "eval" / f"{script}.py"
    done = python("-c", SCRIPT, script, XLA_FLAGS=None, MUJOCO_GL=None)
    assert done.returncode == 0, done.stderr
    left = json.loads(done.stdout)
    if flags == ONE_LOT:  # what renders
        assert left["gl"] == os.environ["MUJOCO_GL"]
    assert not left["asynchronous"]
    assert (left["fused"], left["flags"]) == (flags == OUTPUT_FUSION, flags)


# What draws numbers of cars and lots anew among people, what moves parked cars: XLA
# aborts where it fuses scatters that share their indices, or read what others read.
# Bicycles compile in less time than MJX, which has no scatters either. Scatters of one
# agent are of a kind of their own.
CONFIGS = {
    "mixture": "PPOConfig(curriculum=CurriculumConfig(reverse_ratio=0.3, "
    "target_rate=0.9), env=EnvConfig(layout='street,angled', num_parked_cars=15, "
    "physics='bicycle', min_agents=1, occupancy=(0.2, 0.8), "
    "movers=('pedestrians', 'cart')))",
    "dynamic": "insert(PRESETS['dynamic'], "
    "{'env.physics': 'bicycle', 'env.num_agents': 1})",
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CONFIGS)
def test_training_compiles_with_fused_outputs(name):
    program = (
        "import jax; from carpark_mj.config import EnvConfig; "
        "from carpark_mj.training.ppo.config import CurriculumConfig, PPOConfig; "
        "from carpark_mj.config import insert; "
        "from carpark_mj.training.ppo.learner import Learner; "
        "from carpark_mj.training.ppo.parts import PRESETS; "
        f"learner = Learner({CONFIGS[name]}); "
        "learner.compile().lower(learner.shapes()).compile()"
    )
    flags = f"--xla_backend_optimization_level=0 {OUTPUT_FUSION}"
    done = python("-c", program, XLA_FLAGS=flags)
    assert done.returncode == 0, done.stderr[:2000]


def test_mjx_is_refused_where_xla_would_abort(monkeypatch):
    monkeypatch.setenv("XLA_FLAGS", OUTPUT_FUSION)
    assert MjxPhysics(SimConfig())  # the unrolled step
    for sim in (SimConfig(stepper="mjx"), SimConfig(sim_dt=0.004, tyres="contact")):
        kind = MjxPhysics if sim.tyres == "brush" else ContactPhysics
        with pytest.raises(ValueError, match="set the environment variable XLA_FLAGS"):
            kind(sim)


# The clock of a silent command


TALKING = """
import os, sys, time
from carpark_mj.cli import clock
from carpark_mj.cli.clock import doing, wait_for_user
from carpark_mj.cli.process import enter

clock.SILENCE, clock.PERIOD = 1.5, 0.1  # a busy machine may pause for a second

def main():
    time.sleep(3.0)
    print("first")
    time.sleep(0.3)
    print("soon")
    time.sleep(2.0)
    doing("thinking")
    time.sleep(2.0)
    wait_for_user()
    os.write(1, b"|")  # unseen by the clock
    time.sleep(2.0)
    print("last")

sys.modules["program"] = sys.modules["__main__"]
enter("program", "program:main")
"""


@pytest.fixture(scope="module")
def shown():
    """What a terminal shows of the program, and what a pipe gets, at the same time."""
    command = [sys.executable, "-c", TALKING]
    piped = subprocess.Popen(command, stdout=-1, stderr=subprocess.STDOUT, text=True)
    ours, theirs = pty.openpty()
    streams = {"stdin": theirs, "stdout": theirs, "stderr": theirs}
    process = subprocess.Popen(command, **streams, env={**os.environ, "TERM": "xterm"})
    os.close(theirs)
    data = b""
    try:
        while chunk := os.read(ours, 4096):
            data += chunk
    except OSError:  # Linux says the end so
        pass
    os.close(ours)
    lines = piped.communicate()[0].splitlines()
    assert process.wait() == piped.returncode == 0
    return data.decode(), lines


def test_a_silent_command_shows_a_clock_and_a_pipe_gets_lines_alone(shown):
    text, lines_of_pipe = shown
    before, _, after = text.partition("first")
    between, _, after = after.partition("soon")
    pause, _, after = after.partition("thinking")
    waiting, _, after = after.partition("|")
    assert re.search(r"loading .* [23] s", before)
    assert between.strip() == ""  # no clock in a short silence
    counted = [int(x) for x in re.findall(r"working \.\.\. (\d+) s", pause)]
    assert counted
    assert max(counted) < 5  # from what was printed on, not from the start
    assert re.search(r"\.\.\. [23] s", waiting)
    assert after.strip() == "last"  # no clock while the user works
    lines = text.replace("\r\n", "\n").split("\n")
    on_screen = [line.rpartition("\x1b[K")[2] for line in lines]
    assert on_screen == ["first", "soon", "|last", ""]
    assert sorted(lines_of_pipe) == sorted(["first", "soon", "thinking ...", "|last"])


def test_work_goes_on_without_the_terminal(monkeypatch):
    clock = Clock()
    clock.set("working")
    clock._drawn = True

    def hang_up(descriptor, data):
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(os, "write", hang_up)
    clock.printed()
    clock.set("")
