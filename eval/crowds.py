"""The social force model against its published behaviour: lanes, and a door.

python eval/crowds.py
python eval/crowds.py --out runs/people

Writes `crowds.png` and `crowds.csv`.
"""

from carpark_mj.cli.process import enter

if __name__ == "__main__":  # before the imports, which take seconds
    enter("crowds", "crowds:main")

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.cli.common import run_command
from carpark_mj.files import require_writable, write_atomically, write_csv
from carpark_mj.geometry import norm
from carpark_mj.movers import social_force
from carpark_mj.movers.walking import BODY

DT = 0.05  # s
RADIUS = 0.3  # m
CORRIDOR = (30.0, 10.0)  # m, its ends are joined
WALKERS = 60  # half of them each way
WALK_TIME = 120.0  # s
ROOM, DOOR = 12.0, 2.0  # m, of a square room and the door in the middle of a wall
LEAVERS = 100
LEAVE_TIME = 180.0  # s
SPEEDS = (0.8, 1.34, 2.0, 3.0, 4.5)  # m/s, desired at the door
SEEDS = 5
BAND = 0.6  # m, half the width of the strip in which a walker looks for others
STRIP = 4.0  # m, half its length


@dataclasses.dataclass(frozen=True)
class CrowdsConfig:
    """Settings of `python eval/crowds.py`.

    Attributes:
        out: folder of the figure and the table.
    """

    out: str = "docs/people"


def forces(
    xy: jax.Array, velocity: jax.Array, heading: jax.Array, length: float
) -> jax.Array:
    """Forces (n, 2) of people on each other; x repeats after a length [m]."""
    count = xy.shape[0]
    x = xy[:, :1] - xy[:, 0]
    x = x - length * jnp.round(x / length) + 1e6 * jnp.eye(count)
    y = xy[:, 1:] - xy[:, 1]
    fx, fy = social_force.push((x, y), norm(velocity), heading)
    distance = jnp.sqrt(x * x + y * y)
    part = BODY * jnp.maximum(2 * RADIUS / distance - 1.0, 0.0)
    return jnp.stack([(fx + part * x).sum(1), (fy + part * y).sum(1)], axis=-1)


