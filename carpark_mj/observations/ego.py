"""What an agent observes of itself, its goal, and the bays it tracks.

Lists of bays hold `NO_BAY` where there is none.
"""

import dataclasses
import functools
import math

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj.geometry import box_room, norm, rotate, to_local
from carpark_mj.layouts.routes import RouteLeft, route_to
from carpark_mj.layouts.types import Layout
from carpark_mj.observations.fields import (
    ASIDE,
    CLOSE,
    FAR,
    FARTHEST,
    LENGTH,
    NEAR,
    POSE_FIELDS,
    Field,
    ObservationInput,
    Part,
    distance_field,
    far,
    localise,
    mask_field,
    position_field,
    repeated,
    repeated_values,
    unit_vector,
)
from carpark_mj.observations.sensors import observed
from carpark_mj.types import NO_BAY, State


def _goal_field(name: str, mirror: tuple[int, ...], meaning: str) -> Field:
    """Numbers in [-1, 1] about the goal."""
    n = len(mirror)
    return Field(name, n, -1.0, 1.0, meaning, reveals_goal=True, mirror=mirror)


def _own(name: str, size: int, meaning: str, high: float = 2.0) -> Field:
    """Positive numbers about the own car."""
    return Field(name, size, 0.0, high, meaning)


def _motion(sight: ObservationInput) -> dict[str, jax.Array]:
    motion, vehicle = sight.motion, sight.vehicle
    return {
        "speed": (motion.speed / vehicle.max_speed)[..., None],
        "steering": (motion.steering / vehicle.max_steering)[..., None],
        "yaw_rate": motion.yaw_rate[..., None],
    }


_FORWARD, _TURN = "own signed speed [forward limit]", "own yaw rate [rad/s], left > 0"
_ANGLE = "own road-wheel angle [its limit], left > 0"
MOTION = Part(
    (
        Field("speed", 1, -1.5, 1.5, _FORWARD, speed=math.inf),
        Field("steering", 1, -1.0, 1.0, _ANGLE, mirror=(-1,)),
        Field(
            "yaw_rate", 1, -2.0, 2.0, _TURN, speed=1.0, is_yaw_rate=True, mirror=(-1,)
        ),
    ),
    _motion,
)


def _goal(sight: ObservationInput) -> dict[str, jax.Array]:
    layout, motion, goal = sight.layout, sight.motion, sight.goal
    goal_pose, goal_size = layout.bay_pose[goal], layout.bay_size[goal]
    local = to_local(motion.pose_w, layout.parked_pose[goal])
    inverse = to_local(goal_pose, motion.pose_w)
    xy = local[..., :2]
    values = {
        "goal_position": far(xy),
        "goal_near": jnp.clip(xy / NEAR, -1.0, 1.0),
        "goal_heading": unit_vector(local[..., 2]),
        "goal_distance": far(norm(xy)[..., None]),
        "in_bay": jnp.clip(inverse[..., :2] / NEAR, -1.0, 1.0),
        "goal_size": (goal_size - motion.size) / LENGTH,
    }
    return sight.with_goal(values)


_SIZE = f"length and width of the goal bay less own [{LENGTH:g} m]"
GOAL = Part(
    (
        position_field("goal_position", "goal centre", reveals_goal=True),
        _goal_field(
            "goal_near", ASIDE, f"goal centre, body frame [{NEAR:g} m], clipped"
        ),
        _goal_field("goal_heading", ASIDE, "cos and sin of goal heading minus own"),
        distance_field("goal_distance", "to the goal centre", reveals_goal=True),
        _goal_field("in_bay", ASIDE, f"own centre, goal frame [{NEAR:g} m], clipped"),
        Field("goal_size", 2, 0.0, 2.0, _SIZE, metres=LENGTH, reveals_goal=True),
    ),
    _goal,
)


def _lines(sight: ObservationInput) -> dict[str, jax.Array]:
    layout, motion, goal = sight.layout, sight.motion, sight.goal
    goal_pose, goal_size = layout.bay_pose[goal], layout.bay_size[goal]
    room = box_room(motion.pose_w, motion.size, goal_pose, goal_size)
    return sight.with_goal({"line_room": jnp.clip(room / CLOSE, -1.0, 1.0)})


