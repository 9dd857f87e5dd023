"""Phases of a training: which kinds of lots, for how many steps or episodes."""

import dataclasses
import re

from carpark_mj.config import LayoutConfig
from carpark_mj.layouts import MixtureConfig, layout_config

_TEXT = re.compile(r"(?P<kinds>[^:]+):(?P<count>-?\d+)(?P<unit>steps|episodes)?")


@dataclasses.dataclass(frozen=True)
class Phase:
    """A stretch of training on one kind of lot, or on several interleaved.

    Exactly one of `steps` and `episodes` is given.

    Attributes:
        kinds: names of layouts; every episode draws one of them.
        steps: transitions of all cars together.
        episodes: that end, of all cars together.
    """

    kinds: tuple[str, ...]
    steps: int = 0
    episodes: int = 0

    def __post_init__(self) -> None:
        if min(self.steps, self.episodes) < 0 or bool(self.steps) == bool(
            self.episodes
        ):
            raise ValueError(
                f"a phase needs steps or episodes, at least 1, not {self.steps} steps "
                f"and {self.episodes} episodes"
            )
        for kind in self.kinds:
            layout_config(kind)

    def __str__(self) -> str:
        return ", ".join(self.kinds)

    def progress(self, steps: int, episodes: int) -> float:
        """Share of the phase, in [0, 1], after some steps and episodes of it."""
        return min(1.0, steps / self.steps if self.steps else episodes / self.episodes)


def read_phase(text: str) -> Phase:
    """Reads `KINDS:COUNT`, `KINDS:COUNTsteps` or `KINDS:COUNTepisodes`.

    Args:
        text: kinds are separated by commas: `slots,slots_diagonal:250episodes`.

    Raises:
        ValueError: another form, an unknown kind, or no steps.
    """
    found = _TEXT.fullmatch(text)
    if not found:
        raise ValueError(
            "a phase is KINDS:STEPS or KINDS:COUNTepisodes, for example "
            f"slots,slots_diagonal:30000, not {text!r}"
        )
    kinds = tuple(kind.strip() for kind in found["kinds"].split(","))
    count = int(found["count"])
    try:
        return Phase(kinds, **{found["unit"] or "steps": count})
    except ValueError as error:
        raise ValueError(f"phase {text!r}: {error}") from None


def mixture(layouts: list[LayoutConfig], weights: list[float]) -> LayoutConfig:
    """One lot, or a random one of several."""
    if len(layouts) == 1:
        return layouts[0]
    return MixtureConfig(tuple(layouts), tuple(weights))
