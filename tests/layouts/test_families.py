"""Every family of lots, judged by shapely: no overlaps, everything is reachable."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from helpers.programs import layouts as main
from helpers.scenes import boxes, polygons, solid, try_out
from helpers.spawning import surroundings_of
from matplotlib.figure import Figure

from carpark_mj.config import LAYOUTS, SpawnConfig
from carpark_mj.geometry import box_corners
from carpark_mj.layouts import (
    AngledConfig,
    BayKind,
    DeadEndConfig,
    DesignCar,
    DiscKind,
    GarageRowConfig,
    LotConfig,
    WallKind,
    layout_maxima,
    make_layout,
    pad_layout,
)
from carpark_mj.layouts.checks import describe_faults
from carpark_mj.layouts.plot import number_bays
from carpark_mj.layouts.tight import draw_tight_bay
from carpark_mj.scene.build import drivable_scene
from carpark_mj.spawning.starts import draw_uniform, spawn_pose, spawn_shapes
from carpark_mj.vehicle import COMPACT

KEYS = 60
# Settings with which lots of a family differ most from those with its defaults.
VARIANTS = {
    "angled, back-in": AngledConfig(back_in=True, angle=(45.0, 60.0)),
    "lot, deck with pillars": LotConfig(
        pillar_every=3, row_ends="bollards", num_aisles=(1, 3)
    ),
    "lot, angled": LotConfig(
        angle=(50.0, 75.0), two_way=False, extra_aisle=(0.0, 0.6), boundary="kerb"
    ),
}
TIGHT = ("complex", "perpendicular"), ("extreme", "parallel")
HARD = {
    f"{config.family}, {orientation}, {level}": config(level, orientation)
    for config in (GarageRowConfig, DeadEndConfig)
    for level, orientation in TIGHT
}
PLAIN = ["square_compact", "street", "street_parallel", "angled", "lot"]
SHOWN = HARD | {name: LAYOUTS[name] for name in PLAIN} | VARIANTS
NAMES = [*SHOWN]
PARALLEL = [name for name in NAMES if "parallel" in name]
CAR = DesignCar()
AREA = 0.02  # m^2; rounding of 1e-5 m along a few hundred metres of edges


@functools.cache
def maxima():
    """Of all families, so that what judges them is compiled once."""
    make = [SHOWN[n].generate for n in NAMES]
    return layout_maxima(jax.eval_shape(one, jax.random.key(0)) for one in make)


@functools.cache
def drawn(name):
    """Lots of one family as numpy arrays with a leading (keys,)."""
    config = SHOWN[name]
    make = jax.jit(jax.vmap(lambda key: pad_layout(config.generate(key), maxima())))
    return jax.device_get(make(jax.random.split(jax.random.key(0), KEYS)))


def lots(name, count=KEYS):
    batch = drawn(name)
    return [jax.tree.map(lambda x, k=k: x[k], batch) for k in range(count)]


@pytest.mark.parametrize("name", NAMES)
def test_bays_lanes_and_solids_do_not_overlap(name):
    for layout in lots(name, 25):
        bays, lanes = boxes(layout, "bay"), boxes(layout, "lane")
        area = shapely.area(bays).sum()
        assert shapely.union_all(bays).area == pytest.approx(area, abs=AREA)
        bays, lanes = shapely.union_all(bays), shapely.union_all(lanes)
        for a, b in ((bays, solid(layout)), (bays, lanes), (lanes, solid(layout))):
            assert shapely.intersection(a, b).area < AREA


@pytest.mark.parametrize("name", NAMES)
def test_every_lot_is_well_formed_and_holds_the_bays_promised(name):
    config = SHOWN[name]
    for layout in lots(name):
        assert describe_faults(layout, CAR.size) == []
        assert layout.bay_mask.sum() >= config.min_bays
    fewest = drawn(name).bay_mask.sum(axis=1).min()
    assert fewest == config.min_bays  # 60 keys meet the smallest lots


@pytest.mark.parametrize("name", NAMES)
def test_a_car_gets_from_every_spawn_region_to_every_bay(name):
    """A disc of the car's width can roll there: nothing stands in the way."""
    half = CAR.width / 2
    for layout in lots(name, 12):
        x, y = layout.extent
        bays = boxes(layout, "bay")
        taken = shapely.union_all([solid(layout), *bays])
        room = shapely.box(-x, -y, x, y).difference(taken).buffer(-half)
        starts = shapely.points(layout.spawn_pose[layout.spawn_mask, :2])
        parts = [p for p in shapely.get_parts(room) if p.intersects(starts[0])]
        assert len(parts) == 1
        assert shapely.intersects(parts[0], starts).all()
        pose, size = layout.bay_pose[layout.bay_mask], layout.bay_size[layout.bay_mask]
        # The bay is entered over its mouth, a parallel one over a long side.
        turns = (np.pi / 2, -np.pi / 2) if name in PARALLEL else (0.0,)
        reach = size[:, 1] / 2 if name in PARALLEL else size[:, 0] / 2
        gaps = []
        for turn in turns:
            yaw = pose[:, 2] + turn
            ahead = np.stack([np.cos(yaw), np.sin(yaw)], axis=1) * reach[:, None]
            gaps.append(shapely.distance(shapely.points(pose[:, :2] + ahead), parts[0]))
        # Mouths of angled bays lie up to half a bay's width behind the aisle's edge.
        leaning = "angled" in name or "diagonal" in name
        slack = size[:, 1].max() / 2 if leaning else 0.05
        assert np.min(gaps, axis=0).max() < half + slack