_ROOM = (
    "room between the own outline and the goal bay's lines at +x, -x, +y, -y, goal "
    f"frame [{CLOSE:g} m], clipped"
)
LINES = Part((_goal_field("line_room", (1, 2, 4, 3), _ROOM),), _lines)


def on_last_stretch(sight: ObservationInput) -> jax.Array:
    """Whether routes are straight until the goal, (num_observers,) bool."""
    goal_xy = sight.layout.bay_pose[sight.goal, :2]
    return (_route_left(sight).next_xy == goal_xy).all(axis=-1)


def _route_left(sight: ObservationInput) -> RouteLeft:
    return route_to(sight.state.routes, sight.layout, sight.motion.xy, sight.goal)


def _route(sight: ObservationInput) -> dict[str, jax.Array]:
    motion, route = sight.motion, _route_left(sight)
    position = rotate(route.next_xy - motion.xy, -motion.pose_w[..., 2])
    return {"route_next": far(position), "route_length": far(route.length[..., None])}


_NEXT = "where the route along the lanes turns next"
ROUTE = Part(
    (
        position_field("route_next", _NEXT, True),
        distance_field("route_length", "length of the route to the goal", True),
    ),
    _route,
)


def _car(sight: ObservationInput) -> dict[str, jax.Array]:
    vehicle = sight.vehicle
    radius = vehicle.wheelbase / jnp.tan(vehicle.max_steering)
    return {
        "own_size": sight.motion.size / LENGTH,
        "own_wheelbase": vehicle.wheelbase[..., None] / LENGTH,
        "own_rear_axle": vehicle.centre_offset[..., None] / LENGTH,
        "own_turning_radius": radius[..., None] / LENGTH,
    }


CAR = Part(
    (
        _own("own_size", 2, f"own length and width [{LENGTH:g} m]"),
        _own("own_wheelbase", 1, f"own wheelbase [{LENGTH:g} m]", 1.0),
        _own("own_rear_axle", 1, f"from rear axle to own centre [{LENGTH:g} m]", 1.0),
        _own("own_turning_radius", 1, f"of the rear axle, full lock [{LENGTH:g} m]"),
    ),
    _car,
)


RATE = 0.5  # rad/s, scale of the steering's
LAG = 0.5  # s
ACCELERATION = 4.0  # m/s^2, about a firm brake
MASS = 2000.0  # kg
SPEED = 3.0  # m/s, usual limit of a parking car


def _response(sight: ObservationInput) -> dict[str, jax.Array]:
    car = sight.vehicle
    pedal = jnp.stack([car.max_acceleration, car.max_deceleration], axis=-1)
    limits = jnp.stack([car.max_speed, car.max_reverse_speed], axis=-1)
    values = {
        "own_steering_rate": car.steering_rate[..., None] / RATE,
        "own_lags": jnp.stack([car.steering_lag, car.drive_lag], axis=-1) / LAG,
        "own_pedal": pedal / ACCELERATION,
        "own_mass": car.rated_mass[..., None] / MASS,
        "own_front_drive": car.drive_share[..., :2].sum(axis=-1, keepdims=True),
        "own_speed_limits": limits / SPEED,
    }
    return {name: jnp.clip(value, 0.0, 2.0) for name, value in values.items()}


_LIMITS = f"own speed limits, forward and reverse [{SPEED:g} m/s]"
RESPONSE = Part(
    (
        _own("own_steering_rate", 1, f"own steering rate [{RATE:g} rad/s]"),
        _own("own_lags", 2, f"of own steering and drive [{LAG:g} s]"),
        _own("own_pedal", 2, f"of own full pedal and brake [{ACCELERATION:g} m/s^2]"),
        _own("own_mass", 1, f"own mass, unloaded [{MASS / 1000:g} t]"),
        _own("own_front_drive", 1, "share of the drive in front", 1.0),
        _own("own_speed_limits", 2, _LIMITS),
    ),
    _response,
)


