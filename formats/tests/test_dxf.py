"""Drawings as people make them: stalls as lines, other layers, units and entities."""

import math
from collections import Counter

import ezdxf
import numpy as np
import pytest
import shapely
from helpers.programs import layouts as main
from shapely import affinity

from carpark_formats.maps import dxf as reading
from carpark_formats.maps.bays import bays_between
from carpark_formats.maps.features import Feature
from carpark_formats.maps.fit import joined_lanes
from carpark_formats.maps.importing import import_map, read_plan
from carpark_mj.layouts.files import read_json

LENGTH, WIDTH, COUNT = 5.0, 2.5, 6


def comb(angle=90.0, length=LENGTH, count=COUNT, pitch=WIDTH):
    """The lines between bays in a row along x, `pitch` apart across themselves."""
    turn = math.radians(angle)
    step = pitch / math.sin(turn)
    tip = np.array([math.cos(turn), math.sin(turn)]) * length
    feet = [np.array([k * step, 0.0]) for k in range(count + 1)]
    return [shapely.LineString([foot, foot + tip]) for foot in feet]


def sizes(bays):
    """Sorted sides (n, 2) of rectangles."""
    sides = [np.hypot(*np.diff(shapely.get_coordinates(b)[:3], axis=0).T) for b in bays]
    return np.sort(np.array(sides), axis=1)


@pytest.mark.parametrize("turn", [0.0, 0.7, 2.9])
@pytest.mark.parametrize("angle", [90.0, 75.0, 60.0, 45.0, 30.0])
def test_a_bay_lies_between_two_lines(angle, turn):
    lines = [
        affinity.rotate(line, turn, origin=(0, 0), use_radians=True)
        for line in comb(angle)
    ]
    bays = bays_between(lines)
    assert len(bays) == COUNT
    assert np.allclose(sizes(bays), (WIDTH, LENGTH), atol=0.01)
    # Each bay keeps to its own two lines.
    for bay in bays:
        assert sum(bay.buffer(1e-3).intersects(line) for line in lines) == 2


MIDDLE = shapely.LineString([(0, LENGTH), (COUNT * WIDTH, LENGTH)])
DOUBLE = [affinity.translate(line, dx) for line in comb() for dx in (-0.2, 0.2)]


@pytest.mark.parametrize(
    ("lines", "count", "size"),
    [
        (comb(length=2 * LENGTH), 2 * COUNT, (WIDTH, LENGTH)),  # of two rows
        ([*comb(length=2 * LENGTH), MIDDLE], 2 * COUNT, (WIDTH, LENGTH)),
        (comb(length=2.0, pitch=6.0), COUNT, (2.0, 6.0)),  # along a kerb
        (DOUBLE, COUNT, (WIDTH - 0.4, LENGTH)),
    ],
    ids=["two rows", "with a line between", "parallel", "double lines"],
)
def test_lines_bound_the_bays_between_them(lines, count, size):
    bays = bays_between(lines)
    assert len(bays) == count
    assert np.allclose(sizes(bays), size, atol=0.01)


def test_an_aisle_between_rows_is_no_bay():
    # Two closed rows across an aisle as wide as a bay along a kerb is long.
    row = shapely.box(0, 0, COUNT * WIDTH, LENGTH).exterior
    rows = [*comb(), row]
    rows += [affinity.translate(line, 0, LENGTH + 6.0) for line in rows]
    bays = bays_between(rows)
    assert len(bays) == 2 * COUNT
    aisle = shapely.box(0, LENGTH, COUNT * WIDTH, LENGTH + 6.0)
    assert max(shapely.area(shapely.intersection(bays, aisle))) < 1e-6


def test_lines_that_bound_no_bay_give_none():
    far = [shapely.LineString([(0, 9 * k), (5, 9 * k)]) for k in range(5)]
    assert bays_between(far) == []
    assert bays_between([]) == []
    assert bays_between(comb(), [shapely.box(-1, -1, 20, 6)]) == []
    with pytest.raises(ValueError, match="lines divide bays"):
        bays_between(comb(pitch=9.0, count=3000))
    with pytest.raises(ValueError, match="pairs of lines"):
        bays_between(comb(pitch=0.02, count=300))


def drawing(units=6):
    """An empty drawing in metres, and its model space."""
    new = ezdxf.new("R2010", units=units)
    return new, new.modelspace()


def draw_lines(model, lines, layer, scale=1.0):
    for line in lines:
        start, end = shapely.get_coordinates(line) * scale
        model.add_line(start, end, {"layer": layer})


