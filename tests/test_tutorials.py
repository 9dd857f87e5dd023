"""The tutorials run: files, commands and snippets, with the output that they show."""

import contextlib
import dataclasses
import io
import os
import re
import shlex

import pytest
from helpers import learning
from helpers.pages import ROOT
from helpers.programs import exit_code, python
from helpers.registering import restore_after

from carpark_mj.config import REWARD_TERMS
from carpark_mj.rendering.gl import choose_gl

# A block of code: its language, the name of the file that it is, its text.
BLOCK = re.compile(r'^```(\w+)(?: title="(\S+)")?\n(.*?)^```', re.MULTILINE | re.DOTALL)
NUMBER = re.compile(r"[-+]?\d[\d.,]*(?:e[-+]?\d+)?")
QUICK, TRAINS = "first_drive", "train_and_evaluate"
TUTORIALS = [
    pytest.param(path, id=path.stem, marks=[pytest.mark.slow] * (path.stem != QUICK))
    for path in sorted((ROOT / "docs" / "tutorials").glob("*.md"))
]
TINY = dataclasses.replace(learning.SMALL, num_steps=64)
# Flags that come last and make a command small; what else a snippet does less of.
BICYCLE = "--physics bicycle"
SMALL = {
    "train": "--num-steps 384 --num-lots 4 --unroll-length 4 --num-minibatches 2 "
    "--eval-episodes 4 --env.physics bicycle --env.num-agents 1 "
    "--env.num-parked-cars 2 --curriculum.neighbour-share 0",
    "evaluate": f"--episodes 8 --num-lots 2 {BICYCLE}",
    "render": f"--width 160 --height 120 {BICYCLE}",
}
LESS = (
    ('PRESETS["cpu"]', "TINY"),
    ("episodes=1024", "episodes=4"),
    ('"drive.mp4"', '"drive.mp4", seconds=1.0, width=160, height=120'),
    ('render_mode="rgb_array"', 'render_mode="rgb_array", physics="bicycle"'),
    ("num_agents=1,", 'num_agents=1, physics="bicycle",'),
    ("agents=4", 'agents=2, parked_cars=2, physics="bicycle"'),
    (", 64)", ", 2)"),
    (", 100)", ", 10)"),
)
WAITS = ("play", "edit", "web")  # words of commands that wait for somebody


def small(line):
    """The words of a command, with fewer lots and steps."""
    words = [word for word in shlex.split(line) if "=" not in word.split("-")[0]]
    if words[0] != "carpark_mj":
        return words
    flags = shlex.split(SMALL.get(words[1], ""))
    if "--preset" in words:  # of a GPU
        at = words.index("--preset")
        del words[at : at + 2]
    if words[1] == "render" and "--frame" not in words:
        flags += ["--seconds", "1"]
    return [*words, *flags]


def run_line(line):
    program, *words = small(line.partition("#")[0])
    if program == "python":
        ended = python(ROOT / words[0], *words[1:])
        assert ended.returncode == 0, ended.stderr
        print(ended.stdout)
    elif not {*WAITS} & {*words}:
        assert program == "carpark_mj", line
        assert exit_code(words[0], words[1:]) == 0, line


def shape(line):
    """A line without its numbers and the widths of its columns."""
    return " ".join(NUMBER.sub("#", line).split())


@pytest.mark.filterwarnings("ignore")  # of libraries
@pytest.mark.parametrize("path", TUTORIALS)
def test_a_tutorial_runs_and_prints_what_it_shows(path, tmp_path, monkeypatch):
    text = path.read_text()
    needs = {"onnx": "carpark_formats", "parallel_env": "pettingzoo", "PIL": "PIL"}
    for word, package in needs.items():
        if word in text:
            pytest.importorskip(package)
    if "carpark_mj render" in text or "render_mode" in text:
        assert choose_gl() is None, "this machine cannot render"
    if path.stem != TRAINS:  # the others' trainings are read, as a training is slow
        home = "carpark_mj.training.ppo.train.train_runs"
        monkeypatch.setattr(home, lambda configs: [])
    restore_after(monkeypatch, REWARD_TERMS)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(os.environ, "COLUMNS", "120")
    printed = ""
    for language, name, block in BLOCK.findall(text):
        if name:
            (tmp_path / name).write_text(block)
        elif language == "text":
            lines = {*map(shape, printed.splitlines())}
            shown = [shape(line) for line in block.splitlines() if line != "…"]
            missing = [line for line in shown if line not in lines]
            assert not missing, f"{missing} are not in\n{printed}"
        else:
            with contextlib.redirect_stdout(io.StringIO()) as out:
                if language == "bash":
                    for line in block.splitlines():
                        run_line(line)
                else:
                    for old, new in LESS:
                        block = block.replace(old, new)
                    exec(block, {"TINY": TINY})
            printed = out.getvalue()
