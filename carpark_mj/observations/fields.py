"""Fields of the observation vector: what they mean, and what they are filled from.

Angles enter as cosine and sine; distances both far (divided by `FAR`) and near
(divided by `NEAR` and clipped), so that metres and centimetres are both visible. Where
a lot is larger than the range of a field, the field is clipped.
"""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Self, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config.checks import CheckedConfig
from carpark_mj.extensions import Registry
from carpark_mj.geometry import to_local
from carpark_mj.geometry.obstacles import Group
from carpark_mj.layouts.types import Layout
from carpark_mj.observations.sensors import observed
from carpark_mj.obstacles import lot_obstacles
from carpark_mj.types import NO_BAY, Motion, State, Vehicle

if TYPE_CHECKING:
    from carpark_mj.config import EnvConfig

FAR = 20.0  # m, about half a `square` lot
# Where distances are cut off [FAR]: 160 m. By default lots of the families are up to
# 84 m across (`angled`).
FARTHEST = 8.0
NEAR = 3.0  # m, the last car length before the goal
CLOSE = 0.5  # m, about the room on either side of a car in its bay
LENGTH = 5.0  # m, about a car

# Groups whose slots mean something: actions name tracked bays by their slots.
ORDERED = ("bay",)


@dataclasses.dataclass(frozen=True)
class Field:
    """A named slice of the observation vector.

    Attributes:
        name: unique; starts with group and index if there are any.
        size: numbers it takes.
        low: smallest value.
        high: largest value; the ranges hold while cars stay on the lot and within
            their speed limits.
        meaning: description of the numbers, with scale and unit.
        group: the repeated entity it describes, as `agent`, `parked_car` or `bay`; ""
            if it describes none. All entities of a group have equal fields in one
            order, next to each other.
        index: which of the group, from 0.
        is_mask: whether it is 1 where the entity is present, and 0 where it is not.
        metres: scale of a length [m], whose range holds on the lot only; else 0.
        speed: scale of a speed [m/s], or of a yaw rate [m/s per rad/s], whose range
            holds below the speeds of a car park only; else 0.
        is_yaw_rate: whether it is a yaw rate [rad/s], which a back end that turns cars
            can make larger.
        is_whole: whether its numbers are whole, from `low` to `high`.
        reveals_goal: whether it depends on the agent's own goal, which relabelled goals
            (`carpark_mj.wrappers.goal`) would contradict.
        shape: of the picture that its numbers are: views, height, width, or the last
            two. () = they are no picture.
        gamma: of a picture's bytes in dictionaries of observations: they are its share
            of the range to this power. Below 1, small numbers have more of the bytes.
        mirror: which number, from 1, each is in a mirror image, negative with the other
            sign: (1, -2) for a point. 0 = it has none. () = unchanged.
    """

    name: str
    size: int
    low: float
    high: float
    meaning: str
    group: str = ""
    index: int = 0
    is_mask: bool = False
    metres: float = 0.0
    speed: float = 0.0
    is_yaw_rate: bool = False
    is_whole: bool = False
    reveals_goal: bool = False
    shape: tuple[int, ...] = ()
    gamma: float = 1.0
    mirror: tuple[int, ...] = ()


ASIDE = (1, -2)  # `Field.mirror` of points and vectors, and of cosines and sines


def position_field(name: str, meaning: str, reveals_goal: bool = False) -> Field:
    """A point (2,) in the body frame in units of `FAR`, see `far`."""
    meaning, reach = f"{meaning}, body frame [{FAR:g} m]", FARTHEST
    scale: Any = {"metres": FAR, "reveals_goal": reveals_goal, "mirror": ASIDE}
    return Field(name, 2, -reach, reach, meaning, **scale)


def distance_field(name: str, meaning: str, reveals_goal: bool = False) -> Field:
    """A distance in units of `FAR`, see `far`."""
    meaning = f"{meaning} [{FAR:g} m]"
    return Field(name, 1, 0.0, FARTHEST, meaning, metres=FAR, reveals_goal=reveals_goal)


def mask_field(entity: str) -> Field:
    """Whether an entity of a group is present."""
    meaning = f"1 if the {entity} exists, else all its numbers are 0"
    return Field("present", 1, 0.0, 1.0, meaning, is_mask=True)


