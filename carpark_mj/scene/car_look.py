"""What a car looks like: convex hulls from its parameters, wheels, lights.

Looks only; mass properties are the vehicle's. Meshes are written into the model, so
an exported scene needs no files.
"""

import zlib
from typing import cast

import mujoco
import numpy as np
import trimesh

from carpark_mj.scene import materials
from carpark_mj.vehicle.mjcf import hub_positions
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


def merge(parts: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    """One mesh of several."""
    return cast(trimesh.Trimesh, trimesh.util.concatenate(parts))


def _boxes(
    centres: list[tuple[float, ...]], size: tuple[float, ...]
) -> trimesh.Trimesh:
    parts = []
    for centre in centres:
        part = trimesh.creation.box(size)
        part.apply_translation(centre)
        parts.append(part)
    return merge(parts)


def details(params: VehicleParameters) -> dict[str, trimesh.Trimesh]:
    """Pairs of `headlights` and `tail_lights`, and four standing `wheels`."""
    front = params.length - params.rear_overhang
    y, z = params.width / 2 - 0.24, 0.44 * params.height
    size = (0.12, 0.34, 0.12)
    wheels = []
    for hub in hub_positions(params):
        wheel = trimesh.creation.cylinder(
            params.wheel_radius, params.tyre_width, sections=16
        )
        wheel.apply_transform(
            trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0))
        )
        wheel.apply_translation(hub)
        wheels.append(wheel)
    return {
        "headlights": _boxes([(front - 0.05, y, z), (front - 0.05, -y, z)], size),
        "tail_lights": _boxes(
            [(0.04 - params.rear_overhang, side * y, z) for side in (1, -1)], size
        ),
        "wheels": merge(wheels),
    }


def _shape(spec: mujoco.MjSpec, params: VehicleParameters) -> str:
    """What the names of a car's meshes begin with; they come with its first car."""
    shape = f"car_{zlib.crc32(repr(params).encode()):08x}"
    if spec.mesh(f"{shape}/body") is None:
        _add_meshes(spec, params, shape)
    return shape


def _add_meshes(spec: mujoco.MjSpec, params: VehicleParameters, shape: str) -> None:
    for name, mesh in (body_hulls(params) | details(params)).items():
        spec.add_mesh(
            name=f"{shape}/{name}",
            uservert=np.asarray(mesh.vertices).ravel().tolist(),
            userface=np.asarray(mesh.faces).ravel().tolist(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
            smoothnormal=False,
        )


def _look(body: mujoco.MjsBody, **fields: object) -> None:
    """A geom that is only seen."""
    body.add_geom(contype=0, conaffinity=0, group=2, mass=0.0, **fields)


def add_body_look(
    spec: mujoco.MjSpec,
    car: mujoco.MjsBody,
    params: VehicleParameters,
    colour: Colour,
) -> None:
    """Adds body, windows and lights to a car's body."""
    shape = _shape(spec, params)
    for name, rgba in (
        ("body", colour),
        ("cabin", materials.GLASS),
        ("roof", colour),
        ("headlights", materials.HEADLIGHT),
        ("tail_lights", materials.TAIL_LIGHT),
    ):
        _look(
            car, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"{shape}/{name}", rgba=rgba
        )


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
    spec: mujoco.MjSpec,
    body: mujoco.MjsBody,
    params: VehicleParameters,
    colour: Colour,
) -> None:
    """Everything of a car that does not move; the frame is the rear axle's."""
    add_body_look(spec, body, params, colour)
    _look(
        body,
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=f"{_shape(spec, params)}/wheels",
        rgba=materials.TYRE,
    )
