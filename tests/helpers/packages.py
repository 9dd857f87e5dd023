"""The packages of `examples/extensions`, used as those who install them use them."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ROOT / "examples" / "extensions"
# Three updates of PPO.
TINY = (
    *("--preset", "cpu", "--num-lots", "4", "--num-minibatches", "2"),
    *("--unroll-length", "4", "--num-steps", "96"),
    *("--networks.policy-layers", "16", "--networks.value-layers", "16"),
    *("--eval-episodes", "0", "--video-seconds", "0"),
    *("--env.num-parked-cars", "2"),
)


def run(*arguments, extensions, found=None):
    """Runs the command `carpark_mj`.

    Args:
        *arguments: of the command.
        extensions: packages that are named as extensions.
        found: packages that can be imported, if others.
    """
    folders = [PACKAGES / name for name in found or extensions]
    given = {
        "PYTHONPATH": os.pathsep.join(map(str, [ROOT, *folders])),
        "CARPARK_MJ_EXTENSIONS": ",".join(extensions),
        "COLUMNS": "200",
    }
    return subprocess.run(
        [sys.executable, "-m", "carpark_mj", *arguments],
        cwd=ROOT,
        env=os.environ | given,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )


def train(*arguments, extensions, runs):
    """The folder of a run of `TINY` size in the folder `runs`."""
    flags = (*arguments, "--runs-dir", str(runs), "--name", "tiny")
    done = run("train", *TINY, *flags, extensions=extensions)
    assert done.returncode == 0, done.stderr
    return runs / "tiny"
