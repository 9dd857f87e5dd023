"""The cars of an environment: drawn from presets, for bays they fit in.

Parked cars are drawn when a lot is reset, agents at every spawn. All of it is data, so
nothing recompiles. Without a fleet, jitter or occupancy all cars are the one of the
configuration and bays are drawn by `goals.init_occupancy`, as if this did not exist.
"""

import dataclasses
import math
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config import EnvConfig, LayoutConfig
from carpark_mj.layouts import Layout, make_layout
from carpark_mj.layouts.standards import DesignCar
from carpark_mj.layouts.turning import Entry
from carpark_mj.mdp.goals import Occupancy, draw_places, init_occupancy
from carpark_mj.mdp.parked_cars import SLACK, fits, parked_poses, touches
from carpark_mj.mdp.spawning.respawn import Blocked
from carpark_mj.vehicle import Vehicle, VehicleParameters, make_vehicle, preset
from carpark_mj.vehicle.parameters import scaled

SAMPLED_LOTS = 4  # in which a random lot's bays are measured against the fleet


@dataclasses.dataclass(frozen=True)
class Start:
    """What a lot starts with.

    Attributes:
        occupancy: goals and parked cars.
        cars: the agents' nominal cars, (num_agents,) or one for all.
        parked_size: (num_parked_cars, 2) [m].
        parked_offset: see `State`.
    """

    occupancy: Occupancy
    cars: Vehicle
    parked_size: jax.Array
    parked_offset: jax.Array | None


