"""Compares cameras with MuJoCo's rays, measures their speed, draws their images.

python eval/cameras.py                                # the truth, in every family
python eval/cameras.py --what speed                   # pixels and agent steps a second
python eval/cameras.py --what pictures --layouts lot angled street --out cameras.png

`truth` casts the rays of all pixels in MuJoCo, at cars as the two blocks that cameras
see and as meshes. Exit code 1: too few pixels agree. `speed` counts CPU seconds of all
threads on a CPU, which other work on the machine disturbs less, and wall-clock seconds
on a GPU.
"""

from carpark_mj.cli.process import enter
from carpark_mj.rendering.gl import choose_gl

if __name__ == "__main__":  # before the imports, which take seconds
    choose_gl()  # before MuJoCo is imported
    enter("cameras", "cameras:main")

import dataclasses
import itertools
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from camera_reference import Reference
from carpark_mj import EnvConfig, ParkingEnv
from carpark_mj.benchmarking.measuring import CLOCKS, best_time
from carpark_mj.cameras import (
    COLOURS,
    RIGS,
    BirdsEye,
    Heights,
    Rig,
    Seen,
    paint,
    see,
    see_from_above,
)
from carpark_mj.cameras.encoder import CameraObservation
from carpark_mj.cameras.see import Channel
from carpark_mj.config import LAYOUTS, GoalConfig, SpawnConfig
from carpark_mj.config.checks import CheckedConfig, Count
from carpark_mj.evaluation.tables import markdown
from carpark_mj.files import require_writable, write_atomically
from carpark_mj.layouts import BayKind, layout_config, make_layout
from carpark_mj.rendering.recording import snapshot_of
from carpark_mj.rendering.stage import Stage
from carpark_mj.types import State
from shell import command

AT_RANDOM = SpawnConfig(close_ratio=0.0, conflict_ratio=0.0, reverse_ratio=0.0)
AGENTS, PARKED_CARS = 2, 8
MOVERS = "pedestrians:number=3", "cart"


def families() -> list[str]:
    """A layout of every family, and all layouts unlike any other."""
    first: dict[str, str] = {}
    for name in LAYOUTS:
        first.setdefault(LAYOUTS[name].family, name)
    return sorted(first.values())


def environment(layout: str, people: bool = True, agents: int = AGENTS) -> ParkingEnv:
    """An environment with at most as many cars as bays.

    In lots with exits agents drive out and no car is parked.
    """
    lot = layout_config(layout)
    kinds = make_layout(lot, jax.random.key(0)).bay_kind
    exits = bool((kinds == BayKind.EXIT).any())
    agents = min(agents, lot.min_goals)
    config = EnvConfig(
        layout=layout,
        num_agents=agents,
        num_parked_cars=0 if exits else min(PARKED_CARS, lot.min_bays - agents),
        goals=GoalConfig(drive_out=exits),
        spawn=AT_RANDOM if exits else SpawnConfig(),
        movers=MOVERS if people else (),
    )
    return ParkingEnv(config)


CLOSE = 0.01  # m, of depths that agree
ENOUGH = 0.998  # share of the pixels


class Agreement(NamedTuple):
    """Number of pixels, and shares of them that agree with MuJoCo's rays."""

    pixels: int
    depth: float
    classes: float
    meshes: float = 0.0  # with the class that rays at meshes find


def compare(env: ParkingEnv, states: Sequence[State], meshes: bool = True) -> Agreement:
    """Compares the images of all agents of some lots."""
    heights, shares, pixels = Heights.of(env.fleet), [], 0
    pictures_of = jax.jit(see, static_argnums=(0, 2))
    for state, rig in itertools.product(states, (RIGS["surround"], RIGS["windscreen"])):
        pictures = jax.device_get(pictures_of(rig, state, heights))
        reference = Reference(env, state)
        for agent in range(env.config.num_agents):
            if state.present is not None and not state.present[agent]:
                continue  # it stands far away
            seen = pictures.seen[agent]
            depth, truth = reference.look(rig, agent)
            off = pictures.depth[agent] - np.minimum(depth, rig.reach)
            found = [np.abs(off) < CLOSE, seen == truth]
            found += [seen == reference.look(rig, agent, True)[1]] * meshes
            shares.append(seen.size * np.mean(found, axis=(1, 2, 3)))
            pixels += seen.size
    return Agreement(pixels, *(np.sum(shares, axis=0) / pixels).tolist())