@jax.jit
def spawned(batch, keys):
    """Start poses (lots, 100, 3) near random goals and at random."""
    spawn = SpawnConfig(close_ratio=0.5, min_distance=0.0)

    def one(layout, key):
        goal_key, key = jax.random.split(key)
        chance = jax.random.uniform(goal_key, layout.bay_mask.shape)
        goal = layout.bay_pose[jnp.argmax(jnp.where(layout.bay_mask, chance, -1.0))]
        nobody = surroundings_of(layout)
        draws = draw_uniform(spawn_shapes(spawn), key)
        return spawn_pose(spawn, layout, nobody, goal, draws)

    return jax.vmap(jax.vmap(one, (None, 0)))(batch, keys)


@pytest.mark.parametrize("name", NAMES)
def test_no_car_spawns_in_a_wall_a_disc_or_a_bay(name):
    batch = jax.tree.map(lambda x: x[:12], drawn(name))
    pose = spawned(batch, jax.random.split(jax.random.key(1), (12, 100)))
    for k, layout in enumerate(lots(name, 12)):
        taken = shapely.union_all([solid(layout), *boxes(layout, "bay")])
        cars = polygons(pose[k], np.full((100, 2), CAR.size) - 1e-3)
        assert not shapely.intersects(taken, cars).any()
        regions = shapely.union_all(boxes(layout, "spawn")).buffer(1e-3)
        assert shapely.intersects(regions, shapely.points(pose[k, :, :2])).all()


@pytest.mark.parametrize("name", NAMES)
def test_other_keys_give_other_lots_of_random_families(name):
    extents = np.unique(drawn(name).extent.round(4), axis=0)
    random = SHOWN[name].is_random
    assert len(extents) > KEYS / 2 if random else len(extents) == 1


def test_the_design_car_is_the_default_vehicle():
    for name in ("length", "width", "wheelbase", "rear_overhang", "max_steering"):
        # The steering angle follows from the published circle; here to 0.001 degrees.
        assert getattr(CAR, name) == pytest.approx(getattr(COMPACT, name), abs=1e-5)


