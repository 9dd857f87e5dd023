"""The square of Tanner 2022, under the study's name."""

from carpark_mj.config import register_layout
from carpark_mj.layouts import SQUARE

register_layout("tanner", SQUARE)
