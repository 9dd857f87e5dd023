"""A lot as a car outside the simulator knows it: plain arrays, and the state of them.

Inputs are in the world frame, SI units and radians. A lot is built from them, whose
first and only observing agent is the car outside, so that the environment's own code
computes the observation.
"""

import dataclasses
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp

from carpark_mj.geometry.obstacles import Boxes, Discs, Group, Movers, ObstacleKind
from carpark_mj.layouts.routes import make_routes
from carpark_mj.layouts.types import Layout
from carpark_mj.mdp.parked_cars import place_absent_agents
from carpark_mj.observations import ObservationInput
from carpark_mj.observations.ego import TURNS, Past, goal_code, init_past
from carpark_mj.observations.sensors import observed
from carpark_mj.types import NO_BAY, Motion, ParkedCars, State
from carpark_mj.vehicle import Vehicle


@dataclasses.dataclass(frozen=True)
class Rows:
    """How many rows inputs have, padding included; masks mark the valid rows."""

    others: int = 0  # other cars that drive
    parked: int = 0  # parked cars
    walls: int = 0  # walls and other boxes
    discs: int = 0  # pillars and other discs
    people: int = 0
    movers: int = 0  # drivers, carts and other boxes that may move
    lanes: int = 0
    bays: int = 0  # tracked bays, from which goals are chosen; 0 = goals are fixed
    bay_ends: bool = False  # whether some bays must be entered by an end of the car


@dataclasses.dataclass(frozen=True)
class PlainInput:
    """An input array of a car outside."""

    name: str
    dims: tuple[int | str, ...]  # names of `Rows` for numbers of rows; no batch
    unit: str  # "" of indices and masks
    meaning: str
    dtype: str = "float32"  # or `int32`, `bool`

    def shape(self, rows: Rows) -> tuple[int, ...]:
        """Its shape."""
        return tuple(getattr(rows, n) if isinstance(n, str) else n for n in self.dims)