def far(distance: jax.Array) -> jax.Array:
    """Distances or coordinates (...) [m] in units of `FAR`, within `FARTHEST`."""
    return jnp.clip(distance / FAR, -FARTHEST, FARTHEST)


def unit_vector(yaw: jax.Array) -> jax.Array:
    """Cosine and sine (..., 2) of angles (...) [rad]."""
    return jnp.stack([jnp.cos(yaw), jnp.sin(yaw)], axis=-1)


def repeated(group: str, count: int, fields: Iterable[Field]) -> list[Field]:
    """The fields of the first `count` entities of a group, one after the other."""
    fields = tuple(fields)

    def of(index: int, field: Field) -> Field:
        name = f"{group}_{index}_{field.name}"
        return dataclasses.replace(field, name=name, group=group, index=index)

    return [of(index, field) for index in range(count) for field in fields]


def repeated_values(group: str, values: dict[str, jax.Array]) -> dict[str, jax.Array]:
    """The values of entities (num_agents, count, k) by the names of their fields.

    In the order of their fields they are a piece of the vector as a whole. XLA then
    copies it at once, and not each value by a kernel of its own.
    """
    packed = jnp.concatenate([*values.values()], axis=-1)
    num_agents, count, _ = packed.shape
    packed = jax.lax.optimization_barrier(packed.reshape(num_agents, -1))
    names = [f"{group}_{k}_{name}" for k in range(count) for name in values]
    ends = np.cumsum([value.shape[-1] for value in values.values()] * count)
    columns = jnp.split(packed, ends[:-1], axis=-1)
    return dict(zip(names, columns, strict=True))


_NEAR = f"its centre, body frame [{NEAR * 2:g} m], clipped"
POSE_FIELDS = (
    position_field("position", "its centre, x and y"),
    Field("near_position", 2, -1.0, 1.0, _NEAR, mirror=ASIDE),
    Field(
        "heading", 2, -1.0, 1.0, "cos and sin of its heading minus own", mirror=ASIDE
    ),
)
CAR_FIELDS = (
    mask_field("car"),
    *POSE_FIELDS,
    Field("size", 2, 0.0, 2.0, f"length and width [{LENGTH:g} m]"),
)


def localise(
    own_pose: jax.Array, pose: jax.Array, size: jax.Array, present: jax.Array
) -> dict[str, jax.Array]:
    """`CAR_FIELDS` (num_agents, count, k) of tracked cars in the observers' frames.

    Of observers (num_agents, 3) and tracked cars (num_agents, count, ...) of poses
    (3,), sizes (2,) [m] and presence (); absent cars give zeros.
    """
    local = to_local(own_pose[:, None], pose)
    xy = local[..., :2]
    values = {
        "present": jnp.ones_like(local[..., :1]),
        "position": far(xy),
        "near_position": jnp.clip(xy / (2 * NEAR), -1.0, 1.0),
        "heading": unit_vector(local[..., 2]),
        "size": size / LENGTH,
    }
    return {k: jnp.where(present[..., None], x, 0.0) for k, x in values.items()}


Tree = TypeVar("Tree")


@dataclasses.dataclass(frozen=True)
class Tracked:
    """How many of the nearest other agents and parked cars an encoder tracks."""

    agents: int = 0
    parked_cars: int = 0
    cars: int = 0  # of both, in one list


