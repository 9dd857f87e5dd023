"""A command that is silent shows a clock on a terminal, which leaves no trace."""

import os
import pty
import subprocess
import sys

PROGRAM = """
import sys, time
from carpark_mj.cli.clock import doing, wait_for_user
from carpark_mj.cli.process import enter

def main():
    time.sleep(1.5)
    print("first")
    doing("thinking")
    time.sleep(1.5)
    wait_for_user()
    time.sleep(1.0)
    print("last")

sys.modules["program"] = sys.modules["__main__"]
enter("program", "program:main")
"""


def shown(terminal):
    """What a terminal shows of the program, or what a pipe gets."""
    if not terminal:
        return subprocess.run(
            [sys.executable, "-c", PROGRAM], stdout=-1, stderr=-2, text=True, check=True
        ).stdout
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM],
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
        env={**os.environ, "TERM": "xterm"},
    )
    os.close(theirs)
    data = b""
    try:
        while chunk := os.read(ours, 4096):
            data += chunk
    except OSError:  # Linux says the end so
        pass
    os.close(ours)
    assert process.wait() == 0
    return data.decode()


def on_screen(text):
    """Lines that stand after carriage returns and erased lines."""
    return [
        line.rpartition("\x1b[K")[2] for line in text.replace("\r\n", "\n").split("\n")
    ]


def test_a_silent_command_shows_a_clock():
    text = shown(terminal=True)
    before, _, after = text.partition("first")
    assert "loading" in before
    assert "1 s" in before
    assert "thinking" in after
    assert "working" not in after
    assert on_screen(text) == ["first", "last", ""]


def test_a_pipe_gets_lines_alone():
    assert shown(terminal=False).splitlines() == ["first", "thinking ...", "last"]