class Fleet:
    """What the cars of an environment are drawn from; constants only.

    Attributes:
        agents: parameters of the agents' cars, one each.
        parked_cars: the same for parked cars.
        varies: whether anything differs from one kind of car, neatly parked.
        mixed: whether agents drive several kinds.
    """

    def __init__(self, config: EnvConfig, vehicle: VehicleParameters) -> None:
        """Looks the presets up; `vehicle` stands for an empty list.

        Raises:
            ValueError: an unknown preset; the message lists the known ones.
        """
        self._config = config
        names = config.fleet
        self.agents = tuple(map(preset, names.agents)) or (vehicle,)
        self.parked_cars = tuple(map(preset, names.parked_cars)) or (vehicle,)
        self.mixed = bool(names.agents)
        self.varies = names.is_on or config.jitter.is_on or config.occupancy is not None
        self._cars = jax.tree.map(
            lambda *x: jnp.stack(x), *map(make_vehicle, self.agents)
        )
        self._one = jax.tree.map(lambda x: x[0], self._cars)
        self._size = make_vehicle(vehicle).size
        self._weights = _weights(names.agent_weights, self.agents)
        self._parked_weights = _weights(names.parked_weights, self.parked_cars)

    def start(self, layout: Layout, key: jax.Array) -> Start:
        """Draws goals, parked cars and the agents' cars of a lot; `key` is consumed."""
        config = self._config
        n, m = config.num_agents, config.num_parked_cars
        dynamic = config.goals.dynamic
        exploring = jnp.full(n, layout.num_bays, jnp.int32)
        if not self.varies:
            occupancy = init_occupancy(layout, 0 if dynamic else n, m, key)
            if dynamic:
                occupancy = dataclasses.replace(occupancy, goal=exploring)
            return Start(
                occupancy=occupancy,
                cars=self._one,
                parked_size=jnp.broadcast_to(self._size, (m, 2)),
                parked_offset=None,
            )
        goal_key, count_key, scale_key, place_key, offset_key = jax.random.split(key, 5)
        kind, goal = draw_places(
            jnp.broadcast_to(
                self._goal_bays(layout, self._cars.size),
                (n, len(self.agents), layout.num_bays),
            ),
            self._weights,
            layout.bay_mask,
            jnp.ones(n, bool),
            goal_key,
            anywhere=True,
        )
        if dynamic:
            goal = exploring
        sizes = jnp.array([[p.length, p.width] for p in self.parked_cars])
        sizes = sizes * _uniform(config.jitter.scale, scale_key, (m, 1, 1))
        parked, bay = draw_places(
            fits(layout.bay_size, sizes),
            self._parked_weights,
            layout.bay_mask.at[goal].set(False),
            jnp.arange(m) < self._num_parked(layout, count_key),
            place_key,
            anywhere=False,
        )
        jitter, offset = config.jitter, None
        if jitter.moves:
            ranges = (jitter.along, jitter.across, jitter.heading)
            keys = jax.random.split(offset_key, 3)
            columns = [_uniform(*pair, (m,)) for pair in zip(ranges, keys, strict=True)]
            offset = jnp.stack(columns, axis=-1)
        return Start(
            occupancy=Occupancy(goal=goal, parked_bay=bay),
            cars=jax.tree.map(lambda x: x[kind], self._cars)
            if self.mixed
            else self._one,
            parked_size=sizes[jnp.arange(m), parked],
            parked_offset=offset,
        )

    def draw_agents(self, key: jax.Array) -> tuple[Vehicle, jax.Array]:
        """Nominal cars of agents that spawn, as in `Start`, and a key to go on with.

        Without a fleet of agents nothing is drawn and the key stays what it was.
        """
        if not self.mixed:
            return self._one, key
        key, kind_key = jax.random.split(key)
        shape = (self._config.num_agents,)
        kind = jax.random.categorical(kind_key, jnp.log(self._weights), shape=shape)
        return jax.tree.map(lambda x: x[kind], self._cars), key

    def bays_for(
        self, layout: Layout, size: jax.Array, parked_size: jax.Array
    ) -> tuple[jax.Array | None, jax.Array | None]:
        """Bays that can be goals, and bays that parked cars can stand in.

        Args:
            layout: the lot.
            size: (num_agents, 2) of the agents' cars [m].
            parked_size: (num_parked_cars, 2) [m].

        Returns:
            (num_agents, bays) and (num_parked_cars, bays) bool; None if nothing varies.
        """
        if not self.varies:
            return None, None
        return self._goal_bays(layout, size), fits(layout.bay_size, parked_size)

    def parked_pose(
        self, layout: Layout, bay: jax.Array, size: jax.Array, offset: jax.Array | None
    ) -> jax.Array:
        """Poses (num_parked_cars, 3) of the parked cars, see `fit.parked_poses`."""
        if not self.varies:
            return layout.bay_pose[bay]
        return parked_poses(layout, bay, size, offset)

    def blocked(
        self,
        layout: Layout,
        old: jax.Array,
        new: jax.Array,
        parked_size: jax.Array,
        parked_offset: jax.Array | None,
    ) -> Blocked:
        """Where agents cannot spawn; nowhere special if they all drive alike.

        Args:
            layout: the lot.
            old: (num_agents, 2) of the agents' cars so far [m].
            new: (num_agents, 2) of the cars drawn for them [m].
            parked_size: (num_parked_cars, 2) [m].
            parked_offset: see `State`.
        """

        def blocked(agent: jax.Array, occupancy: Occupancy, renewed: jax.Array):
            if not self.mixed:
                return None
            size = jnp.where(renewed, new[agent], old[agent])
            parked_pose = self.parked_pose(
                layout, occupancy.parked_bay, parked_size, parked_offset
            )
            return lambda pose: touches(layout, pose, size, parked_pose, parked_size)

        return blocked

    def parked_vehicles(self, parked_size: np.ndarray) -> list[VehicleParameters]:
        """The presets, scaled, of parked cars of sizes (num_parked_cars, 2) [m]."""
        shapes = np.array([p.length / p.width for p in self.parked_cars])
        cars: list[VehicleParameters] = []
        for length, width in np.asarray(parked_size, float):
            # The scale keeps proportions, and no two presets share theirs.
            car = self.parked_cars[np.abs(shapes - length / width).argmin()]
            cars.append(scaled(car, length / car.length))
        return cars

    def _goal_bays(self, layout: Layout, size: jax.Array) -> jax.Array:
        if not self.mixed:  # as ever, any bay is a goal for the one kind of car
            return jnp.ones((*size.shape[:-1], layout.num_bays), bool)
        slack = SLACK[self._config.episode.parked_rule]
        return fits(layout.bay_size, size, slack)

    def _num_parked(self, layout: Layout, key: jax.Array) -> jax.Array:
        """How many parked cars the lot has; a whole number within the range."""
        most = jnp.asarray(self._config.num_parked_cars, jnp.int32)
        if self._config.occupancy is None:
            return most
        low, high = self._config.occupancy
        bays = jnp.sum(layout.bay_mask)
        rounding = 1e-4  # 0.3 of 20 bays is 6, in float32 too
        least = jnp.ceil(low * bays - rounding).astype(jnp.int32)
        limit = jnp.floor(high * bays + rounding).astype(jnp.int32)
        count = jax.random.randint(key, (), least, jnp.maximum(limit, least) + 1)
        return jnp.minimum(count, most)

    def check(self, lot: LayoutConfig, layout: Layout | None) -> None:
        """Refuses impossible cars, and more parked cars than there can be.

        Agents' cars must get into some bay from the aisle (on the grid they turn on the
        spot), and all cars of a fleet must fit into one.

        Args:
            lot: of the environment.
            layout: its layout, None if that is random: then a few are drawn.

        Raises:
            ValueError: naming the car or the range and what is allowed.
        """
        config = self._config
        if config.occupancy is not None:
            needed = math.floor(config.occupancy[1] * lot.min_bays + 1e-6)
            if needed > config.num_parked_cars:
                raise ValueError(
                    f"occupancy of up to {config.occupancy[1]:g} of {lot.min_bays} "
                    f"bays needs num_parked_cars of at least {needed}, not "
                    f"{config.num_parked_cars}"
                )
        if config.physics != "grid":
            names = config.fleet.agents or (config.vehicle,)
            for car in zip(names, self.agents, strict=True):
                _require_entry(*car, lot.entries)
        one_size = not config.fleet.is_on and config.jitter.scale == (1.0, 1.0)
        if not self.varies or (one_size and layout is None):
            return
        lots = [layout] if layout is not None else _sample(lot)
        bays = [np.asarray(x.bay_size)[np.asarray(x.bay_mask)] for x in lots]
        rule = config.episode.parked_rule
        if self.mixed:
            names = config.fleet.agents
            cars = zip(names, self.agents, strict=True)
            room = (1.0, SLACK[rule], bays)
            counts = [_fitting("fleet.agents", *car, *room) for car in cars]
            goals = 0 if config.goals.dynamic else config.num_agents
            if layout is not None and max(counts) < goals:
                raise ValueError(
                    f"fleet.agents find goals in only {max(counts)} bays of this lot "
                    f"under the {rule} rule, fewer than num_agents {config.num_agents}"
                )
        if config.num_parked_cars:
            names = config.fleet.parked_cars or (config.vehicle,)
            for car in zip(names, self.parked_cars, strict=True):
                _fitting("parked cars", *car, config.jitter.scale[1], 0.0, bays)