class ObservationConfig(CheckedConfig, abc.ABC):
    """An encoder of observations: a frozen dataclass of its settings.

    It lists the fields of the vector and fills them. Properties and methods below say
    what else the encoder needs; a class overrides them where the defaults are wrong.

    Attributes:
        encoding: its name in `ENCODERS`, the default of each class and never another.
        own_car: whether agents observe the parameters of their own car.
        route: whether it reads `State.routes`.
        global_information: whether agents observe how near all agents are to bays.
    """

    encoding: str
    own_car = False
    route = False
    global_information = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.encoding != (own := type(self).encoding):
            raise ValueError(f"encoding must be {own!r}, not {self.encoding!r}")

    @abc.abstractmethod
    def fields(self, env: EnvConfig) -> Sequence[Field]:
        """The fields of the vector in order."""

    @abc.abstractmethod
    def values(self, env: EnvConfig, state: State) -> Mapping[str, jax.Array]:
        """Values (num_agents, field.size) of all fields by name.

        `known(env, state)` has the measured poses of cars.
        """

    def known(self, env: EnvConfig, state: State) -> Motion:
        """The motion of all agents (num_agents,) as they know it."""
        del env
        return observed(state)

    def check(self, env: EnvConfig) -> None:
        """Raises `ValueError` for environments that the encoder does not support."""

    @property
    def tracked(self) -> Tracked:
        """How many cars are tracked at most."""
        return Tracked()

    @property
    def circles(self) -> tuple[float, ...]:
        """Diameters of the circles about the car that count objects [m]."""
        return ()

    def tracks_agents(self, state: State) -> jax.Array | None:
        """Whether agents track each other, (num_agents, num_agents); None = none."""
        del state

    def tracks_parked_cars(self, state: State) -> jax.Array | None:
        """Whether agents track cars, (num_agents, num_parked_cars); None = none."""
        del state

    def bays_in_view(self, state: State) -> jax.Array | None:
        """Bays (num_agents, bays) that agents can track; None = always all."""
        del state

    def init_memory(self, env: EnvConfig) -> Any:
        """`State.memory`, a pytree of arrays (num_agents, ...), as episodes begin."""
        del env

    def remember(self, state: State) -> Any:
        """`State.memory` once the state belongs to the past."""
        return state.memory


_HOMES = "carpark_mj.observations.continuous", "carpark_mj.cameras.encoder"
ENCODERS: Registry[type[ObservationConfig]] = Registry("observation encoding", *_HOMES)


@dataclasses.dataclass(frozen=True)
class ObservationInput:
    """What fields are filled from: the state of a lot as its agents measure it.

    Attributes:
        state: of the lot.
        agents: measured motion of all (num_agents,); `state.motion` is the true one.
        num_observers: how many of them observe, the first; None = all, as in `values`
            of parts (num_agents, k).
        number: (num_agents,) numbers that give priority; None = 0, 1, 2...
    """

    state: State
    agents: Motion
    num_observers: int | None = None
    number: jax.Array | None = None

    @classmethod
    def of(cls, state: State) -> Self:
        """What all agents measure."""
        return cls(state, observed(state))

    @property
    def motion(self) -> Motion:
        """Measured motion of the observers."""
        return self.own(self.agents)

    @property
    def layout(self) -> Layout:
        """The layout of the lot."""
        return self.state.layout

    @property
    def goal(self) -> jax.Array:
        """(num_observers,) bays."""
        return self.own(self.state.goal)

    @property
    def tracked_bays(self) -> jax.Array:
        """(num_observers, num_tracked_bays) of agents that choose their goals."""
        assert self.state.tracked_bays is not None
        return self.own(self.state.tracked_bays)

    @property
    def obstacles(self) -> tuple[Group, ...]:
        """All obstacles, agents first and at their measured poses."""
        state = self.state
        return lot_obstacles(state.layout, self.agents, state.parked_cars, state.movers)

    @property
    def vehicle(self) -> Vehicle:
        """The observers' cars."""
        return self.own(self.state.physics.vehicle)

    def with_goal(self, values: dict[str, jax.Array]) -> dict[str, jax.Array]:
        """Values (num_observers, k) about the goal; zeros without a goal."""
        if self.state.tracked_bays is None:
            return values
        has_goal = (self.goal != NO_BAY)[:, None]
        return {name: jnp.where(has_goal, x, 0.0) for name, x in values.items()}

    def own(self, tree: Tree) -> Tree:
        """Rows of the observers, of arrays (num_agents, ...)."""
        if self.num_observers is None:
            return tree
        return jax.tree.map(lambda x: x[: self.num_observers], tree)


@dataclasses.dataclass(frozen=True)
class Part:
    """Neighbouring fields, and their values (num_observers, field.size) by name."""

    fields: tuple[Field, ...]
    fill: Callable[[ObservationInput], dict[str, jax.Array]]
