"""The social force model against published behaviour: speeds, lanes, and a door.

python eval/crowds.py
python eval/crowds.py --out runs/people

Writes `crowds.png` and `crowds.csv`.
"""

from carpark_mj.cli.process import enter

if __name__ == "__main__":  # before the imports, which take seconds
    enter("crowds", "crowds:main")

import functools
import itertools
import math
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

from carpark_mj.files import require_writable, write_atomically, write_csv
from carpark_mj.geometry import norm
from carpark_mj.movers import bodies
from carpark_mj.movers.bodies import go_round, outlines, room_among, room_to
from shell import Folder, command

DT = 0.2  # s, the control period
RADIUS = 0.3  # m
CORRIDOR = (30.0, 10.0)  # m, its ends are joined
ONE_WAY = (12.0, 4.0)  # m, of a corridor in which all walk one way, ends joined
ONE_WAY_TIME = 20.0  # s
# Persons per square metre, and radii [m]; four of 0.3 m would cover more than there is.
CROWDED = ((1.0, 0.2), (2.0, 0.2), (4.0, 0.2), (1.0, 0.3), (2.0, 0.3))
PERIODS = (0.2, 0.02)  # s, control periods
WALKERS = 60  # half of them each way
WALK_TIME = 120.0  # s
ROOM, DOOR = 12.0, 2.0  # m, of a square room and the door in the middle of a wall
WALL = 0.2  # m, how thick it is
LEAVERS = 100
LEAVE_TIME = 180.0  # s
SPEEDS = (0.8, 1.34, 2.0, 3.0, 4.5)  # m/s, desired at the door
SEEDS = 5
BAND = 0.6  # m, half the width of the strip in which a walker looks for others
STRIP = 4.0  # m, half its length


def apart(xy: jax.Array, length: float) -> bodies.Pair:
    """X and y (n, n) [m] from the second people to the first; x repeats."""
    x = xy[:, :1] - xy[:, 0]
    x = x - length * jnp.round(x / length) + 1e6 * jnp.eye(xy.shape[0])
    return x, xy[:, 1:] - xy[:, 1]


def aiming(speed: jax.Array, heading: jax.Array, radius: float = RADIUS) -> bodies.Aim:
    """Aims of people with desired speeds (n,) [m/s] and unit vectors (n, 2)."""
    nobody, radii = jnp.zeros(speed.shape, bool), jnp.full(speed.shape, radius)
    return bodies.Aim(speed[:, None] * heading, heading, speed, nobody, radii)


def move(
    xy: jax.Array,
    velocity: jax.Array,
    aim: bodies.Aim,
    borders: jax.Array,
    length: float,
    dt: float = DT,
) -> tuple[jax.Array, jax.Array]:
    """Places and velocities (n, 2) after a control step, as pedestrians move."""
    offset = functools.partial(apart, length=length)
    end, after = bodies.advance_people(xy, velocity, aim, offset, [borders], dt)
    rooms = [room_among(offset(xy), aim.radius), room_to(xy, aim.radius, borders)]
    moved = go_round(rooms, end - xy, bodies.DODGE * dt**2)
    return xy + moved, after + (xy + moved - end) / dt


def order(xy: jax.Array, way: jax.Array) -> jax.Array:
    """Order of lanes (): how far people ahead and behind walk in one direction.

    The mean over walkers of the share of others in their strip with their direction,
    less the share with the opposite one: 0 in a mixed crowd, 1 in lanes.
    """
    x, y = apart(xy, CORRIDOR[0])
    in_strip = (jnp.abs(y) < BAND) & (jnp.abs(x) < STRIP)
    others = in_strip.sum(axis=1)
    alike = (in_strip * way[:, None] * way).sum(axis=1) / jnp.maximum(others, 1)
    return jnp.where(others > 0, alike, 0.0).sum() / jnp.maximum((others > 0).sum(), 1)


def spread(key: jax.Array, count: int, size: tuple[float, float]) -> jax.Array:
    """Places (count, 2) [m] near grid points in a rectangle from the origin."""
    columns = math.ceil(math.sqrt(count * size[0] / size[1]))
    rows = math.ceil(count / columns)
    number = jnp.arange(count)
    x, y = number % columns, number // columns
    x = x + 0.5 * (y % 2)  # in a hexagonal pattern
    cell = jnp.array([size[0] / columns, size[1] / rows])
    jitter = jax.random.uniform(key, (count, 2), minval=-0.1, maxval=0.1)
    places = jnp.stack([x + 0.25, y + 0.5], axis=-1) * cell
    return places + jitter * jnp.maximum(cell - 2 * RADIUS, 0.0)