_GEAR = "direction of the own last motion: 1 forwards, -1 backwards, 0 = none yet"
GEAR = Part(
    (Field("own_gear", 1, -1.0, 1.0, _GEAR),),
    lambda sight: {"own_gear": sight.own(sight.state.stats.direction)[..., None]},
)


TURNS = 4  # times the direction of travel changed last, whose places are observed
CHANGES = 20.0  # changes of direction in a tight bay
LONG = 100.0  # s, about a long episode
REST = 10.0  # s
STANDING = 0.01  # m, shorter steps are rest


@struct.dataclass
class Past:
    """What agents remember of their episodes, arrays (num_agents, ...).

    Attributes:
        turns_w: (..., TURNS, 3) measured poses at the last changes of the direction of
            travel, the newest first.
        changes: number of these changes so far.
        path: driven length so far [m].
        rest: control steps since the car last moved.
    """

    turns_w: jax.Array
    changes: jax.Array
    path: jax.Array
    rest: jax.Array


def init_past(num_agents: int) -> Past:
    """Nothing yet."""
    zero = jnp.zeros(num_agents, jnp.float32)
    return Past(jnp.zeros((num_agents, TURNS, 3), jnp.float32), zero, zero, zero)


def update_past(state: State) -> Past:
    """The past once the state belongs to it."""
    past: Past = state.memory["past"]
    pose, stats = observed(state).pose_w[:, None], state.stats
    turned = (stats.gear_changes > past.changes)[:, None, None]
    turns = jnp.concatenate([pose, past.turns_w[:, :-1]], axis=1)
    return Past(
        turns_w=jnp.where(turned, turns, past.turns_w),
        changes=stats.gear_changes,
        path=stats.path,
        rest=jnp.where(stats.path - past.path < STANDING, past.rest + 1.0, 0.0),
    )


@functools.cache
def past_part(ctrl_dt: float) -> Part:
    """What agents remember, `Past`; `ctrl_dt` is the time of a control step [s]."""

    def fill(sight: ObservationInput) -> dict[str, jax.Array]:
        past, step = sight.own((sight.state.memory["past"], sight.state.step))
        known = jnp.arange(TURNS) < past.changes[:, None]
        local = to_local(sight.motion.pose_w[:, None], past.turns_w)
        place = jnp.clip(local[..., :2] / (2 * NEAR), -1.0, 1.0)
        turns = jnp.concatenate([place, unit_vector(local[..., 2])], axis=-1)
        turns = jnp.where(known[..., None], turns, 0.0)
        seconds = ctrl_dt * jnp.stack([step / LONG, past.rest / REST], axis=-1)
        return {
            "own_time": jnp.clip(seconds, 0.0, 2.0),
            "own_changes": jnp.clip(past.changes / CHANGES, 0.0, 2.0)[:, None],
            "own_turns": turns.reshape(len(turns), -1),
        }

    times = f"since the episode began [{LONG:g} s], since the car moved [{REST:g} s]"
    changes = f"times the direction of travel has changed [{CHANGES:g}]"
    turns = (
        f"where it last changed, {TURNS} times, the newest first: x and y, body frame "
        f"[{NEAR * 2:g} m], clipped, cos and sin of the heading less own; 0 = not yet"
    )
    aside = tuple(place * (-1) ** (place + 1) for place in range(1, 4 * TURNS + 1))
    fields = (
        _own("own_time", 2, times),
        _own("own_changes", 1, changes),
        Field("own_turns", 4 * TURNS, -1.0, 1.0, turns, mirror=aside),
    )
    return Part(fields, fill)


_ROOM_LEFT = f"length and width less own [{LENGTH:g} m]"
_BAY_FIELDS = (
    mask_field("bay"),
    *POSE_FIELDS,
    Field("size", 2, 0.0, 2.0, _ROOM_LEFT, metres=LENGTH),
    distance_field("distance", "to its centre"),
)
_CLAIM = f"1 and that of the nearest with this goal [{FAR:g} m]; 0"
_RIVAL_FIELDS = (
    distance_field("nearest_agent", "from it to the nearest of all agents"),
    Field("claim", 2, 0.0, FARTHEST, _CLAIM, metres=FAR),
)


