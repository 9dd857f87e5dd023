"""Clearance against shapely, in crowds and with nobody near."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from helpers.scenes import cars, lot, moved, moved_cars, polygons

from carpark_mj.mdp.metrics import clearance
from carpark_mj.mdp.metrics.clearance import RANGE, clearances
from carpark_mj.mdp.terminations import find_hits

LOTS, AGENTS, PARKED, WALLS, DISCS, TRACES = 60, 4, 5, 3, 4, 3
TEMPLATE = lot(np.zeros((1, 3)), np.zeros((WALLS, 3)), discs=np.zeros((DISCS, 3)))


@jax.jit
@jax.vmap
def run(vehicle, layout, parked, parked_size, parked_mask):
    hits = find_hits(layout, vehicle, parked, parked_size)
    return clearances(layout, vehicle, parked, parked_size, parked_mask), hits


@pytest.fixture(scope="module")
def scene():
    """Dense lots and wide ones, with rows that do not count."""
    rng = np.random.default_rng(0)
    reach = np.where(np.arange(LOTS) % 2, 12.0, 60.0)[:, None, None]

    def poses(count):
        place = rng.uniform(-1, 1, (LOTS, count, 2)) * reach
        yaw = rng.uniform(-np.pi, np.pi, (LOTS, count, 1))
        return np.float32(np.concatenate([place, yaw], axis=-1))

    def sizes(count):
        return np.float32(rng.uniform(0.5, 5.0, (LOTS, count, 2)))

    pose = poses(AGENTS)[:, :, None]
    way = rng.uniform(-0.7, 0.7, (LOTS, AGENTS, 1, 3))
    trace = np.float32(pose + way * np.linspace(-1, 0, TRACES)[:, None])
    vehicle = cars(trace[..., -1, :], size=sizes(AGENTS), trace=trace)
    layout = jax.tree.map(lambda x: jnp.stack([x] * LOTS), TEMPLATE).replace(
        wall_pose=poses(WALLS),
        wall_size=sizes(WALLS),
        wall_mask=rng.uniform(size=(LOTS, WALLS)) < 0.7,
        disc_centre=poses(DISCS)[..., :2],
        disc_radius=np.float32(rng.uniform(0.1, 1.5, (LOTS, DISCS))),
        disc_mask=rng.uniform(size=(LOTS, DISCS)) < 0.7,
    )
    mask = rng.uniform(size=(LOTS, PARKED)) < 0.7
    return vehicle, layout, poses(PARKED), sizes(PARKED), mask


def oracle(scene):
    """The same by shapely, of every pair at every instant."""
    vehicle, layout, parked, parked_size, parked_mask = scene
    own = polygons(vehicle.trace_w, np.asarray(vehicle.size)[:, :, None])

    def gaps(shapes, counts, radius=0.0):  # shapes (lots, n, instants or 1)
        found = shapely.distance(own[:, :, None], shapes[:, None]) - radius
        return np.where(counts, found.min(axis=-1), np.inf).min(axis=-1)

    def still(pose, size, mask):
        return gaps(polygons(pose, size)[..., None], np.asarray(mask)[:, None])

    points = shapely.points(np.asarray(layout.disc_centre, np.float64))[..., None]
    radius = np.asarray(layout.disc_radius)[:, None, :, None]
    discs = gaps(points, np.asarray(layout.disc_mask)[:, None], radius)
    walls = still(layout.wall_pose, layout.wall_size, layout.wall_mask)
    found = {
        "agent": gaps(own, ~np.eye(AGENTS, dtype=bool)),
        "parked_car": still(parked, parked_size, parked_mask),
        "wall": np.minimum(walls, discs),
    }
    return {name: np.clip(gap, 0.0, RANGE) for name, gap in found.items()}


def test_clearance_is_shapely_s_distance_and_zero_just_where_cars_are_hit(scene):
    got, hits = run(*scene)
    expected = oracle(scene)
    for name, gap in expected.items():
        # Coordinates up to 60 m resolve 4e-6 m in float32.
        np.testing.assert_allclose(got[name], gap, atol=5e-5, err_msg=name)
        assert 0.05 < (gap == 0).mean() < 0.6  # all three kinds of answers
        assert 0.05 < (gap == RANGE).mean() < 0.9
    for kind, hit in zip(expected, hits, strict=True):
        if kind != "parked_car":  # those that do not exist are hit as well here
            np.testing.assert_array_equal(hit, got[kind] == 0.0)


def test_clearance_does_not_depend_on_the_frame(scene):
    vehicle, layout, parked, *rest = scene
    motion = (5.0, -3.0, 1.1)
    centre = jnp.pad(layout.disc_centre, ((0, 0), (0, 0), (0, 1)))
    layout = layout.replace(
        wall_pose=moved(layout.wall_pose, motion),
        disc_centre=moved(centre, motion)[..., :2],
    )
    got, _ = run(moved_cars(vehicle, motion), layout, moved(parked, motion), *rest)
    for name, gap in run(*scene)[0].items():
        np.testing.assert_allclose(got[name], gap, atol=1e-4, err_msg=name)


def test_nobody_near_costs_no_exact_test_and_counts_as_the_range(monkeypatch):
    tested = []

    def counted(exact):
        def wrapped(*args):
            jax.debug.callback(lambda: tested.append(exact.__name__))
            return exact(*args)

        return wrapped

    for name in ("box_distance", "box_disc_distance"):
        monkeypatch.setattr(clearance, name, counted(getattr(clearance, name)))
    plan = lot([(0, 0, 0)], [(40, 0, 0)], discs=[(0, 40, 1)])
    parked = jnp.array([[-40.0, 0, 0], [0, 0, 0]]), jnp.full((2, 2), 3.0)
    mask = jnp.array([True, False])
    search = jax.jit(clearances)
    far = search(plan, cars([(0, 0, 0), (0, -40, 0)]), *parked, mask)
    jax.effects_barrier()
    assert tested == []
    for gap in far.values():
        np.testing.assert_array_equal(gap, RANGE)
    search(plan, cars([(0, 0, 0), (0, -10, 0)]), *parked, mask)
    jax.effects_barrier()
    assert set(tested) == {"box_distance"}


def test_an_agent_alone_in_an_empty_lot_is_far_from_everything():
    plan, none = lot([(0, 0, 0)]), (jnp.zeros((0, 3)), jnp.zeros((0, 2)))
    gap = jax.jit(clearances)(plan, cars([(0, 0, 0)]), *none, jnp.zeros(0, bool))
    assert list(gap) == ["agent", "parked_car", "wall"]
    assert all(value.tolist() == [RANGE] for value in gap.values())