@pytest.mark.parametrize("name", ["street", "street_parallel", "lot"])
def test_traffic_keeps_right_and_parked_cars_stand_as_described(name):
    for layout in lots(name, 10):
        lane = layout.lane_pose[layout.lane_mask]
        for x, y, yaw in lane:
            # The lane of the opposite direction lies to the left.
            other = lane[np.cos(lane[:, 2] - yaw) < -0.99, :2] - (x, y)
            closest = other[np.linalg.norm(other, axis=1).argmin()]
            width = 0.8 * 24 * 0.3048  # more than one lane away is another aisle
            assert np.linalg.norm(closest) < width
            assert closest @ (-np.sin(yaw), np.cos(yaw)) > 0
    if name == "street_parallel":
        layout = lots(name, 1)[0]
        right = layout.bay_pose[layout.bay_mask & (layout.bay_pose[:, 1] < 0)]
        np.testing.assert_allclose(right[:, 2], 0.0, atol=1e-6)


@pytest.mark.parametrize(("back_in", "sign"), [(False, -1.0), (True, 1.0)])
def test_angled_bays_open_against_the_traffic_or_with_it(back_in, sign):
    """Nose-in a car ends facing away from its way; backed in it faces along it."""
    layout = make_layout(AngledConfig(num_aisles=(2, 2), back_in=back_in))
    aisles = layout.lane_pose[:2]
    ways = np.cos(aisles[:, 2])
    assert ways[0] * ways[1] == pytest.approx(-1.0)  # one-way, alternating
    for _, y, yaw in np.asarray(layout.bay_pose[layout.bay_mask]):
        aisle = np.argmin(np.abs(aisles[:, 1] - y))
        assert np.sign(np.cos(yaw)) == sign * np.sign(ways[aisle])
        assert np.sign(np.sin(yaw)) == np.sign(aisles[aisle, 1] - y)  # out of the bay


def test_an_angled_row_has_the_pitch_and_depth_of_the_textbook():
    # 60 deg, 2.5 m x 5 m: pitch w / sin, depth l sin + w cos.
    config = AngledConfig(
        num_aisles=(1, 1), angle=(60, 60), bay_width=(2.5, 2.5), bay_length=(5.0, 5.0)
    )
    layout = make_layout(config)
    row = np.asarray(layout.bay_pose[layout.bay_mask & (layout.bay_pose[:, 1] > 0)])
    pitch = np.diff(np.sort(row[:, 0]))
    np.testing.assert_allclose(pitch, 2.5 / np.sin(np.pi / 3), atol=1e-4)
    top = max(p.bounds[3] for p in boxes(jax.device_get(layout), "bay"))
    lane = float(layout.lane_size[0, 1]) / 2 + float(layout.lane_pose[0, 1])
    assert top - lane == pytest.approx(5 * np.sin(np.pi / 3) + 1.25, abs=1e-4)


def test_a_lot_has_its_wide_bays_islands_pillars_and_gates():
    counts = {"num_aisles": (2, 2), "bays_per_row": (8, 8), "num_entrances": (2, 2)}
    config = LotConfig(bay_width=(2.5, 2.5), pillar_every=3, **counts)
    layout = jax.device_get(make_layout(config))
    kind, mask = layout.bay_kind, layout.bay_mask
    assert [(mask & (kind == k)).sum() for k in BayKind] == [24 + 4, 2, 1, 0, 0]
    assert config.min_bays == 31  # 2 x 3.5 m + 3 m + 4 x 2.5 m = 20 m = 8 x 2.5 m
    assert (layout.bay_size[mask & (kind == BayKind.ACCESSIBLE), 1] == 3.5).all()
    wall = layout.wall_kind[layout.wall_mask]
    assert (wall == WallKind.ISLAND).sum() == 8
    assert (wall == WallKind.GATE).sum() == 2
    # After bays 3 and 6 of each row of 8 and of the row of 7.
    assert (layout.disc_kind[layout.disc_mask] == DiscKind.PILLAR).sum() == 8
    bollards = LotConfig(row_ends="bollards", num_aisles=(2, 2))
    drawn = make_layout(bollards)
    assert int(drawn.disc_mask.sum()) == 4 * 2 * 2
    assert int((drawn.wall_mask & (drawn.wall_kind == WallKind.ISLAND)).sum()) == 0


