"""What a script sets up before its work: OpenGL, XLA's flags, dispatch, fusion."""

import json
import os

import pytest
from helpers.programs import ROOT, python

from carpark_mj.cli.process import OUTPUT_FUSION
from carpark_mj.config import SimConfig
from carpark_mj.physics.mjx import MjxPhysics
from carpark_mj.physics.mjx_step import ContactPhysics
from carpark_mj.rendering.gl import choose_gl

# Runs a script that finds no policy. Says what it has set when MuJoCo is first imported
# and after it, and whether a program compiled then is fused.
PROGRAM = """
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


def left_behind(script, flags=None):
    """What `PROGRAM` says of a script, started with `XLA_FLAGS` or without."""
    done = python("-c", PROGRAM, ROOT / script, XLA_FLAGS=flags, MUJOCO_GL=None)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_a_script_sets_up_what_it_needs():
    assert choose_gl() is None, "this machine cannot render"
    left = left_behind("eval/render.py")
    assert left["gl"] == os.environ["MUJOCO_GL"]
    assert not left["asynchronous"]
    assert (left["fused"], left["flags"]) == (True, OUTPUT_FUSION)


def test_flags_of_the_user_are_kept():
    left = left_behind("eval/evaluate.py", "--xla_cpu_enable_fast_math=false")
    assert (left["fused"], left["flags"]) == (False, "--xla_cpu_enable_fast_math=false")


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
