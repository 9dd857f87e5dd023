"""Compares cameras with MuJoCo's renderer, measures their speed, shows what they see.

python eval/cameras.py                                # the truth, in every family
python eval/cameras.py --what speed                   # pixels and agent steps a second
python eval/cameras.py --what pictures --layouts lot angled street --out cameras.png

`truth` draws the same state by MuJoCo, with every car as the two blocks that cameras
see and, beside that, as its mesh. Exit code 1: fewer pixels agree than must. `speed`
counts a core's seconds on a CPU, of all threads together, which other work on the
machine disturbs far less, and the wall clock's on a GPU.
"""

from carpark_mj.cli.process import enter
from carpark_mj.rendering.gl import choose_gl

if __name__ == "__main__":  # before the imports, which take seconds
    choose_gl()  # before MuJoCo is imported
    enter("cameras", "cameras:main")

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from PIL import Image

from camera_reference import BlockStage, Reference, Renderer
from carpark_mj import EnvConfig, ParkingEnv
from carpark_mj.benchmarking.measuring import CLOCKS, best_time
from carpark_mj.cameras import (
    COLOURS,
    RIGS,
    BirdsEye,
    Heights,
    Pictures,
    Rig,
    Seen,
    paint,
    see,
    see_from_above,
)
from carpark_mj.cameras.encoder import CameraObservation
from carpark_mj.cameras.see import Channel
from carpark_mj.config import LAYOUTS, GoalConfig, Mover, ObstacleKind, SpawnConfig
from carpark_mj.config.checks import CheckedConfig, Count
from carpark_mj.files import require_writable, write_atomically
from carpark_mj.layouts import BayKind, layout_config, make_layout
from carpark_mj.obstacles import Boxes, Discs, Group
from carpark_mj.types import State
from shell import command

AT_RANDOM = SpawnConfig(close_ratio=0.0, conflict_ratio=0.0, reverse_ratio=0.0)
AGENTS, PARKED_CARS, PEOPLE = 2, 8, 3


@dataclasses.dataclass(frozen=True)
class Bystanders(Mover):
    """People who stand anywhere in the lot."""

    mover: str = "bystanders"
    kind = ObstacleKind.PERSON

    def init(self, key: Any, layout: Any) -> jax.Array:
        """Poses (n, 3)."""
        far = jnp.append(layout.extent, jnp.pi)
        return far * jax.random.uniform(key, (PEOPLE, 3), minval=-1.0)

    def step(self, key: Any, state: Any, lot: Any, dt: float) -> jax.Array:
        """They stay."""
        del key, lot, dt
        return state

    def obstacles(self, state: jax.Array) -> list[Group]:
        """All of them."""
        return [Discs(state[:, :2], jnp.full(PEOPLE, 0.3))]


@dataclasses.dataclass(frozen=True)
class Carts(Bystanders):
    """As many carts."""

    mover: str = "carts"
    kind = ObstacleKind.MOVER

    def obstacles(self, state: jax.Array) -> list[Group]:
        """All of them."""
        return [Boxes(state, jnp.broadcast_to(jnp.array([1.2, 0.7]), (PEOPLE, 2)))]


def families() -> list[str]:
    """A layout of every family, and the rest of those that no other looks like."""
    first: dict[str, str] = {}
    for name in LAYOUTS:
        first.setdefault(LAYOUTS[name].family, name)
    return sorted(first.values())


def environment(layout: str, people: bool = True, agents: int = AGENTS) -> ParkingEnv:
    """An environment with as many of the cars as its lots have bays for.

    Where lots have exits, agents drive out and nobody is parked.
    """
    lot = layout_config(layout)
    kinds = make_layout(lot, jax.random.key(0)).bay_kind
    exits = bool((kinds == BayKind.EXIT).any())
    agents = min(agents, lot.min_goals)
    parked_cars = 0 if exits else min(PARKED_CARS, lot.min_bays - agents)
    return ParkingEnv(
        EnvConfig(
            layout=layout,
            num_agents=agents,
            num_parked_cars=parked_cars,
            goals=GoalConfig(drive_out=exits),
            spawn=AT_RANDOM if exits else SpawnConfig(),
            movers=(Bystanders(), Carts()) if people else (),
        )
    )


CLOSE = 0.01  # m, of depths that agree
ENOUGH = 0.995  # share of the pixels
RIG_NAMES = ("surround", "windscreen")


