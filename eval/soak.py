"""Soak test of the physics: 10^7 car-steps of extreme inputs.

python eval/soak.py
python eval/soak.py --car-steps 1000000 --first-case 5000000

All presets with widely randomised parameters, from ice to dry asphalt, under random,
alternating, saturated and invalid inputs. Prints a table of the worst cases; exit code
1 if a car had a non-finite state, too much energy, or left the ground. A case is one
car for one episode and is determined by its number.
"""

from carpark_mj.cli.process import enter

if __name__ == "__main__":  # before the imports, which take seconds
    enter("soak", "soak:main")

import dataclasses
import time
from functools import partial
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from rich.progress import track

from carpark_mj.config import RandomizationConfig, SimConfig
from carpark_mj.config.checks import CheckedConfig, Count, Natural, NonNegative
from carpark_mj.evaluation.tables import print_rows
from carpark_mj.mdp.actions import sanitize_numbers
from carpark_mj.physics.mjx import CarState, MjxPhysics
from carpark_mj.spawning.randomization import randomize
from carpark_mj.vehicle import PRESETS, Vehicle, make_vehicle
from shell import command

ArrayOrNumpy = TypeVar("ArrayOrNumpy", jax.Array, np.ndarray)

HOLD = 10  # control steps of 20 ms for which an action is held, as in the environment
MAX_CASE = 2**31 - 1  # beyond it the seeds, int32, would repeat seeds of other cases
ROUNDS = 60  # actions of an episode: 12 s
RANDOMISATION = RandomizationConfig(
    mass=(0.75, 1.25),
    cg_x=(0.89, 1.11),  # 0.15 m or more in every preset
    cg_height=(0.8, 1.2),
    friction=(0.13, 1.2),  # 0.12 (ice) to 1.08
    tyre_stiffness=(0.7, 1.3),
    brake_gain=(0.5, 1.5),
    steering_offset=(-0.03, 0.03),
    steering_lag=(0.0, 0.3),
)
PATTERNS = ("random", "held", "lock to lock", "brake to throttle", "flip", "invalid")
INVALID = (np.nan, np.inf, -np.inf, 1e30, -5.0, 1.0001, 1.0, -1.0, 0.5, 0.0)


@struct.dataclass
class Worst:
    """The worst of each case; all (n,).

    Attributes:
        broken: steps that produced a non-finite number.
        hop: of a tyre above the ground [m]; negative while its spring is loaded.
        energy: per mass [J/kg].
        invalid: actions that had to be sanitized.
    """

    broken: jax.Array
    hop: jax.Array
    energy: jax.Array
    invalid: jax.Array