def _sample(lot: LayoutConfig) -> list[Layout]:
    keys = jax.random.split(jax.random.key(0), SAMPLED_LOTS)
    return [make_layout(lot, key) for key in keys]


def _require_entry(
    name: str, params: VehicleParameters, entries: Sequence[Entry]
) -> None:
    """Refuses a car that gets into no bay of a lot, as families refuse their own."""
    car = DesignCar(
        params.length,
        params.width,
        params.wheelbase,
        params.rear_overhang,
        params.max_steering,
    )
    if not entries or any(entry.least(car) <= entry.aisle for entry in entries):
        return
    entry = min(entries, key=lambda entry: entry.least(car) - entry.aisle)
    raise ValueError(
        f"the {name} needs an aisle of {entry.least(car):.2f} m to turn into a bay "
        f"{entry.bay_width:.2f} m wide (carpark_mj.layouts.turning), the lot's aisles "
        f"are up to {entry.aisle:.2f} m wide"
    )


def _fitting(
    kind: str,
    name: str,
    params: VehicleParameters,
    scale: float,
    slack: float,
    lots: Sequence[np.ndarray],
) -> int:
    """In how many bays of the roomiest lot a car fits; refuses 0."""
    size = scale * np.array([params.length, params.width])
    count = max(int((size + slack <= bays).all(axis=1).sum()) for bays in lots)
    if not count:
        longest, widest = np.concatenate(lots).max(axis=0)
        raise ValueError(
            f"{kind}: the {name}, {size[0]:.2f} m x {size[1]:.2f} m, fits with "
            f"{slack:g} m to spare in no bay of the lot: these are up to "
            f"{longest:.2f} m long and {widest:.2f} m wide"
        )
    return count


def _weights(given: Sequence[float], kinds: Sequence[object]) -> jax.Array:
    return jnp.array(given or (1.0,) * len(kinds), jnp.float32)


def _uniform(
    bounds: tuple[float, float], key: jax.Array, shape: tuple[int, ...]
) -> jax.Array:
    low, high = bounds
    return jax.random.uniform(key, shape, jnp.float32, low, high)
