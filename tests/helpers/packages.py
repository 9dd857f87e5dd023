"""The packages of `examples/extensions`, used as those who install them use them."""

import os

from helpers.programs import ROOT, python

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
    return python("-m", "carpark_mj", *arguments, cwd=ROOT, **given)


def train(*arguments, extensions, runs):
    """The folder of a run of `TINY` size in the folder `runs`."""
    flags = (*arguments, "--runs-dir", str(runs), "--name", "tiny")
    done = run("train", *TINY, *flags, extensions=extensions)
    assert done.returncode == 0, done.stderr
    return runs / "tiny"
