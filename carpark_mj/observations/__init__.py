"""What agents observe: fields, and the functions that fill them."""

from carpark_mj.observations.compose import (
    cardinalities,
    make_fields,
    markdown_table,
    observation_size,
    observe,
    unpack,
)
from carpark_mj.observations.continuous import ContinuousObservation
from carpark_mj.observations.fields import Field, ObservationInput, Part

__all__ = [
    "ContinuousObservation",
    "Field",
    "ObservationInput",
    "Part",
    "cardinalities",
    "make_fields",
    "markdown_table",
    "observation_size",
    "observe",
    "unpack",
]