@dataclasses.dataclass
class Agreement:
    """Counts of pixels.

    Attributes:
        pixels: all.
        on_edge: where things meet within a quarter of a pixel or so.
        close: off the edges, with the right depth.
        same: of the right class.
        same_meshes: of the same class as where MuJoCo draws the cars' meshes.
    """

    pixels: int = 0
    on_edge: int = 0
    close: int = 0
    same: int = 0
    same_meshes: int = 0

    @property
    def depth(self) -> float:
        """Share of the pixels off edges whose depth agrees."""
        return self.close / max(self.pixels - self.on_edge, 1)

    @property
    def classes(self) -> float:
        """Share of the pixels whose class agrees."""
        return self.same / self.pixels

    @property
    def meshes(self) -> float:
        """The same where MuJoCo draws meshes."""
        return self.same_meshes / self.pixels

    def add(self, rig: Rig, pictures: Pictures, reference: Reference) -> None:
        """Counts the pictures (cameras, height, width) of a car."""
        depth, seen = np.asarray(pictures.depth), np.asarray(pictures.seen)
        off = np.abs(depth - np.minimum(reference.depth, rig.reach))
        self.pixels += seen.size
        self.on_edge += int(reference.on_edge.sum())
        self.close += int(((off < CLOSE) & ~reference.on_edge).sum())
        self.same += int((seen == reference.seen).sum())


def compare(env: ParkingEnv, states: Sequence[State], meshes: bool = True) -> Agreement:
    """Compares the pictures of all agents that are in some lots.

    Args:
        env: the environment.
        states: of its lots.
        meshes: compare with meshes, too.
    """
    heights, total = Heights.of(env.fleet), Agreement()
    pictures_of = jax.jit(see, static_argnums=(0, 2))
    for state in states:
        drawn = [
            Renderer(env, state, meshes=each) for each in (False, True)[: 1 + meshes]
        ]
        for name in RIG_NAMES:
            rig = RIGS[name]
            pictures = pictures_of(rig, state, heights)
            for agent in _present(env, state):
                own = jax.tree.map(lambda x: x[agent], pictures)  # noqa: B023
                total.add(rig, own, drawn[0].show(rig, agent))
                for renderer in drawn[1:]:
                    other = renderer.show(rig, agent).seen
                    total.same_meshes += int((np.asarray(own.seen) == other).sum())
        for renderer in drawn:
            renderer.close()
    return total


def _present(env: ParkingEnv, state: State) -> list[int]:
    """The agents in the lot: absent ones stand far away."""
    agents = range(env.config.num_agents)
    return [k for k in agents if state.present is None or bool(state.present[k])]


def compare_layout(layout: str, lots: int) -> Agreement:
    """Compares the pictures in some lots of a layout."""
    env = environment(layout)
    reset = jax.jit(lambda key: env.reset(key)[0])
    return compare(env, [reset(jax.random.key(seed)) for seed in range(lots)])


CHANNELS: tuple[Channel, ...] = ("depth", "seen", "colour")
GAP = 4  # pixels between pictures
ENLARGED = 3


def mosaic(layouts: Sequence[str]) -> np.ndarray:
    """The cameras of one car in lots of some layouts, (rows, columns, 3) uint8."""
    sheets = []
    palette = (255 * np.array([COLOURS[kind] for kind in Seen])).astype(np.uint8)
    for layout in layouts:
        env = environment(layout)
        state = jax.jit(lambda key: env.reset(key)[0])(jax.random.key(0))  # noqa: B023
        rig = dataclasses.replace(RIGS["surround"], shaded=True)
        heights = Heights.of(env.fleet)
        pictures = jax.jit(see, static_argnums=(0, 2))(rig, state, heights)
        own = jax.tree.map(lambda x: x[0], pictures)
        config = BirdsEye(3 * rig.height + 2 * GAP)
        above = jax.jit(see_from_above, static_argnums=0)(config, state)[0]
        painted = [np.asarray(paint(own, name)) for name in CHANNELS]
        rows = np.concatenate([_row(images) for images in painted])[:-GAP]
        sheets.append(np.concatenate([rows, _framed(palette[above])[:-GAP]], axis=1))
        sheets.append(np.full((2 * GAP, sheets[0].shape[1], 3), 255, np.uint8))
    return np.concatenate(sheets[:-1])


