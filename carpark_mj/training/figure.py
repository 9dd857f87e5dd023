"""The axes of a learning curve."""

import contextlib
from collections.abc import Generator
from pathlib import Path
from typing import Any

from carpark_mj.files import write_atomically

NAME = "learning_curve.png"


@contextlib.contextmanager
def two_panels(folder: Path, title: str, xlabel: str) -> Generator[tuple[Any, Any]]:
    """Gives the axes of a tall and a low panel to draw in, then writes the picture."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (tall, low) = plt.subplots(
        2, 1, figsize=(8, 6), sharex=True, height_ratios=(3, 2), layout="constrained"
    )
    try:
        yield tall, low
        tall.set_title(title)
        low.set(xlabel=xlabel)
        for axes in (tall, low):
            axes.grid(alpha=0.3)
        write_atomically(
            folder / NAME, lambda temporary: figure.savefig(temporary, dpi=120)
        )
    finally:
        plt.close(figure)