# HOPE (arXiv 2405.20579), for our car of 4.255 m x 1.799 m: least and largest bay
# beyond the car, and the distance of the wall opposite.
HOPE = {
    ("perpendicular", "normal"): (0.85, 1.2, 7.0),
    ("perpendicular", "complex"): (0.4, 0.85, 6.0),
    ("parallel", "normal"): (0.25 * 4.255, 0.25 * 4.255 + 0.5, 4.5),
    ("parallel", "complex"): (0.9, 0.25 * 4.255, 4.0),
    ("parallel", "extreme"): (0.6, 0.9, 3.5),
}


@pytest.mark.parametrize(("orientation", "level"), sorted(HOPE))
def test_hard_cases_have_the_room_of_hopes_levels(orientation, level):
    low, high, aisle = HOPE[orientation, level]
    chance = np.linspace(0.0, 1.0, 11)
    config = GarageRowConfig(level=level, orientation=orientation, car=CAR)
    draw = functools.partial(draw_tight_bay, config)
    size = np.array([draw(jnp.array([c, 0.5], jnp.float32))[0] for c in chance])
    room = size[:, 0] - 4.255 if orientation == "parallel" else size[:, 1] - 1.799
    np.testing.assert_allclose(room, low + (high - low) * chance, atol=1e-5)
    for name in HARD:
        if f"{orientation}, {level}" in name:
            batch = drawn(name)
            np.testing.assert_allclose(batch.lane_size[:, 0, 1], aisle)
            assert not batch.lane_one_way.any()
            size = batch.bay_size[batch.bay_mask]
            axis = 0 if orientation == "parallel" else 1
            room = size[:, axis] - CAR.size[axis]
            assert low - 1e-5 <= room.min() < low + 0.1 * (high - low)
            assert high - 0.1 * (high - low) < room.max() <= high + 1e-5


@pytest.mark.parametrize("name", [n for n in HARD if "garage" in n])
def test_every_garage_bay_has_a_wall_on_both_sides_and_one_opposite(name):
    config = SHOWN[name]
    for layout in lots(name, 10):
        walls = solid(layout)
        for bay in boxes(layout, "bay"):
            left, low, right, top = bay.bounds
            for x in (left, right):
                side = shapely.LineString([(x, low + 0.01), (x, top)])
                assert side.difference(walls.buffer(1e-3)).length < 1e-6
            aisle = HOPE[config.orientation, config.level][2]
            middle = (left + right) / 2
            across = shapely.LineString([(middle, low), (middle, low - 20)])
            gap = across.intersection(walls).distance(shapely.Point(middle, low))
            assert gap == pytest.approx(aisle, abs=1e-4)


@pytest.mark.parametrize("name", ["lot, deck with pillars", NAMES[1]])
def test_scenes_run_without_a_warning(name):
    for layout in lots(name, 2):
        starts = np.asarray(layout.spawn_pose[layout.spawn_mask][:2])
        parked = np.asarray(layout.bay_pose[layout.bay_mask])
        assert try_out(drivable_scene(layout, COMPACT, starts, parked)) == []


def test_the_command_checks_and_draws(tmp_path, capsys):
    target = tmp_path / "plan.png"
    assert main(["dead_end", "--plot", str(target), "--check", "2"]) == 0
    assert "dead_end: 2 lots, 0 problems" in capsys.readouterr().out
    assert target.read_bytes()[:4] == b"\x89PNG"
    assert main(["ring", "--check", "1"]) == 2
    assert "unknown layout 'ring'" in capsys.readouterr().err
    # JAX would take it for 0.
    assert main(["square", "--check", "1", "--seed", str(2**32)]) == 2
    assert "seed must lie in" in capsys.readouterr().err


def test_numbers_of_bays_stand_in_them():
    lot, axes = make_layout("dead_end"), Figure().add_axes((0, 0, 1, 1))
    number_bays(axes, lot, 0.1)
    found = {int(text.get_text()): text.get_position() for text in axes.texts}
    assert [*found] == list(range(lot.num_bays))
    for bay, place in found.items():  # inside its bay
        corners = box_corners(lot.bay_pose[bay], lot.bay_size[bay])
        assert shapely.Polygon(np.asarray(corners)).contains(shapely.Point(place))
