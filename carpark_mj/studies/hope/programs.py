"""Presets and programs of the study, by name."""

from carpark_mj.extensions import Entry
from carpark_mj.training.ppo.parts import PRESET_ENTRIES

PRESET_ENTRIES.register("hope", Entry("carpark_mj.studies.hope.presets:HOPE"))
