"""The observation vector, declared once: ordered fields with units and ranges.

`make_fields` is what `observe`, the observation size and the README's table all read.
Angles enter as cosine and sine; distances both far (divided by `FAR`) and near
(divided by `NEAR` and clipped), so that metres and centimetres are both visible.
"""

import dataclasses
from collections.abc import Sequence

from carpark_mj.config import GridConfig, ObservationConfig
from carpark_mj.config.observation import BAY_PARTS

FAR = 20.0  # m, about half a `tanner` lot
NEAR = 3.0  # m, the last car length before the goal


@dataclasses.dataclass(frozen=True)
class Field:
    """A named slice of the observation vector.

    Attributes:
        name: unique.
        size: numbers it takes.
        low: smallest value.
        high: largest value; the ranges hold while cars stay on the lot and within
            their speed limits.
        meaning: what the numbers are, with scale and unit.
    """

    name: str
    size: int
    low: float
    high: float
    meaning: str


_CAR = (
    ("present", 1, 0.0, 1.0, "1 if there is such a car; else all its numbers are 0"),
    ("position", 2, -4.0, 4.0, f"its centre, x and y, body frame [{FAR:g} m]"),
    ("near_position", 2, -1.0, 1.0, f"the same [{NEAR * 2:g} m], clipped"),
    ("heading", 2, -1.0, 1.0, "cos and sin of its heading minus own"),
    ("size", 2, 0.0, 2.0, "length and width [5 m]"),
)
_SPEED = ("speed", 1, -1.5, 1.5, "its signed speed [own forward limit]")
_GOAL = ("goal", 2, -4.0, 4.0, f"centre of its goal, body frame [{FAR:g} m]")
_GOAL_HEADING = ("goal_heading", 2, -1.0, 1.0, "cos and sin of its goal's minus own")
_SPACE = (
    ("present", 1, 0.0, 1.0, "1 if there is such a bay; else all its numbers are 0"),
    *_CAR[1:-1],
    ("size", 2, 0.0, 2.0, "length and width less own [5 m]"),
    ("distance", 1, 0.0, 4.0, f"to its centre [{FAR:g} m]"),
)
_RIVALS = (
    ("nearest_agent", 1, 0.0, 4.0, f"from it to the nearest of all agents [{FAR:g} m]"),
    ("claim", 2, 0.0, 4.0, f"1 and that of the nearest with this goal [{FAR:g} m]; 0"),
)


def make_fields(
    config: ObservationConfig, grid: GridConfig | None = None, num_spaces: int = 0
) -> tuple[Field, ...]:
    """Lists the fields of the observation vector in order.

    Args:
        config: what is observed.
        grid: whose ranges `indices` have; None is the default grid.
        num_spaces: bays tracked where agents choose their goals; 0 = fixed goals.
    """
    if config.encoding == "tanner":
        return _tanner_fields(config, num_spaces)
    if config.encoding == "indices":
        return _index_fields(config, grid if grid is not None else GridConfig())
    fields = [
        Field("speed", 1, -1.5, 1.5, "own signed speed [forward limit]"),
        Field("steering", 1, -1.0, 1.0, "own road-wheel angle [its limit], left > 0"),
        Field("yaw_rate", 1, -2.0, 2.0, "own yaw rate [rad/s], left > 0"),
        Field("goal_position", 2, -4.0, 4.0, f"goal centre, body frame [{FAR:g} m]"),
        Field(
            "goal_near", 2, -1.0, 1.0, f"goal centre, body frame [{NEAR:g} m], clipped"
        ),
        Field("goal_heading", 2, -1.0, 1.0, "cos and sin of goal heading minus own"),
        Field("goal_distance", 1, 0.0, 4.0, f"to the goal centre [{FAR:g} m]"),
        Field("in_bay", 2, -1.0, 1.0, f"own centre, goal frame [{NEAR:g} m], clipped"),
        Field(
            "goal_size", 2, 0.0, 2.0, "length and width of the goal bay less own [5 m]"
        ),
    ]
    rivals = _RIVALS if config.global_information else ()
    if num_spaces:
        meaning = "one-hot: exploring, or which tracked bay is the goal"
        fields.append(Field("goal_choice", num_spaces + 1, 0.0, 1.0, meaning))
        for k in range(num_spaces):
            fields += _named(f"space_{k}", (*_SPACE, *rivals))
    else:
        fields += _named("goal", rivals)
    if config.own_car:
        fields += [
            Field("own_size", 2, 0.0, 2.0, "own length and width [5 m]"),
            Field("own_wheelbase", 1, 0.0, 1.0, "own wheelbase [5 m]"),
            Field("own_rear_axle", 1, 0.0, 1.0, "own centre ahead of rear axle [5 m]"),
            Field(
                "own_turning_radius", 1, 0.0, 2.0, "of the rear axle, full lock [5 m]"
            ),
        ]
    agent = [*_CAR]
    if config.share_speeds:
        agent.append(_SPEED)
    if config.share_goals and num_spaces:
        meaning = "one-hot: it explores, its goal's place among the own bays, none"
        agent.append(("goal", num_spaces + 2, 0.0, 1.0, meaning))
    elif config.share_goals:
        agent += [_GOAL, _GOAL_HEADING] if config.share_goal_heading else [_GOAL]
    for k in range(config.tracked_agents):
        fields += _named(f"agent_{k}", agent)
    for k in range(config.tracked_parked_cars):
        fields += _named(f"parked_{k}", _CAR)
    fields += _ring_fields(config, 1.0, f"the circle about the car [{config.ring_cap}]")
    if config.rays:
        meaning = (
            f"free way along bearings from ahead to the left [{config.ray_range:g} m]"
        )
        fields.append(Field("rays", config.rays, 0.0, 1.0, meaning))
    if config.lane:
        fields += [
            Field("lane_present", 1, 0.0, 1.0, "1 if the lot has lanes; else all 0"),
            Field("lane_heading", 2, -1.0, 1.0, "cos and sin of its heading minus own"),
            Field("lane_one_way", 1, 0.0, 1.0, "1 if only that direction is right"),
        ]
    return tuple(fields)


