"""Compares cameras with MuJoCo's renderer, measures their speed, shows what they see.

python eval/cameras.py                                # the truth, in every family
python eval/cameras.py --what speed                   # pixels and agent steps a second
python eval/cameras.py --what pictures --layouts lot angled street --out cameras.png

`truth` draws the same state by MuJoCo, with every car as the two blocks that cameras
see and, beside that, as its mesh. Exit code 1: fewer pixels agree than must.
"""

from carpark_mj.cli.process import enter

if __name__ == "__main__":  # before the imports, which take seconds
    enter("cameras", "cameras:main")

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from carpark_mj.cli.common import run_command
from carpark_mj.cli.flags import read_flags
from carpark_mj.config.checks import CheckedConfig, require_count, require_whole
from carpark_mj.files import require_writable
from carpark_mj.layouts import layout_config
from carpark_mj.rendering.gl import choose_gl


@dataclasses.dataclass(frozen=True)
class CamerasConfig(CheckedConfig):
    """Settings of `python eval/cameras.py`.

    Attributes:
        what: what to do.
        layouts: of the lots; by default one of every family, `lot` for `speed`, and
            three of the families for `pictures`.
        lots: of each layout, for `truth`.
        batch: numbers of lots for `speed`; by default 1024, 4096 and 16384 on a GPU, 64
            on a CPU.
        out: file of the pictures.
    """

    what: Literal["truth", "speed", "pictures"] = "truth"
    layouts: tuple[str, ...] = ()
    lots: int = 2
    batch: tuple[int, ...] = ()
    out: str = "cameras.png"

    def __post_init__(self) -> None:
        super().__post_init__()
        require_whole(self, 1, "lots")
        for count in self.batch:
            require_count("batch", count, 1)
        for name in self.layouts:
            layout_config(name)  # raises what is unknown


def truth(config: CamerasConfig) -> int:
    """Prints the table; returns 1 where too few pixels agree."""
    from camera_suite.lots import families
    from camera_suite.truth import ENOUGH, compare_layout

    print("| layout | pixels | on edges | depth within 1 cm | classes | meshes |")
    print("|---|---|---|---|---|---|")
    missed = 0
    for name in config.layouts or families():
        found = compare_layout(name, config.lots)
        print(
            f"| `{name}` | {found.pixels:,} | {found.on_edge / found.pixels:.1%} | "
            f"{found.depth:.2%} | {found.classes:.2%} | {found.meshes:.1%} |",
            flush=True,
        )
        missed += min(found.depth, found.classes) < ENOUGH
    return int(missed > 0)


def speed(config: CamerasConfig) -> None:
    """Prints the table."""
    import jax

    from camera_suite.speed import speeds

    on_cpu, missing = jax.default_backend() == "cpu", choose_gl()
    batches = config.batch or ((64,) if on_cpu else (1024, 4096, 16384))
    second = "a core's" if on_cpu else "the wall clock's"
    print(f"{jax.devices()[0].device_kind}, {second} seconds")
    if missing:
        print(f"without MuJoCo's renderer: {missing}")
    print("| layout | what | lots | pixels/s | agent steps/s | GiB |")
    print("|---|---|---|---|---|---|", flush=True)
    for name in config.layouts or ("lot",):
        for row in speeds(name, batches, draws=not missing):
            print(
                f"| `{name}` | {row.what} | {row.lots:,} | {row.pixels * row.rate:.3g} "
                f"| {row.rate:,.0f} | {row.memory:.2g} |",
                flush=True,
            )


def run(config: CamerasConfig) -> int:
    """Does what is asked for; returns the exit code."""
    if config.what == "truth":
        return truth(config)
    if config.what == "speed":
        speed(config)
    else:
        from camera_suite.mosaic import write_mosaic

        out = Path(config.out)
        require_writable(out)
        write_mosaic(out, config.layouts or ("lot", "angled", "street"))
        print(f"wrote {out}")
    return 0


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit code."""
    choose_gl()  # before a layout's study imports MuJoCo
    return run_command(
        "cameras",
        lambda: run(read_flags(CamerasConfig, arguments, description=__doc__)),
    )