class Soak:
    """Compiled cases."""

    def __init__(self, sim: SimConfig) -> None:
        """Prepares the physics and the nominal cars."""
        self.physics = MjxPhysics(dataclasses.replace(sim, ctrl_dt=0.02, trace_dt=0.02))
        cars = [make_vehicle(params) for params in PRESETS.values()]
        self._nominal: Vehicle = jax.tree.map(lambda *x: jnp.stack(x), *cars)
        self.run = jax.jit(self._run)

    def run_batches(
        self, first_case: int, num_batches: int, num_cars: int
    ) -> tuple[np.ndarray, Worst]:
        """Runs batches of `num_cars` cases each, counted on from `first_case`.

        Returns:
            The numbers of all cases (n,) and the worst of each.

        Raises:
            ValueError: a number beyond `MAX_CASE`.
        """
        count = num_batches * num_cars
        last = first_case + count - 1
        if last > MAX_CASE:
            raise ValueError(
                f"cases must be numbered up to {MAX_CASE}, not {last}: first_case is "
                f"{first_case}, of {count} cases"
            )
        firsts = range(first_case, first_case + count, num_cars)
        worst = [
            jax.device_get(self.run(jnp.arange(k, k + num_cars, dtype=jnp.int32)))
            for k in track(firsts, "soaking", transient=True)
        ]
        cases = np.arange(first_case, first_case + count)
        return cases, jax.tree.map(lambda *x: np.concatenate(x), *worst)

    def _run(self, cases: jax.Array) -> Worst:
        """Runs cases (n,) of int32 for an episode each."""
        keys = jax.vmap(jax.random.key)(cases)
        preset, pattern = preset_of(cases), pattern_of(cases)

        def spawn(preset: jax.Array, key: jax.Array) -> tuple[Vehicle, jax.Array]:
            car_key, yaw_key = jax.random.split(key)
            nominal = jax.tree.map(lambda x: x[preset], self._nominal)
            yaw = jax.random.uniform(yaw_key, minval=-jnp.pi, maxval=jnp.pi)
            return randomize(RANDOMISATION, nominal, car_key), yaw

        fleet, yaw = jax.vmap(spawn)(preset, keys)
        pose = jnp.pad(yaw[:, None], ((0, 0), (2, 0)))
        zero = jnp.zeros(cases.shape, jnp.float32)
        carry = self.physics.init(pose, fleet), Worst(zero, zero - jnp.inf, zero, zero)

        def act(carry, step: jax.Array):
            draw = partial(draw_action, step)
            action = jax.vmap(draw)(pattern, fleet, keys)
            action, invalid = sanitize_numbers(action)
            state, worst = carry
            worst = dataclasses.replace(worst, invalid=worst.invalid + invalid)
            hold = partial(self._hold, action)
            return jax.lax.scan(hold, (state, worst), length=HOLD)

        (_, worst), _ = jax.lax.scan(act, carry, jnp.arange(ROUNDS))
        return worst

    def _hold(self, action: jax.Array, carry: tuple[CarState, Worst], _: None):
        state, worst = carry
        state = self.physics.step(state, action)
        worst = dataclasses.replace(
            worst,
            broken=worst.broken + ~state.finite,
            hop=jnp.maximum(worst.hop, hops(state).max(axis=-1)),
            energy=jnp.maximum(worst.energy, energy_per_mass(state)),
        )
        return (state, worst), None


def preset_of(case: ArrayOrNumpy) -> ArrayOrNumpy:
    """Index of a case's car in `PRESETS`."""
    return case % len(PRESETS)


def pattern_of(case: ArrayOrNumpy) -> ArrayOrNumpy:
    """Index of a case's inputs in `PATTERNS`."""
    return case // len(PRESETS) % len(PATTERNS)


