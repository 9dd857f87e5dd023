"""A car's meshes from its parameters: body, cage, glass, lights, trim, tyre and rim.

Every car has the silhouette of a style (`scene.looks`), stretched to its own length,
width, height, wheelbase, overhangs and wheels. All parts are watertight. Frame: the
MJCF body's (rear axle on the ground, x forward, y left, z up); of tyre and rim the hub.
"""

from collections.abc import Sequence
from typing import cast

import mujoco
import numpy as np
import trimesh

from carpark_mj.scene.looks import STYLES, CarStyle, nearest_style
from carpark_mj.vehicle.mjcf import hub_positions
from carpark_mj.vehicle.parameters import VehicleParameters

DECIMALS = 4  # of a coordinate [m]: the same numbers on every machine


def merge(parts: Sequence[trimesh.Trimesh]) -> trimesh.Trimesh:
    """One mesh of several."""
    return cast(trimesh.Trimesh, trimesh.util.concatenate(list(parts)))


def make_mesh(vertices: np.ndarray, faces: np.ndarray) -> trimesh.Trimesh:
    """A mesh of rounded vertices (n, 3) [m] and triangles (m, 3), facing outwards."""
    vertices = np.round(vertices, DECIMALS) + 0.0  # no negative zeros
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    if mesh.volume < 0:
        mesh.invert()
    return mesh


def loft(rings: np.ndarray) -> trimesh.Trimesh:
    """A skin over rings (stations, points, 3) [m], closed at both ends.

    The points of a ring run round it; at the ends point k is joined with point -1 - k,
    so that a ring may be any outline that is mirrored about a line.
    """
    stations, points, _ = rings.shape
    index = np.arange(stations * points).reshape(stations, points)
    around = np.roll(index, -1, axis=1)
    corners = (index[:-1], index[1:], around[1:], around[:-1])
    quads = [np.stack(corners, -1).reshape(-1, 4)]
    half = np.arange(points // 2 - 1)
    for ring, turn in ((index[0], 1), (index[-1], -1)):
        cap = np.stack([ring[half], ring[half + 1], ring[-2 - half], ring[-1 - half]])
        quads.append(cap.T[:, ::turn])
    quad = np.concatenate(quads)
    faces = np.concatenate([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]])
    return make_mesh(rings.reshape(-1, 3), faces)


def loft_mirrored(left: np.ndarray) -> trimesh.Trimesh:
    """A skin over rings of which (stations, points, 3) [m] is the left half."""
    return loft(np.concatenate([left, left[:, ::-1] * [1.0, -1.0, 1.0]], axis=1))


def revolve(profile: np.ndarray, sections: int) -> trimesh.Trimesh:
    """A closed profile (points, 2) of (radius, y) [m] turned about the y axis."""
    points = len(profile)
    angle = 2 * np.pi * np.arange(sections) / sections
    radius, y = profile.T
    x, z = np.outer(np.cos(angle), radius), np.outer(np.sin(angle), radius)
    vertices = np.stack([x, np.tile(y, (sections, 1)), z], -1)
    index = np.arange(sections * points).reshape(sections, points)
    ahead = np.roll(index, -1, axis=0)
    aside = np.roll(ahead, -1, axis=1)
    faces = [(index, ahead, aside), (index, aside, np.roll(index, -1, axis=1))]
    triangles = np.concatenate([np.stack(f, -1).reshape(-1, 3) for f in faces])
    return make_mesh(vertices.reshape(-1, 3), triangles)


