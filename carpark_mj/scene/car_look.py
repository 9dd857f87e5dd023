"""Puts a car's looks on its bodies: paint, glass, lights, wheels.

Visual geoms only; mass properties are the vehicle's. Cars of one shape share their
meshes, which are written into the model, so an exported scene needs no files.
"""

import zlib

import mujoco
import numpy as np
import trimesh

from carpark_mj.scene import materials
from carpark_mj.scene.car_mesh import car_meshes, standing_wheels
from carpark_mj.scene.car_style import nearest_style
from carpark_mj.scene.mesh import add_mesh
from carpark_mj.vehicle.parameters import VehicleParameters
from carpark_mj.vehicle.presets import PRESETS

# What a mesh depends on; cars that agree in it look alike.
_SHAPE = (
    "length",
    "width",
    "height",
    "wheelbase",
    "track_width",
    "rear_overhang",
    "wheel_radius",
    "tyre_width",
)
# Part: material, colour (None: the car's), whether it casts a shadow.
_PARTS = {
    "body": ("paint", None, True),
    "cage": ("paint", None, True),
    "glass": ("glass", materials.GLASS, True),
    "headlights": ("lamp", materials.HEADLIGHT, False),
    "tail_lights": ("lamp", materials.TAIL_LIGHT, False),
    "trim": ("rubber", materials.TRIM, True),
    "shade": ("rubber", materials.SHADE, False),
    "tyre": ("rubber", materials.TYRE, True),
    "rim": ("metal", materials.RIM, False),
    "tyres": ("rubber", materials.TYRE, True),
    "rims": ("metal", materials.RIM, False),
}
_CABIN = ("cage", "glass")
_FIXED = ("body", "cage", "glass", "headlights", "tail_lights", "trim", "shade")


def shape_name(params: VehicleParameters) -> str:
    """Name of a car's shape: its preset's, with a check sum if it is not quite that."""
    name = nearest_style(params)
    shape = [getattr(params, field) for field in _SHAPE]
    if shape == [getattr(PRESETS[name], field) for field in _SHAPE]:
        return name
    return f"{name}_{zlib.crc32(repr(shape).encode()):08x}"


def _meshes(params: VehicleParameters) -> dict[str, trimesh.Trimesh]:
    return car_meshes(params) | standing_wheels(params)


def _add_looks(
    spec: mujoco.MjSpec,
    body: mujoco.MjsBody,
    params: VehicleParameters,
    parts: tuple[str, ...],
    paint: materials.Colour = materials.RIM,
) -> None:
    """Adds visual geoms; the first car of a shape adds its meshes, too."""
    shape = shape_name(params)
    if spec.mesh(f"{shape}/body") is None:
        for part, mesh in _meshes(params).items():
            add_mesh(spec, f"{shape}/{part}", mesh)
    for part in parts:
        material, colour, shadow = _PARTS[part]
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=f"{shape}/{part}",
            material=material,
            rgba=colour or paint,
            castshadow=shadow,
            contype=0,
            conaffinity=0,
            group=2,
            mass=0.0,
        )


def add_body_look(
    spec: mujoco.MjSpec,
    car: mujoco.MjsBody,
    params: VehicleParameters,
    colour: materials.Colour,
) -> None:
    """Adds everything of a car but its wheels; the frame is the rear axle's."""
    _add_looks(spec, car, params, _FIXED, colour)


def add_wheel_look(
    spec: mujoco.MjSpec, wheel: mujoco.MjsBody, params: VehicleParameters
) -> None:
    """Adds tyre and rim to a wheel's body."""
    _add_looks(spec, wheel, params, ("tyre", "rim"))


def add_standing_car(
    spec: mujoco.MjSpec,
    body: mujoco.MjsBody,
    params: VehicleParameters,
    colour: materials.Colour,
) -> None:
    """Adds a whole car whose wheels do not move; the frame is the rear axle's."""
    _add_looks(spec, body, params, (*_FIXED, "tyres", "rims"), colour)


def cabin_geoms(model: mujoco.MjModel, car: int) -> np.ndarray:
    """Ids of the geoms that are roof, pillars and glass of a car, by its body."""
    own = np.flatnonzero((model.geom_bodyid == car) & (model.geom_dataid >= 0))
    parts = [model.mesh(model.geom_dataid[g]).name.rpartition("/")[2] for g in own]
    return own[np.isin(parts, _CABIN)]
