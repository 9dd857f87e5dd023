"""Drivers: rules of the road, worked by hand, and that the attentive never collide."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.lanes import with_lanes
from helpers.scenes import cars
from helpers.states import parked_in, state_of

from carpark_mj.geometry import boxes_overlap
from carpark_mj.geometry.obstacles import Discs, Movers, ObstacleKind
from carpark_mj.layouts import MixtureConfig, build
from carpark_mj.layouts.base import LAYOUTS
from carpark_mj.movers import Drivers, driving
from carpark_mj.movers.traffic import AWAY, DRIVE, SIZE, STAY, track_path
from carpark_mj.obstacles import hit_kinds, make_movers
from carpark_mj.types import NO_BAY

DT = 0.2
LOOKS = Drivers(number=2, attention=1.0, aggressiveness=(0.5, 0.5))
NOBODY = cars(np.array([[500.0, 500.0, 0.0]]))


def in_the_open(poses, sizes, one_way):
    """A lot of two lanes, without bays."""
    lot = with_lanes(build.lanes(poses, sizes, one_way=one_way))
    return lot.replace(bay_mask=jnp.zeros(1, bool), extent=jnp.array([60.0, 60.0]))


TWO_WAY = in_the_open([(0, 0, 0), (0, 50, 0)], [(100, 7), (20, 7)], False)
CROSSING = in_the_open([(0, 0, 0), (0, 0, np.pi / 2)], (100, 3), True)


@jax.jit
def roll(drivers, lot):
    """(150, n) poses, speeds and phases of drivers in a lot that stands still."""

    def step(state, key):
        state = LOOKS.step(key, state, lot, DT)
        return state, (state.centre, state.speed, state.phase)

    keys = jax.random.split(jax.random.key(0), 150)
    return jax.lax.scan(step, drivers, keys)[1]


def placed(layout, track, way):
    """Drivers at rest on tracks (2,), after ways (2,) [m]; their rear axles."""
    state = LOOKS.init(jax.random.key(1), layout)
    track, way = jnp.array(track, jnp.int32), jnp.array(way, jnp.float32)
    path = track_path(state.tracks, track)
    return dataclasses.replace(
        state,
        path=path,
        pose=path.at(way[:, None])[:, 0],
        way=way,
        track=track,
        next_track=track,
        phase=jnp.full(2, DRIVE, jnp.int32),
        attentive=jnp.ones(2, bool),
        aggressiveness=jnp.full(2, 0.5),
    )


def driven(layout, track, way, motion=NOBODY, person=(500.0, 500.0)):
    rest = jnp.array([0.3]), jnp.zeros((1, 2)), jnp.ones(1, bool)
    disc = Discs(jnp.array([person]), *rest, kind=ObstacleKind.PERSON)
    movers = Movers((), ((disc,),))
    lot = state_of(layout, motion, NO_BAY, movers=movers)
    return [np.asarray(x) for x in roll(placed(layout, track, way), lot)]


def test_the_equilibrium_gap_is_that_of_the_model():
    # (1 + 2 * 1.5) / sqrt(1 - (2 / 3)^4) = 4.4653 m at 2 of 3 m/s behind an equal.
    values = {"wanted": 3.0, "headway": 1.5, "accel": 1.0}
    rate = driving.idm_acceleration(2.0, gap=4.46525, leader_speed=2.0, **values)
    assert float(rate) == pytest.approx(0.0, abs=1e-4)
    for speed, expected in ((0.0, 1.0), (3.0, 0.0)):
        found = driving.idm_acceleration(speed, gap=jnp.inf, leader_speed=0.0, **values)
        assert float(found) == expected


def test_they_keep_right_and_follow_at_the_models_gap():
    pose, speed, _ = driven(TWO_WAY, [0, 2], [4.0, 4.0])  # against each other
    for car, side in ((0, -1.0), (1, 1.0)):
        np.testing.assert_allclose(pose[:100, car, 1], side * 1.75, atol=0.05)
    assert np.ptp(pose[:100, 0, 0]) > 30.0
    pose, speed, _ = driven(TWO_WAY, [0, 0], [12.0, 4.0])
    follows = slice(40, 80)  # both at the wanted speed, 2.25 m/s: the gap only grows
    gap = pose[follows, 0, 0] - pose[follows, 1, 0] - SIZE[0]
    assert (np.diff(gap) > -1e-3).all()
    assert gap.min() > driving.JAM_GAP + 1.3 * speed[follows].mean()


@pytest.mark.parametrize("who", ["person", "car"])
def test_they_stop_for_who_is_in_their_lane(who):
    car = {"motion": cars(np.array([[0.0, -1.75, 1.0]]))}
    there = {"person": (0.0, -1.75)} if who == "person" else car
    pose, speed, _ = driven(TWO_WAY, [0, 2], [20.0, 20.0], **there)
    assert speed[:20, 0].max() > 1.5
    assert speed[-1, 0] < 0.05
    front = pose[-1, 0, 0] + SIZE[0] / 2
    reach = 0.3 if who == "person" else 2.0 * np.cos(1.0) + np.sin(1.0)
    assert driving.JAM_GAP - 0.2 < -reach - front < driving.JAM_GAP + 1.2
    assert pose[-1, 1, 0] < -10.0  # nobody is in the other's


@pytest.mark.parametrize("east", [0, 1])
def test_they_yield_to_the_right(east):
    """The car that goes north comes from the right of the one that goes east."""
    track = [0, 1] if east == 0 else [1, 0]
    pose, _, _ = driven(CROSSING, track, [30.0, 30.0])
    passed = np.argmax(pose[:, east, 0] > 0.0), np.argmax(pose[:, 1 - east, 1] > 0.0)
    assert 0 < passed[1] < passed[0]
    own, other = pose[:, 0], pose[:, 1]
    assert not boxes_overlap(own, SIZE, other, SIZE).any()
    # But who is further in goes first.
    way = [48.0, 30.0] if east == 0 else [30.0, 48.0]
    pose, _, _ = driven(CROSSING, track, way)
    assert np.argmax(pose[:, east, 0] > 0.0) < np.argmax(pose[:, 1 - east, 1] > 0.0)


LOTS, STEPS = 14, 600  # two minutes each
NAMES = ("angled", "dead_end", "garage_row", "lot", "square", "street")
FAMILIES = MixtureConfig(tuple(LAYOUTS[name] for name in (*NAMES, "street_parallel")))


@pytest.fixture(scope="module")
def traffic():
    """Five drivers in lots of all families, two thirds full."""
    [mover] = make_movers(["drivers:number=5,stay=2..8,attention=1"])
    assert mover == Drivers(number=5, attention=1.0, stay=(2.0, 8.0))
    assert ObstacleKind.DRIVER in hit_kinds(["drivers"])

    def one(key):
        keys = jax.random.split(key, 4)
        layout = FAMILIES.generate(keys[0])
        score = jax.random.uniform(keys[1], layout.bay_mask.shape)
        full = layout.bay_mask & (score < 0.6)
        bay = jnp.arange(full.shape[0])
        parked = parked_in(layout, bay)
        parked = parked.replace(bay=jnp.where(full, bay, NO_BAY).astype(jnp.int32))
        lot = state_of(layout, NOBODY, NO_BAY, parked_cars=parked)

        def step(state, key):
            state = mover.step(key, state, lot, DT)
            centre = state.centre
            hit = boxes_overlap(centre[:, None], SIZE, centre, SIZE)
            there = state.present
            hit = hit & there & there[:, None] & ~jnp.eye(5, dtype=bool)
            walls = boxes_overlap(
                centre[:, None], SIZE, layout.wall_pose, layout.wall_size
            )
            cars = boxes_overlap(centre[:, None], SIZE, parked.pose_w, SIZE)
            still = (walls & layout.wall_mask).any(1) | (cars & full).any(1)
            return state, (hit.any(1), still & there, state.phase, centre)

        begin = mover.init(keys[2], layout)
        return jax.lax.scan(step, begin, jax.random.split(keys[3], STEPS))[1]

    run = jax.jit(jax.vmap(one))
    return jax.device_get(run(jax.random.split(jax.random.key(2), LOTS)))


def test_attentive_drivers_never_collide(traffic):
    hit, still, phase, centre = traffic
    assert not hit.any()
    assert not still.any()
    assert np.isfinite(centre).all()
    assert (phase == STAY).any()
    assert (phase != AWAY).mean() > 0.5
    assert {*np.unique(phase)} == {0, 1, 2, 3, 4}  # they do all that drivers do
    moved = np.linalg.norm(np.diff(centre[..., :2], axis=1), axis=-1)
    in_lot = (phase[:, 1:] != AWAY) & (phase[:, :-1] != AWAY)
    assert moved[in_lot].max() < 4.0 * DT  # nobody jumps