def walls(*boxes: tuple[float, float, float, float]) -> jax.Array:
    """Outlines (6, 1, k) of rectangles, from x to x and from y to y [m]."""
    low_x, high_x, low_y, high_y = jnp.array(boxes).T
    pose = jnp.stack([(low_x + high_x) / 2, (low_y + high_y) / 2, 0 * low_x], axis=-1)
    size = jnp.stack([high_x - low_x, high_y - low_y], axis=-1)
    return outlines(pose, size, jnp.ones(len(boxes), bool))[:, None]


def corridor(length: float, width: float) -> jax.Array:
    """The walls of a corridor, longer than it is."""
    ends = -length, 2 * length
    return walls((*ends, -1.0, 0.0), (*ends, width, width + 1.0))


def paces(key: jax.Array, count: int) -> jax.Array:
    """Desired speeds (count,) [m/s] of Weidmann."""
    return 1.34 + 0.26 * jax.random.truncated_normal(key, -2, 2, (count,))


def walk(key: jax.Array, pushes: bool) -> tuple[jax.Array, ...]:
    """Places (n, 2) first and last, directions (n,), and the order over time."""
    place_key, speed_key, way_key = jax.random.split(key, 3)
    xy = spread(place_key, WALKERS, CORRIDOR)
    way = jnp.where(jnp.arange(WALKERS) % 2 == 0, 1.0, -1.0)
    way = jax.random.permutation(way_key, way)
    heading = jnp.stack([way, jnp.zeros(WALKERS)], axis=-1)
    aim, borders = aiming(paces(speed_key, WALKERS), heading), corridor(*CORRIDOR)

    def step(carry, _):
        xy, velocity = carry
        if pushes:
            xy, velocity = move(xy, velocity, aim, borders, CORRIDOR[0])
        else:
            xy = xy + DT * velocity
        xy = xy.at[:, 0].set(xy[:, 0] % CORRIDOR[0])
        return (xy, velocity), order(xy, way)

    steps = round(WALK_TIME / DT)
    (last, _), orders = jax.lax.scan(step, (xy, aim.wanted), length=steps)
    return xy, last, way, orders


