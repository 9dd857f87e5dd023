"""Training from Python, and what trainers share.

    from carpark_mj.training import PPOConfig, evaluate, render, train

    run = train(PPOConfig(num_steps=1_000_000), callback=lambda metrics: None)
    print(evaluate(run).summary["parked"])
    render(run, "drive.mp4")

The names load on first use, so that registering presets costs no import.
"""

import importlib
from typing import TYPE_CHECKING, Any

from carpark_mj.rendering.gl import choose_gl

choose_gl()  # before MuJoCo is imported, for `render`

if TYPE_CHECKING:
    from carpark_mj.training.ppo.config import PPOConfig
    from carpark_mj.training.ppo.parts import PRESETS
    from carpark_mj.training.run import Run, evaluate, render, train

_HOMES = {
    "PPOConfig": "carpark_mj.training.ppo.config",
    "PRESETS": "carpark_mj.training.ppo.parts",
    "Run": "carpark_mj.training.run",
    "evaluate": "carpark_mj.training.run",
    "render": "carpark_mj.training.run",
    "train": "carpark_mj.training.run",
}

__all__ = ["PRESETS", "PPOConfig", "Run", "evaluate", "render", "train"]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'carpark_mj.training' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), name)
