"""The parts of a lot's scene; each function adds one kind of thing to a spec."""

import math
import zlib
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
import trimesh

from carpark_mj.layouts import types as lot
from carpark_mj.layouts.types import DiscKind, Layout, WallKind
from carpark_mj.scene import looks
from carpark_mj.scene.cameras import add_car_cameras, view_yaw
from carpark_mj.scene.car_mesh import add_mesh, car_meshes, merge, standing_wheels
from carpark_mj.scene.looks import nearest_style
from carpark_mj.vehicle.contact_wheels import add_locked_tyres
from carpark_mj.vehicle.mjcf import WHEELS, add_car
from carpark_mj.vehicle.parameters import VehicleParameters
from carpark_mj.vehicle.presets import PRESETS

# What a mesh depends on; cars that agree in it look alike.
_SHAPE = (
    *("length", "width", "height", "wheelbase", "track_width"),
    *("rear_overhang", "wheel_radius", "tyre_width"),
)
# Part: material, colour (None: the car's), whether it casts a shadow.
_LOOKS = {
    "body": ("paint", None, True),
    "cage": ("paint", None, True),
    "glass": ("glass", looks.GLASS, True),
    "headlights": ("lamp", looks.HEADLIGHT, False),
    "tail_lights": ("lamp", looks.TAIL_LIGHT, False),
    "trim": ("rubber", looks.TRIM, True),
    "shade": ("rubber", looks.SHADE, False),
    "tyre": ("rubber", looks.TYRE, True),
    "rim": ("metal", looks.RIM, False),
    "tyres": ("rubber", looks.TYRE, True),
    "rims": ("metal", looks.RIM, False),
}
_CABIN = ("cage", "glass")
# Parts of a car but for its wheels, in the rear axle's frame, and of a wheel.
FIXED = ("body", *_CABIN, "headlights", "tail_lights", "trim", "shade")
WHEEL = ("tyre", "rim")
WHOLE = (*FIXED, "tyres", "rims")  # whose wheels do not move


def shape_name(params: VehicleParameters) -> str:
    """Name of a car's shape: its preset's, with a check sum if it is not quite that."""
    name = nearest_style(params)
    shape = [getattr(params, field) for field in _SHAPE]
    if shape == [getattr(PRESETS[name], field) for field in _SHAPE]:
        return name
    return f"{name}_{zlib.crc32(repr(shape).encode()):08x}"


def add_looks(
    spec: mujoco.MjSpec,
    body: mujoco.MjsBody,
    params: VehicleParameters,
    parts: tuple[str, ...],
    paint: looks.Colour = looks.RIM,
) -> None:
    """Adds visual geoms to a body; the first car of a shape adds its meshes."""
    shape = shape_name(params)
    if spec.mesh(f"{shape}/body") is None:
        for part, mesh in (car_meshes(params) | standing_wheels(params)).items():
            add_mesh(spec, f"{shape}/{part}", mesh)
    for part in parts:
        material, colour, shadow = _LOOKS[part]
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=f"{shape}/{part}",
            material=material,
            rgba=colour or paint,
            castshadow=shadow,
            mass=0.0,
            **looks.VISUAL | {"group": 2},
        )


def cabin_geoms(model: mujoco.MjModel, car: int) -> np.ndarray:
    """Ids of the geoms that are roof, pillars and glass of a car, by its body."""
    own = np.flatnonzero((model.geom_bodyid == car) & (model.geom_dataid >= 0))
    parts = [model.mesh(model.geom_dataid[g]).name.rpartition("/")[2] for g in own]
    return own[np.isin(parts, _CABIN)]


GROUND = "ground"
VERGE = 20.0  # reach of the grass, in the lot's larger half width
HULL_GROUP = 3  # hidden by default, like all collision geoms
_WALL_COLOURS = {
    WallKind.WALL: looks.CONCRETE,
    WallKind.KERB: looks.KERB,
    WallKind.ISLAND: looks.GREEN,
    WallKind.GATE: looks.GATE,
}
_DISC_COLOURS = {DiscKind.PILLAR: looks.CONCRETE, DiscKind.BOLLARD: looks.GATE}
HIDDEN = -50.0  # m, under the ground: where things are that are not there
# Hulls crush like springs with dampers. In a barrier test at 15.6 m/s a passenger car
# is crushed by 0.6 m [est], which is a linear stiffness k = m v^2 / x^2 (Gabler and
# Hollowell, SAE 980908) of m (26 rad/s)^2, 0.93 MN/m of `compact`. MuJoCo takes the
# mass to be the one that a contact moves: against a wall that of the car, between two
# cars half of it, as if two springs were in series.
CRUSH_FREQUENCY = 26.0  # rad/s
# Cars that meet at 1 to 2 m/s part at 0.2 to 0.4 of that (Howard, Bomar and Bare,
# SAE 931842); 0.3 with this.
CRUSH_DAMPING = 0.5
# Cars, walls and parked cars touch each other; sheet metal slides on sheet metal.
COLLIDES: dict[str, Any] = {
    "contype": 1,
    "conaffinity": 1,
    "friction": [0.4, 0.005, 0.0001],
    "solref": [1.0 / (CRUSH_DAMPING * CRUSH_FREQUENCY), CRUSH_DAMPING],
}


