"""What the adapters of the junction share: its environment, space and pictures."""

import dataclasses
import functools
from typing import Any

import jax
import numpy as np
from gymnasium import spaces

from carpark_mj.rendering.stage import Snapshot, Stage
from carpark_mj.vehicle import VehicleParameters, preset
from carpark_mj.wrappers.batch import Screen
from carpark_mj.wrappers.options import require_options
from carpark_papers.cederle.junction import JunctionConfig, JunctionEnv
from carpark_papers.cederle.junction.cars import road_car
from carpark_papers.cederle.junction.rules import State
from carpark_papers.cederle.video import JunctionStage


def junction_env(**options: Any) -> JunctionEnv:
    """The environment of a `JunctionConfig` in which finished agents wait."""
    known = {field.name for field in dataclasses.fields(JunctionConfig)} - {"respawn"}
    require_options(options, known)
    config = JunctionConfig(**options, respawn=False)
    return _shared_env(config, preset(config.vehicle))


@functools.lru_cache(maxsize=32)
def _shared_env(config: JunctionConfig, car: VehicleParameters) -> JunctionEnv:
    """The environment of a configuration, made and compiled only once."""
    del car  # which the name stands for now
    return JunctionEnv(config)


def observation_box(env: JunctionEnv) -> spaces.Box:
    """The space of an agent's observations: unbounded float32, or uint8 images."""
    if env.config.observation == "image":
        return spaces.Box(0, 255, env.observation_shape, np.uint8)
    return spaces.Box(-np.inf, np.inf, env.observation_shape, np.float32)


class JunctionScreen(Screen):
    """Shows junctions of a batch; squares are the goals of the cars of their colour."""

    def __init__(self, env: JunctionEnv, camera: str = "topdown") -> None:
        """Opens nothing yet; see `Screen`."""
        super().__init__(env, camera, env.num_cars)

    @functools.cached_property
    def _junction(self) -> JunctionStage:
        """The scene of all lots."""
        car = road_car(preset(self._env.config.vehicle))
        return JunctionStage(car, self._env.num_cars)

    def _place(self, state: State, lot: int) -> tuple[Stage, Snapshot]:
        one = dataclasses.replace(state, frames=None)  # large, and not drawn
        seen = self._junction.snapshot(jax.tree.map(lambda x: x[lot], one))
        return self._junction, seen
