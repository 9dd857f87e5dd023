"""The cars of an environment: drawn from presets, for bays they fit in, and varied.

Parked cars are drawn when a lot is reset, agents at every spawn. All of it is data, so
nothing recompiles.
"""

import dataclasses
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config import EnvConfig
from carpark_mj.layouts import Layout
from carpark_mj.mdp.parked_cars import fits, free_bays, poses_in_bays
from carpark_mj.spawning.config import ADDED, RandomizationConfig
from carpark_mj.spawning.reset_options import ResetOptions, given_goals, kept_clear
from carpark_mj.types import NO_BAY, ParkedCars
from carpark_mj.vehicle import VEHICLES, Vehicle, VehicleParameters, make_vehicle
from carpark_mj.vehicle.mjcf import chassis_inertial
from carpark_mj.vehicle.parameters import scaled
from carpark_mj.vehicle.presets import cars_of, fleet_cars
from carpark_mj.vehicle.vehicle import with_grip, with_mass


class Start(NamedTuple):
    """The cars and goals of a lot that begins."""

    goal: jax.Array  # (num_agents,) int32, `NO_BAY` where agents choose them
    parked_cars: ParkedCars  # in their bays
    vehicles: Vehicle  # nominal parameters of the agents' cars (num_agents,)
    kind: jax.Array  # (num_agents,) int32 which of the fleet's kinds they are