def yaw_quat(yaw: float, pitch: float = 0.0) -> list[float]:
    """Quaternion (w, x, y, z) of a pitch, nose down, and then a yaw [rad]."""
    (cos, sin), (level, nod) = (
        (math.cos(x / 2), math.sin(x / 2)) for x in (yaw, pitch)
    )
    return [cos * level, 0.0 - sin * nod, cos * nod, sin * level]


def rear_axle(params: VehicleParameters, centre: Any) -> tuple[float, float, float]:
    """The pose (3,) of a car's rear axle, given that of its footprint's centre."""
    x, y, yaw = centre
    offset = params.centre_offset
    return x - offset * math.cos(yaw), y - offset * math.sin(yaw), yaw


def add_ground(spec: mujoco.MjSpec) -> None:
    """An endless asphalt plane under a pale sky."""
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=looks.ZENITH[:3],
        rgb2=looks.HORIZON[:3],
        width=128,
        height=128,
    )
    spec.add_texture(
        name="asphalt",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
        mark=mujoco.mjtMark.mjMARK_RANDOM,
        random=0.08,
        markrgb=[0.30, 0.31, 0.33],
        rgb1=looks.ASPHALT[:3],
        rgb2=looks.ASPHALT[:3],
        width=256,
        height=256,
    )
    asphalt = spec.add_material(name="asphalt", texrepeat=[0.25, 0.25])
    asphalt.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "asphalt"
    asphalt.texuniform = True
    spec.worldbody.add_geom(
        name=GROUND,
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0.0, 0.0, 1.0],
        material="asphalt",
        castshadow=False,  # nothing lies below it
        contype=0,
        conaffinity=0,
    )


def add_verge(spec: mujoco.MjSpec, extent: np.ndarray) -> None:
    """Grass around the lot, visual only."""
    far = VERGE * float(np.max(extent))
    x, y = np.asarray(extent, float) + lot.VERGE_GAP
    for name, *pos, half_x, half_y in (
        ("north", 0.0, (y + far) / 2, far, (far - y) / 2),
        ("south", 0.0, -(y + far) / 2, far, (far - y) / 2),
        ("east", (x + far) / 2, 0.0, (far - x) / 2, y),
        ("west", -(x + far) / 2, 0.0, (far - x) / 2, y),
    ):
        spec.worldbody.add_geom(
            name=f"verge/{name}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=[*pos, 0.0],
            size=[half_x, half_y, lot.VERGE_HEIGHT],
            **looks.PAINT | {"rgba": looks.GRASS},
        )


def add_walls(spec: mujoco.MjSpec, layout: Layout) -> None:
    """Walls, kerbs, islands and gates as boxes `wall0`..., all of them solid.

    Kerbs and islands are lower than a car's hull: the visible box is low, the colliding
    box is invisible and taller.
    """
    for wall in np.flatnonzero(np.asarray(layout.wall_mask)):
        x, y, yaw = np.asarray(layout.wall_pose[wall], float)
        half = np.asarray(layout.wall_size[wall], float) / 2
        kind = WallKind(int(layout.wall_kind[wall]))
        low = lot.WALL_HEIGHTS[kind] < lot.WALL_HEIGHT
        solid = {"name": f"wall{wall}", "group": HULL_GROUP if low else 1, **COLLIDES}
        boxes = [(lot.WALL_HEIGHT, solid)]
        if low:
            boxes.insert(0, (lot.WALL_HEIGHTS[kind], looks.VISUAL))
        for height, fields in boxes:
            spec.worldbody.add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX,
                pos=[x, y, height / 2],
                quat=yaw_quat(yaw),
                size=[*half, height / 2],
                rgba=_WALL_COLOURS[kind],
                **fields,
            )


def add_discs(spec: mujoco.MjSpec, layout: Layout) -> None:
    """Pillars and bollards as solid cylinders `disc0`..."""
    for disc in np.flatnonzero(np.asarray(layout.disc_mask)):
        kind = DiscKind(int(layout.disc_kind[disc]))
        half = lot.DISC_HEIGHTS[kind] / 2
        spec.worldbody.add_geom(
            name=f"disc{disc}",
            type=mujoco.mjtGeom.mjGEOM_CYLINDER,
            pos=[*np.asarray(layout.disc_centre[disc], float), half],
            size=[float(layout.disc_radius[disc]), half, 0.0],
            rgba=_DISC_COLOURS[kind],
            group=1,
            **COLLIDES,
        )


