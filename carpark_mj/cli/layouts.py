"""`carpark_mj layouts`: draws, checks, saves and edits layouts."""

import math
from collections.abc import Callable, Iterator
from pathlib import Path

import jax

from carpark_mj.cli.clock import wait_for_user
from carpark_mj.cli.settings.lots import Crop, EditConfig, LayoutsConfig
from carpark_mj.config import LAYOUTS, LayoutConfig
from carpark_mj.config.checks import counted
from carpark_mj.editor.server import EXTENT, Draft, EditorServer, read_picture
from carpark_mj.evaluation.aggregation import wilson_interval
from carpark_mj.files import require_writable, write_text
from carpark_mj.layouts import DesignCar, layout_config
from carpark_mj.layouts.base import LAYOUT_WRITERS
from carpark_mj.layouts.car_park import crop
from carpark_mj.layouts.checks import describe_faults
from carpark_mj.layouts.plot import plot_layouts
from carpark_mj.layouts.types import Layout
from carpark_mj.rendering.local_pages import HOST

CHUNK = 250  # layouts drawn at once
OUT_OF_REACH = "with bays out of reach"


def families() -> dict[str, LayoutConfig]:
    """One layout of every family by its name."""
    # The first of a family, whose later ones do not replace it.
    known = {type(config): name for name, config in reversed([*LAYOUTS.items()])}
    return {name: LAYOUTS[name] for name in sorted(known.values())}


def draw(layout: LayoutConfig | str, num_keys: int, seed: int) -> Iterator[Layout]:
    """Draws lots of one layout, as numpy arrays; keys are `fold_in(key(seed), k)`."""
    config = layout_config(layout)
    make = jax.jit(jax.vmap(config.generate))
    fold = jax.vmap(jax.random.fold_in, (None, 0))
    chunk = min(CHUNK, num_keys)
    for first in range(0, num_keys, chunk):
        numbers = first + jax.numpy.arange(chunk)
        batch = jax.device_get(make(fold(jax.random.key(seed), numbers)))
        for row in range(min(chunk, num_keys - first)):
            yield jax.tree.map(lambda leaf, row=row: leaf[row], batch)


# What an inspection says of a lot, a sentence each.
Inspect = Callable[[Layout], list[str]]


def faults(layout: LayoutConfig | str, vehicle: str = "") -> Inspect:
    """Problems of a lot's plan with a car, by default the lots' design car."""
    config = layout_config(layout)
    size = (config.car or DesignCar()).size
    if vehicle:
        from carpark_mj.vehicle import preset

        size = preset(vehicle).length, preset(vehicle).width

    def inspect(drawn: Layout) -> list[str]:
        problems = describe_faults(drawn, size)
        bays = int(drawn.bay_mask.sum())
        if bays < config.min_bays:
            problems.append(f"{counted(bays, 'bay')}, min_bays is {config.min_bays}")
        return problems

    return inspect


def out_of_reach(paths: int, seed: int, vehicle: str = "") -> Inspect:
    """Bays, of `paths` drawn at random, that the planner finds no path to."""
    from carpark_mj.planning.search import unreached
    from carpark_mj.vehicle import preset

    def inspect(drawn: Layout) -> list[str]:
        tried, missed = unreached(drawn, preset(vehicle or "compact"), paths, seed)
        bays = f"{counted(len(tried), 'bay')}: {', '.join(map(str, missed))}"
        return [f"no path found to {len(missed)} of {bays}"] if missed else []

    return inspect


def _writer(path: Path) -> Callable[[Layout], str]:
    return LAYOUT_WRITERS[path.suffix[1:]]


def save(layout: Layout, part: Crop | None, path: Path, *said: object) -> None:
    """Writes a layout, or a part of it, by the suffix, and prints the file's name."""
    if part is not None:
        layout = crop(layout, part)
    write_text(path, _writer(path)(layout))
    bays = counted(int(layout.bay_mask.sum()), "bay")
    print(*said, f"wrote {path}: {bays}", sep="\n")


def main(config: LayoutsConfig) -> int:
    """Draws, saves and checks; returns the exit code, 1 if there are problems."""
    shown = {name: layout_config(name) for name in config.layouts} or families()
    for file in filter(None, (config.save, config.plot)):
        require_writable(Path(file))  # refused before the work
    if config.save:
        _writer(Path(config.save))  # so is a suffix that none has
        [drawn] = draw(config.layouts[0], 1, config.seed)
        save(drawn, config.crop, Path(config.save))
    if config.plot:
        named = bool(config.layouts)
        pictures = [
            (name, drawn)
            for name, layout in shown.items()
            for drawn in draw(layout, 1 + (named and layout.is_random), config.seed)
        ]
        print(f"wrote {plot_layouts(pictures, Path(config.plot))}")
    sound = True
    for name, layout in shown.items():
        inspections: list[tuple[Inspect, int, str]] = []
        if config.check:
            inspect = faults(layout, config.vehicle)
            inspections.append((inspect, config.check, "problems"))
        if config.paths:
            inspect = out_of_reach(config.paths, config.seed, config.vehicle)
            inspections.append((inspect, config.check, OUT_OF_REACH))
        for inspect, number, what in inspections:
            found = [
                f"key {key}: {problem}"
                for key, drawn in enumerate(draw(layout, number, config.seed))
                for problem in inspect(drawn)
            ]
            sound = sound and not found
            if what == OUT_OF_REACH:
                reached = number - len(found)
                low, high = (100 * end for end in wilson_interval(reached, number))
                rate = 100 * reached / number
                what += f"; {rate:.1f} % ({low:.1f} … {high:.1f}) without"
            print(f"{name}: {counted(number, 'lot')}, {len(found)} {what}", flush=True)
            print("".join(f"  {problem}\n" for problem in found[:10]), end="")
    return 0 if sound else 1


def edit(config: EditConfig) -> None:
    """Serves the page until it is interrupted."""
    out, source = Path(config.target), Path(config.file) if config.file else None
    if out.exists() and (source is None or not out.samefile(source)):
        raise ValueError(f"{out} exists: edit it by `carpark_mj layouts edit {out}`")
    picture, extent = None, EXTENT
    if config.background:
        picture = read_picture(Path(config.background), config.width)
        extent = tuple(math.ceil(side) / 2 for side in picture.size)
    require_writable(out)
    draft = Draft(out, source, extent)
    with EditorServer(draft, config.port, picture) as server:
        if draft.kept.exists():
            print(f"opened unsaved changes: {draft.kept}")
        print(f"open http://{HOST}:{server.server_port} (Ctrl-C ends)", flush=True)
        wait_for_user()
        server.serve_forever()
