"""Presets and variants of PPO by name: ours and those of extensions.

They are imported when they are used.
"""

from typing import Any

from carpark_mj.extensions import Entry, Registry

BRAX = "brax"  # the variant of the presets
PRESETS: Registry[Any] = Registry("preset")  # of `PPOConfig`s
VARIANTS: Registry[Any] = Registry("variant")

for _name in ("cpu", "gpu", "square", "dynamic", "anywhere", "considerate", "sees"):
    _home = f"carpark_mj.training.ppo.presets:{_name.upper()}"
    PRESETS.register(_name, Entry(_home, "CPU" if _name == "cpu" else "GPU"))
VARIANTS.register(BRAX, Entry("carpark_mj.training.ppo.variants:BRAX"))


def summaries() -> dict[str, str]:
    """What each preset is for, in a line."""
    lines: dict[str, str] = {}
    for name in PRESETS:  # imports the extensions
        config, summary = PRESETS[name], PRESETS.summaries[name]
        minutes = f" or {config.minutes:g} min" if config.minutes else ""
        steps = f"{config.num_steps / 1e6:g} M steps{minutes}"
        lines[name] = f"{summary or 'GPU'}, {steps}"
    return lines