CHANNELS: tuple[Channel, ...] = ("depth", "seen", "colour")


def draw(path: Path, layouts: Sequence[str]) -> None:
    """Writes the cameras of one car in lots of some layouts as PNG, with a legend."""
    high = len(CHANNELS)
    figure = Figure((10.0, 4.0 * len(layouts) + 0.5), layout="constrained")
    grid = figure.add_gridspec(high * len(layouts), 7)
    palette = np.array([COLOURS[kind] for kind in Seen])
    for k, layout in enumerate(layouts):
        env = environment(layout)
        state = jax.jit(lambda key: env.reset(key)[0])(jax.random.key(0))  # noqa: B023
        rig = dataclasses.replace(RIGS["surround"], shaded=True)
        pictures = jax.jit(see, static_argnums=(0, 2))(
            rig, state, Heights.of(env.fleet)
        )
        own = jax.tree.map(lambda x: x[0], pictures)
        config = BirdsEye(high * rig.height)
        above = jax.jit(see_from_above, static_argnums=0)(config, state)
        rows = slice(high * k, high * (k + 1))
        images = [(grid[rows, 4:], palette[np.asarray(above[0])])]
        for row, name in enumerate(CHANNELS, high * k):
            painted = enumerate(np.asarray(paint(own, name)))
            images += [(grid[row, column], image) for column, image in painted]
        for place, image in images:
            axes = figure.add_subplot(place)
            axes.imshow(image, interpolation="nearest")
            axes.set_axis_off()
    names = {kind.name.lower().replace("_", " "): COLOURS[kind] for kind in Seen}
    patches = [Patch(fc=colour, ec="k", label=name) for name, colour in names.items()]
    figure.legend(handles=patches, loc="outside lower center", ncols=5)
    write_atomically(path, lambda file: figure.savefig(file, format="png", dpi=100))


REPEATS = 5


def speeds(layout: str, batches: Sequence[int], draws: bool) -> Iterator[dict]:
    """Rows of a table, for numbers of lots of one agent; `draws`: MuJoCo can."""
    blind = environment(layout, people=False, agents=1)
    env = ParkingEnv(dataclasses.replace(blind.config, observation=CameraObservation()))
    still = jnp.zeros((env.num_agents, env.action_spec.size))
    rig, heights, above = RIGS["surround"], Heights.of(env.fleet), BirdsEye()
    cameras = len(rig.cameras) * rig.width * rig.height

    def drawn(state: Any) -> Any:  # as MuJoCo draws them
        pictures = see(rig, state, heights)
        return pictures.depth, pictures.seen

    looks: dict[str, Callable[[Any], Any]] = {
        "surround": drawn,
        "surround, classes only": lambda s: see(rig, s, heights).seen,
        "bird's eye": lambda s: see_from_above(above, s),
        "step with surround": lambda s: env.step(s, still)[1].observation,
    }

    def row(what: str, lots: int, rate: float, memory: float = 0.0) -> dict[str, str]:
        pixels = above.pixels**2 if what == "bird's eye" else cameras
        numbers = f"{lots:,}", f"{pixels * rate:.3g}", f"{rate:,.0f}", f"{memory:.2g}"
        names = "lots", "pixels/s", "agent steps/s", "GiB"
        said = {"layout": f"`{layout}`", "what": what}
        return said | dict(zip(names, numbers, strict=True))

    reset = jax.jit(jax.vmap(lambda key: env.reset(key)[0]))
    for lots in batches:
        states = reset(jax.random.split(jax.random.key(0), lots))
        for what, look in looks.items():
            yield row(what, lots, *_lots(look, states, lots))
    if draws:
        states = reset(jax.random.split(jax.random.key(0), 1))
        state = jax.tree.map(lambda x: x[0], states)
        yield row("MuJoCo's renderer", 1, 1 / _mujoco_seconds(env, state, rig))


