"""The observation layer: fields, and the functions that fill them."""

from carpark_mj.observations.compose import observe
from carpark_mj.observations.fields import (
    Field,
    make_fields,
    markdown_table,
    observation_size,
)

__all__ = ["Field", "make_fields", "markdown_table", "observation_size", "observe"]
