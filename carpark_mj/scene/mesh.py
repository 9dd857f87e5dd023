"""Closed meshes from rings of points, and adding them to a model."""

from collections.abc import Sequence
from typing import cast

import mujoco
import numpy as np
import trimesh

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


def revolve(profile: np.ndarray, sections: int) -> trimesh.Trimesh:
    """A closed profile (points, 2) of (radius, y) [m] turned about the y axis."""
    points = len(profile)
    angle = 2 * np.pi * np.arange(sections) / sections
    radius, y = profile.T
    vertices = np.stack(
        [
            np.outer(np.cos(angle), radius),
            np.tile(y, (sections, 1)),
            np.outer(np.sin(angle), radius),
        ],
        -1,
    )
    index = np.arange(sections * points).reshape(sections, points)
    ahead = np.roll(index, -1, axis=0)
    faces = [
        (index, ahead, np.roll(ahead, -1, axis=1)),
        (index, np.roll(ahead, -1, axis=1), np.roll(index, -1, axis=1)),
    ]
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
