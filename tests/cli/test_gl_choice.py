"""Scripts that render choose MuJoCo's OpenGL before anything imports MuJoCo."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from carpark_mj.rendering.gl import choose_gl

ROOT = Path(__file__).parents[2]
# Prints the back end that MuJoCo finds when it is first imported.
AT_IMPORT = """
import contextlib, os, runpy, sys

class Watch:
    def find_spec(self, name, path=None, target=None):
        if name == "mujoco":
            print("chosen:", os.environ.get("MUJOCO_GL"), file=sys.stderr)

sys.meta_path.insert(0, Watch())
script = sys.argv[1]
sys.argv, sys.path[0] = [script, "--help"], os.path.dirname(script)
with contextlib.suppress(SystemExit):
    runpy.run_path(script, run_name="__main__")
"""


@pytest.mark.parametrize("script", ["train/ppo.py", "eval/render.py", "eval/suite.py"])
def test_a_script_that_renders_chooses_gl_before_mujoco_is_imported(script: str):
    assert choose_gl() is None, "this machine cannot render"
    environment = {k: v for k, v in os.environ.items() if k != "MUJOCO_GL"}
    done = subprocess.run(
        [sys.executable, "-c", AT_IMPORT, str(ROOT / script)],
        env=environment | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=True,
    )
    chosen = [x for x in done.stderr.splitlines() if x.startswith("chosen:")]
    assert chosen == [f"chosen: {os.environ['MUJOCO_GL']}"]
