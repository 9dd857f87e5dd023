"""The observation vector, declared once: ordered fields with units and ranges.

`make_fields` is what `observe`, the observation size and the README's table all read.
Angles enter as cosine and sine; distances both far (divided by `FAR`) and near
(divided by `NEAR` and clipped), so that metres and centimetres are both visible.
"""

import dataclasses

from carpark_mj.config import GridConfig, ObservationConfig

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
_AGENT = (
    ("speed", 1, -1.5, 1.5, "its signed speed [own forward limit]"),
    ("goal", 2, -4.0, 4.0, f"centre of its goal, body frame [{FAR:g} m]"),
)


def make_fields(
    config: ObservationConfig, grid: GridConfig | None = None
) -> tuple[Field, ...]:
    """Lists the fields of the observation vector in order.

    Args:
        config: what is observed.
        grid: whose ranges `indices` have; None is the default grid.
    """
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
    if config.own_car:
        fields += [
            Field("own_size", 2, 0.0, 2.0, "own length and width [5 m]"),
            Field("own_wheelbase", 1, 0.0, 1.0, "own wheelbase [5 m]"),
            Field("own_rear_axle", 1, 0.0, 1.0, "own centre ahead of rear axle [5 m]"),
            Field(
                "own_turning_radius", 1, 0.0, 2.0, "of the rear axle, full lock [5 m]"
            ),
        ]
    for k in range(config.tracked_agents):
        for name, size, low, high, meaning in _CAR + _AGENT:
            fields.append(Field(f"agent_{k}_{name}", size, low, high, meaning))
    for k in range(config.tracked_parked_cars):
        for name, size, low, high, meaning in _CAR:
            fields.append(Field(f"parked_{k}_{name}", size, low, high, meaning))
    meaning = (
        f"walls and discs within the circle about the car [{config.ring_cap}], capped"
    )
    fields.extend(
        Field(f"ring_{diameter:g}m", 1, 0.0, 1.0, meaning) for diameter in config.rings
    )
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


def _index_fields(config: ObservationConfig, grid: GridConfig) -> tuple[Field, ...]:
    objects = "objects" if config.ring_cars else "walls and discs"
    return (
        Field("level", 1, 0.0, grid.num_levels - 1, "own speed from fastest reverse"),
        Field(
            "bearing", 1, 0.0, grid.headings - 1, "of the goal, clockwise from ahead"
        ),
        *(
            Field(f"ring_{d:g}m", 1, 0.0, config.ring_cap, f"{objects} within, capped")
            for d in config.rings
        ),
    )


def observation_size(config: ObservationConfig) -> int:
    """Length of the observation vector."""
    return sum(field.size for field in make_fields(config))


def markdown_table(config: ObservationConfig) -> str:
    """The fields as a markdown table; the README carries its output.

    Cars tracked after the first of their kind repeat its rows and are left out.
    """
    rows = ["| field | size | range | meaning [unit] |", "|---|---|---|---|"]
    for field in make_fields(config):
        parts = field.name.split("_")
        if parts[0] in ("agent", "parked") and parts[1] != "0":
            continue
        rows.append(
            f"| `{field.name}` | {field.size} | {field.low:g} … {field.high:g} | "
            f"{field.meaning} |"
        )
    return "\n".join(rows)
