"""Room for starts: what they keep away from, and who finds no room waits."""

import dataclasses
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from helpers.scenes import lot, polygons
from helpers.sliding import SlidePhysics
from helpers.spawning import many, surroundings_of
from helpers.states import parked_at

from carpark_mj.config import EnvConfig, EpisodeConfig, SpawnConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.layouts import SquareConfig, make_layout
from carpark_mj.mdp.collisions import find_hits
from carpark_mj.spawning.placing import (
    FREE,
    SpawnInputs,
    has_room,
    place_waiting,
    start_placing,
)
from carpark_mj.spawning.starts import draw_uniform, random_pose, spawn_shapes
from carpark_mj.types import NO_BAY
from carpark_mj.vehicle import COMPACT

SIZE = (COMPACT.length, COMPACT.width)
# 8 agents in a spawn region of 7.3 m x 7.3 m, which has room for three or four.
CROWD = EnvConfig(
    layout=SquareConfig(
        bays_per_side=5,
        bay_width=2.5,
        bay_length=5.0,
        wall_gap=0.3,
        block_inset=0.2,
        spawn_margin=2.6,
    ),
    num_agents=8,
    num_parked_cars=4,
    physics="bicycle",
    episode=EpisodeConfig(max_steps=12),
)
LOTS, STEPS = 24, 60


def overlap(pose, size):
    """(n,) bool, which of cars (n, 3) overlap another."""
    boxes = polygons(pose, size)
    meet = shapely.intersects(boxes[:, None], boxes) & ~np.eye(len(pose), dtype=bool)
    return meet.any(axis=1)


@pytest.fixture(scope="module")
def crowd():
    """Lots at their start and after every step in which agents drive at random."""
    env = ParkingEnv(CROWD)

    def run(key):
        reset_key, key = jax.random.split(key)
        state, _ = env.reset(reset_key)

        def step(state, key):
            action = jax.random.uniform(key, (8, 2), minval=-1.0)
            after, timestep = env.step(state, action)
            return after, (after.replace(key=jnp.zeros(()), layout=None), timestep)

        first = state.replace(key=jnp.zeros(()), layout=None)
        return first, jax.lax.scan(step, state, jax.random.split(key, STEPS))[1]

    return many(run, LOTS)


def test_nobody_starts_on_top_of_another(crowd):
    first, (after, _) = crowd
    starts = 0
    for k in range(LOTS):
        here = first.present[k]
        assert not overlap(first.motion.pose_w[k][here], SIZE).any()
        for t in range(STEPS):
            begins = after.present[k, t] & (after.step[k, t] == 0)
            here = np.flatnonzero(after.present[k, t])
            hit = overlap(after.motion.pose_w[k, t][here], SIZE)
            assert not hit[begins[here]].any()
            starts += begins.sum()
    assert starts > 300


def test_who_finds_no_room_is_absent_until_there_is(crowd):
    first, (after, timestep) = crowd
    before = jax.tree.map(
        lambda x, y: np.concatenate([x[:, None], y[:, :-1]], axis=1), first, after
    )
    for lots in (first, after):
        np.testing.assert_array_equal(lots.active, lots.present)
        np.testing.assert_array_equal(lots.waited > 0, ~lots.present)
        away = np.abs(lots.motion.pose_w[..., 0]) > 5000.0
        np.testing.assert_array_equal(away, ~lots.present)
    waits = before.waited > 0
    assert 0.1 < waits.mean() < 0.8
    for part in (timestep.events, timestep.reward_terms):
        assert not any(x[waits].any() for x in jax.tree.leaves(part))
    assert not timestep.observation[after.waited > 0].any()
    stays = waits & (after.waited > 0)
    np.testing.assert_array_equal(after.waited[stays], before.waited[stays] + 1)
    comes = waits & after.present
    assert (after.step[comes] == 0).all()
    assert comes.any(axis=(0, 1)).all()  # nobody waits for ever
    # Goals stay apart, those that waiting agents will drive to included.
    goal = np.sort(after.goal, axis=-1)
    assert (np.diff(goal, axis=-1) > 0).all()


def test_where_nobody_respawns_who_finds_no_room_is_absent():
    episode = dataclasses.replace(CROWD.episode, respawn=False)
    env = ParkingEnv(dataclasses.replace(CROWD, episode=episode))
    state, _ = jax.jit(env.reset)(jax.random.key(0))
    present = np.asarray(state.present)
    assert 1 <= present.sum() < 8
    np.testing.assert_array_equal(state.active, present)
    np.testing.assert_array_equal(state.takes_part, present)
    assert (np.asarray(state.goal)[~present] == NO_BAY).all()
    assert not overlap(np.asarray(state.motion.pose_w)[present], SIZE).any()


def test_a_lot_with_room_for_all_knows_of_no_absent_agents():
    tanner = dataclasses.replace(CROWD, layout="square", num_agents=3)
    for config in (tanner, dataclasses.replace(CROWD, num_agents=1)):
        state = jax.eval_shape(ParkingEnv(config).reset, jax.random.key(0))[0]
        assert state.present is state.waited is None