def draw_action(
    step: jax.Array, pattern: jax.Array, vehicle: Vehicle, key: jax.Array
) -> jax.Array:
    """The action (2,) of one case at action number `step`, possibly invalid."""
    wave_key, noise_key = jax.random.split(jax.random.fold_in(key, 1))
    half = jax.random.randint(wave_key, (), 1, 13)  # half a period of 0.2 to 2.4 s
    square = jnp.where(step // half % 2 == 0, 1.0, -1.0)
    flip = jnp.where(step % 2 == 0, 1.0, -1.0)

    def uniform(number: jax.Array) -> jax.Array:
        noise = jax.random.fold_in(noise_key, number)
        return jax.random.uniform(noise, (2,), minval=-1.0, maxval=1.0)

    held, noise = uniform(step // half), uniform(step)
    # As long as the wheels take from one lock to the other at the rate limit.
    turn = jnp.ceil(2 * vehicle.max_steering / vehicle.steering_rate / 0.2)
    lock = jnp.where(step // turn.astype(int) % 2 == 0, 1.0, -1.0)
    wild = jax.random.choice(
        jax.random.fold_in(noise_key, step + ROUNDS), jnp.array(INVALID), (2,)
    )
    mixed = (lock, held[1]), (held[0], square), (flip, flip)
    return jnp.stack([noise, held, *map(jnp.stack, mixed), wild])[pattern]


def wheel_heights(state: CarState) -> jax.Array:
    """Heights (..., 4) of the wheels above their rest positions [m]."""
    w, x, y, z = jnp.moveaxis(state.qpos[..., 3:7], -1, 0)
    across = jnp.stack([2 * (x * z - w * y), 2 * (y * z + w * x)], axis=-1)
    rise = jnp.sum(state.vehicle.hub * across[..., None, :], axis=-1)
    return state.qpos[..., 2, None] + rise


def hops(state: CarState) -> jax.Array:
    """Heights (..., 4) of the tyres above the ground [m]; negative: loaded."""
    tyres = state.vehicle.tyres
    droop = tyres.static_load / tyres.vertical_stiffness[..., None]
    return wheel_heights(state) - droop


def energy_per_mass(state: CarState) -> jax.Array:
    """Kinetic and spring energy (...) over mass [J/kg], of the wheels their spin."""
    vehicle = state.vehicle
    linear, angular = state.qvel[..., :3], state.qvel[..., 3:6]
    spin = state.qvel[..., [7, 9, 10, 11]]
    turning = vehicle.body_inertia[..., 1, :] * angular**2
    spinning = vehicle.wheel_inertia[..., None] * spin**2
    sprung = vehicle.tyres.vertical_stiffness[..., None] * wheel_heights(state) ** 2
    rest = turning.sum(-1) + spinning.sum(-1) + sprung.sum(-1)
    return 0.5 * (jnp.sum(linear**2, axis=-1) + rest / vehicle.mass)


def breaches(worst: Worst, max_hop: float, max_energy: float) -> np.ndarray:
    """(n,) bool, the cases that broke a limit; a NaN breaks it too."""
    held = (worst.hop <= max_hop) & (worst.energy <= max_energy)
    return ~np.asarray(held) | (np.asarray(worst.broken) > 0)


@dataclasses.dataclass(frozen=True)
class SoakConfig(CheckedConfig):
    """Settings of `python eval/soak.py`.

    Attributes:
        car_steps: total number of substeps of cars, rounded up to full batches.
        num_cars: number of cars simulated in parallel.
        first_case: number of the first case.
        max_hop: largest allowed gap between tyre and ground, at full droop [m].
        max_energy: largest allowed kinetic and spring energy per mass [J/kg]; a car at
            its speed limit of 3 m/s has 4.5.
        sim: time step, slope and surface; `ctrl_dt` is always 20 ms, so that
            hops are seen.
    """

    car_steps: Count = 10_000_000
    num_cars: Count = 720
    first_case: Natural = 0
    max_hop: NonNegative = 0.0
    max_energy: NonNegative = 8.0
    sim: SimConfig = dataclasses.field(default_factory=SimConfig)


def run(config: SoakConfig) -> int:
    """Runs the cases and prints the table; returns 1 if a case broke a limit."""
    cars = Soak(config.sim)
    substeps = ROUNDS * HOLD * cars.physics.sim.num_substeps
    num_batches = -(-config.car_steps // (substeps * config.num_cars))
    begun = time.monotonic()
    cases, worst = cars.run_batches(config.first_case, num_batches, config.num_cars)
    print_table(config, worst, cases)
    bad = breaches(worst, config.max_hop, config.max_energy)
    told = (
        f"{bad.sum()} of {len(cases)} cases broke a limit" if any(bad) else "all held"
    )
    print(
        f"{len(cases) * substeps:.3g} car-steps of {cars.physics.sim.sim_dt:g} s in "
        f"{time.monotonic() - begun:.0f} s, "
        f"{int(worst.invalid.sum())} actions sanitized; {told}"
    )
    return int(bad.any())


def print_table(config: SoakConfig, worst: Worst, cases: np.ndarray) -> None:
    """The worst by preset and by pattern, with the case that reached it."""
    values = {
        f"tyre off the ground, mm (<= {1e3 * config.max_hop:g})": 1e3 * worst.hop,
        f"energy, J/kg (<= {config.max_energy:g})": worst.energy,
    }
    groups = [(name, preset_of(cases) == k) for k, name in enumerate(PRESETS)]
    groups += [(name, pattern_of(cases) == k) for k, name in enumerate(PATTERNS)]
    rows: list[dict[str, Any]] = []
    for name, mask in groups:
        if not mask.any():
            continue
        where = np.flatnonzero(mask)
        broken = int(worst.broken[where].sum())
        rows.append({"cars": name, "cases": len(where), "non-finite": broken})
        for column, numbers in values.items():
            k = where[np.argmax(numbers[where])]
            rows[-1][column] = f"{numbers[k]:.2f} ({cases[k]})"
    ends = {sum(bool(mask.any()) for _, mask in groups[: len(PRESETS)]) - 1}
    print_rows(rows, "worst found, in brackets its case", ends=ends)


main = command(SoakConfig, run, __doc__, fused=True)
