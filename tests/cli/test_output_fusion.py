"""Programs that are trained compile where XLA fuses loops with several outputs."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from carpark_mj.cli.process import OUTPUT_FUSION
from carpark_mj.config import SimConfig
from carpark_mj.physics.mjx import MjxPhysics
from carpark_mj.physics.mjx_step import ContactPhysics

ROOT = Path(__file__).parents[2]
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
