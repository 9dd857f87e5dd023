"""What a car looks like: convex hulls from its parameters, wheels, lights.

Looks only; mass properties are the vehicle's. Meshes are written into the model, so
an exported scene needs no files.
"""

import mujoco
import numpy as np
import trimesh

from carpark_mj.scene import materials
from carpark_mj.vehicle.mjcf import WHEELS, hub_positions
from carpark_mj.vehicle.parameters import VehicleParameters

Colour = tuple[float, float, float, float]

GROUND_CLEARANCE = 0.16  # m
BELT = 0.60  # share of the height where the windows begin


def _slab(
    bottom: tuple[float, float, float, float], top: tuple[float, float, float, float]
) -> np.ndarray:
    """Corners of a tapered block: (x from, x to, half width, z) below and above."""
    points = []
    for rear, front, half, z in (bottom, top):
        points += [(x, y, z) for x in (rear, front) for y in (-half, half)]
    return np.array(points)


def body_hulls(params: VehicleParameters) -> dict[str, trimesh.Trimesh]:
    """Convex hulls `body`, `cabin` (glass) and `roof` in the MJCF body frame [m]."""
    rear = -params.rear_overhang
    front = rear + params.length
    half = params.width / 2
    belt, top = BELT * params.height, params.height
    length = params.length
    body = np.concatenate(
        [
            _slab(
                (rear + 0.06, front - 0.10, half - 0.06, GROUND_CLEARANCE),
                (rear, front, half, 0.42 * params.height),
            ),
            _slab(
                (rear + 0.03, front - 0.10, half - 0.02, 0.52 * params.height),
                (rear + 0.08, front - 0.28 * length, half - 0.06, belt),
            ),
        ]
    )
    cabin = _slab(
        (rear + 0.10, front - 0.26 * length, half - 0.07, belt - 0.01),
        (rear + 0.14 * length, front - 0.46 * length, half - 0.22, top - 0.03),
    )
    roof = _slab(
        (rear + 0.13 * length, front - 0.45 * length, half - 0.21, top - 0.05),
        (rear + 0.16 * length, front - 0.49 * length, half - 0.27, top),
    )
    return {
        name: trimesh.convex.convex_hull(points)
        for name, points in (("body", body), ("cabin", cabin), ("roof", roof))
    }


def add_meshes(spec: mujoco.MjSpec, params: VehicleParameters) -> None:
    """Adds the car's meshes to a spec, once for all cars."""
    for name, hull in body_hulls(params).items():
        spec.add_mesh(
            name=f"car_{name}",
            uservert=np.asarray(hull.vertices).ravel().tolist(),
            userface=np.asarray(hull.faces).ravel().tolist(),
            smoothnormal=False,
        )


def _look(body: mujoco.MjsBody, **fields: object) -> None:
    """A geom that is only seen."""
    body.add_geom(contype=0, conaffinity=0, group=2, mass=0.0, **fields)


def add_body_look(
    car: mujoco.MjsBody, params: VehicleParameters, colour: Colour
) -> None:
    """Adds body, windows and lights to a car's body."""
    mesh = mujoco.mjtGeom.mjGEOM_MESH
    _look(car, type=mesh, meshname="car_body", rgba=colour)
    _look(car, type=mesh, meshname="car_cabin", rgba=materials.GLASS)
    _look(car, type=mesh, meshname="car_roof", rgba=colour)
    box = mujoco.mjtGeom.mjGEOM_BOX
    front = params.length - params.rear_overhang
    for side in (-1, 1):
        y = side * (params.width / 2 - 0.24)
        z = 0.44 * params.height
        for x, rgba in (
            (front - 0.05, materials.HEADLIGHT),
            (-params.rear_overhang + 0.04, materials.TAIL_LIGHT),
        ):
            _look(car, type=box, pos=[x, y, z], size=[0.06, 0.17, 0.06], rgba=rgba)


def add_wheel_look(wheel: mujoco.MjsBody, params: VehicleParameters) -> None:
    """Adds a tyre and a rim with a bar, so that turning is seen."""
    half = params.tyre_width / 2
    cylinder = mujoco.mjtGeom.mjGEOM_CYLINDER
    across = [np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0]  # axle along y
    radius = params.wheel_radius
    _look(
        wheel, type=cylinder, size=[radius, half, 0], quat=across, rgba=materials.TYRE
    )
    _look(
        wheel,
        type=cylinder,
        size=[0.62 * radius, half + 0.005, 0],
        quat=across,
        rgba=materials.RIM,
    )
    _look(
        wheel,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[0.6 * radius, half + 0.01, 0.035],
        rgba=materials.TYRE,
    )


def add_standing_car(
    body: mujoco.MjsBody, params: VehicleParameters, colour: Colour
) -> None:
    """Everything of a car that does not move; the frame is the rear axle's."""
    add_body_look(body, params, colour)
    for name, hub in zip(WHEELS, hub_positions(params), strict=True):
        wheel = body.add_body(name=f"{body.name}/wheel_{name}", pos=hub)
        add_wheel_look(wheel, params)