_POSE, _SIZE = "m, m, rad", "their lengths and widths"
_PARKED = "centre, and heading of a car parked tail in"
_END = "the end that goes in first: 0 either, 1 nose, 2 tail"
_AGO = "as of a step ago"
INPUTS = (
    PlainInput("pose", (3,), _POSE, "own footprint: centre and heading"),
    PlainInput("speed", (), "m/s", "own, of the rear axle, forwards > 0"),
    PlainInput("yaw_rate", (), "rad/s", "own, counter-clockwise > 0"),
    PlainInput("steering", (), "rad", "own road-wheel angle, left > 0"),
    PlainInput("size", (2,), "m", "own length and width"),
    PlainInput("wheelbase", (), "m", "own, from axle to axle"),
    PlainInput("rear_axle", (), "m", "own, from the rear axle to the centre"),
    PlainInput("max_speed", (), "m/s", "own limit forwards"),
    PlainInput("max_steering", (), "rad", "own largest road-wheel angle"),
    PlainInput("max_reverse_speed", (), "m/s", "own limit backwards"),
    PlainInput("max_acceleration", (), "m/s^2", "own, at full pedal"),
    PlainInput("max_deceleration", (), "m/s^2", "own, at full brake"),
    PlainInput("steering_rate", (), "rad/s", "own largest, of the road wheels"),
    PlainInput("steering_lag", (), "s", "time constant of the own steering"),
    PlainInput("drive_lag", (), "s", "time constant of the own drive and brake"),
    PlainInput("mass", (), "kg", "own, unloaded"),
    PlainInput("front_drive", (), "", "share of the own drive at the front axle"),
    PlainInput("gear", (), "", "direction of the own last motion: 1, -1 or 0 = none"),
    PlainInput("time", (), "control steps", "since the own episode began"),
    PlainInput("rest", (), "control steps", f"since the own car last moved, {_AGO}"),
    PlainInput("changes", (), "", f"how often the own direction has changed, {_AGO}"),
    PlainInput("turns", (TURNS, 3), _POSE, "where it did last, the newest first"),
    PlainInput("goal_pose", (3,), _POSE, f"bay to park in: {_PARKED}"),
    PlainInput("goal_size", (2,), "m", "its length and width"),
    PlainInput("goal_end", (), "", _END, "int32"),
    PlainInput("choice", (), "", "last choice: 0 = none, k = the k-th bay", "int32"),
    PlainInput("bay_pose", ("bays", 3), _POSE, f"tracked free bays: {_PARKED}"),
    PlainInput("bay_size", ("bays", 2), "m", _SIZE),
    PlainInput("bay_end", ("bays",), "", _END, "int32"),
    PlainInput("bay_mask", ("bays",), "", "padding mask: valid rows", "bool"),
    PlainInput("other_pose", ("others", 3), _POSE, "other cars that drive"),
    PlainInput("other_size", ("others", 2), "m", _SIZE),
    PlainInput("other_speed", ("others",), "m/s", "communicated, forwards > 0"),
    PlainInput("other_steering", ("others",), "rad", "communicated, left > 0"),
    PlainInput("other_max_steering", ("others",), "rad", "their largest"),
    PlainInput("other_goal", ("others", 2), "m", "communicated: centres of their bays"),
    PlainInput(
        "other_choice",
        ("others",),
        "",
        "communicated: 0 = none, k = the k-th of the own bays, one more = another",
        "int32",
    ),
    PlainInput("other_priority", ("others",), "", "before the own car", "bool"),
    PlainInput("other_mask", ("others",), "", "padding mask: valid rows", "bool"),
    PlainInput("parked_pose", ("parked", 3), _POSE, "parked cars"),
    PlainInput("parked_size", ("parked", 2), "m", _SIZE),
    PlainInput("parked_mask", ("parked",), "", "padding mask: valid rows", "bool"),
    PlainInput("wall_pose", ("walls", 3), _POSE, "walls and other solid boxes"),
    PlainInput("wall_size", ("walls", 2), "m", _SIZE),
    PlainInput("wall_mask", ("walls",), "", "padding mask: valid rows", "bool"),
    PlainInput("disc_centre", ("discs", 2), "m", "pillars and other solid discs"),
    PlainInput("disc_radius", ("discs",), "m", "their radii"),
    PlainInput("disc_mask", ("discs",), "", "padding mask: valid rows", "bool"),
    PlainInput("person_centre", ("people", 2), "m", "people"),
    PlainInput("person_radius", ("people",), "m", "their radii"),
    PlainInput("person_velocity", ("people", 2), "m/s", "their velocities"),
    PlainInput("person_mask", ("people",), "", "padding mask: valid rows", "bool"),
    PlainInput("mover_pose", ("movers", 3), _POSE, "carts, drivers and other movers"),
    PlainInput("mover_size", ("movers", 2), "m", _SIZE),
    PlainInput("mover_velocity", ("movers", 2), "m/s", "their velocities"),
    PlainInput("mover_mask", ("movers",), "", "padding mask: valid rows", "bool"),
    PlainInput("lane_pose", ("lanes", 3), _POSE, "lanes: centre and direction"),
    PlainInput("lane_size", ("lanes", 2), "m", _SIZE),
    PlainInput("lane_one_way", ("lanes",), "", "one-way in that direction", "bool"),
    PlainInput("lane_mask", ("lanes",), "", "padding mask: valid rows", "bool"),
)
# Inputs that are fields of `Layout`, too.
_FIXED = ("wall_", "disc_", "lane_")
_FIXED_NAMES = [x.name for x in INPUTS if x.name.startswith(_FIXED)]


def rows_of(state: State) -> Rows:
    """The rows that hold a lot (arrays or their shapes)."""
    layout = state.layout
    people, movers = (sum(x.count for x in groups) for groups in _movers(state))
    return Rows(
        others=state.goal.shape[0] - 1,
        parked=state.parked_cars.bay.shape[0],
        walls=layout.wall_mask.shape[0],
        discs=layout.disc_mask.shape[0],
        people=people,
        movers=movers,
        lanes=layout.lane_mask.shape[0],
        bays=0 if state.tracked_bays is None else state.tracked_bays.shape[1],
        bay_ends=layout.bay_end is not None,
    )


def _movers(state: State) -> tuple[list[Group], list[Group]]:
    """People, and what else moves by itself."""
    people, others = [], []
    for group in state.movers.groups:
        (people if group.kind == ObstacleKind.PERSON else others).append(group)
    return people, others


# Limits of a car's response, which `Vehicle` and the inputs call alike.
_RESPONSE = (
    *("max_speed", "max_steering", "max_reverse_speed", "max_acceleration"),
    *("max_deceleration", "steering_rate", "steering_lag", "drive_lag"),
)


