"""Observations with pictures: the default encoder's vector and what cameras see.

In a vector a picture is a row of numbers; adapters give it its shape again.
"""

import dataclasses
import functools
import math
from typing import Literal

import jax
import jax.numpy as jnp

from carpark_mj.cameras.blocks import Heights
from carpark_mj.cameras.rig import RIGS, Rig, RigName, Seen
from carpark_mj.cameras.see import see
from carpark_mj.config import ENCODERS, EnvConfig
from carpark_mj.observations import (
    ContinuousObservation,
    Field,
    ObservationInput,
    Part,
    ego,
)
from carpark_mj.vehicle.presets import fleet_cars

Channel = Literal["depth", "seen"]


@dataclasses.dataclass(frozen=True)
class CameraObservation(ContinuousObservation):
    """What the default encoder observes, and pictures of the car's cameras.

    Cars are as tall as the presets that the environment's config names.

    Attributes:
        rig: name of the cameras in `RIGS`.
        width: of a picture [pixels].
        height: of a picture [pixels].
        reach: depths are at most this [m].
        channels: what of the pictures.
        goal: `pose` = the goal pose is observed; `seen` = it is removed while pixels
            show the own bay. A `route` then leads there, and is zero on its last
            stretch while a camera sees the bay.
    """

    rig: RigName = "surround"
    width: int = 64
    height: int = 48
    reach: float = 50.0
    channels: tuple[Channel, ...] = ("depth", "seen")
    goal: Literal["pose", "seen"] = "pose"
    encoding: str = "cameras"

    def __post_init__(self) -> None:
        super().__post_init__()
        _ = self.cameras  # refuses pictures without pixels
        if not self.channels or len({*self.channels}) < len(self.channels):
            raise ValueError(
                f"channels must be one or both of depth and seen, not {self.channels}"
            )
        if self.goal == "pose":
            return
        if "seen" not in self.channels:
            raise ValueError(f"goal 'seen' needs the channel seen of {self.channels}")
        for name in ("lines", "global_information"):
            if getattr(self, name):
                raise ValueError(f"{name} contains the goal pose: goal must be 'pose'")

    def check(self, env: EnvConfig) -> None:
        """See `ObservationConfig.check`."""
        super().check(env)
        if self.goal == "seen" and env.goals.dynamic:
            raise ValueError("goal 'seen' needs fixed goals, not goals.dynamic")

    @functools.cached_property
    def cameras(self) -> Rig:
        """The rig with the resolution and the reach of the pictures."""
        changes = {name: getattr(self, name) for name in ("width", "height", "reach")}
        return dataclasses.replace(RIGS[self.rig], **changes)

    def parts(self, env: EnvConfig) -> list[Part]:
        """Parts of the default encoder, and the pictures."""
        rig = self.cameras
        shape = (len(rig.cameras), rig.height, rig.width)
        size = math.prod(shape)
        far = f"distance along the pixels' rays [{rig.reach:g} m]"
        show, most = "what the pixels show, `Seen`", float(max(Seen))
        # Depths have centimetres near by, decimetres far off.
        depth = Field("camera_depth", size, 0.0, 1.0, far, shape=shape, gamma=0.5)
        seen = Field("camera_seen", size, 0.0, most, show, shape=shape)
        seen = dataclasses.replace(seen, is_whole=True, reveals_goal=True)
        fields = {"depth": depth, "seen": seen}
        fleet = env.fleet
        kinds = [fleet.agents or (env.vehicle,), fleet.parked_cars or (env.vehicle,)]
        cars = [[car for _, car in fleet_cars(names)] for names in kinds]
        heights = Heights(*(tuple(c.height / c.length for c in each) for each in cars))

        def fill(sight: ObservationInput) -> dict[str, jax.Array]:
            pictures = see(rig, sight.state, heights)
            values = {"depth": pictures.depth / rig.reach, "seen": pictures.seen}
            count = sight.motion.size.shape[0]
            return {
                f"camera_{name}": values[name][:count].reshape(count, size)
                for name in self.channels
            }

        pictured = tuple(fields[name] for name in self.channels)
        parts = super().parts(env)
        if self.goal == "seen":
            parts = [part for part in parts if part is not ego.GOAL]
        return [*parts, Part(pictured, fill)]

    def see(self, env: EnvConfig, sight: ObservationInput) -> dict[str, jax.Array]:
        """Parts of the default encoder and the pictures; see `goal`."""
        values = super().see(env, sight)
        if self.goal == "seen" and self.route:
            in_view = (values["camera_seen"] == Seen.OWN_BAY).any(axis=-1)
            silent = (in_view & ego.on_last_stretch(sight))[:, None]
            for field in ego.ROUTE.fields:
                values[field.name] = jnp.where(silent, 0.0, values[field.name])
        return values


ENCODERS.register("cameras", CameraObservation)
