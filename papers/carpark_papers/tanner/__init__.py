"""Tanner 2022 (arXiv 2206.13338): agents on a grid around a square."""

from carpark_mj.extensions import Entry
from carpark_mj.policy.runs import ALGORITHMS
from carpark_mj.training.ppo.parts import PRESETS, VARIANTS
from carpark_papers.tanner import environments, grid, indices, observation

__all__ = ["environments", "grid", "indices", "observation"]


ALGORITHMS.register(
    "q_learning", Entry("carpark_papers.tanner.q_learning.tables:TABLES")
)
_PRESETS = "carpark_papers.tanner.presets"
for _name, _summary in {
    "fixed": "GPU",
    "dynamic": "GPU",
    "fixed-original": "GPU, hyperparameters of the study",
    "dynamic-original": "GPU, hyperparameters of the study",
}.items():
    PRESETS.register(
        f"tanner-{_name}",
        Entry(f"{_PRESETS}:{_name.upper().replace('-', '_')}", _summary),
    )
VARIANTS.register(
    "ml-agents",
    Entry("carpark_papers.tanner.ml_agents:ML_AGENTS", "PPO of ML-Agents 0.27"),
)