def sight_of(rows: Rows, given: Mapping[str, jax.Array]) -> ObservationInput:
    """The view of a car from all of `INPUTS`, by name."""

    def cars(name: str) -> jax.Array:
        """Values of the own car, then of the others; zeros without communication."""
        own = given[name][None]
        none = jnp.zeros((rows.others, *own.shape[1:]))
        return jnp.concatenate([own, given.get(f"other_{name}", none)])

    present = jnp.concatenate([jnp.ones(1, bool), given["other_mask"]])
    pose, speed = place_absent_agents(cars("pose"), present), cars("speed")
    motion = Motion(
        pose_w=pose,
        velocity_b=jnp.stack([speed, jnp.zeros_like(speed)], axis=-1),
        yaw_rate=cars("yaw_rate"),
        steering=cars("steering"),
        size=cars("size"),
        trace_w=pose[:, None],
        finite=present,
    )
    front = cars("front_drive")[:, None] / 2.0
    read: dict[str, Any] = dict(  # by observations
        size=motion.size,
        wheelbase=cars("wheelbase"),
        centre_offset=cars("rear_axle"),
        rated_mass=cars("mass"),
        drive_share=jnp.concatenate([front, front, 0.5 - front, 0.5 - front], axis=-1),
        **{name: cars(name) for name in _RESPONSE},
    )
    unread: Any = None
    values: dict[str, Any] = dict.fromkeys(Vehicle.__dataclass_fields__)
    car = Vehicle(**values | read)
    layout = _layout(rows, given)
    if rows.bays:
        number = jnp.arange(rows.bays, dtype=jnp.int32)
        tracked_bays = jnp.where(given["bay_mask"], number, NO_BAY)[None]
        choice = jnp.concatenate([given["choice"][None], given["other_choice"]])
        goal, routes = jnp.where(choice == 0, NO_BAY, choice - 1), None
    else:
        goal, tracked_bays = jnp.arange(1 + rows.others, dtype=jnp.int32), None
        own = {n: getattr(layout, n)[:1] for n in ("bay_pose", "bay_size", "bay_mask")}
        routes = make_routes(dataclasses.replace(layout, **own))
    parked = jnp.where(given["parked_mask"], jnp.arange(rows.parked), NO_BAY)
    physics: Any = SimpleNamespace(vehicle=car)
    stats: Any = SimpleNamespace(direction=cars("gear"))
    past = Past(cars("turns"), cars("changes"), path=unread, rest=cars("rest"))
    state = State(
        physics=physics,
        motion=motion,
        layout=layout,
        goal=goal,
        tracked_bays=tracked_bays,
        parked_cars=ParkedCars(parked, given["parked_pose"], given["parked_size"]),
        memory={"past": past},
        step=cars("time"),
        active=unread,
        stats=stats,
        sensors=None,
        key=unread,
        present=present,
        routes=routes,
        movers=Movers(obstacles=(_groups(given),)),
    )
    before = jnp.concatenate([jnp.zeros(1, bool), given["other_priority"]])
    return ObservationInput(
        state, motion, num_observers=1, number=-before.astype(jnp.int32)
    )


def _groups(given: Mapping[str, jax.Array]) -> tuple[Group, ...]:
    """People and other movers that are given."""
    groups: list[Group] = []
    for name, shape, place, size, kind in (
        ("person", Discs, "centre", "radius", ObstacleKind.PERSON),
        ("mover", Boxes, "pose", "size", ObstacleKind.MOVER),
    ):
        found = (given[f"{name}_{x}"] for x in (place, size, "velocity", "mask"))
        groups.append(shape(*found, kind=kind))
    return tuple(group for group in groups if group.count)


def _layout(rows: Rows, given: Mapping[str, jax.Array]) -> Layout:
    """The plan: the own goal and those of the others, or the tracked bays and one."""
    if rows.bays:
        pose, size, end = given["bay_pose"], given["bay_size"], given["bay_end"]
        beyond = jnp.zeros((1, 3))  # goal of others that the car does not track
    else:
        pose, size = given["goal_pose"][None], given["goal_size"][None]
        end = given["goal_end"][None]
        beyond = jnp.pad(given["other_goal"], ((0, 0), (0, 1)))
    pose, more = jnp.concatenate([pose, beyond]), beyond.shape[0]
    none = jnp.zeros((0, 3))
    return Layout(
        bay_pose=pose,
        bay_size=jnp.pad(size, ((0, more), (0, 0))),
        bay_kind=jnp.zeros(pose.shape[0], jnp.int32),
        bay_mask=jnp.ones(pose.shape[0], bool),
        wall_kind=jnp.zeros(rows.walls, jnp.int32),
        disc_kind=jnp.zeros(rows.discs, jnp.int32),
        **{name: given[name] for name in _FIXED_NAMES},
        spawn_pose=none,
        spawn_size=none[:, :2],
        spawn_spread=none[:, 0],
        spawn_mask=none[:, 0] > 0.0,
        extent=jnp.zeros(2),
        bay_end=jnp.pad(end, (0, more)) if rows.bay_ends else None,
    )


