"""What agents observe: fields, and the functions that fill them."""

from carpark_mj.observations.compose import (
    make_fields,
    markdown_table,
    observation_size,
    observe,
)
from carpark_mj.observations.fields import Field

__all__ = ["Field", "make_fields", "markdown_table", "observation_size", "observe"]