def write_mosaic(path: Path, layouts: Sequence[str]) -> None:
    """Writes `mosaic` as a PNG, enlarged."""
    image = Image.fromarray(mosaic(layouts))
    size = (image.width * ENLARGED, image.height * ENLARGED)
    image = image.resize(size, Image.Resampling.NEAREST)
    write_atomically(path, lambda temporary: image.save(temporary, format="PNG"))


def _row(images: np.ndarray) -> np.ndarray:
    return np.concatenate([_framed(image) for image in images], axis=1)


def _framed(image: np.ndarray) -> np.ndarray:
    return np.pad(image, ((0, GAP), (0, GAP), (0, 0)), constant_values=255)


REPEATS = 5


@dataclasses.dataclass(frozen=True)
class Speed:
    """A row of the table.

    Attributes:
        what: is drawn.
        lots: at once, with one agent each.
        rate: of them [1/s].
        pixels: of the pictures of an agent.
        memory: of the program, the pictures included [GiB].
    """

    what: str
    lots: int
    rate: float
    pixels: int
    memory: float = 0.0


def speeds(layout: str, batches: Sequence[int], draws: bool) -> Iterator[Speed]:
    """Rows of a table.

    Args:
        layout: of the lots.
        batches: numbers of lots.
        draws: whether MuJoCo can draw.
    """
    blind = environment(layout, people=False, agents=1)
    env = ParkingEnv(dataclasses.replace(blind.config, observation=CameraObservation()))
    still = jnp.zeros((env.num_agents, env.action_spec.size))
    rig, heights, above = RIGS["surround"], Heights.of(env.fleet), BirdsEye()
    cameras = len(rig.cameras) * rig.width * rig.height
    looks: list[tuple[str, int, Callable[[Any], Any]]] = [
        ("surround", cameras, lambda state: _drawn(see(rig, state, heights))),
        ("surround, classes only", cameras, lambda s: see(rig, s, heights).seen),
        ("bird's eye", above.pixels**2, lambda s: see_from_above(above, s)),
        ("step with surround", cameras, lambda s: env.step(s, still)[1].observation),
    ]
    reset = jax.jit(jax.vmap(lambda key: env.reset(key)[0]))
    states = None
    for lots in batches:
        states = reset(jax.random.split(jax.random.key(0), lots))
        for what, pixels, look in looks:
            rate, memory = _lots(look, states, lots)
            yield Speed(what, lots, rate, pixels, memory)
    if draws and states is not None:
        first = jax.tree.map(lambda x: x[0], states)
        yield Speed(
            "MuJoCo's renderer", 1, 1 / _mujoco_seconds(env, first, rig), cameras
        )


def _drawn(pictures: Pictures) -> tuple[jax.Array, jax.Array]:
    """Depth and classes, as MuJoCo draws them."""
    return pictures.depth, pictures.seen


def _lots(look: Callable[[Any], Any], states: Any, lots: int) -> tuple[float, float]:
    """Lots a second and GiB: all at once on a GPU, one after the other on a CPU."""
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
    """Seconds in which MuJoCo draws depth and segmentation of as many pictures."""
    stage = BlockStage(
        jax.device_get(state.layout),
        env.vehicle,
        env.config.num_agents,
        env.config.num_parked_cars,
    )
    state = jax.device_get(state)
    stage.place(state.motion.pose_w, state.motion.steering, state.parked_cars.pose_w)
    renderer = mujoco.Renderer(stage.model, rig.height, rig.width)

    def draw() -> None:
        for _ in rig.cameras:
            renderer.update_scene(stage.data, camera="agent0/driver")
            renderer.enable_depth_rendering()
            renderer.render()
            renderer.disable_depth_rendering()
            renderer.enable_segmentation_rendering()
            renderer.render()
            renderer.disable_segmentation_rendering()

    draw()
    seconds = best_time(draw, REPEATS, _clock())
    renderer.close()
    return seconds


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
    lots: Count = 2
    batch: tuple[Count, ...] = ()
    out: str = "cameras.png"

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in self.layouts:
            layout_config(name)  # raises what is unknown


def truth(config: CamerasConfig) -> int:
    """Prints the table; returns 1 where too few pixels agree."""
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
        out = Path(config.out)
        require_writable(out)
        write_mosaic(out, config.layouts or ("lot", "angled", "street"))
        print(f"wrote {out}")
    return 0


main = command(CamerasConfig, run, __doc__)