def draw_lane(model, layer="aisle", scale=1.0, y=-3.0):
    points = np.array([(-4.0, y), (COUNT * WIDTH + 4.0, y)]) * scale
    attributes = {"layer": layer, "const_width": 5.5 * scale}
    model.add_lwpolyline(points, dxfattribs=attributes)


def saved(tmp_path, new):
    path = tmp_path / "plan.dxf"
    new.saveas(path)
    return path


def test_flags_name_the_layers_and_the_unit(tmp_path, capsys):
    new, model = drawing(units=0)
    draw_lines(model, comb(), "STELLPLÄTZE", scale=1000.0)
    draw_lane(model, "Fahrgasse", scale=1000.0)
    path, out = saved(tmp_path, new), tmp_path / "lot.json"
    flags = ["--layer", "stall=stellplätze", "--layer", "lane=GASSE"]
    command = ["import", str(path), "--out", str(out)]
    assert main([*command, "--unit", "mm", *flags]) == 0
    lot = read_json(out)
    assert np.allclose(lot.bay_size, (LENGTH, WIDTH), atol=0.02)
    assert len(lot.bay_size) == COUNT
    for wrong, told in (
        (flags, "--unit"),
        (["--unit", "mm"], "LINE on layer STELLPLÄTZE"),
        (["--unit", "league"], "league"),
        (["--unit", "mm", "--layer", "stal=x"], "stal=x"),
    ):
        capsys.readouterr()
        assert main([*command, *wrong]) == 2
        assert told in capsys.readouterr().err
    with pytest.raises(ValueError, match="--unit"):  # of drawings alone
        read_plan(tmp_path / "a.osm", unit="m")


def test_any_entity_may_be_on_a_known_layer(tmp_path):
    new, model = drawing()
    model.add_line((0, 9), (15, 9), {"layer": "wall"})
    model.add_circle((16, 4), 0.3, {"layer": "column"})
    model.add_arc((0, 9), 3, 90, 180, dxfattribs={"layer": "wall"})
    model.add_spline([(0, 9), (5, 10), (9, 9)], dxfattribs={"layer": "kerb"})
    model.add_mline([(0, 12), (15, 12)], dxfattribs={"layer": "wall"})
    model.add_text("12", dxfattribs={"layer": "stall"})
    # A hatch and its outline are one stall.
    outline = [(0, 0), (WIDTH, 0), (WIDTH, LENGTH), (0, LENGTH)]
    model.add_lwpolyline(outline, close=True, dxfattribs={"layer": "stall"})
    hatch = model.add_hatch(dxfattribs={"layer": "stall"})
    hatch.paths.add_polyline_path(outline[2:] + outline[:2])
    draw_lane(model)
    plan = read_plan(saved(tmp_path, new))
    found = Counter(feature.tag for feature in plan.features)
    assert found["bay"] == found["pillar"] == found["lane"] == found["kerb"] == 1
    assert found["wall"] >= 3
    assert dict(plan.report.unknown) == {"TEXT on layer stall": 1}


def test_outlines_within_the_ground_are_islands(tmp_path):
    # Road plates around two rows, as a hatch and its outlines, with an arrow on them.
    new, model = drawing()

    def corners(*bounds):
        return shapely.get_coordinates(shapely.box(*bounds))[:-1]

    rings = [corners(0, 0, 60, 36), corners(6, 6, 54, 15), corners(6, 21, 54, 30)]
    hatch = model.add_hatch(dxfattribs={"layer": "aisle"})
    for ring in rings:
        model.add_lwpolyline(ring, close=True, dxfattribs={"layer": "aisle"})
        hatch.paths.add_polyline_path(ring)
    arrow = corners(20, 2, 23, 3)
    model.add_lwpolyline(arrow, close=True, dxfattribs={"layer": "aisle"})
    plan = read_plan(saved(tmp_path, new))
    ground = shapely.union_all([f.shape for f in plan.features if f.tag == "drivable"])
    assert ground.area == pytest.approx(60 * 36 - 2 * 48 * 9)
    lanes = joined_lanes([one for one in plan.features if one.tag == "lane"])
    assert len(lanes) >= 5
    assert np.allclose([lane.width for lane, _ in lanes], 6.0, atol=0.05)


def test_the_ground_of_an_aisle_gives_its_lanes(tmp_path):
    new, model = drawing()
    draw_lines(model, comb(), "PARKING")
    ground = [(-4, 0), (-4, -6), (25, -6), (25, 14), (19, 14), (19, 0)]
    model.add_lwpolyline(ground, close=True, dxfattribs={"layer": "AISLE"})
    lot, report = import_map(saved(tmp_path, new))
    assert len(report.errors) == COUNT
    lanes = np.asarray(lot.lane_size)[np.asarray(lot.lane_mask)]
    assert len(lanes) == 2
    assert np.allclose(lanes[:, 1], 6.0, atol=0.05)