def block(low: Sequence[float], high: Sequence[float]) -> trimesh.Trimesh:
    """An upright box between two corners (3,) [m]."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    ring = [(y0, z0), (y0, z1), (y1, z1), (y1, z0)]
    return loft(np.array([[(x, y, z) for y, z in ring] for x in (x0, x1)]))


def add_mesh(spec: mujoco.MjSpec, name: str, mesh: trimesh.Trimesh) -> None:
    """Adds a mesh to a model as data, without a file."""
    spec.add_mesh(
        name=name,
        uservert=np.asarray(mesh.vertices).ravel().tolist(),
        userface=np.asarray(mesh.faces).ravel().tolist(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        smoothnormal=False,
    )


SECTIONS = 16  # of a wheel
SPOKES = 5
ARCH_GAP = 0.05  # m, between tyre and wheel arch
RIM = 0.66  # radius of the rim over the tyre's
# Half width in plan over the car's, along the length from the nose.
_PLAN = (
    (0.0, 0.02, 0.08, 0.16, 0.86, 0.98, 1.0),
    (0.80, 0.90, 0.97, 1.0, 1.0, 0.93, 0.85),
)
# The body's section: height between underside and upper edge, and half width.
_RISE = np.array([0.0, 0.30, 0.60, 0.86, 1.0])
_SECTION = np.array([0.965, 0.99, 1.0, 0.965, 0.87])
_LEAN = np.array([0.025, 0.0, 0.0, 0.02, 0.05])  # m, nose and tail lean inwards
# The cabin's section: height between foot and roof, and what is left of its slant.
_CABIN_RISE = np.array([0.0, 0.55, 1.0])
_CABIN_SLANT = np.array([0.0, 0.48, 1.0])
_SHADE = (0.20, 0.12, 0.04, -0.04)  # m, of the sheets beyond the footprint
_PROUD, _DEEP = 0.008, 0.03  # m, of pillars over and under the glass


def car_meshes(params: VehicleParameters) -> dict[str, trimesh.Trimesh]:
    """Meshes of a car by part.

    `body` up to the windows, `cage` (roof and pillars), `glass`, `headlights`,
    `tail_lights`, `trim` and the soft `shade` on the ground below are in the body
    frame, `tyre` and `rim` of a wheel about its hub, the axle along y.
    """
    style = STYLES[nearest_style(params)]
    glass, cage = _cabin(params, style)
    return {
        "body": _shell(params, style),
        "cage": cage,
        "glass": glass,
        **_lights(params, style),
        "trim": _trim(params, style),
        "shade": _shade(params),
        "tyre": _tyre(params),
        "rim": _rim(params),
    }


def standing_wheels(params: VehicleParameters) -> dict[str, trimesh.Trimesh]:
    """All four `tyres` and `rims` in the body frame, straight ahead."""
    return {
        f"{name}s": merge(
            [mesh.copy().apply_translation(hub) for hub in hub_positions(params)]
        )
        for name, mesh in (("tyre", _tyre(params)), ("rim", _rim(params)))
    }


def driver_eye(params: VehicleParameters) -> tuple[float, float, float]:
    """Where the driver of a left-hand-drive car looks from [m]."""
    style = STYLES[nearest_style(params)]
    (foot, belt), (roof, top), *_ = style.windows
    behind_nose = foot + 0.78 * (roof - foot)
    x = params.length * (1 - behind_nose) - params.rear_overhang
    z = min(top * params.height - 0.17, belt * params.height + 0.32)
    return x, 0.2 * params.width, z


def _x(params: VehicleParameters, behind_nose: np.ndarray) -> np.ndarray:
    """Coordinates [m] of shares of the length behind the nose."""
    return params.length * (1.0 - behind_nose) - params.rear_overhang


def _arches(params: VehicleParameters) -> np.ndarray:
    """Stations [m] at the wheel arches; the outermost stand on the sill."""
    radius = params.wheel_radius + ARCH_GAP
    half = np.append(radius * np.cos(np.linspace(0.0, np.pi, 6)), radius + 0.01)
    half = np.append(half, -radius - 0.01)
    return np.concatenate([half, params.wheelbase + half])


def _lower_edge(
    params: VehicleParameters, x: np.ndarray, sill: np.ndarray
) -> np.ndarray:
    """Height [m] of the body's lower edge at points x: sills and wheel arches."""
    radius = params.wheel_radius + ARCH_GAP
    off = np.abs(x[:, None] - [0.0, params.wheelbase]).min(axis=1)
    rise = np.sqrt(np.maximum(radius**2 - off**2, 0.0))
    return np.where(off <= radius + 1e-6, params.wheel_radius + rise, sill)


def _shell(params: VehicleParameters, style: CarStyle) -> trimesh.Trimesh:
    """The body up to the windows, with open wheel arches, as rings along x."""
    nose, tail = _x(params, np.array([0.0, 1.0]))
    arches = _arches(params)
    arches = arches[(arches > tail) & (arches < nose)]
    plain = _x(params, np.array([*style.along, *_PLAN[0]]))
    # Stations close to an arch's own would make slivers.
    free = np.abs(plain[:, None] - arches).min(axis=1) > 0.06
    x = np.concatenate([plain[free], arches, [nose, tail]])
    x = np.unique(np.round(x, DECIMALS))
    u = 1.0 - (x + params.rear_overhang) / params.length
    top = params.height * np.interp(u, style.along, style.top)
    half = params.width / 2 * np.interp(u, *_PLAN)
    under = style.clearance + 0.06 * np.interp(u, [0, 0.08, 0.9, 1], [1, 0, 0, 1])
    low = _lower_edge(params, x, under)
    z = under[:, None] + (top - under)[:, None] * _RISE
    z = np.maximum(z, low[:, None] + 0.015 * np.arange(len(_RISE)))
    y = half[:, None] * _SECTION
    lean = np.maximum(0.0, 1.0 - u / 0.07) - np.maximum(0.0, 1.0 - (1.0 - u) / 0.05)
    along = x[:, None] - lean[:, None] * _LEAN
    return loft_mirrored(np.stack([along, y, z], -1))