def _named(
    prefix: str, rows: Sequence[tuple[str, int, float, float, str]]
) -> list[Field]:
    return [
        Field(f"{prefix}_{name}", size, low, high, meaning)
        for name, size, low, high, meaning in rows
    ]


def ring_names(config: ObservationConfig) -> list[str]:
    """Names of the counts as agents see them: now, then the past, the oldest first."""
    now = [f"ring_{diameter:g}m" for diameter in config.rings]
    past = range(config.ring_history, 0, -1)
    return now + [f"{name}_ago_{ago}" for ago in past for name in now]


def _ring_fields(config: ObservationConfig, high: float, where: str) -> list[Field]:
    objects = "walls and discs, cars too," if config.ring_cars else "walls and discs"
    meaning = f"{objects} within {where}, capped"
    return [Field(name, 1, 0.0, high, meaning) for name in ring_names(config)]


# What `tanner` tells of a bay and of a car, by part: highest value, -1 = no such.
_TANNER = {
    "heading": (1.0, "heading minus own, clockwise [360 deg]"),
    "distance": (1.5, "to its centre [diagonal]"),
    "bearing": (1.0, "of its centre, clockwise from ahead, rounded [360 deg]"),
    "nearest_agent": (1.5, "from it to the nearest of all agents [diagonal]"),
    "claim": (1.5, "from it to the nearest agent with this goal [diagonal]"),
    "goal_heading": (1.0, "its goal's heading minus its own, clockwise [360 deg]"),
    "goal_distance": (1.5, "from it to its goal [diagonal]"),
    "goal_bearing": (1.0, "of its goal, clockwise from ahead of it [360 deg]"),
    "goal": (1.0, "its goal [values]: 0 exploring, the own bays, one not tracked"),
}
_LEVEL = "speed from fastest reverse [levels]"


def _tanner_fields(config: ObservationConfig, num_spaces: int) -> tuple[Field, ...]:
    def padded(prefix: str, names: Sequence[str]) -> list[Field]:
        return [Field(f"{prefix}_{n}", 1, -1.0, *_TANNER[n]) for n in names]

    # Cars with other limits than the grid's may leave its range of speeds by a little.
    fields = [Field("speed", 1, -0.5, 1.5, f"own {_LEVEL}")]
    bay = [part for part in BAY_PARTS if part in config.bay_parts]
    if config.global_information:
        bay += ["nearest_agent", "claim"]
    for name in [f"space_{k}" for k in range(num_spaces)] or ["goal"]:
        fields += padded(name, bay)
    fields += _ring_fields(config, 1.0, f"the circle about it [{config.ring_cap + 1}]")
    car = ["distance", "bearing", "heading"]
    if config.share_goals and num_spaces:
        car.append("goal")
    elif config.share_goals:
        car += ["goal_bearing", "goal_distance"]
        car += ["goal_heading"] if config.share_goal_heading else []
    for k in range(config.tracked_cars):
        fields += padded(f"car_{k}", car)
        if config.share_speeds:
            fields.append(Field(f"car_{k}_speed", 1, -1.0, 1.5, f"its {_LEVEL}"))
    if num_spaces:
        meaning = "own goal [values]: 0 exploring, then the own bays"
        fields.append(Field("goal_choice", 1, 0.0, 1.0, meaning))
    return tuple(fields)


def _index_fields(config: ObservationConfig, grid: GridConfig) -> tuple[Field, ...]:
    return (
        Field("level", 1, 0.0, grid.num_levels - 1, "own speed from fastest reverse"),
        Field(
            "bearing", 1, 0.0, grid.headings - 1, "of the goal, clockwise from ahead"
        ),
        *_ring_fields(config, config.ring_cap, "the circle about the car"),
    )


def observation_size(config: ObservationConfig, num_spaces: int = 0) -> int:
    """Length of the observation vector; see `make_fields`."""
    return sum(field.size for field in make_fields(config, None, num_spaces))


def markdown_table(config: ObservationConfig) -> str:
    """The fields as a markdown table; the README carries its output.

    Cars tracked after the first of their kind repeat its rows and are left out.
    """
    rows = ["| field | size | range | meaning [unit] |", "|---|---|---|---|"]
    for field in make_fields(config):
        parts = field.name.split("_")
        if parts[0] in ("agent", "parked", "car", "space") and parts[1] != "0":
            continue
        rows.append(
            f"| `{field.name}` | {field.size} | {field.low:g} … {field.high:g} | "
            f"{field.meaning} |"
        )
    return "\n".join(rows)
