"""Shapes that name what they are by a tag of ours."""

import math
from collections.abc import Mapping
from typing import Any, get_args

import shapely

from carpark_mj.maps.features import LINE_THICKNESS, Feature, Plan, Tag
from carpark_mj.maps.fit import boxes
from carpark_mj.maps.openstreetmap import add_by_tags

NARROW = 2.0  # m, less of an aisle is no lane
BEND = 0.25  # m, smaller bends of an aisle are straightened


def add_tagged(plan: Plan, name: str, shape: Any, tags: Mapping[str, Any]) -> None:
    """Adds a shape by its `tag`, or by the tags of OpenStreetMap if it has none.

    Args:
        plan: to add to.
        name: of the shape.
        shape: of shapely [m].
        tags: `tag`, one of `features.Tag`; of lanes `width` [m] and `one_way` too.
    """
    tag = tags.get("tag")
    if tag is None:
        add_by_tags(plan, name, tags, shape)
    elif tag not in get_args(Tag):
        plan.unknown[f"tag={tag}"] += 1
    elif tag == "lane" and shape.area:
        _add_aisle(plan, name, shapely.make_valid(shape), bool(tags.get("one_way")))
    elif tag == "lane":
        road = {"highway": "service", "width": tags.get("width")}
        road["level"] = tags.get("level")
        road["oneway"] = "yes" if tags.get("one_way") else "no"
        add_by_tags(plan, name, road, shape)
    else:
        if not shape.area and tag in ("wall", "kerb", "pillar"):
            shape = shape.buffer(LINE_THICKNESS / 2)
        if shape.area:
            level = str(tags.get("level") or "")
            plan.features.append(
                Feature(tag, shapely.make_valid(shape), name, level=level)
            )
        elif tag == "bay":
            plan.lost[name] = f"a {shape.geom_type.lower()}, not an area"
        else:
            plan.unknown[f"{tag} that is no area"] += 1


def _add_aisle(plan: Plan, name: str, ground: Any, one_way: bool) -> None:
    """Adds the ground of an aisle, and lanes along the rectangles that cover it."""
    plan.features.append(Feature("drivable", ground, name))
    # Without its narrow corners and small bends.
    wide = ground.buffer(-NARROW / 2, join_style="mitre")
    wide = wide.buffer(NARROW / 2, join_style="mitre").simplify(BEND)
    for box in boxes(wide):
        dx, dy = (box.length / 2 * f(box.yaw) for f in (math.cos, math.sin))
        line = shapely.LineString([(box.x - dx, box.y - dy), (box.x + dx, box.y + dy)])
        plan.features.append(
            Feature("lane", line, name, width=box.width, one_way=one_way)
        )