def _lots(look: Callable[[Any], Any], states: Any, lots: int) -> tuple[float, float]:
    """Lots a second and GiB: all at once on a GPU, one after the other on a CPU.

    The memory is that of the program with its images.
    """
    on_cpu = jax.default_backend() == "cpu"
    looked = (lambda s: jax.lax.map(look, s)) if on_cpu else jax.vmap(look)
    run = jax.jit(looked).lower(states).compile()
    used: Any = run.memory_analysis()
    memory = used.temp_size_in_bytes + used.output_size_in_bytes
    jax.block_until_ready(run(states))
    return lots / best_time(lambda: run(states), REPEATS, _clock()), memory / 2**30


def _clock() -> Callable[[], float]:
    return CLOCKS["cpu" if jax.default_backend() == "cpu" else "wall"]


def _mujoco_seconds(env: ParkingEnv, state: Any, rig: Rig) -> float:
    """Seconds that MuJoCo needs for depth and segmentation of as many images."""
    stage = Stage.of(env, state)
    stage.place(snapshot_of(state))
    stage.model.vis.quality.offsamples = 0  # edges are not smoothed
    renderer = mujoco.Renderer(stage.model, rig.height, rig.width)

    def draw() -> None:
        for _ in rig.cameras:
            renderer.update_scene(stage.data, camera="agent0/driver")
            for kind in ("depth", "segmentation"):
                getattr(renderer, f"enable_{kind}_rendering")()
                renderer.render()
                getattr(renderer, f"disable_{kind}_rendering")()

    draw()
    seconds = best_time(draw, REPEATS, _clock())
    renderer.close()
    return seconds


@dataclasses.dataclass(frozen=True)
class CamerasConfig(CheckedConfig):
    """Settings of `python eval/cameras.py`.

    Attributes:
        what: comparison, speed measurement or pictures.
        layouts: of the lots; by default one of every family, `lot` for `speed`, and
            three of the families for `pictures`.
        lots: of each layout, for `truth`.
        batch: numbers of lots for `speed`; by default 1024, 4096 and 16384 on a GPU, 64
            on a CPU.
        out: file of the pictures.
    """

    what: Literal["truth", "speed", "pictures"] = "truth"
    layouts: tuple[str, ...] = ()
    lots: Count = 2
    batch: tuple[Count, ...] = ()
    out: str = "cameras.png"

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in self.layouts:
            layout_config(name)  # raises what is unknown


def truth(config: CamerasConfig) -> int:
    """Prints the table; returns 1 where too few pixels agree."""
    rows, missed = [], 0
    for name in config.layouts or families():
        env = environment(name)
        reset = jax.jit(lambda key: env.reset(key)[0])  # noqa: B023
        states = [reset(jax.random.key(seed)) for seed in range(config.lots)]
        found = compare(env, states)
        shares = (f"{share:.2%}" for share in found[1:])
        names = "depth within 1 cm", "classes", "meshes"
        row = {"layout": f"`{name}`", "pixels": f"{found.pixels:,}"}
        rows.append(row | dict(zip(names, shares, strict=True)))
        missed += min(found.depth, found.classes) < ENOUGH
    print(markdown(rows))
    return int(missed > 0)


def speed(config: CamerasConfig) -> None:
    """Prints the table."""
    on_cpu, missing = jax.default_backend() == "cpu", choose_gl()
    batches = config.batch or ((64,) if on_cpu else (1024, 4096, 16384))
    second = "a core's" if on_cpu else "the wall clock's"
    print(f"{jax.devices()[0].device_kind}, {second} seconds")
    if missing:
        print(f"without MuJoCo's renderer: {missing}")
    names = config.layouts or ("lot",)
    rows = (row for name in names for row in speeds(name, batches, not missing))
    print(markdown(list(rows)))


def run(config: CamerasConfig) -> int:
    """Runs `what`; returns the exit code."""
    if config.what == "truth":
        return truth(config)
    if config.what == "speed":
        speed(config)
    else:
        out = Path(config.out)
        require_writable(out)
        draw(out, config.layouts or ("lot", "angled", "street"))
        print(f"wrote {out}")
    return 0


main = command(CamerasConfig, run, __doc__)
