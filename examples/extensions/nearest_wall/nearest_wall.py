"""An observation field: how far an agent is from the nearest wall."""

import dataclasses

import jax
import jax.numpy as jnp

from carpark_mj.config import ENCODERS, EnvConfig
from carpark_mj.geometry import point_box_distance
from carpark_mj.observations import ContinuousObservation, Field, ObservationInput, Part
from carpark_mj.observations.fields import FAR, FARTHEST, far


def distance(sight: ObservationInput) -> dict[str, jax.Array]:
    """From the own centre, as measured, to the nearest wall."""
    layout, own_xy = sight.layout, sight.motion.xy
    gap = point_box_distance(own_xy[:, None], layout.wall_pose, layout.wall_size)
    nearest = jnp.min(jnp.where(layout.wall_mask, gap, jnp.inf), axis=1, keepdims=True)
    return {"nearest_wall": far(nearest)}


MEANING = f"from the own centre to the nearest wall [{FAR:g} m]"
NEAREST_WALL = Part(
    (Field("nearest_wall", 1, 0.0, FARTHEST, MEANING, metres=FAR),), distance
)


@dataclasses.dataclass(frozen=True)
class NearestWallObservation(ContinuousObservation):
    """What the default encoder observes, and the nearest wall."""

    encoding: str = "nearest_wall"

    def parts(self, env: EnvConfig) -> list[Part]:
        """Parts of the default encoder, and one more."""
        return [*super().parts(env), NEAREST_WALL]


ENCODERS.register("nearest_wall", NearestWallObservation)
