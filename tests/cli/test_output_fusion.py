"""Scripts make XLA fuse loops with several outputs, unless the user sets flags."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from carpark_mj.cli.common import OUTPUT_FUSION
from carpark_mj.config import SimConfig
from carpark_mj.physics.contact import ContactPhysics
from carpark_mj.physics.mjx import MjxPhysics

ROOT = Path(__file__).parents[2]
# What a script leaves behind: the flags, and a program compiled under them.
AFTER = """
import contextlib, os, runpy, sys
script = sys.argv[1]
sys.argv, sys.path[0] = [script, "--help"], os.path.dirname(script)
with contextlib.suppress(SystemExit), contextlib.redirect_stdout(sys.stderr):
    runpy.run_path(script, run_name="__main__")
import jax, jax.numpy as jnp
twice = jax.jit(lambda x: (jnp.exp(x) + x, jnp.exp(x) - x))
fused = "(f32[9]{0}, f32[9]{0}) fusion(" in twice.lower(jnp.ones(9)).compile().as_text()
print(fused, os.environ.get("XLA_FLAGS"))
"""


def run(script: str, flags: str | None) -> str:
    """What `AFTER` prints of a script, started with `XLA_FLAGS` or without."""
    environment = {k: v for k, v in os.environ.items() if k != "XLA_FLAGS"}
    environment["PYTHONPATH"] = str(ROOT)
    if flags is not None:
        environment["XLA_FLAGS"] = flags
    done = subprocess.run(
        [sys.executable, "-c", AFTER, str(ROOT / script)],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.strip()


@pytest.mark.parametrize(
    "script",
    [
        *("train/ppo.py", "train/q_learning.py"),
        *("eval/evaluate.py", "eval/render.py"),
    ],
)
def test_a_script_fuses_outputs_from_the_first_program_on(script):
    assert run(script, None) == f"True {OUTPUT_FUSION}"


# What trains by default, what draws numbers of cars and lots anew, what moves parked
# cars: XLA aborts where it fuses scatters that share their indices. Bicycles compile
# in less time than MJX, which has no scatters either; the first has it. Scatters of one
# agent are of a kind of their own.
CONFIGS = {
    "cpu": "PRESETS['cpu']",
    "mixture": "PPOConfig(curriculum=CurriculumConfig(reverse_ratio=0.3, "
    "target_rate=0.9), env=EnvConfig(layout='street,angled', num_parked_cars=15, "
    "physics='bicycle', min_agents=1, occupancy=(0.2, 0.8)))",
    "dynamic": "insert(PRESETS['dynamic'], "
    "{'env.physics': 'bicycle', 'env.num_agents': 1})",
}


@pytest.mark.parametrize("name", CONFIGS)
def test_training_compiles_with_fused_outputs(name: str):
    program = (
        "import jax; from carpark_mj.config import EnvConfig; "
        "from carpark_mj.training.ppo.config import CurriculumConfig, PPOConfig; "
        "from carpark_mj.config import insert; "
        "from carpark_mj.training.ppo.learner import Learner; "
        "from carpark_mj.training.ppo.parts import PRESETS; "
        f"learner = Learner({CONFIGS[name]}); "
        "learner.compile().lower(learner.shapes()).compile()"
    )
    environment = os.environ | {
        "XLA_FLAGS": f"--xla_backend_optimization_level=0 {OUTPUT_FUSION}",
        "PYTHONPATH": str(ROOT),
    }
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[:2000]


def test_mjx_is_refused_where_xla_would_abort(monkeypatch):
    monkeypatch.setenv("XLA_FLAGS", OUTPUT_FUSION)
    assert MjxPhysics(SimConfig())  # the unrolled step
    for sim in (SimConfig(stepper="mjx"), SimConfig(sim_dt=0.004, tyres="contact")):
        kind = MjxPhysics if sim.tyres == "brush" else ContactPhysics
        with pytest.raises(ValueError, match="set the environment variable XLA_FLAGS"):
            kind(sim)


@pytest.mark.parametrize("flags", ["", "--xla_cpu_enable_fast_math=false"])
def test_flags_of_the_user_are_kept(flags):
    assert run("eval/evaluate.py", flags) == f"False {flags}".strip()