def add_hull(body: mujoco.MjsBody, params: VehicleParameters, name: str) -> None:
    """The box with which a car touches others: its footprint, up to its roof."""
    low, high = lot.GROUND_CLEARANCE, params.height
    body.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=[params.centre_offset, 0.0, (low + high) / 2],
        size=[params.length / 2, params.width / 2, (high - low) / 2],
        mass=0.0,
        group=HULL_GROUP,
        **COLLIDES,
    )


def add_parked_cars(spec: mujoco.MjSpec, cars: Sequence[VehicleParameters]) -> None:
    """Parked cars `parked0`... that slide on locked tyres when pushed.

    Each moves in the plane only: two slides and a hinge, whose coordinates are the pose
    of its rear axle's centre. Its four tyres bear their loads at rest.
    """
    for k, params in enumerate(cars):
        name = f"parked{k}"
        body = spec.worldbody.add_body(name=name)
        body.mass = params.mass
        body.ipos = [params.cg_to_rear_axle, 0.0, params.cg_height]
        body.inertia = [params.roll_inertia, params.pitch_inertia, params.yaw_inertia]
        body.explicitinertial = True
        slide, hinge = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
        joints = zip(("x", "y", "yaw"), (slide, slide, hinge), np.eye(3), strict=True)
        for suffix, kind, axis in joints:
            body.add_joint(name=f"{name}/{suffix}", type=kind, axis=axis)
        add_locked_tyres(spec, body, params)
        add_hull(body, params, f"{name}/hull")
        colour = looks.PARKED[k % len(looks.PARKED)]
        add_looks(spec, body, params, WHOLE, colour)


def car_prefix(agent: int, kind: int = 0) -> str:
    """Prefix of the names of an agent's car, or of one of several to choose from."""
    return f"agent{agent}/kind{kind}/" if kind else f"agent{agent}/"


def add_agents(
    spec: mujoco.MjSpec,
    params: VehicleParameters,
    count: int,
    servos: bool = True,
    kind: int = 0,
    suspension: bool = False,
) -> None:
    """Agents' cars with prefixes `agent0/`..., each with its cameras."""
    for k in range(count):
        prefix = car_prefix(k, kind)
        car = add_car(spec.worldbody, spec, params, prefix, servos, suspension)
        add_hull(car, params, f"{prefix}hull")
        add_looks(spec, car, params, FIXED, looks.agent_colour(k))
        for name in WHEELS:
            add_looks(spec, spec.body(f"{prefix}wheel_{name}"), params, WHEEL)
        add_car_cameras(car, params, prefix)


def add_lights(spec: mujoco.MjSpec, extent: np.ndarray) -> None:
    """A sun with shadows and a weak sky."""
    spec.worldbody.add_light(
        name="sun",
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        pos=[-8.0, -6.0, 20.0],
        dir=[0.35, 0.25, -0.9],
        diffuse=[0.65, 0.65, 0.62],
        specular=[0.1, 0.1, 0.1],
        castshadow=True,
    )
    spec.visual.headlight.ambient = [0.42, 0.42, 0.44]
    spec.visual.headlight.diffuse = [0.18, 0.18, 0.18]
    spec.visual.headlight.specular = [0.0, 0.0, 0.0]
    spec.visual.rgba.haze = looks.HORIZON
    quality = spec.visual.quality
    quality.shadowsize = 4096
    # Lines and pillars look as round, flat faces as even, with far fewer triangles.
    quality.numslices, quality.numstacks, quality.numquads = 16, 4, 1
    # A tight shadow map shows stripes on the ground where it ends.
    spec.visual.map.shadowclip = 3.0
    spec.stat.center = [0.0, 0.0, 0.0]
    spec.stat.extent = float(np.max(extent))


# Paint on the asphalt: bay lines and numbers, and arrows along one-way lanes.


def _paint(
    spec: mujoco.MjSpec, name: str, pose: Any, along: float, aside: float, **shape: Any
) -> None:
    """Adds paint at a place in the frame of a pose (3,) [m, m, rad]."""
    x, y, yaw = map(float, pose)
    cos, sin = math.cos(yaw), math.sin(yaw)
    place = [x + cos * along - sin * aside, y + sin * along + cos * aside, 0.0]
    fields = shape | looks.PAINT
    spec.worldbody.add_geom(name=name, pos=place, quat=yaw_quat(yaw), **fields)


