"""The example with torch runs from end to end."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

from carpark_mj.wrappers.batch import Step

EXAMPLES = Path(__file__).parents[1] / "examples"


def test_ppo_in_one_file_trains_and_evaluates(tmp_path):
    pytest.importorskip("torch")
    flags = ("--minutes", "0.05", "--lots", "8", "--minibatches", "4")
    ended = subprocess.run(
        [sys.executable, EXAMPLES / "cleanrl_ppo.py", *flags],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    assert re.search(r"held out: [\d.]+% of 1024 episodes parked", ended.stdout)


def test_examples_read_fields_that_steps_have():
    """Also where torch is not installed."""
    tree = ast.parse((EXAMPLES / "cleanrl_ppo.py").read_text())
    read = {
        node.attr
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute)
        and isinstance(node.value, ast.Name)
        and node.value.id == "step"
    }
    assert "observation" in read
    assert read <= set(Step._fields)
