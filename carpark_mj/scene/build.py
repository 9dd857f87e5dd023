"""Builds the MuJoCo scene of a lot with `MjSpec`.

One builder serves three purposes: the renderer's pictures, the `scene` back end in
which all cars and walls collide, and exported models to drive in the viewer.
"""

from collections.abc import Sequence

import mujoco
import numpy as np

from carpark_mj.geometry.obstacles import Group
from carpark_mj.layouts.types import Layout
from carpark_mj.scene import cameras, markings, materials, parts
from carpark_mj.scene.movers import add_movers
from carpark_mj.scene.numbers import add_bay_numbers
from carpark_mj.vehicle.contact_wheels import (
    add_contact_wheels,
    add_controls,
    set_contact_options,
)
from carpark_mj.vehicle.parameters import VehicleParameters

OFFSCREEN_WIDTH, OFFSCREEN_HEIGHT = 1920, 1080  # largest frame the renderer may ask for


def build_scene(
    layout: Layout,
    params: VehicleParameters,
    num_agents: int,
    parked_cars: Sequence[VehicleParameters],
    contact_wheels: bool = False,
    agent_kinds: Sequence[VehicleParameters] = (),
    suspension: bool = False,
    movers: Sequence[Group] = (),
) -> mujoco.MjSpec:
    """Builds the scene of one lot, all cars at the origin.

    Hulls of agents' cars, parked cars and walls collide with each other.

    Args:
        layout: one layout (no batch dimension).
        params: the vehicle of the agents' cars.
        num_agents: cars `agent0/car`... with free joints.
        parked_cars: vehicles of the cars `parked0`..., one each, with joints
            `parked0/x`, `/y` and `/yaw`.
        contact_wheels: tyres that touch the ground and the controls `agentK/steer`,
            `/drive` and `/brake`. Without them a car has steering servos only, and
            its tyres are forces that the physics applies.
        agent_kinds: several cars for each agent, of which a picture shows one, instead
            of `params`; the names of the second begin with `agentK/kind1/`...
        suspension: springs between the contact wheels and the cars.
        movers: obstacles that move by themselves, bodies `mover0`...

    Returns:
        A spec; cameras are `topdown`, `overview`, `agentK/chase` and
        `agentK/driver`.
    """
    spec = mujoco.MjSpec()
    spec.modelname = "carpark"
    spec.visual.global_.offwidth = OFFSCREEN_WIDTH
    spec.visual.global_.offheight = OFFSCREEN_HEIGHT
    extent = np.asarray(layout.extent, float)
    materials.add_materials(spec)
    parts.add_ground(spec)
    parts.add_verge(spec, extent)
    markings.add_bay_lines(spec, layout)
    markings.add_lane_arrows(spec, layout)
    add_bay_numbers(spec, layout)
    parts.add_walls(spec, layout)
    parts.add_discs(spec, layout)
    add_movers(spec, movers)
    parts.add_parked_cars(spec, parked_cars)
    for k, kind in enumerate(tuple(agent_kinds) or (params,)):
        parts.add_agents(
            spec,
            kind,
            num_agents,
            servos=not contact_wheels,
            kind=k,
            suspension=suspension,
        )
    if contact_wheels:
        set_contact_options(spec)
        for k in range(num_agents):
            add_contact_wheels(spec, params, f"agent{k}/", parts.GROUND, suspension)
            add_controls(spec, params, f"agent{k}/")
    parts.add_lights(spec, extent)
    cameras.add_lot_cameras(spec, extent)
    return spec