def _cabin(
    params: VehicleParameters, style: CarStyle
) -> tuple[trimesh.Trimesh, trimesh.Trimesh]:
    """The glass as rings from the belt upwards; roof and pillars around it."""
    (u0, h0), (u1, h1), (u2, h2), (u3, h3) = style.windows
    foot_front, front, rear, foot_rear = _x(params, np.array([u0, u1, u2, u3]))
    rise, slant = _CABIN_RISE, _CABIN_SLANT
    ahead = foot_front + slant * (front - foot_front)
    behind = foot_rear + slant * (rear - foot_rear)
    wide = params.width / 2 * (0.86 + slant * (style.roof - 0.86))
    belt = params.height * min(h0, h3) - 0.02
    # Front and rear edge of the side windows: (levels, x, y, z).
    z = np.stack([belt + rise * (params.height * h - belt) for h in (h1, h2)])
    fore = np.stack([ahead, 0.90 * wide, z[0]], -1)
    middle = np.stack([(ahead + behind) / 2, wide, z.mean(0)], -1)
    aft = np.stack([behind, 0.92 * wide, z[1]], -1)
    centre = np.array([1.0, 0.35, 1.0])  # windscreen and rear window bulge
    left = np.stack([fore * centre, fore, middle, aft, aft * centre], 1)
    left[:, 0, 0] += 0.05
    left[:, -1, 0] -= 0.02
    side = np.stack([fore, middle, aft])
    pillars = [_pillar(side, a, b, sign) for a, b in style.pillars for sign in (1, -1)]
    return loft_mirrored(left), merge([_roof(params, left[-1]), *pillars])


def _pillar(side: np.ndarray, start: float, end: float, sign: int) -> trimesh.Trimesh:
    """A strip over a side window (3, levels, 3) between two shares of its length."""

    def edge(at: float) -> np.ndarray:
        half = int(at >= 0.5)
        return side[half] + (2 * at - half) * (side[half + 1] - side[half])

    out, into = np.array([[0.0, _PROUD, 0.0], [0.0, -_DEEP, 0.0]])
    a, b = edge(start), edge(end)
    rings = np.stack([a + out, b + out, b + into, a + into], axis=1)
    return loft(rings * [1.0, sign, 1.0])


def _roof(params: VehicleParameters, rim: np.ndarray) -> trimesh.Trimesh:
    """A crowned panel over the cabin's upper ring (5, 3), its left half."""
    front, rear = rim[0, 0] + 0.01, rim[-1, 0] - 0.02
    x = front + np.array([0.0, 0.12, 0.5, 0.88, 1.0]) * (rear - front)
    wide = np.interp(x, rim[::-1, 0], rim[::-1, 1]) + 0.012
    wide[[0, -1]] = rim[[1, 3], 1] * [0.94, 0.96]
    top = params.height - np.array([0.035, 0.008, 0.0, 0.012, 0.045])
    low = np.interp(x, rim[::-1, 0], rim[::-1, 2]) - 0.012
    low = np.minimum(low, top - 0.02)
    across, down = np.array([1.0, 0.96, 0.72]), np.array([1.0, 0.35, 0.0])
    y = wide[:, None] * across
    z = top[:, None] - down * (top - low)[:, None]
    x = np.broadcast_to(x[:, None], y.shape)
    return loft_mirrored(np.stack([x, y, z], -1))


def _pair(low: tuple[float, ...], high: tuple[float, ...]) -> trimesh.Trimesh:
    """A block and its mirror image on the right."""
    left = block(low, high)
    return merge([left, block((low[0], -high[1], low[2]), (high[0], -low[1], high[2]))])