def move(
    xy: jax.Array, velocity: jax.Array, wanted: jax.Array, force: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Places and velocities (n, 2) after a step."""
    velocity = social_force.advance(velocity, wanted, force, DT)
    velocity = social_force.limit(velocity, norm(wanted))
    return xy + DT * velocity, velocity


def order(xy: jax.Array, way: jax.Array) -> jax.Array:
    """Order of lanes (): how far those before and behind walk the same way.

    The mean over walkers of the share of others in their strip who walk as they do,
    less that of those who come towards them: 0 in a mixed crowd, 1 in lanes.
    """
    length, count = CORRIDOR[0], way.shape[0]
    x = xy[:, None, 0] - xy[:, 0]
    x = x - length * jnp.round(x / length)
    in_strip = (jnp.abs(xy[:, None, 1] - xy[:, 1]) < BAND) & (jnp.abs(x) < STRIP)
    in_strip = in_strip & ~jnp.eye(count, dtype=bool)
    others = in_strip.sum(axis=1)
    alike = (in_strip * way[:, None] * way).sum(axis=1) / jnp.maximum(others, 1)
    return jnp.where(others > 0, alike, 0.0).sum() / jnp.maximum((others > 0).sum(), 1)


def walk(key: jax.Array, pushes: float) -> tuple[jax.Array, ...]:
    """Places (n, 2) first and last, directions (n,), and the order over time."""
    length, width = CORRIDOR
    place_key, speed_key = jax.random.split(key)
    size = jnp.array([length, width - 2 * RADIUS])
    xy = jax.random.uniform(place_key, (WALKERS, 2)) * size
    xy = xy + jnp.array([0.0, RADIUS])
    way = jnp.where(jnp.arange(WALKERS) % 2 == 0, 1.0, -1.0)
    speed = 1.34 + 0.26 * jax.random.truncated_normal(speed_key, -2, 2, (WALKERS,))
    heading = jnp.stack([way, jnp.zeros(WALKERS)], axis=-1)

    def step(carry, _):
        xy, velocity = carry
        y = xy[:, 1]
        below = social_force.border_push((jnp.zeros(WALKERS), y))[1]
        above = social_force.border_push((jnp.zeros(WALKERS), y - width))[1]
        force = pushes * forces(xy, velocity, heading, length)
        force = force.at[:, 1].add(below + above)
        xy, velocity = move(xy, velocity, speed[:, None] * heading, force)
        xy = jnp.stack([xy[:, 0] % length, jnp.clip(xy[:, 1], 0.0, width)], axis=-1)
        return (xy, velocity), order(xy, way)

    start = xy, speed[:, None] * heading
    (last, _), orders = jax.lax.scan(step, start, length=round(WALK_TIME / DT))
    return xy, last, way, orders


def leave(key: jax.Array, speed: jax.Array) -> jax.Array:
    """How many have left a room through its door, over time."""
    xy = jax.random.uniform(key, (LEAVERS, 2), minval=0.5, maxval=ROOM - 0.5)
    door = jnp.array([ROOM, ROOM / 2])
    posts = door + jnp.array([[0.0, DOOR / 2], [0.0, -DOOR / 2]])

    def step(carry, _):
        xy, velocity = carry
        out = xy[:, 0] > ROOM
        inward = jnp.clip(xy[:, 1], ROOM / 2 - DOOR / 4, ROOM / 2 + DOOR / 4)
        aim = jnp.stack([jnp.full(LEAVERS, ROOM + 1.0), inward], axis=-1)
        aim = jnp.where((xy[:, :1] > ROOM - 0.3), aim, door)
        to_go = aim - xy
        heading = to_go / jnp.maximum(norm(to_go), 1e-3)[:, None]
        heading = jnp.where(out[:, None], jnp.array([1.0, 0.0]), heading)
        # Those who are through walk away: far off, so that they block nobody.
        force = forces(xy, velocity, heading, 1e9)
        x, y = xy[:, 0], xy[:, 1]
        zero = jnp.zeros(LEAVERS)
        walls = [(x, zero), (zero, y), (zero, y - ROOM)]
        at_door = jnp.abs(y - ROOM / 2) < DOOR / 2
        front = jnp.where(at_door, 1e3, x - ROOM)
        walls += [(front, zero), *((x - post[0], y - post[1]) for post in posts)]
        force += (
            sum(
                jnp.stack(social_force.border_push(offset), axis=-1) for offset in walls
            )
            * ~out[:, None]
        )
        xy, velocity = move(xy, velocity, speed * heading, force)
        kept = jnp.minimum(xy[:, 0], ROOM - 0.05)
        shut = ~out & (jnp.abs(xy[:, 1] - ROOM / 2) >= DOOR / 2)
        xy = xy.at[:, 0].set(jnp.where(shut, kept, xy[:, 0]))
        return (xy, velocity), (xy[:, 0] > ROOM).sum()

    start = xy, jnp.zeros((LEAVERS, 2))
    return jax.lax.scan(step, start, length=round(LEAVE_TIME / DT))[1]


def flow(left: np.ndarray) -> float:
    """Persons per second between the 10th and the 80th who leave, or until the end."""
    if left[-1] <= 10:
        return 0.0
    first = int(np.argmax(left >= 10))
    last = int(np.argmax(left >= 80)) if left[-1] >= 80 else left.size
    return (min(int(left[-1]), 80) - 10) / (DT * (last - first))


def run(config: CrowdsConfig) -> None:
    """Simulates, and writes figure and table."""
    out = Path(config.out)
    require_writable(out / "crowds.csv", new_folders=True)
    jax.config.update("jax_platforms", "cpu")
    keys = jax.random.split(jax.random.key(0), SEEDS)
    many = jax.jit(jax.vmap(walk, (0, None)))
    walks = {pushes: jax.device_get(many(keys, pushes)) for pushes in (1.0, 0.0)}
    leaving = jax.jit(jax.vmap(jax.vmap(leave, (0, None)), (None, 0)))
    left = np.asarray(leaving(keys, jnp.array(SPEEDS)))
    flows = np.array([[flow(one) for one in row] for row in left])
    end = round(20.0 / DT)
    rows = [
        ("order of lanes, last 20 s", "", *walks[1.0][3][:, -end:].mean(axis=1)),
        ("the same without forces", "", *walks[0.0][3][:, -end:].mean(axis=1)),
        *(
            (f"flow through the door at {v:g} m/s", "1/s", *row)
            for v, row in zip(SPEEDS, flows, strict=True)
        ),
    ]
    out.mkdir(parents=True, exist_ok=True)
    names = [f"seed {k}" for k in range(SEEDS)]
    table = [
        {"what": what, "unit": unit}
        | {name: f"{x:.3f}" for name, x in zip(names, values, strict=True)}
        for what, unit, *values in rows
    ]
    write_csv(out / "crowds.csv", table)
    draw(out / "crowds.png", walks, flows)
    for what, unit, *values in rows:
        print(f"{what}: {np.mean(values):.2f} ± {np.std(values):.2f} {unit}")


def draw(path: Path, walks: dict[float, tuple], flows: np.ndarray) -> None:
    """The figure: a corridor first and last, lanes over time, flows by speed."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure = plt.figure(figsize=(10, 5.6), layout="constrained")
    grid = figure.add_gridspec(3, 2, height_ratios=[1, 1, 1.8])
    first, last, way, orders = walks[1.0]
    for row, (places, name) in enumerate(((first, "0 s"), (last, f"{WALK_TIME:g} s"))):
        axes = figure.add_subplot(grid[row, :])
        for sign, colour in ((1.0, "tab:blue"), (-1.0, "tab:orange")):
            axes.scatter(*places[0][way[0] == sign].T, s=22, c=colour)
        axes.set(xlim=(0, CORRIDOR[0]), ylim=(0, CORRIDOR[1]), ylabel="y [m]")
        axes.set_title(f"corridor at {name}", fontsize=9)
    axes = figure.add_subplot(grid[2, 0])
    time = DT * np.arange(1, orders.shape[1] + 1)
    for pushes, label in ((1.0, "social force"), (0.0, "no forces between people")):
        axes.plot(time, walks[pushes][3].mean(axis=0), label=label)
    axes.set(xlabel="time [s]", ylabel="order of lanes")
    axes.legend(fontsize=8)
    axes = figure.add_subplot(grid[2, 1])
    axes.errorbar(SPEEDS, flows.mean(axis=1), flows.std(axis=1), marker="o", capsize=3)
    axes.set(xlabel="desired speed [m/s]", ylabel=f"flow, door of {DOOR:g} m [1/s]")
    axes.set_ylim(bottom=0)
    write_atomically(path, lambda file: figure.savefig(file, dpi=110, format="png"))
    plt.close(figure)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit code."""

    def command() -> object:
        from carpark_mj.cli.flags import read_flags

        return run(read_flags(CrowdsConfig, arguments, description=__doc__))

    return run_command("crowds", command)
