"""Which runs of a sweep train side by side, in one program."""

from collections.abc import Hashable, Sequence

from carpark_mj.sweeps.plan import Run, settings_of
from carpark_mj.training.ppo.group import program


def groups(runs: Sequence[Run], size: int) -> list[tuple[Run, ...]]:
    """Runs put together, those that differ in seeds and data only.

    A run that ends after some `minutes` is alone: others beside it would slow it down.

    Args:
        runs: all of them.
        size: most runs of a group.
    """
    alike: dict[Hashable, list[Run]] = {}
    for run in runs:
        config = settings_of(run)
        alone = size == 1 or config.minutes
        alike.setdefault(run.name if alone else program(config), []).append(run)
    return [
        tuple(members[start : start + size])
        for members in alike.values()
        for start in range(0, len(members), size)
    ]