@functools.cache
def choice_part(num_tracked_bays: int) -> Part:
    """Which of the tracked bays an agent has chosen."""

    def fill(sight: ObservationInput) -> dict[str, jax.Array]:
        bays = sight.tracked_bays
        choice = goal_code(sight.goal[:, None], bays)[:, 0]
        return {"goal_choice": jax.nn.one_hot(choice, num_tracked_bays + 1)}

    meaning = "one-hot: exploring, or which tracked bay is the goal"
    size = num_tracked_bays + 1
    field = Field("goal_choice", size, 0.0, 1.0, meaning, reveals_goal=True)
    return Part((field,), fill)


@functools.cache
def bays_part(count: int, global_information: bool) -> Part:
    """The tracked bays, with the agents near them if there is global information."""

    def fill(sight: ObservationInput) -> dict[str, jax.Array]:
        layout, motion, bays = sight.layout, sight.motion, sight.tracked_bays
        room = layout.bay_size[bays] - motion.size[:, None]
        pose, present = layout.parked_pose[bays], bays != NO_BAY
        values = localise(motion.pose_w, pose, room, present)
        distance = jnp.minimum(norm(values["position"]), FARTHEST)[..., None]
        values |= {"distance": distance}
        if global_information:
            values |= _rival_values(sight, bays)
        return repeated_values("bay", values)

    fields = [*_BAY_FIELDS, *(_RIVAL_FIELDS if global_information else ())]
    return Part(tuple(repeated("bay", count, fields)), fill)


def goal_code(goal: jax.Array, bays: jax.Array) -> jax.Array:
    """Goals (num_agents, count) as numbers (num_agents, count) that observers know.

    0 is exploring (`NO_BAY`), 1 to n which of the `bays` (num_agents, n) an observer
    tracks, n + 1 a bay it does not track.
    """
    match = bays[:, None] == goal[..., None]
    code = jnp.where(match.any(-1), 1 + jnp.argmax(match, -1), 1 + bays.shape[1])
    return jnp.where(goal == NO_BAY, 0, code)


def rivals(
    layout: Layout, agent_xy: jax.Array, goal: jax.Array, bays: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """How near agents are to bays: global information (Tanner 2022, eq. 3.7).

    Agents, the observers too, are at centres (num_agents, 2) [m] with goals
    (num_agents,). Returns distances [m] to the centres of `bays` (num_agents, count),
    of the nearest agent and of the nearest with the bay as goal, inf if none has.
    """
    gap = norm(layout.bay_pose[bays][..., None, :2] - agent_xy)
    wants = bays[..., None] == goal
    return jnp.min(gap, axis=-1), jnp.min(jnp.where(wants, gap, jnp.inf), axis=-1)


def _rival_values(sight: ObservationInput, bays: jax.Array) -> dict[str, jax.Array]:
    """`_RIVAL_FIELDS` (num_observers, count, k) of bays; zeros where there is none."""
    nearest, claim = rivals(sight.layout, sight.agents.xy, sight.state.goal, bays)
    present, claimed = bays != NO_BAY, jnp.isfinite(claim)
    claimed = claimed & present
    claim = far(jnp.where(claimed, claim, 0.0))
    return {
        "nearest_agent": far(jnp.where(present, nearest, 0.0)[..., None]),
        "claim": jnp.stack([claimed.astype(claim.dtype), claim], axis=-1),
    }


def _goal_rivals(sight: ObservationInput) -> dict[str, jax.Array]:
    found = _rival_values(sight, sight.goal[:, None])
    return {f"goal_{name}": value[:, 0] for name, value in found.items()}


# The agents near a fixed goal.
RIVALS = Part(
    tuple(
        dataclasses.replace(field, name=f"goal_{field.name}", reveals_goal=True)
        for field in _RIVAL_FIELDS
    ),
    _goal_rivals,
)