def one_way(key: jax.Array, density: float, radius: float, dt: float) -> jax.Array:
    """Mean speed () [m/s] of people walking one way, in the second half of the time.

    There are `density` people per square metre, with bodies of a radius [m].
    """
    length, width = ONE_WAY
    count = round(density * length * width)
    place_key, speed_key = jax.random.split(key)
    xy, speed = spread(place_key, count, ONE_WAY), paces(speed_key, count)
    heading = jnp.tile(jnp.array([1.0, 0.0]), (count, 1))
    aim = aiming(speed, heading, radius)
    borders = corridor(length, width)

    def step(carry, _):
        xy, velocity = carry
        after, velocity = move(xy, velocity, aim, borders, length, dt)
        pace = (after - xy)[:, 0].mean() / dt
        return (after.at[:, 0].set(after[:, 0] % length), velocity), pace

    steps = round(ONE_WAY_TIME / dt)
    pace = jax.lax.scan(step, (xy, 0.3 * aim.wanted), length=steps)[1]
    return pace[steps // 2 :].mean()


def leave(key: jax.Array, speed: jax.Array) -> jax.Array:
    """Number of people that left a room through its door, over time."""
    xy, middle, half = spread(key, LEAVERS, (ROOM, ROOM)), ROOM / 2, DOOR / 2
    borders = walls(
        (-1.0, 0.0, -1.0, ROOM + 1.0),
        (-1.0, ROOM + WALL, -1.0, 0.0),
        (-1.0, ROOM + WALL, ROOM, ROOM + 1.0),
        (ROOM, ROOM + WALL, 0.0, middle - half),
        (ROOM, ROOM + WALL, middle + half, ROOM),
    )
    nobody, speeds = jnp.zeros(LEAVERS, bool), jnp.full(LEAVERS, speed)
    radii = jnp.full(LEAVERS, RADIUS)

    def step(carry, _):
        xy, velocity = carry
        # Through the door, and then far away, so that nobody blocks it.
        inward = jnp.clip(xy[:, 1], middle - half / 2, middle + half / 2)
        beyond = jnp.where(xy[:, 0] > ROOM - RADIUS, 1e3, ROOM)
        to_go = jnp.stack([beyond, inward], axis=-1) - xy
        heading = to_go / jnp.maximum(norm(to_go), 1e-3)[:, None]
        # Rounded otherwise, a crowd at a door ends otherwise.
        aim = bodies.Aim(speed * heading, heading, speeds, nobody, radii)
        xy, velocity = move(xy, velocity, aim, borders, 1e9)
        return (xy, velocity), (xy[:, 0] > ROOM).sum()

    start = xy, jnp.zeros((LEAVERS, 2))
    return jax.lax.scan(step, start, length=round(LEAVE_TIME / DT))[1]


def flow(left: np.ndarray) -> float:
    """Persons per second between the 10th and the 80th to leave, or until the end."""
    if left[-1] <= 10:
        return 0.0
    first = int(np.argmax(left >= 10))
    last = int(np.argmax(left >= 80)) if left[-1] >= 80 else left.size
    return (min(int(left[-1]), 80) - 10) / (DT * (last - first))


def run(config: Folder) -> None:
    """Simulates, and writes figure and table."""
    out = Path(config.out)
    require_writable(out / "crowds.csv", new_folders=True)
    jax.config.update("jax_platforms", "cpu")
    keys = jax.random.split(jax.random.key(0), SEEDS)
    many = jax.jit(jax.vmap(walk, (0, None)), static_argnums=1)
    walks = {pushes: jax.device_get(many(keys, pushes)) for pushes in (True, False)}
    speeds = jax.jit(jax.vmap(one_way, (0, None, None, None)), static_argnums=(1, 2, 3))
    leaving = jax.jit(jax.vmap(jax.vmap(leave, (0, None)), (None, 0)))
    left = np.asarray(leaving(keys, jnp.array(SPEEDS)))
    flows = np.array([[flow(one) for one in row] for row in left])
    rows: dict[tuple[str, str], np.ndarray] = {}
    for (density, radius), dt in itertools.product(CROWDED, PERIODS):
        what = f"speed at {density:g} 1/m2, radius {radius:g} m, steps of {dt:g} s"
        rows[what, "m/s"] = np.asarray(speeds(keys, density, radius, dt))
    late = {
        pushes: walked[3][:, -round(20.0 / DT) :] for pushes, walked in walks.items()
    }
    rows["order of lanes, last 20 s", ""] = late[True].mean(axis=1)
    rows["order of lanes without forces", ""] = late[False].mean(axis=1)
    for speed, row in zip(SPEEDS, flows, strict=True):
        rows[f"flow through the door at {speed:g} m/s", "1/s"] = row
    out.mkdir(parents=True, exist_ok=True)
    table = []
    for (what, unit), values in rows.items():
        print(f"{what}: {np.mean(values):.2f} ± {np.std(values):.2f} {unit}")
        seeds = {f"seed {k}": f"{x:.3f}" for k, x in enumerate(values)}
        table.append({"what": what, "unit": unit, **seeds})
    write_csv(out / "crowds.csv", table)
    draw(out / "crowds.png", walks, flows)


def draw(path: Path, walks: dict[bool, tuple], flows: np.ndarray) -> None:
    """The figure: a corridor first and last, lanes over time, flows by speed."""
    figure = Figure((10, 5.6), layout="constrained")
    grid = figure.add_gridspec(3, 2, height_ratios=[1, 1, 1.8])
    first, last, way, orders = walks[True]
    for row, (places, name) in enumerate(((first, "0 s"), (last, f"{WALK_TIME:g} s"))):
        axes = figure.add_subplot(grid[row, :])
        for sign, colour in ((1.0, "tab:blue"), (-1.0, "tab:orange")):
            axes.scatter(*places[0][way[0] == sign].T, s=22, c=colour)
        axes.set(xlim=(0, CORRIDOR[0]), ylim=(0, CORRIDOR[1]), ylabel="y [m]")
        axes.set_title(f"corridor at {name}", fontsize=9)
    axes = figure.add_subplot(grid[2, 0])
    time = DT * np.arange(1, orders.shape[1] + 1)
    for pushes, label in ((True, "social force"), (False, "no forces between people")):
        axes.plot(time, walks[pushes][3].mean(axis=0), label=label)
    axes.set(xlabel="time [s]", ylabel="order of lanes")
    axes.legend(fontsize=8)
    axes = figure.add_subplot(grid[2, 1])
    axes.errorbar(SPEEDS, flows.mean(axis=1), flows.std(axis=1), marker="o", capsize=3)
    axes.set(xlabel="desired speed [m/s]", ylabel=f"flow, door of {DOOR:g} m [1/s]")
    axes.set_ylim(bottom=0)
    write_atomically(path, lambda file: figure.savefig(file, dpi=110, format="png"))


main = command(Folder("docs/people"), run, __doc__)
