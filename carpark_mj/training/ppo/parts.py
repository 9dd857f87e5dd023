"""Presets and variants of PPO by name: ours and those of extensions.

They are imported when they are used.
"""

from collections.abc import Iterator, Mapping
from typing import Any

from carpark_mj.extensions import Entry, Registry

PRESET_ENTRIES: Registry[Entry] = Registry("preset")
VARIANTS: Registry[Entry] = Registry("variant")
_OURS = "carpark_mj.training.ppo"

_NAMES = ("cpu", "gpu", "square", "dynamic", "anywhere", "considerate", "sees")
for _name in _NAMES:
    PRESET_ENTRIES.register(_name, Entry(f"{_OURS}.presets:{_name.upper()}"))
VARIANTS.register("brax", Entry(f"{_OURS}.variants:BRAX", "as Brax has it"))


class _Presets(Mapping[str, Any]):
    """The presets themselves, each a `PPOConfig`."""

    def __getitem__(self, name: str) -> Any:
        return PRESET_ENTRIES[name].load()

    def __contains__(self, name: object) -> bool:
        return name in PRESET_ENTRIES

    def __iter__(self) -> Iterator[str]:
        return iter(PRESET_ENTRIES)

    def __len__(self) -> int:
        return len(PRESET_ENTRIES)


PRESETS: Mapping[str, Any] = _Presets()


def summaries() -> dict[str, str]:
    """What each preset is for, in a line."""
    return {name: _summary(name, config) for name, config in PRESETS.items()}


def _summary(name: str, config: Any) -> str:
    given = PRESET_ENTRIES[name].summary or ("CPU" if name == "cpu" else "GPU")
    length = f"{config.num_steps / 1e6:g} M steps"
    return f"{given}, {length}" + (
        f" or {config.minutes:g} min" if config.minutes else ""
    )
