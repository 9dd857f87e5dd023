"""Clearance against shapely, in crowds and with nobody near."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from helpers.scenes import cars, lot, moved, moved_cars, polygons
from helpers.states import parked_at, state_of

from carpark_mj.geometry.obstacles import is_crowded
from carpark_mj.mdp import safety as clearance
from carpark_mj.mdp.collisions import find_hits
from carpark_mj.mdp.safety import RANGE, agent_clearance, clearances
from carpark_mj.obstacles import lot_obstacles

LOTS, AGENTS, PARKED, WALLS, DISCS, TRACES = 60, 4, 5, 3, 4, 3
TEMPLATE = lot(np.zeros((1, 3)), np.zeros((WALLS, 3)), discs=np.zeros((DISCS, 3)))


def gaps_of(layout, motion, parked):
    return clearances(motion, lot_obstacles(layout, motion, parked))


@jax.jit
@jax.vmap
def run(layout, motion, parked):
    hits = find_hits(state_of(layout, motion, 0, parked_cars=parked))
    return gaps_of(layout, motion, parked), hits


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
    motion = cars(trace[..., -1, :], size=sizes(AGENTS), trace=trace)
    layout = jax.tree.map(lambda x: jnp.stack([x] * LOTS), TEMPLATE).replace(
        wall_pose=poses(WALLS),
        wall_size=sizes(WALLS),
        wall_mask=rng.uniform(size=(LOTS, WALLS)) < 0.7,
        disc_centre=poses(DISCS)[..., :2],
        disc_radius=np.float32(rng.uniform(0.1, 1.5, (LOTS, DISCS))),
        disc_mask=rng.uniform(size=(LOTS, DISCS)) < 0.7,
    )
    parked = jax.vmap(parked_at)(
        poses(PARKED), sizes(PARKED), rng.uniform(size=(LOTS, PARKED)) < 0.7
    )
    return layout, motion, parked


def oracle(scene):
    """The same by shapely, of every pair at every instant."""
    layout, motion, parked = scene
    own = polygons(motion.trace_w, np.asarray(motion.size)[:, :, None])

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
        "parked_car": still(parked.pose_w, parked.size, parked.present),
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
    assert hits.keys() == got.keys()
    for kind, hit in hits.items():
        np.testing.assert_array_equal(hit, got[kind] == 0.0)


def test_an_agent_alone_in_an_empty_lot_is_far_from_everything():
    plan, alone = lot([(0, 0, 0)]), cars([(0, 0, 0)])
    gap = jax.jit(gaps_of)(plan, alone, parked_at())
    assert {*gap} == {"agent", "parked_car", "wall"}
    assert all(value.tolist() == [RANGE] for value in gap.values())
    assert agent_clearance(alone).tolist() == [np.inf]


@pytest.mark.parametrize("count", [5, 30])  # of all pairs, and of the near ones
def test_the_clearance_of_agents_as_they_stand_is_shapely_s(count):
    rng = np.random.default_rng(count)
    pose = rng.uniform((-15, -15, -3.1), (15, 15, 3.1), (count, 3))
    size = rng.uniform(0.5, 5.0, (count, 2))
    own = polygons(pose, size)
    gap = shapely.distance(own[:, None], own)
    expected = np.where(np.eye(count, dtype=bool), np.inf, gap).min(axis=1)
    assert is_crowded(count, count) == (count == 30)
    got = agent_clearance(cars(pose, size=size))
    np.testing.assert_allclose(got, expected, atol=5e-5)  # m, float32 at 15 m
    assert (expected > 0).any()


def test_in_a_crowd_gradients_are_those_of_all_pairs(monkeypatch):
    rng = np.random.default_rng(0)
    pose = np.float32(rng.uniform((-30, -30, -3), (30, 30, 3), (24, 3)))
    assert is_crowded(24, 24)

    def slope():
        return jax.grad(lambda pose: agent_clearance(cars(pose)).sum())(pose)

    crowded = slope()
    monkeypatch.setattr(clearance, "is_crowded", lambda *_: False)
    np.testing.assert_allclose(crowded, slope(), atol=1e-6)
    assert np.abs(crowded).max() > 0.5


def test_clearance_does_not_depend_on_the_frame(scene):
    layout, motion, parked = scene
    shift = (5.0, -3.0, 1.1)
    centre = jnp.pad(layout.disc_centre, ((0, 0), (0, 0), (0, 1)))
    layout = layout.replace(
        wall_pose=moved(layout.wall_pose, shift),
        disc_centre=moved(centre, shift)[..., :2],
    )
    parked = parked.replace(pose_w=moved(parked.pose_w, shift))
    got, _ = run(layout, moved_cars(motion, shift), parked)
    for name, gap in run(*scene)[0].items():
        np.testing.assert_allclose(got[name], gap, atol=1e-4, err_msg=name)
