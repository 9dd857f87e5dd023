"""The cars of an environment: drawn from presets, for bays they fit in.

Parked cars are drawn when a lot is reset, agents at every spawn. All of it is data, so
nothing recompiles.
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config import EnvConfig
from carpark_mj.config.vehicles import READ, is_name
from carpark_mj.layouts import Layout
from carpark_mj.mdp.bays import Wanted, draw_bays, fits, free_bays, shuffled_bays
from carpark_mj.mdp.parked_cars import poses_in_bays
from carpark_mj.mdp.reset_options import ResetOptions, given_goals, kept_clear
from carpark_mj.types import NO_BAY, ParkedCars
from carpark_mj.vehicle import (
    VEHICLES,
    Vehicle,
    VehicleParameters,
    make_vehicle,
    preset,
)
from carpark_mj.vehicle.parameters import scaled


class Start(NamedTuple):
    """The cars and goals of a lot that begins.

    Attributes:
        goal: (num_agents,) int32 goals, `NO_BAY` where agents choose them.
        parked_cars: the parked cars, in their bays.
        vehicles: nominal parameters of the agents' cars (num_agents,).
        kind: (num_agents,) int32 which of the fleet's kinds they are; None if it has
            one.
    """

    goal: jax.Array
    parked_cars: ParkedCars
    vehicles: Vehicle
    kind: jax.Array | None = None


class Fleet:
    """The presets that the cars of an environment are drawn from; constants only.

    Attributes:
        agent_names: presets of the kinds of cars that agents drive.
        agents: their parameters.
        parked_names: the same for parked cars.
        parked_cars: their parameters.
    """

    def __init__(self, config: EnvConfig, vehicle: VehicleParameters) -> None:
        """Looks the presets up; `vehicle` stands for an empty list.

        Raises:
            ValueError: an unknown preset; the message lists the known ones.
        """
        self._config = config
        names = config.fleet
        own_name = _name(vehicle, config.vehicle)
        self.agent_names = tuple(map(_known_as, names.agents)) or (own_name,)
        self.parked_names = tuple(map(_known_as, names.parked_cars)) or (own_name,)
        self.agents = tuple(map(preset, names.agents)) or (vehicle,)
        self.parked_cars = tuple(map(preset, names.parked_cars)) or (vehicle,)
        kinds = [make_vehicle(params) for params in self.agents]
        self._kinds: Vehicle = jax.tree.map(lambda *x: jnp.stack(x), *kinds)
        self._size = make_vehicle(vehicle).size
        weights = names.agent_weights or (1.0,) * len(self.agents)
        self._weights = jnp.array(weights, jnp.float32)
        weights = names.parked_weights or (1.0,) * len(self.parked_cars)
        self._parked_weights = jnp.array(weights, jnp.float32)

    @property
    def mixed(self) -> bool:
        """Whether agents drive cars of several kinds, drawn at every spawn."""
        return bool(self._config.fleet.agents)

    def start(
        self,
        layout: Layout,
        key: jax.Array,
        present: jax.Array | None = None,
        options: ResetOptions | None = None,
    ) -> Start:
        """Draws goals, parked cars and the agents' cars of a lot.

        Args:
            layout: of the lot.
            key: consumed.
            present: (num_agents,) bool, agents that are in the lot; None = all.
            options: starts that are given.
        """
        if self._config.varies:
            return self._start_varied(layout, key, present, options)
        n, m = self._config.num_agents, self._config.num_parked_cars
        goals = 0 if self._config.goals.dynamic else n
        order = shuffled_bays(layout, key)
        goal = order[:goals] if goals else self._no_goals()
        size = jnp.broadcast_to(self._size, (m, 2))
        bay = order[goals : goals + m]
        if options is not None:
            goal, bay = self._around_given(layout, order, options)
        parked = _in_bays(layout, ParkedCars(bay, jnp.zeros((m, 3)), size))
        return Start(goal, parked, self.of_kind(jnp.zeros(n, jnp.int32)))

    def _around_given(
        self, layout: Layout, order: jax.Array, options: ResetOptions
    ) -> tuple[jax.Array, jax.Array]:
        """Goals (num_agents,) and bays (num_parked_cars,) int32 around given starts.

        Args:
            layout: of the lot.
            order: (bays,) int32 in which bays are assigned.
            options: starts that are given.
        """
        clear = kept_clear(layout, options, self._size)
        order = order[jnp.argsort(clear[order], stable=True)]  # those kept clear last
        goal = given_goals(options, self._config.num_agents)
        drawn = (goal == NO_BAY) & (not self._config.goals.dynamic)
        goal = jnp.where(drawn, order[jnp.cumsum(drawn) - 1], goal)
        place = jnp.sum(drawn) + jnp.arange(self._config.num_parked_cars)
        free = place < jnp.sum(layout.bay_mask & ~clear)
        return goal, jnp.where(free, order[place], NO_BAY)

    def _start_varied(
        self,
        layout: Layout,
        key: jax.Array,
        present: jax.Array | None,
        options: ResetOptions | None,
    ) -> Start:
        config = self._config
        n, m = config.num_agents, config.num_parked_cars
        goal_key, count_key, scale_key, place_key, offset_key = jax.random.split(key, 5)
        goal_bays = jnp.broadcast_to(
            self._goal_bays(layout), (n, len(self.agents), layout.num_bays)
        )
        clear = jnp.zeros(layout.num_bays, bool)
        if options is not None:
            clear = kept_clear(layout, options, self._kinds.size.max(axis=0))
            given = given_goals(options, n)[:, None]
            own = jnp.arange(layout.num_bays) == given
            usable = jnp.where(given == NO_BAY, ~clear, own)
            goal_bays = goal_bays & usable[:, None]
        agents = Wanted(
            fits=goal_bays,
            weights=self._weights,
            cars=jnp.ones(n, bool) if present is None else present,
            anywhere=True,
        )
        kind, goal = draw_bays(agents, layout.bay_mask, goal_key)
        if options is not None:
            given = given_goals(options, n)
            goal = jnp.where(given == NO_BAY, goal, given)
        if config.goals.dynamic:
            goal = self._no_goals()
        sizes = jnp.array([[p.length, p.width] for p in self.parked_cars])
        sizes = sizes * _uniform(config.jitter.scale, scale_key, (m, 1, 1))
        parked = Wanted(
            fits=fits(layout.bay_size, sizes),
            weights=self._parked_weights,
            cars=jnp.arange(m) < self._num_parked_cars(layout, count_key),
            anywhere=False,
        )
        free = free_bays(layout, goal) & ~clear
        parked_kind, bay = draw_bays(parked, free, place_key)
        jitter, offset = config.jitter, None
        if jitter.moves:
            ranges = (jitter.along, jitter.across, jitter.heading)
            keys = jax.random.split(offset_key, 3)
            columns = [_uniform(*pair, (m,)) for pair in zip(ranges, keys, strict=True)]
            offset = jnp.stack(columns, axis=-1)
        size = sizes[jnp.arange(m), parked_kind]
        cars = ParkedCars(bay, jnp.zeros((m, 3)), size, offset, parked_kind)
        if not self.mixed:
            kind = jnp.zeros_like(kind)
        return Start(goal, _in_bays(layout, cars), self.of_kind(kind), kind)

    def draw_kinds(self, key: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Kinds (num_agents,) int32 of cars drawn by weight, and the next key.

        Without a fleet of agents they are all of the one kind and nothing is drawn.
        """
        shape = (self._config.num_agents,)
        if not self.mixed:
            return jnp.zeros(shape, jnp.int32), key
        key, kind_key = jax.random.split(key)
        logits = jnp.log(self._weights)
        kind = jax.random.categorical(kind_key, logits, shape=shape)
        return kind.astype(jnp.int32), key

    def parked_vehicles(self, cars: ParkedCars) -> list[VehicleParameters]:
        """The presets, scaled, of parked cars."""
        lengths = np.asarray(cars.size, float)[:, 0]
        kinds = [0] * len(lengths) if cars.kind is None else np.asarray(cars.kind)
        presets = [self.parked_cars[kind] for kind in kinds]
        return [
            scaled(car, length / car.length)
            for car, length in zip(presets, lengths, strict=True)
        ]

    def _no_goals(self) -> jax.Array:
        return jnp.full(self._config.num_agents, NO_BAY, jnp.int32)

    def of_kind(self, kind: jax.Array) -> Vehicle:
        """Nominal parameters of cars of kinds (...) int32."""
        return jax.tree.map(lambda x: x[kind], self._kinds)

    def _goal_bays(self, layout: Layout) -> jax.Array:
        """Bays (kinds, bays) bool that can be goals of each kind of car."""
        if not self.mixed:  # any bay is a goal for the one kind of car
            return layout.goal_mask[None]
        slack = self._config.episode.slack
        return fits(layout.bay_size, self._kinds.size, slack) & layout.goal_mask

    def _num_parked_cars(self, layout: Layout, key: jax.Array) -> jax.Array:
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


def _name(vehicle: VehicleParameters, named: str) -> str:
    """The name of a car: its preset's, `named` if it is that one."""
    if vehicle == preset(named):
        return _known_as(named)
    return VEHICLES.name_of(vehicle) or "custom car"


def _known_as(vehicle: str) -> str:
    """The name of a car that a config names or describes."""
    return vehicle if is_name(vehicle) else READ.load()(vehicle)[0]


def _in_bays(layout: Layout, cars: ParkedCars) -> ParkedCars:
    return dataclasses.replace(cars, pose_w=poses_in_bays(layout, cars))


def _uniform(
    bounds: tuple[float, float], key: jax.Array, shape: tuple[int, ...]
) -> jax.Array:
    low, high = bounds
    return jax.random.uniform(key, shape, jnp.float32, low, high)