def _lights(params: VehicleParameters, style: CarStyle) -> dict[str, trimesh.Trimesh]:
    nose, tail = _x(params, np.array([0.0, 1.0]))
    half, height = params.width / 2, params.height
    bonnet = np.interp(0.0, style.along, style.top) * height
    boot = np.interp(1.0, style.along, style.top) * height
    drop, inner = (0.26, 0.68) if style.tall_lights else (0.15, 0.5)
    front = nose - 0.16, 0.46 * half, bonnet - 0.17
    front_end = nose - 0.018, 0.79 * half, bonnet - 0.05
    rear = tail + 0.014, inner * half, boot - drop
    rear_end = tail + 0.16, 0.825 * half, boot - 0.01
    return {"headlights": _pair(front, front_end), "tail_lights": _pair(rear, rear_end)}


def _trim(params: VehicleParameters, style: CarStyle) -> trimesh.Trimesh:
    """Dark parts: underbody between the wheels, grille, bumper slots, dashboard."""
    nose, tail = _x(params, np.array([0.0, 1.0]))
    half = params.width / 2
    bonnet = np.interp(0.0, style.along, style.top) * params.height
    (foot, belt), _, _, (foot_rear, _) = style.windows
    inner = params.track_width / 2 - params.tyre_width / 2 - 0.6 * params.wheel_radius
    reach = params.wheel_radius + 2 * ARCH_GAP
    dash_rear, dash = _x(params, np.array([foot_rear - 0.04, foot + 0.02]))
    sill, deck = style.clearance, belt * params.height
    under = max(-reach, tail + 0.05), min(params.wheelbase + reach, nose - 0.05)
    parts = (  # from and to along x, half the width, from and to above the ground
        (*under, inner, sill + 0.02, 2 * params.wheel_radius),
        (nose - 0.15, nose - 0.010, 0.40 * half, bonnet - 0.15, bonnet - 0.06),
        (nose - 0.15, nose, 0.62 * half, sill + 0.10, sill + 0.20),
        (tail, tail + 0.15, 0.60 * half, sill + 0.10, sill + 0.19),
        # Covers the body's deck under the glass, which the driver looks down on.
        (dash_rear, dash, 0.72 * half, deck - 0.03, deck + 0.015),
    )
    return merge([block((x, -y, low), (to, y, high)) for x, to, y, low, high in parts])


def _shade(params: VehicleParameters) -> trimesh.Trimesh:
    """Sheets on the ground below the car, one on another: darker towards the middle."""
    sheets = []
    for k, grow in enumerate(_SHADE):
        x, y = params.length / 2 + grow, params.width / 2 + grow
        corner = 0.45 + grow
        along = params.centre_offset + np.array([-x, corner - x, x - corner, x])
        across = np.array([y - corner, y, y, y - corner])
        z = 0.004 + 0.001 * np.array([k, k + 0.5])
        low, high = (np.stack([along, across, np.full(4, h)], -1) for h in z)
        sheets.append(loft_mirrored(np.stack([low, high], axis=1)))
    return merge(sheets)


def _both_ways(side: list[tuple[float, float]]) -> np.ndarray:
    """A profile of (radius, y), symmetric in y, from its half at +y."""
    return np.array([(r, -y) for r, y in side] + side[::-1])


def _tyre(params: VehicleParameters) -> trimesh.Trimesh:
    """Tread, shoulders and side walls down to the rim, and a dark disc inside it."""
    radius, half = params.wheel_radius, params.tyre_width / 2
    inner = RIM * radius
    outline = [(inner, 0.92 * half), (0.90 * radius, half), (radius, 0.80 * half)]
    disc = [(0.04, 0.55 * half), (inner + 0.01, 0.55 * half)]
    return merge([revolve(_both_ways(side), SECTIONS) for side in (outline, disc)])


def _rim(params: VehicleParameters) -> trimesh.Trimesh:
    """A flange, a hub and spokes, alike on both sides of the wheel."""
    radius, half = RIM * params.wheel_radius, 0.93 * params.tyre_width / 2
    flange = [(radius - 0.022, 0.0), (radius, -half), (radius, half)]
    hub = _both_ways([(0.02, half), (0.24 * radius, half)])
    parts = [revolve(np.array(flange), SECTIONS), revolve(hub, 10)]
    long, wide = radius - 0.01, 0.075 * params.wheel_radius
    for k in range(SPOKES):
        angle = 2 * np.pi * k / SPOKES
        spoke = block((0.03, -0.9 * half, -wide), (long, 0.9 * half, wide))
        turn = trimesh.transformations.rotation_matrix(angle, (0.0, 1.0, 0.0))
        parts.append(spoke.apply_transform(turn))
    return merge(parts)
