"""A command that is silent shows a clock on a terminal, which leaves no trace."""

import os
import pty
import re
import subprocess
import sys

import pytest

from carpark_mj.cli.clock import Clock, doing

PROGRAM = """
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
    command = [sys.executable, "-c", PROGRAM]
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


def test_without_a_clock_what_is_done_is_printed(monkeypatch, capsys):
    monkeypatch.setattr(os, "isatty", lambda descriptor: True)
    doing("thinking")
    assert capsys.readouterr().out == "thinking ...\n"
