"""The social force model against published behaviour: speeds in a crowd, and lanes.

python eval/crowds.py
python eval/crowds.py --out runs/people

Writes `crowds.csv`.
"""

from carpark_mj.cli.process import enter

if __name__ == "__main__":  # before the imports, which take seconds
    enter("crowds", "crowds:main")

import functools
import itertools
import math
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.files import require_writable, write_csv
from carpark_mj.movers import bodies
from carpark_mj.movers.bodies import go_round, outlines, room_among, room_to
from shell import Folder, command

SEEDS = 5
BAND = 0.6  # m, half the width of the strip in which a walker looks for others
STRIP = 4.0  # m, half its length


class Corridor(NamedTuple):
    """People in a corridor whose ends are joined; all walk one way, or half each."""

    length: float = 12.0  # m
    width: float = 4.0
    density: float = 1.0  # persons per square metre
    radius: float = 0.2  # m, of their bodies
    dt: float = 0.2  # s, the control period
    seconds: float = 20.0
    both_ways: bool = False


# Four persons of 0.3 m per square metre would cover more than there is.
CROWDED = ((1.0, 0.2), (2.0, 0.2), (4.0, 0.2), (1.0, 0.3), (2.0, 0.3))
PERIODS = (0.2, 0.02)  # s
LANES = Corridor(30.0, 10.0, 0.2, 0.3, 0.2, 120.0, both_ways=True)


def apart(xy: jax.Array, length: float) -> bodies.Pair:
    """X and y (n, n) [m] from the second people to the first; x repeats."""
    x = xy[:, :1] - xy[:, 0]
    x = x - length * jnp.round(x / length) + 1e6 * jnp.eye(xy.shape[0])
    return x, xy[:, 1:] - xy[:, 1]


def order(xy: jax.Array, way: jax.Array, length: float) -> jax.Array:
    """Order of lanes (): how far people ahead and behind walk in one direction.

    The mean over walkers of the share of others in their strip with their direction,
    less the share with the opposite one: 0 in a mixed crowd, 1 in lanes.
    """
    x, y = apart(xy, length)
    in_strip = (jnp.abs(y) < BAND) & (jnp.abs(x) < STRIP)
    others = in_strip.sum(axis=1)
    alike = (in_strip * way[:, None] * way).sum(axis=1) / jnp.maximum(others, 1)
    return jnp.where(others > 0, alike, 0.0).sum() / jnp.maximum((others > 0).sum(), 1)


def spread(key: jax.Array, count: int, place: Corridor) -> jax.Array:
    """Places (count, 2) [m] near the points of a hexagonal grid."""
    columns = math.ceil(math.sqrt(count * place.length / place.width))
    rows = math.ceil(count / columns)
    x, y = jnp.arange(count) % columns, jnp.arange(count) // columns
    cell = jnp.array([place.length / columns, place.width / rows])
    jitter = jax.random.uniform(key, (count, 2), minval=-0.1, maxval=0.1)
    places = jnp.stack([x + 0.5 * (y % 2) + 0.25, y + 0.5], axis=-1) * cell
    return places + jitter * jnp.maximum(cell - 0.6, 0.0)


def walk(key: jax.Array, place: Corridor) -> tuple[jax.Array, jax.Array]:
    """Mean speed ahead [m/s] and order of lanes after each period, (steps,) each."""
    length, width, density, radius, dt, seconds, both_ways = place
    count = round(density * length * width)
    place_key, speed_key, way_key = jax.random.split(key, 3)
    speed = 1.34 + 0.26 * jax.random.truncated_normal(speed_key, -2, 2, (count,))
    way = jnp.where((jnp.arange(count) % 2 == 1) & both_ways, -1.0, 1.0)
    way = jax.random.permutation(way_key, way)
    heading = jnp.stack([way, 0.0 * way], axis=-1)
    nobody, radii = jnp.zeros(count, bool), jnp.full(count, radius)
    aim = bodies.Aim(speed[:, None] * heading, heading, speed, nobody, radii)
    # Walls 1 m thick along both sides, thrice as long as the corridor.
    walls = jnp.array([[length / 2, -0.5, 0.0], [length / 2, width + 0.5, 0.0]])
    size = jnp.array([[3 * length, 1.0]] * 2)
    borders = outlines(walls, size, jnp.ones(2, bool))[:, None]
    offset = functools.partial(apart, length=length)

    def step(carry, _):
        """As pedestrians move in a lot."""
        xy, velocity = carry
        end, after = bodies.advance_people(xy, velocity, aim, offset, [borders], dt)
        rooms = [room_among(offset(xy), radii), room_to(xy, radii, borders)]
        moved = go_round(rooms, end - xy, bodies.DODGE * dt**2)
        xy, after = xy + moved, after + (xy + moved - end) / dt
        xy = xy.at[:, 0].set(xy[:, 0] % length)
        pace = (moved[:, 0] * way).mean() / dt
        return (xy, after), (pace, order(xy, way, length))

    start = spread(place_key, count, place), 0.3 * aim.wanted
    return jax.lax.scan(step, start, length=round(seconds / dt))[1]


def run(config: Folder) -> None:
    """Simulates, and writes the table."""
    out = Path(config.out)
    require_writable(out / "crowds.csv", new_folders=True)
    jax.config.update("jax_platforms", "cpu")
    keys = jax.random.split(jax.random.key(0), SEEDS)
    many = jax.jit(jax.vmap(walk, (0, None)), static_argnums=1)
    rows: dict[tuple[str, str], np.ndarray] = {}
    for (density, radius), dt in itertools.product(CROWDED, PERIODS):
        pace = np.asarray(
            many(keys, Corridor(density=density, radius=radius, dt=dt))[0]
        )
        what = f"speed at {density:g} 1/m2, radius {radius:g} m, steps of {dt:g} s"
        rows[what, "m/s"] = pace[:, pace.shape[1] // 2 :].mean(axis=1)
    lanes = np.asarray(many(keys, LANES)[1])
    late = round(20.0 / LANES.dt)
    rows["order of lanes, first second", ""] = lanes[:, :5].mean(axis=1)
    rows["order of lanes, last 20 s", ""] = lanes[:, -late:].mean(axis=1)
    table = []
    for (what, unit), values in rows.items():
        print(f"{what}: {np.mean(values):.2f} ± {np.std(values):.2f} {unit}")
        seeds = {f"seed {k}": f"{x:.3f}" for k, x in enumerate(values)}
        table.append({"what": what, "unit": unit, **seeds})
    out.mkdir(parents=True, exist_ok=True)
    write_csv(out / "crowds.csv", table)


main = command(Folder("docs/people"), run, __doc__)
