"""Builds the MuJoCo scene of a lot with `MjSpec`, and exports it.

One builder serves three purposes: the renderer's pictures, the `scene` back end in
which all cars and walls collide, and exported models to drive in the viewer.
"""

import math
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from carpark_mj.config.checks import counted
from carpark_mj.geometry.obstacles import Group
from carpark_mj.layouts.types import Layout
from carpark_mj.scene import cameras, looks, parts
from carpark_mj.scene.camera_flags import OFFSCREEN_HEIGHT, OFFSCREEN_WIDTH
from carpark_mj.scene.movers import add_movers
from carpark_mj.vehicle import contact_wheels as contact
from carpark_mj.vehicle.mjcf import add_car
from carpark_mj.vehicle.parameters import GRAVITY, VehicleParameters


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

    Hulls of agents' cars, parked cars and walls collide with each other. Cameras are
    `topdown`, `overview`, `agentK/chase` and `agentK/driver`.

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
    """
    spec = mujoco.MjSpec()
    spec.modelname = "carpark"
    spec.visual.global_.offwidth = OFFSCREEN_WIDTH
    spec.visual.global_.offheight = OFFSCREEN_HEIGHT
    extent = np.asarray(layout.extent, float)
    looks.add_materials(spec)
    parts.add_ground(spec)
    parts.add_verge(spec, extent)
    parts.add_bay_lines(spec, layout)
    parts.add_lane_arrows(spec, layout)
    parts.add_bay_numbers(spec, layout)
    parts.add_walls(spec, layout)
    parts.add_discs(spec, layout)
    add_movers(spec, movers)
    parts.add_parked_cars(spec, parked_cars)
    for k, kind in enumerate(tuple(agent_kinds) or (params,)):
        parts.add_agents(spec, kind, num_agents, not contact_wheels, k, suspension)
    if contact_wheels:
        contact.set_contact_options(spec)
        for prefix in map(parts.car_prefix, range(num_agents)):
            contact.add_contact_wheels(spec, params, prefix, parts.GROUND, suspension)
            contact.add_controls(spec, params, prefix)
    parts.add_lights(spec, extent)
    cameras.add_lot_cameras(spec, extent)
    return spec


SETTLING = 5.0  # s, after which a car placed on the ground is at rest

_GUIDE = """
  A {place} with {agents} to drive, made by carpark_mj.
  Open it with `python -m mujoco.viewer`: drop the file into the window.

  Sliders of car K (panel "Control"):
    agentK/steer  target angle of the bicycle model's wheel [rad], left positive,
                  reached at {rate:g} rad/s; two joint equalities turn the wheels
    agentK/drive  {reverse:.2f} to 1: motor torque with engine braking; the driven
                  wheels settle at about this times {speed:g} m/s, less
                  {loss:.2f} m/s for rolling resistance. In a curve front wheels are
                  faster than the car.
    agentK/brake  0 to 1: disc brakes on the four wheels, up to the torque of
                  {brake:.1f} m/s^2. The wheels lock before that: their tyres slide at
                  {grip:.1f} m/s^2. The brake holds the car on a slope, too: on 20 %
                  it creeps by less than 1 mm in a minute.

  Contact wheels roll without slip up to a friction of {friction:g}. Cars, parked cars
  (on locked wheels) and walls collide. Cameras: topdown, overview, agentK/chase,
  agentK/driver.
"""


def drivable_scene(
    layout: Layout,
    params: VehicleParameters,
    agent_pose: np.ndarray,
    parked_pose: np.ndarray,
    suspension: bool = False,
    movers: Sequence[Group] = (),
) -> mujoco.MjSpec:
    """Builds a scene on contact wheels, all cars placed and at rest.

    Poses (n, 3) are those of the footprints' centres of the cars to drive and of the
    parked ones; movers stay where they are. See `build_scene`.
    """
    parked = (params,) * len(parked_pose)
    wheels: dict[str, Any] = {"contact_wheels": True, "suspension": suspension}
    scene = layout, params, len(agent_pose), parked
    spec = build_scene(*scene, movers=movers, **wheels)
    height, pitch = rest_attitude(params, suspension)
    cars = [(f"agent{k}/car", x, height, pitch) for k, x in enumerate(agent_pose)]
    cars += [(f"parked{k}", x, 0.0, 0.0) for k, x in enumerate(parked_pose)]
    for name, pose, height, pitch in cars:
        x, y, yaw = parts.rear_axle(params, map(float, pose))
        body = spec.body(name)
        body.pos, body.quat = [x, y, height], parts.yaw_quat(yaw, pitch)
    return spec


def rest_attitude(
    params: VehicleParameters, suspension: bool = False
) -> tuple[float, float]:
    """Height [m] and pitch [rad] at which a car on contact wheels is at rest."""
    spec = mujoco.MjSpec()
    contact.set_contact_options(spec)
    parts.add_ground(spec)
    add_car(spec.worldbody, spec, params, "", servos=False, suspension=suspension)
    contact.add_contact_wheels(spec, params, "", parts.GROUND, suspension)
    contact.add_controls(spec, params, "")
    model = spec.compile()
    data = mujoco.MjData(model)
    for _ in range(round(SETTLING / model.opt.timestep)):
        mujoco.mj_step(model, data)
    w, _, y, _ = data.qpos[3:7]
    return float(data.qpos[2]), 2.0 * math.atan2(y, w)


def scene_xml(
    spec: mujoco.MjSpec, params: VehicleParameters, place: str = "car park"
) -> str:
    """The scene as MJCF text, with a guide to its controls at the top.

    It is well-formed XML for other readers too: comments must not contain `--`.
    """
    spec.compile()
    agents = sum(body.name.startswith("agent") for body in spec.worldbody.bodies)
    guide = _GUIDE.format(
        place=place,
        agents=counted(agents, "car"),
        rate=params.steering_rate,
        reverse=-params.max_reverse_speed / params.max_speed,
        speed=params.max_speed,
        loss=contact.rolling_loss(params),
        brake=contact.FULL_BRAKE * params.tyre.friction * GRAVITY,
        grip=params.tyre.friction * GRAVITY,
        friction=params.tyre.friction,
    )
    return f"<!--{guide}-->\n{spec.to_xml()}"
