"""The MuJoCo scene of a lot: what the renderer shows, built with `MjSpec`."""

import mujoco
import numpy as np

from carpark_mj.layouts.types import Layout
from carpark_mj.scene import car_look, parts
from carpark_mj.vehicle.parameters import VehicleParameters

OFFSCREEN_WIDTH, OFFSCREEN_HEIGHT = 1920, 1080  # largest frame the renderer may ask for


def build_scene(
    layout: Layout,
    params: VehicleParameters,
    num_agents: int,
    num_parked_cars: int,
) -> mujoco.MjSpec:
    """Builds the scene of one lot.

    Args:
        layout: one layout (no batch dimension).
        params: the vehicle of all cars.
        num_agents: cars `agent0/car`... with free joints.
        num_parked_cars: mocap bodies `parked0`...

    Returns:
        A spec; cameras are `topdown`, `overview` and `agentK/chase`.
    """
    spec = mujoco.MjSpec()
    spec.modelname = "carpark"
    spec.visual.global_.offwidth = OFFSCREEN_WIDTH
    spec.visual.global_.offheight = OFFSCREEN_HEIGHT
    extent = np.asarray(layout.extent, float)
    car_look.add_meshes(spec, params)
    parts.add_ground(spec)
    parts.add_bay_lines(spec, layout)
    parts.add_walls(spec, layout)
    parts.add_parked_cars(spec, params, num_parked_cars)
    parts.add_agents(spec, params, num_agents)
    parts.add_lights(spec, extent)
    parts.add_cameras(spec, extent)
    return spec


__all__ = ["build_scene"]