def plain_values(
    rows: Rows, state: State, motion: Motion | None = None
) -> dict[str, jax.Array]:
    """The inputs of every agent of a lot by name, (num_agents, *shape).

    `rows` are at least as many as the lot has; `motion` is as agents know it, None as
    measured.
    """
    motion = observed(state) if motion is None else motion
    car, layout = state.physics.vehicle, state.layout
    count, goal, bays = state.goal.shape[0], state.goal, state.tracked_bays
    agent, other = jnp.arange(count)[:, None], jnp.arange(count - 1)
    other = other + (other >= agent)  # (num_agents, others)
    present = jnp.ones(count, bool) if state.present is None else state.present
    past = (state.memory or {}).get("past") or init_past(count)
    values: dict[str, jax.Array] = {
        "pose": motion.pose_w,
        "speed": motion.speed,
        "yaw_rate": motion.yaw_rate,
        "steering": motion.steering,
        "size": motion.size,
        "wheelbase": car.wheelbase,
        "rear_axle": car.centre_offset,
        "mass": car.rated_mass,
        "front_drive": car.drive_share[..., :2].sum(axis=-1),
        "gear": state.stats.direction,
        "time": state.step.astype(jnp.float32),
        "rest": past.rest,
        "changes": past.changes,
        "turns": past.turns_w,
        **{name: getattr(car, name) for name in _RESPONSE},
    }
    shared = ("pose", "size", "speed", "steering", "max_steering")
    values |= {f"other_{name}": values[name][other] for name in shared}
    values |= {"other_mask": present[other], "other_priority": other < agent}
    end = jnp.zeros_like(layout.bay_kind) if layout.bay_end is None else layout.bay_end
    if bays is None:
        kind, which = "goal", goal
        values["other_goal"] = layout.parked_pose[goal][other, :2]
    else:
        kind, which = "bay", bays
        values["bay_mask"] = bays != NO_BAY
        values["choice"] = goal_code(goal[:, None], bays)[:, 0]
        values["other_choice"] = goal_code(goal[other], bays)
    values |= {f"{kind}_pose": layout.bay_pose[which], f"{kind}_end": end[which]}
    values[f"{kind}_size"] = layout.bay_size[which]
    for name, value in _lot_values(state).items():
        values[name] = jnp.broadcast_to(value, (count, *value.shape))
    return {
        x.name: _pad(values[x.name], x.shape(rows))
        for x in INPUTS
        if x.name in values and 0 not in x.shape(rows)
    }


def _lot_values(state: State) -> dict[str, jax.Array]:
    """The inputs that all agents share."""
    layout, parked_cars = state.layout, state.parked_cars
    values = {
        "parked_pose": parked_cars.pose_w,
        "parked_size": parked_cars.size,
        "parked_mask": parked_cars.present,
        **{
            x.name: getattr(layout, x.name) for x in INPUTS if x.name.startswith(_FIXED)
        },
    }
    empty: Any = (jnp.zeros((0, 3)), *[jnp.zeros((0, 2))] * 2, jnp.zeros(0, bool))
    for name, groups in zip(("person", "mover"), _movers(state), strict=True):
        parts = zip(empty, *(group.as_boxes for group in groups), strict=True)
        pose, size, velocity, there = (jnp.concatenate(part) for part in parts)
        values |= {f"{name}_velocity": velocity, f"{name}_mask": there}
        values |= {f"{name}_pose": pose, f"{name}_size": size}
        values |= {f"{name}_centre": pose[:, :2], f"{name}_radius": size[:, 0] / 2}
    return values


def _pad(value: jax.Array, shape: tuple[int, ...]) -> jax.Array:
    """Values (num_agents, ...) as (num_agents, *shape), with zeros behind."""
    missing = zip(shape, value.shape[1:], strict=True)
    return jnp.pad(value, [(0, 0), *((0, most - own) for most, own in missing)])
