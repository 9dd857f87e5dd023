"""What agents observe: fields, and the functions that fill them."""

from carpark_mj.observations.compose import make_fields as make_fields
from carpark_mj.observations.compose import observation_size as observation_size
from carpark_mj.observations.compose import observe as observe
from carpark_mj.observations.compose import unpack as unpack
from carpark_mj.observations.continuous import (
    ContinuousObservation as ContinuousObservation,
)
from carpark_mj.observations.fields import Field as Field
from carpark_mj.observations.fields import ObservationInput as ObservationInput
from carpark_mj.observations.fields import Part as Part
