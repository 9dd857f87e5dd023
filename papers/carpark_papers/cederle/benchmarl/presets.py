"""Settings of BenchMARL's algorithms by name."""

import dataclasses
from typing import Any

from carpark_papers.cederle.benchmarl.config import ON_POLICY, BenchMARLConfig
from carpark_papers.cederle.training.config import Algorithm

# Starts vary more than in evaluations, and who waits has the time to get through. Held
# for 0.5 s, random actions brake for long enough to find out that waiting pays.
PPO: dict[str, Any] = {
    "max_steps": 150,
    "jitter": 3.0,
    "repeat": 5,
    "num_junctions": 256,
    "discount": 0.995,
}
# An update every few steps, as many transitions of the buffer as there are new ones.
OFF_POLICY: dict[str, Any] = {
    "end": "any",
    "num_junctions": 64,
    "unroll": 8,
    "updates": 8,
    "batch_size": 256,
    "learning_rate": 5e-4,
    "total_steps": 500_000,
}
MADDPG: dict[str, Any] = {"action": "scalar", "shared": False}

# Cederle 2023, section 5.3 and table 5.2, and, where the text is silent, its program.
# Evaluations vary the starts, or all of their episodes would be the same.
STUDY: dict[str, Any] = {
    "preset": "cederle",
    "end": "any",
    "jitter": 0.0,
    "num_junctions": 1,
    "updates": 1,
    "random_steps": 0,
    "total_steps": 500_000,
    "eval_period": 5000,
    "eval_episodes": 20,
}
STUDY_MADDPG: dict[str, Any] = {
    "unroll": 100,
    "batch_size": 1024,
    "buffer_size": 1_000_000,
    "learning_rate": 1e-4,
    "critic_learning_rate": 1e-3,
    "discount": 0.95,
    "tau": 0.01,
    "epsilon_end": 1.0,
    "hidden": (64, 64),
}
# As its program: whole episodes are learnt from, once per episode.
STUDY_MIXING: dict[str, Any] = {
    "unroll": 75,
    "batch_size": 32 * 75,
    "buffer_size": 5000 * 75,
    "learning_rate": 5e-4,
    "tau": 0.005,
    "epsilon_steps": 50_000,
    "hidden": (64,),
    "recurrent": 64,
}

BENCHMARL_SUMMARIES = {
    "parallel": "many junctions at once, small networks",
    "cederle": "settings of Cederle 2023: one junction (not of ippo, mappo)",
}


def benchmarl_presets(algorithm: Algorithm) -> dict[str, BenchMARLConfig]:
    """Presets of an algorithm."""
    if algorithm in ON_POLICY:
        return {"parallel": BenchMARLConfig(algorithm=algorithm, **PPO)}
    own = MADDPG if algorithm == "maddpg" else {}
    study = STUDY_MADDPG if algorithm == "maddpg" else STUDY_MIXING
    base = BenchMARLConfig(algorithm=algorithm, **(OFF_POLICY | own))
    return {
        "parallel": base,
        "cederle": dataclasses.replace(base, **(STUDY | study)),
    }