@pytest.mark.parametrize("spacing", [0.0, 0.5625])
def test_room_for_all_is_room_wherever_the_others_stand(spacing):
    """They stand as far apart as they can, and across the car that starts."""
    layout = make_layout("square_compact")
    most = next(n for n in itertools.count(1) if not has_room(layout, SIZE, n, spacing))
    most -= 1
    assert 4 <= most <= 8
    rng, half = np.random.default_rng(0), float(layout.spawn_size[0, 0]) / 2
    grid = np.arange(-half, half, 0.1)
    if spacing:
        grid = spacing * np.arange(-np.floor(half / spacing), half / spacing)
    points = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)
    box = polygons(np.zeros((1, 3)), SIZE)[0]
    least = 1.0
    for turn in rng.uniform(-np.pi, np.pi, 20):
        free = np.ones(len(points), bool)
        for xy in rng.uniform(-half, half, (most - 1, 2)):
            other = polygons(np.array([[*xy, turn]]), SIZE)[0]
            corners = np.array(other.exterior.coords)[:-1, None]
            corners = corners - np.array(box.exterior.coords)[:-1]
            blocked = shapely.MultiPoint(corners.reshape(-1, 2)).convex_hull
            free &= ~shapely.contains_xy(blocked, *points.T)
        least = min(least, free.mean())
    assert least >= FREE
    assert least < 0.7  # the bound is not idle


def test_blocked_starts_wait_and_the_longest_wait_is_first():
    """A stand-in draws starts one beside the other; one place is taken."""
    layout = lot([(0.0, 20.0, 0.0)], spawn_size=(40.0, 40.0))
    size = jnp.tile(jnp.array([SIZE]), (4, 1))
    cars = dataclasses.make_dataclass("Cars", ["size"])(size)
    inputs = SpawnInputs(layout, parked_at(), cars=cars)
    pose = jnp.array([[0.0, 0.0, 0.0]] * 4).at[:, 1].add(10.0 * jnp.arange(4) - 10.0)
    waiting = jnp.array([True, False, True, True])

    def place(inputs, placing, agent, key):
        # The x of a start counts the starts made before it; that of agent 3 is taken.
        made = jnp.sum(~placing.waiting)
        x = jnp.where(agent == 3, 0.0, 100.0 * made)
        y = jnp.where(agent == 3, 0.0, 10.0 * agent)
        return placing.set(agent, pose_w=jnp.stack([x, y, 0.0]), goal=7)

    def placed(accept_last):
        waited = jnp.array([0, 0, 5, 2])
        nobody = jnp.zeros(0, jnp.int32)
        placing = start_placing(jnp.arange(4), nobody, pose, waiting, waited)
        how = jax.random.key(0), 3, accept_last
        return jax.device_get(place_waiting(place, inputs, placing, *how))

    after = placed(accept_last=False)
    np.testing.assert_array_equal(after.waiting, [False, False, False, True])
    np.testing.assert_array_equal(after.tries, [1, 0, 1, 3])
    np.testing.assert_array_equal(after.goal, [7, 1, 7, 3])
    assert after.pose_w[2, 0] < after.pose_w[0, 0]  # it had waited longer
    np.testing.assert_array_equal(after.pose_w[3], pose[3])
    at_last = placed(accept_last=True)
    assert not at_last.waiting.any()
    assert at_last.goal[3] == 7


def test_crowded_lane_start_has_the_most_room():
    # A lane of 12 m by 3 m with a long car across it: no start keeps 7 m. Cars whose
    # centres are far apart may still touch, so that centres do not count.
    lane = lot([(0.0, 20.0, 0.0)], spawn_size=(12.0, 3.0))
    lane = lane.replace(spawn_spread=jnp.full(1, 0.1))
    outlines = [[4.0, 2.0], [9.0, 1.0]]
    around = surroundings_of(
        lane, [[0.0, 0.0], [3.0, 1.0]], [False, True], outlines=outlines
    )
    config = SpawnConfig(close_ratio=0.0, min_distance=12.0, num_candidates=8)
    other = polygons(np.array([[3.0, 1.0, 0.0]]), np.array([outlines[1]]))[0]

    def start(key):
        draws = draw_uniform(spawn_shapes(config), key)
        alone, tried = SpawnConfig(close_ratio=0.0, num_candidates=1), []
        for k in range(8):
            one = {name: x[k : k + 1] for name, x in draws.items() if name != "kind"}
            tried.append(random_pose(alone, lane, around, one))
        return random_pose(config, lane, around, draws), jnp.stack(tried)

    for pose, candidates in zip(*many(start, 200), strict=True):
        own, *room = shapely.distance(polygons([pose, *candidates], outlines[0]), other)
        np.testing.assert_allclose(own, max(room), atol=1e-4)


def test_a_car_that_lots_are_not_made_for_starts_without_contact():
    """The compact has room among what stands wherever it may start, the van has not."""
    config = EnvConfig(
        layout="mixture",
        vehicle="van",
        num_agents=2,
        num_parked_cars=8,
        spawn=SpawnConfig(min_distance=0.0, num_candidates=1),
    )
    env = ParkingEnv(config, SlidePhysics())

    def hits(key):
        state, _ = env.reset(key)
        return {kind: hit & state.present for kind, hit in find_hits(state).items()}

    assert not any(hit.any() for hit in many(hits, 250).values())