class Fleet:
    """The presets that the cars of an environment are drawn from; constants only.

    `agent_names` and `agents` are the presets of cars that agents drive and their
    parameters, `parked_names` and `parked_cars` those of parked cars. `mixed` is
    whether agents drive cars of several kinds, drawn at every spawn.
    """

    def __init__(self, config: EnvConfig, vehicle: VehicleParameters) -> None:
        """Looks the presets up; `vehicle` stands for an empty list."""
        self._config = config
        [(own_name, own_car)] = cars_of(config.vehicle)
        if vehicle != own_car:
            own_name = VEHICLES.name_of(vehicle) or "custom car"
        own = ((own_name, vehicle),)
        agents = fleet_cars(config.fleet.agents) or own
        parked = fleet_cars(config.fleet.parked_cars) or own
        self.agent_names, self.agents = zip(*agents, strict=True)
        self.parked_names, self.parked_cars = zip(*parked, strict=True)
        self.mixed = bool(config.fleet.agents)
        kinds = [make_vehicle(params) for params in self.agents]
        # Stacked by NumPy: JAX would compile programs.
        stacked = jax.tree.map(lambda *x: np.stack(x), *kinds)
        self._kinds: Vehicle = jax.device_put(stacked)
        self._only = kinds[0] if len(kinds) == 1 else None
        self._size = make_vehicle(vehicle).size

    def start(
        self,
        layout: Layout,
        key: jax.Array,
        present: jax.Array | None = None,
        options: ResetOptions | None = None,
    ) -> Start:
        """Draws goals, parked cars and the agents' cars of a lot; `key` is consumed.

        `present` (num_agents,) are the agents in the lot, None = all.
        """
        config = self._config
        if config.varies:
            return self._start_varied(layout, key, present, options)
        n, m = config.num_agents, config.num_parked_cars
        goals = 0 if config.goals.dynamic else n
        order = shuffled_bays(layout, key)
        goal = order[:goals] if goals else jnp.full(n, NO_BAY, jnp.int32)
        bay = order[goals : goals + m]
        if options is not None:  # drawn goals and parked cars keep clear of given ones
            clear = kept_clear(layout, options, self._size)
            order = order[jnp.argsort(clear[order], stable=True)]  # these last
            goal = given_goals(options, n)
            drawn = (goal == NO_BAY) & (not config.goals.dynamic)
            goal = jnp.where(drawn, order[jnp.cumsum(drawn) - 1], goal)
            place = jnp.sum(drawn) + jnp.arange(m)
            free = place < jnp.sum(layout.bay_mask & ~clear)
            bay = jnp.where(free, order[place], NO_BAY)
        size = jnp.broadcast_to(self._size, (m, 2))
        parked = ParkedCars(bay, jnp.zeros((m, 3)), size)
        parked = dataclasses.replace(parked, pose_w=poses_in_bays(layout, parked))
        kind = jnp.zeros(n, jnp.int32)
        return Start(goal, parked, self.of_kind(kind), kind)

    def _start_varied(
        self,
        layout: Layout,
        key: jax.Array,
        present: jax.Array | None,
        options: ResetOptions | None,
    ) -> Start:
        """`start` where the number, kinds, poses or sizes of parked cars vary."""
        config = self._config
        n, m = config.num_agents, config.num_parked_cars
        goal_key, count_key, scale_key, place_key, offset_key = jax.random.split(key, 5)
        goal_bays = layout.goal_mask[None]  # any is a goal for the one kind of car
        if self.mixed:
            goal_bays = self._goal_bays(layout)
        shape = n, len(self.agents), layout.num_bays
        goal_bays = jnp.broadcast_to(goal_bays, shape)
        clear = jnp.zeros(layout.num_bays, bool)
        given = given_goals(options, n)
        if options is not None:
            clear = kept_clear(layout, options, self._kinds.size.max(axis=0))
            own = jnp.arange(layout.num_bays) == given[:, None]
            usable = jnp.where(given[:, None] == NO_BAY, ~clear, own)
            goal_bays = goal_bays & usable[:, None]
            if options.kind is not None:
                drawn = options.kind[:, None] < 0
                chosen = options.kind[:, None] == jnp.arange(len(self.agents))
                goal_bays = goal_bays & (drawn | chosen)[..., None]
        kind, goal = draw_bays(
            goal_bays,
            jnp.ones(n, bool) if present is None else present,
            layout.bay_mask,
            goal_key,
            anywhere=True,
            snug=config.fleet.snug,
            room=self._room(layout),
        )
        if options is not None:
            goal = jnp.where(given == NO_BAY, goal, given)
            if options.kind is not None:  # also where it fits into no bay
                kind = jnp.where(options.kind < 0, kind, options.kind)
        if config.goals.dynamic:
            goal = jnp.full(n, NO_BAY, jnp.int32)
        sizes = jnp.array([[p.length, p.width] for p in self.parked_cars])
        sizes = sizes * _uniform(config.jitter.scale, scale_key, (m, 1, 1))
        there = jnp.arange(m) < self._num_parked_cars(layout, count_key)
        free = free_bays(layout, goal) & ~clear
        fit = fits(layout.bay_size, sizes)
        parked_kind, bay = draw_bays(fit, there, free, place_key)
        jitter, offset = config.jitter, None
        if jitter.moves:
            ranges = (jitter.along, jitter.across, jitter.heading)
            keys = jax.random.split(offset_key, 3)
            columns = [_uniform(*pair, (m,)) for pair in zip(ranges, keys, strict=True)]
            offset = jnp.stack(columns, axis=-1)
        size = sizes[jnp.arange(m), parked_kind]
        cars = ParkedCars(bay, jnp.zeros((m, 3)), size, offset, parked_kind)
        cars = dataclasses.replace(cars, pose_w=poses_in_bays(layout, cars))
        if not self.mixed:
            kind = jnp.zeros_like(kind)
        return Start(goal, cars, self.of_kind(kind), kind)

    def draw_kinds(self, layout: Layout, key: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Kinds (num_agents,) int32 of drawn cars, and the next key."""
        config = self._config
        shape = (config.num_agents,)
        if not self.mixed:
            return jnp.zeros(shape, jnp.int32), key
        key, kind_key = jax.random.split(key)
        logits = jnp.zeros(len(self.agents))
        if config.fleet.snug:
            fit, room = self._goal_bays(layout), self._room(layout)
            logits = kind_logits(fit, room, config.fleet.snug)
        kind = jax.random.categorical(kind_key, logits, shape=shape)
        return kind.astype(jnp.int32), key

    def _goal_bays(self, layout: Layout) -> jax.Array:
        """(kinds, bays) bool, goals that cars of each kind fit into."""
        slack = self._config.episode.slack
        return fits(layout.bay_size, self._kinds.size, slack) & layout.goal_mask

    def _room(self, layout: Layout) -> jax.Array:
        """(kinds, bays) that bays leave in length and width together [m]."""
        return layout.bay_size.sum(axis=1) - self._kinds.size.sum(axis=1)[:, None]

    def of_kind(self, kind: jax.Array) -> Vehicle:
        """Nominal parameters of cars of kinds (...) int32."""
        if self._only is not None:
            return jax.tree.map(
                lambda x: jnp.broadcast_to(x, (*kind.shape, *x.shape)), self._only
            )
        kind = kind.astype(jnp.uint32)  # or JAX adds code for negative indices
        return jax.tree.map(lambda x: x[kind], self._kinds)

    def parked_vehicles(self, cars: ParkedCars) -> list[VehicleParameters]:
        """The presets, scaled, of parked cars."""
        lengths = np.asarray(cars.size, float)[:, 0]
        kinds = [0] * len(lengths) if cars.kind is None else np.asarray(cars.kind)
        presets = [self.parked_cars[kind] for kind in kinds]
        pairs = zip(presets, lengths, strict=True)
        return [scaled(car, length / car.length) for car, length in pairs]

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


def _uniform(
    bounds: tuple[float, float], key: jax.Array, shape: tuple[int, ...]
) -> jax.Array:
    low, high = bounds
    return jax.random.uniform(key, shape, jnp.float32, low, high)


def shuffled_bays(layout: Layout, key: jax.Array) -> jax.Array:
    """Indices (bays,) int32 in random order: bays for goals, reserved ones, padding."""
    score = jax.random.uniform(key, layout.bay_mask.shape)
    score = jnp.where(layout.goal_mask, score, score + 1.0)
    return jnp.argsort(jnp.where(layout.bay_mask, score, 3.0)).astype(jnp.int32)


SNUG = 0.2  # m more room makes a kind less likely by a factor of e [est]


def kind_logits(fit: jax.Array, room: jax.Array | None, snug: float) -> jax.Array:
    """Logits (kinds,) of kinds that fit into a bay; of all if none does.

    `fit` is (kinds, bays) bool; without `snug`, see `draw_bays`, the room is unused.
    """
    possible = fit.any(axis=1)
    possible = possible | ~possible.any()
    if room is None or not snug:
        return jnp.where(possible, 0.0, -jnp.inf)
    left = jnp.where(fit, room, jnp.inf).min(axis=1)
    left = left - jnp.where(fit.any(), left.min(), 0.0)
    close = jnp.where(fit.any(axis=1), jnp.exp(-left / SNUG), 0.0)
    close = close / jnp.maximum(close.sum(), 1.0)
    return jnp.log(snug * close + (1.0 - snug) * possible / possible.sum())


def draw_bays(
    fit: jax.Array,
    cars: jax.Array,
    free: jax.Array,
    key: jax.Array,
    anywhere: bool = False,
    snug: float = 0.0,
    room: jax.Array | None = None,
) -> tuple[jax.Array, jax.Array]:
    """Draws kinds of cars and distinct bays for them, one car after the other.

    A kind is drawn among those that `fit` (cars, kinds, bays) into a bay of `free`
    (bays,) left, and then one of these bays, for `cars` (cars,) that need one. With
    `anywhere` a car that fits nowhere still gets a free bay. A share `snug` of the
    kinds is likelier the less `room` (kinds, bays) bays leave in length and width
    together [m]. Returns both (cars,) int32, `NO_BAY` for none; `key` is consumed.
    """
    num_bays = free.shape[0]

    def draw(free: jax.Array, car: tuple[jax.Array, jax.Array, jax.Array]):
        fits, wants, key = car
        kind_key, bay_key = jax.random.split(key)
        logits = kind_logits(fits & free, room, snug)
        kind = jax.random.categorical(kind_key, logits)
        good = free & fits[kind]
        if anywhere:
            good = jnp.where(good.any(), good, free)
        score = jax.random.uniform(bay_key, (num_bays,))
        bay = jnp.argmax(jnp.where(good, score, -1.0))
        bay = jnp.where(wants & good.any(), bay, NO_BAY).astype(jnp.int32)
        return free & (jnp.arange(num_bays) != bay), (kind.astype(jnp.int32), bay)

    keys = jax.random.split(key, cars.shape[0])
    return jax.lax.scan(draw, free, (fit, cars, keys))[1]


# Domain randomization: what is drawn is data of the car, so nothing recompiles. The
# footprint is unchanged, and so are collisions and the parked rule.


def randomize(config: RandomizationConfig, vehicle: Vehicle, key: jax.Array) -> Vehicle:
    """Draws one car about a nominal one.

    Each parameter has its own part of `key`, so that switching one on changes no other.
    """
    ranges = config.ranges()
    varied = [k for k, name in enumerate(ranges) if config.varies(name)]
    keys = jax.random.split(key, len(ranges))[np.array(varied)]
    bounds = jnp.array([*ranges.values()])[np.array(varied)]

    @jax.vmap  # at once, as one call of the generator is one loop
    def draw(key: jax.Array, bounds: jax.Array) -> jax.Array:
        return jax.random.uniform(key, minval=bounds[0], maxval=bounds[1])

    numbers = jnp.unstack(draw(keys, bounds))
    drawn = {[*ranges][k]: x for k, x in zip(varied, numbers, strict=True)}

    def vary(name: str, nominal: jax.Array) -> jax.Array:
        if name not in drawn:
            return nominal
        return nominal + drawn[name] if name in ADDED else nominal * drawn[name]

    if any(map(config.varies, ("mass", "cg_x", "cg_height"))):
        cg = vehicle.cg
        cg = jnp.stack([vary("cg_x", cg[0]), cg[1], vary("cg_height", cg[2])])
        vehicle = with_mass(vehicle, vary("mass", vehicle.mass), cg)
    one = jnp.ones_like(vehicle.mass)
    vehicle = with_grip(vehicle, vary("friction", one))
    stiffness, brake = vary("tyre_stiffness", one), vary("brake_gain", one)
    tyres = dataclasses.replace(
        vehicle.tyres,
        longitudinal_stiffness=vehicle.tyres.longitudinal_stiffness * stiffness,
        lateral_stiffness=vehicle.tyres.lateral_stiffness * stiffness,
    )
    return dataclasses.replace(
        vehicle,
        tyres=tyres,
        steering_offset=vary("steering_offset", vehicle.steering_offset),
        steering_lag=vary("steering_lag", vehicle.steering_lag),
        max_deceleration=vehicle.max_deceleration * brake,
        hold_deceleration=vehicle.hold_deceleration * brake,
    )


def randomize_all(
    config: RandomizationConfig, vehicles: Vehicle, key: jax.Array
) -> Vehicle:
    """Draws cars (count,) about nominal ones, which they are while nothing varies."""
    if not config.is_on:
        return vehicles
    keys = jax.random.split(key, vehicles.mass.shape[0])
    return jax.vmap(partial(randomize, config))(vehicles, keys)


def check_randomization(config: RandomizationConfig, params: VehicleParameters) -> None:
    """Refuses ranges from which an impossible car could be drawn."""
    unsprung = params.mass - chassis_inertial(params)[0]
    least_mass = 2 * unsprung / params.mass
    cg_x, wheelbase = params.cg_to_rear_axle, params.wheelbase
    cg_height, radius = params.cg_height, params.wheel_radius
    allowed = {
        "mass": (least_mass, 3.0),
        "cg_x": (0.1 * wheelbase / cg_x, 0.9 * wheelbase / cg_x),
        "cg_height": (0.5 * radius / cg_height, params.height / cg_height),
        "friction": (0.01, 3.0),
        "tyre_stiffness": (0.1, 2.0),
        "brake_gain": (0.0, 3.0),
        "steering_offset": (-0.2, 0.2),
        "steering_lag": (0.0 - params.steering_lag, 10.0 - params.steering_lag),
    }
    for name, (least, most) in allowed.items():
        low, high = config.ranges()[name]
        if config.varies(name) and not least <= low <= high <= most:
            raise ValueError(
                f"randomization.{name} must lie within [{least:.3g}, {most:.3g}] for "
                f"this car, not reach from {low:.3g} to {high:.3g}"
            )
