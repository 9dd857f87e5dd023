"""Plane geometry: poses in SE(2), oriented boxes and discs, the broad phase."""

from carpark_mj.geometry.boxes import box_contact_time as box_contact_time
from carpark_mj.geometry.boxes import box_corners as box_corners
from carpark_mj.geometry.boxes import box_disc_contact_time as box_disc_contact_time
from carpark_mj.geometry.boxes import box_disc_distance as box_disc_distance
from carpark_mj.geometry.boxes import box_disc_overlap as box_disc_overlap
from carpark_mj.geometry.boxes import box_distance as box_distance
from carpark_mj.geometry.boxes import box_inside as box_inside
from carpark_mj.geometry.boxes import box_room as box_room
from carpark_mj.geometry.boxes import boxes_overlap as boxes_overlap
from carpark_mj.geometry.boxes import point_box_distance as point_box_distance
from carpark_mj.geometry.boxes import ray_box_distance as ray_box_distance
from carpark_mj.geometry.boxes import ray_disc_distance as ray_disc_distance
from carpark_mj.geometry.boxes import swept_half_size as swept_half_size
from carpark_mj.geometry.reeds_shepp import reeds_shepp_length as reeds_shepp_length
from carpark_mj.geometry.se2 import axis_angle_error as axis_angle_error
from carpark_mj.geometry.se2 import heading_error as heading_error
from carpark_mj.geometry.se2 import move_forward as move_forward
from carpark_mj.geometry.se2 import nearest as nearest
from carpark_mj.geometry.se2 import norm as norm
from carpark_mj.geometry.se2 import rotate as rotate
from carpark_mj.geometry.se2 import to_local as to_local
from carpark_mj.geometry.se2 import to_world as to_world
from carpark_mj.geometry.se2 import wrap_angle as wrap_angle
