"""Plane geometry: poses in SE(2), oriented boxes and discs, the broad phase."""

from carpark_mj.geometry.boxes import (
    box_contact_time,
    box_corners,
    box_disc_contact_time,
    box_disc_distance,
    box_disc_overlap,
    box_distance,
    box_inside,
    box_room,
    boxes_overlap,
    point_box_distance,
    ray_box_distance,
    ray_disc_distance,
    swept_half_size,
)
from carpark_mj.geometry.nearest import nearest
from carpark_mj.geometry.reeds_shepp import reeds_shepp_length
from carpark_mj.geometry.se2 import (
    axis_angle_error,
    heading_error,
    move_forward,
    norm,
    rotate,
    to_local,
    to_world,
    wrap_angle,
)

__all__ = [
    "axis_angle_error",
    "box_contact_time",
    "box_corners",
    "box_disc_contact_time",
    "box_disc_distance",
    "box_disc_overlap",
    "box_distance",
    "box_inside",
    "box_room",
    "boxes_overlap",
    "heading_error",
    "move_forward",
    "nearest",
    "norm",
    "point_box_distance",
    "ray_box_distance",
    "ray_disc_distance",
    "reeds_shepp_length",
    "rotate",
    "swept_half_size",
    "to_local",
    "to_world",
    "wrap_angle",
]