def test_columns_that_touch_bays_stay_beside_them(tmp_path):
    new, model = drawing()
    draw_lines(model, comb(), "stalls")
    draw_lane(model)
    corner = COUNT * WIDTH
    square = [(0.0, 0.0), (0.6, 0.0), (0.6, 0.6), (0.0, 0.6)]
    for dx in (0.0, -0.25):  # beside the last bay, and into it
        points = [(corner + x + dx, 2.0 - 8 * dx + y) for x, y in square]
        model.add_lwpolyline(points, close=True, dxfattribs={"layer": "column"})
    lot, _ = import_map(saved(tmp_path, new))
    [centre] = np.asarray(lot.disc_centre)[np.asarray(lot.disc_mask)]
    [radius] = np.asarray(lot.disc_radius)[np.asarray(lot.disc_mask)]
    bays = np.asarray(lot.bay_pose)[:, :2]
    assert radius == pytest.approx(0.3, abs=0.01)
    gap = np.abs(centre[0] - bays[:, 0]).min() - WIDTH / 2
    assert gap == pytest.approx(0.3, abs=0.02)
    assert int(lot.wall_mask.sum()) == 1


def test_layers_that_are_off_are_not_read(tmp_path):
    new, model = drawing()
    draw_lines(model, comb(), "stalls")
    draw_lines(model, comb(), "old stalls")
    new.layers.add("old stalls").off()
    new.layers.add("stalls")
    assert len(read_plan(saved(tmp_path, new)).features) == COUNT


def nested(new, depth, copies=10):
    """A block of `copies ** depth` lines."""
    new.blocks.new("B0").add_line((0, 0), (1, 0))
    for level in range(1, depth + 1):
        block = new.blocks.new(f"B{level}")
        for k in range(copies):
            block.add_blockref(f"B{level - 1}", (k, 0))
    return f"B{depth}"


def test_blocks_of_countless_entities_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(reading, "MOST_SHAPES", 500)
    new, model = drawing()
    model.add_blockref(nested(new, 12), (0, 0), {"layer": "wall"})
    with pytest.raises(ValueError, match="shapes or more"):
        read_plan(saved(tmp_path, new))


def test_blocks_that_say_nothing_are_not_opened(tmp_path):
    new, model = drawing()
    model.add_blockref(nested(new, 12), (0, 0), {"layer": "furniture"})
    draw_lines(model, comb(), "stalls")
    plan = read_plan(saved(tmp_path, new))
    assert len(plan.features) == COUNT
    assert dict(plan.report.unknown) == {"INSERT on layer furniture": 1}


def test_a_block_within_itself_is_refused(tmp_path):
    new, model = drawing()
    block = new.blocks.new("B")
    block.add_line((0, 0), (1, 0))
    block.add_blockref("B", (1, 0))
    block.add_blockref("B", (2, 0))
    model.add_blockref("B", (0, 0), {"layer": "wall"})
    with pytest.raises(ValueError, match=r"no DXF.*recursion"):
        read_plan(saved(tmp_path, new))


def test_a_helix_without_end_is_left_out(tmp_path):
    new, model = drawing()
    model.add_helix(radius=5, pitch=1, turns=2, dxfattribs={"layer": "kerb"})
    model.add_helix(radius=100, pitch=1, turns=400, dxfattribs={"layer": "wall"})
    plan = read_plan(saved(tmp_path, new))
    assert [one.tag for one in plan.features] == ["kerb"]
    assert dict(plan.report.unknown) == {"HELIX on layer wall": 1}


def test_lanes_far_apart_are_joined_as_each_alone():
    rng = np.random.default_rng(0)
    lines = [
        [(x, y), (x + 12, y + 12 * slope)]
        for x, y, slope in rng.uniform(-20, 20, (20, 3)) * (1, 0.05, 0.005)
    ]
    cross = [[(0, -30), (0, 30)], [(7, -4), (7, 9)]]

    def lanes(shift):
        return [
            Feature("lane", shapely.LineString(np.add(line, (shift, 0))), "", width=5.0)
            for line in (*lines, *cross)
        ]

    alone = joined_lanes(lanes(0.0))
    many = joined_lanes([lane for k in range(90) for lane in lanes(200.0 * k)])
    assert len(many) == 90 * len(alone)
    assert len(alone) < len(lines)

    def rows(found):
        return np.array([(*box.pose, *box.size) for box, _ in found])

    there = rows(many)
    there[:, 0] -= 200.0 * np.round(there[:, 0] / 200.0)
    distance = np.abs(there[:, None] - rows(alone)).max(axis=-1)
    assert distance.min(axis=1).max() < 1e-6