def _mesh(name: str) -> dict[str, Any]:
    return {"type": mujoco.mjtGeom.mjGEOM_MESH, "meshname": name}


def add_bay_lines(spec: mujoco.MjSpec, layout: Layout) -> None:
    """Paints both long sides of every bay and its far end."""
    box = mujoco.mjtGeom.mjGEOM_BOX
    for bay in np.flatnonzero(np.asarray(layout.bay_mask)):
        length, width = np.asarray(layout.bay_size[bay], float)
        half = lot.LINE_WIDTH / 2
        for name, dx, dy, *size in (
            ("left", 0.0, width / 2, length / 2, half),
            ("right", 0.0, -width / 2, length / 2, half),
            ("end", -length / 2 + half, 0.0, half, width / 2),
        ):
            shape = {"type": box, "size": [*size, lot.LINE_HEIGHT]}
            _paint(spec, f"bay{bay}/{name}", layout.bay_pose[bay], dx, dy, **shape)


def add_lane_arrows(spec: mujoco.MjSpec, layout: Layout) -> None:
    """Paints arrows of travel on every one-way lane."""
    rows = np.flatnonzero(np.asarray(layout.lane_mask & layout.lane_one_way))
    if not rows.size:
        return
    length, width = lot.ARROW_LENGTH, lot.ARROW_WIDTH
    half, head = length / 2, length * lot.ARROW_HEAD
    high = lot.ARROW_HEIGHT  # as deep under the ground
    shaft = trimesh.creation.box((length - head, width * lot.ARROW_SHAFT, 2 * high))
    shaft.apply_translation((-head / 2, 0.0, 0.0))
    corners = [(half, 0.0), (half - head, width / 2), (half - head, -width / 2)]
    tip = trimesh.convex.convex_hull(
        np.array([(x, y, z) for x, y in corners for z in (-high, high)])
    )
    add_mesh(spec, "arrow", merge([shaft, tip]))
    for lane in rows:
        pose, length = layout.lane_pose[lane], float(layout.lane_size[lane, 0])
        count = max(int(length / lot.ARROW_SPACING), 1)
        for k in range(count):
            along = ((k + 0.5) / count - 0.5) * length
            _paint(spec, f"lane{lane}/arrow{k}", pose, along, 0.0, **_mesh("arrow"))


HEIGHT, WIDTH = 0.42, 0.24  # m, of a digit
STROKE = 0.06  # m
SPACING = 0.32  # m, from digit to digit
THICKNESS = 0.008  # m
EDGE_DISTANCE = 0.30  # m, from the open end of the bay to the middle of its number

# Segments at points in units of a digit's half width and half height; those with x = 0
# are horizontal.
_SEGMENTS = {
    "a": (0, 1),
    "b": (1, 0.5),
    "c": (1, -0.5),
    "d": (0, -1),
    "e": (-1, -0.5),
    "f": (-1, 0.5),
    "g": (0, 0),
}
_DIGITS = (
    *("abcdef", "bc", "abged", "abgcd", "fgbc"),
    *("afgcd", "afgedc", "abc", "abcdefg", "abcdfg"),
)


def digit_mesh(digit: int) -> trimesh.Trimesh:
    """One digit in the xy-plane, upright along +y, centred on the origin."""
    strokes = []
    for name in _DIGITS[digit]:
        x, y = _SEGMENTS[name]
        extent = (STROKE, HEIGHT / 2) if x else (WIDTH, STROKE)
        stroke = trimesh.creation.box((*extent, THICKNESS))
        at = (x * (WIDTH - STROKE) / 2, y * (HEIGHT - STROKE) / 2, 0.0)
        strokes.append(stroke.apply_translation(at))
    return merge(strokes)


def add_bay_numbers(spec: mujoco.MjSpec, layout: Layout) -> None:
    """Paints every bay's index at its open end, upright for the lot's cameras."""
    right = view_yaw(np.asarray(layout.extent, float))
    for digit in range(10):
        add_mesh(spec, f"digit{digit}", digit_mesh(digit))
    for bay in np.flatnonzero(np.asarray(layout.bay_mask)):
        x, y, yaw = np.asarray(layout.bay_pose[bay], float)
        reach = float(layout.bay_size[bay, 0]) / 2 - EDGE_DISTANCE
        x, y = x + reach * math.cos(yaw), y + reach * math.sin(yaw)
        turn = yaw + math.pi / 2  # read from the aisle
        if math.cos(turn - right) < -1e-3:  # upside down
            turn += math.pi
        text = str(bay)
        for place, digit in enumerate(text):
            along = (place - (len(text) - 1) / 2) * SPACING
            name, shape = f"bay{bay}/digit{place}", _mesh(f"digit{digit}")
            _paint(spec, name, (x, y, turn), along, 0.0, **shape)
