"""Inputs of a car outside the simulator, about itself and its lot: plain arrays.

World frame, SI units and radians.
"""

import dataclasses

from carpark_mj.geometry.obstacles import Boxes, Discs
from carpark_mj.types import State


@dataclasses.dataclass(frozen=True)
class Rows:
    """How many rows inputs have, padding included; masks mark the valid rows.

    Attributes:
        others: other cars that drive.
        parked: parked cars.
        walls: walls and other boxes.
        discs: pillars and other discs.
        lanes: lanes.
        bays: tracked bays, from which goals are chosen; 0 = goals are fixed.
        bay_ends: whether there are bays that an end of the car must enter first.
    """

    others: int = 0
    parked: int = 0
    walls: int = 0
    discs: int = 0
    lanes: int = 0
    bays: int = 0
    bay_ends: bool = False


@dataclasses.dataclass(frozen=True)
class PlainInput:
    """An input array of a car outside.

    Attributes:
        name: of the input.
        dims: its shape, names of `Rows` for numbers of rows; there is no batch.
        unit: of its numbers; "" of indices and masks.
        meaning: what they are.
        dtype: `float32`, `int32` or `bool`.
    """

    name: str
    dims: tuple[int | str, ...]
    unit: str
    meaning: str
    dtype: str = "float32"

    def shape(self, rows: Rows) -> tuple[int, ...]:
        """Its shape."""
        return tuple(getattr(rows, n) if isinstance(n, str) else n for n in self.dims)


_POSE, _SIZE = "m, m, rad", "their lengths and widths"
_PARKED = "centre, and heading of a car parked tail in"
_END = "the end that goes in first: 0 either, 1 nose, 2 tail"
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
    PlainInput("lane_pose", ("lanes", 3), _POSE, "lanes: centre and direction"),
    PlainInput("lane_size", ("lanes", 2), "m", _SIZE),
    PlainInput("lane_one_way", ("lanes",), "", "one-way in that direction", "bool"),
    PlainInput("lane_mask", ("lanes",), "", "padding mask: valid rows", "bool"),
)


def rows_of(state: State) -> Rows:
    """The rows that hold a lot (arrays or their shapes)."""
    layout, movers = state.layout, state.movers.groups
    boxes, discs = (
        sum(group.count for group in movers if isinstance(group, shape))
        for shape in (Boxes, Discs)
    )
    return Rows(
        others=state.goal.shape[0] - 1,
        parked=state.parked_cars.bay.shape[0],
        walls=layout.wall_mask.shape[0] + boxes,
        discs=layout.disc_mask.shape[0] + discs,
        lanes=layout.lane_mask.shape[0],
        bays=0 if state.tracked_bays is None else state.tracked_bays.shape[1],
        bay_ends=layout.bay_end is not None,
    )


def markdown_inputs() -> str:
    """`INPUTS` as a markdown table."""
    rows = ["| input | shape | unit | |", "|---|---|---|---|"]
    for entry in INPUTS:
        shape = ", ".join(map(str, entry.dims))
        shape = f"({shape},)" if len(entry.dims) == 1 else f"({shape})"
        unit = entry.unit or entry.dtype
        rows.append(f"| `{entry.name}` | {shape} | {unit} | {entry.meaning} |")
    return "\n".join(rows)
