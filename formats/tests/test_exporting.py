"""Lots as maps of others: every row is where it was, and what is lost is as written."""

import math
from xml.etree import ElementTree

import jax
import numpy as np
import pytest
import shapely
from helpers.programs import assert_refused
from helpers.programs import layouts as main

from carpark_formats.maps.importing import import_map
from carpark_mj.geometry import box_corners
from carpark_mj.layouts import make_layout
from carpark_mj.layouts.types import BayKind, WallKind


@pytest.fixture(scope="module", params=["lot", "square_compact", "street"])
def lot(request):
    """A lot's name with the layout that the command draws of seed 3."""
    key = jax.random.fold_in(jax.random.key(3), 0)
    return request.param, jax.device_get(make_layout(request.param, key))


def exported(name, out):
    assert main([name, "--seed", "3", "--save", str(out)]) == 0
    return ElementTree.parse(out).getroot()


def rows(layout, kind, *parts):
    mask = getattr(layout, f"{kind}_mask")
    return [getattr(layout, f"{kind}_{part}")[mask] for part in parts]


def numbers(element, *names):
    return [float(element.get(name)) for name in names]


def test_opendrive_has_every_row(lot, tmp_path):
    name, layout = lot
    ground, *roads = exported(name, tmp_path / "lot.xodr").findall("road")
    for part in (one for road in (ground, *roads) for one in road.iter()):
        # The schema refuses them without children.
        assert part.tag not in ("left", "center", "right", "objects") or len(part)
    x, y, yaw = numbers(ground.find("planView/geometry"), "x", "y", "hdg")
    assert yaw == 0.0
    objects = ground.findall("objects/object")
    found = [
        (one.get("type"), one.get("name"), *numbers(one, "s", "t", "hdg"), *size)
        for one in objects
        for size in [
            [float(one.get(side, 0)) for side in ("length", "width", "radius")]
        ]
    ]
    drawn = []
    for pose, size, kind in zip(
        *rows(layout, "bay", "pose", "size", "kind"), strict=True
    ):
        drawn.append(("parkingSpace", BayKind(kind).name, *pose, *size, 0))
    for pose, size, kind in zip(
        *rows(layout, "wall", "pose", "size", "kind"), strict=True
    ):
        what = "trafficIsland" if kind == WallKind.ISLAND else "barrier"
        drawn.append((what, WallKind(kind).name, *pose, *size, 0))
    assert len(found) == len(drawn) + int(layout.disc_mask.sum())
    for (what, word, *there), (kind, label, *values) in zip(found, drawn, strict=False):
        assert (what, word) == (kind, label.lower())
        there[0], there[1] = there[0] + x, there[1] + y
        np.testing.assert_allclose(there, values, atol=1e-5)
        assert 0.0 <= there[0] - x <= float(ground.get("length"))
    lanes = rows(layout, "lane", "pose", "size", "one_way")
    assert len(roads) == len(lanes[0])
    for road, pose, size, one_way in zip(roads, *lanes, strict=True):
        *start, yaw, length = numbers(
            road.find("planView/geometry"), "x", "y", "hdg", "length"
        )
        [lane] = road.findall("lanes/laneSection/right/lane")
        [width] = numbers(lane.find("width"), "a")
        middle = complex(*start) + complex(length, -width) / 2 * np.exp(1j * yaw)
        np.testing.assert_allclose([middle.real, middle.imag, yaw], pose, atol=1e-4)
        np.testing.assert_allclose([length, width], size, atol=1e-5)
        assert lane.get("type") == ("driving" if one_way else "bidirectional")


def shape(layout, *kinds, more=0.0):
    """The rows of some kinds as one shape, longer and wider by `more`."""
    return shapely.union_all(
        [
            shapely.Polygon(np.asarray(box_corners(pose, size + more)))
            for kind in kinds
            for pose, size in zip(*rows(layout, kind, "pose", "size"), strict=True)
        ]
    )


def test_lanelet2_comes_back_as_the_lot(lot, tmp_path):
    name, layout = lot
    exported(name, tmp_path / "lot.osm")
    back, report = import_map(tmp_path / "lot.osm")
    assert not report.lost
    (pose, size), (again, sizes) = (
        rows(x, "bay", "pose", "size") for x in (layout, back)
    )
    np.testing.assert_allclose(sizes, size, atol=3e-3)
    shift = (again - pose)[:, :2].mean(axis=0)  # its middle becomes the origin
    np.testing.assert_allclose(again[:, :2], pose[:, :2] + shift, atol=3e-3)
    np.testing.assert_allclose(np.cos(again[:, 2] - pose[:, 2]), 1.0, atol=1e-5)
    # Walls are cut and joined anew; those far from the ground are left out.
    walls, ground = shape(layout, "wall"), shape(layout, "bay", "lane", "spawn", more=1)
    moved = shapely.affinity.translate(shape(back, "wall"), *-shift)
    assert moved.difference(walls.buffer(0.05)).area < 0.01 * walls.area
    near = walls.intersection(ground)
    assert near.area > 0.0
    assert near.difference(moved.buffer(0.05)).area < 0.01 * walls.area
    # Lost: starts, kinds of bays, which end goes in first.
    assert back.bay_end is None
    assert (back.bay_kind == BayKind.STANDARD).all()


def test_latitudes_and_longitudes_are_metres_apart(tmp_path):
    import pyproj

    root = exported("square_compact", tmp_path / "lot.osm")
    nodes = root.findall("node")
    tags = [{tag.get("k"): tag.get("v") for tag in node} for node in nodes]
    (first, *_, last), places = (
        nodes,
        [(float(t["local_x"]), float(t["local_y"])) for t in tags],
    )
    ends = [numbers(node, "lon", "lat") for node in (first, last)]
    _, _, away = pyproj.Geod(ellps="WGS84").inv(*ends[0], *ends[1])
    assert away == pytest.approx(math.dist(places[0], places[-1]), abs=1e-4)


def test_other_suffixes_are_refused(capsys):
    assert_refused(capsys, "layouts", ["square", "--save", "a.txt"], "xodr")
