"""Verdicts of several seeds on a yes-or-no question."""

from collections.abc import Sequence

ENOUGH = 5  # seeds for a verdict
CLEAR = 0.8  # share of seeds, or its complement, that is called always, or never


def always(rates: Sequence[float]) -> bool | None:
    """Whether it happens always (True) or never (False); None = neither."""
    rate = sum(rates) / len(rates)
    if rate >= CLEAR:
        return True
    return False if 1.0 - rate >= CLEAR else None
