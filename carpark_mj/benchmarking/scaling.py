"""How the cost of a step grows with the agents of a lot and with its size."""

import csv
import dataclasses
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax

from carpark_mj.benchmarking.timing import best_time
from carpark_mj.config import EnvConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.files import write_atomically
from carpark_mj.layouts import LotConfig
from carpark_mj.reading import read_csv
from carpark_mj.types import State

AGENTS = (1, 2, 4, 8, 16, 32, 64)
AISLES = (1, 2, 4, 8, 16)
ROW = 24  # bays
CROWD = 8  # agents, where the size of the lot varies


@dataclasses.dataclass(frozen=True)
class Point:
    """Cost in one kind of lot.

    Attributes:
        series: `agents` or `size`, what varies.
        agents: in a lot.
        bays: of a lot.
        lots: in the batch.
        microseconds: of a control step, by agent.
    """

    series: str
    agents: int
    bays: int
    lots: int
    microseconds: float


def environments(series: str) -> list[ParkingEnv]:
    """Environments of a series, small ones first; half the free bays have a car."""
    shapes = (
        [(agents, AISLES[-2]) for agents in AGENTS]
        if series == "agents"
        else [(CROWD, aisles) for aisles in AISLES]
    )
    return [_environment(agents, aisles) for agents, aisles in shapes]


def _environment(agents: int, aisles: int) -> ParkingEnv:
    layout = LotConfig(num_aisles=(aisles, aisles), bays_per_row=(ROW, ROW))
    parked = (layout.min_bays - max(AGENTS if aisles > AISLES[0] else (CROWD,))) // 2
    return ParkingEnv(
        EnvConfig(layout=layout, num_agents=agents, num_parked_cars=parked)
    )


def measure(
    env: ParkingEnv, series: str, total: int, steps: int, repeats: int
) -> Point:
    """Times whole steps under random actions.

    Args:
        env: of the lots.
        series: to note.
        total: agents in the batch, all lots together.
        steps: control steps of a timing.
        repeats: timings; the best counts.
    """
    lots = max(1, total // env.num_agents)
    reset_key, key = jax.random.split(jax.random.key(0))
    shape = (lots, env.num_agents, 2)

    def step(state: State, key: jax.Array) -> tuple[State, Any]:
        action = jax.random.uniform(key, shape, minval=-1.0)
        state, timestep = jax.vmap(env.step)(state, action)
        # Without a use of the observation XLA would leave it out.
        return state, (timestep.observation.sum(-1), timestep.reward)

    drive = jax.jit(
        lambda state: jax.lax.scan(step, state, jax.random.split(key, steps))
    )
    reset = jax.jit(jax.vmap(env.reset))
    state, _ = reset(jax.random.split(reset_key, lots))
    state, _ = jax.block_until_ready(drive(state))
    seconds = best_time(lambda: drive(state), repeats)
    bays = state.layout.bay_mask.shape[-1]
    per_agent = 1e6 * seconds / (steps * lots * env.num_agents)
    return Point(series, env.num_agents, bays, lots, per_agent)


def write_points(path: Path, points: Sequence[Point]) -> None:
    """Writes a CSV, one point a line."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([field.name for field in dataclasses.fields(Point)])
    writer.writerows(dataclasses.astuple(point) for point in points)
    write_atomically(path, lambda temporary: temporary.write_text(text.getvalue()))


def read_points(path: Path) -> list[Point]:
    """Reads what `write_points` wrote.

    Raises:
        ValueError: it is no such file.
    """
    names = [field.name for field in dataclasses.fields(Point)]
    return [
        Point(
            series=row.cells["series"],
            agents=row.whole("agents"),
            bays=row.whole("bays"),
            lots=row.whole("lots"),
            microseconds=row.number("microseconds"),
        )
        for row in read_csv(path, *names)
    ]


def draw(path: Path, tables: dict[str, Sequence[Point]]) -> None:
    """Draws the cost of a lot's step over agents and over bays.

    Args:
        path: of the picture.
        tables: points of each device, by its name.
    """
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    for axes, series in zip(panels, ("agents", "size"), strict=True):
        ticks: set[int] = set()
        for device, points in tables.items():
            chosen = [point for point in points if point.series == series]
            across = [p.agents if series == "agents" else p.bays for p in chosen]
            ticks |= set(across)
            cost = [point.agents * point.microseconds for point in chosen]
            (line,) = axes.loglog(across, cost, "o-", label=device)
            if series == "agents" and chosen:
                linear = [cost[-1] * n / across[-1] for n in across]
                axes.loglog(across, linear, ":", color=line.get_color(), alpha=0.6)
        axes.set_xticks(sorted(ticks), [str(tick) for tick in sorted(ticks)])
        axes.minorticks_off()
        axes.grid(alpha=0.3)
        axes.set_ylabel("one step of one lot [µs]")
    panels[0].set(xlabel="agents in the lot (dotted: in proportion)")
    panels[1].set(xlabel=f"bays in the lot, {CROWD} agents")
    panels[0].legend()
    write_atomically(path, lambda temporary: figure.savefig(temporary, dpi=120))
    plt.close(figure)
