import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from helpers.scenes import (
    CAR,
    cars,
    lot,
    moved,
    moved_cars,
    moved_lot,
    overlap_oracle,
    polygons,
)

from carpark_mj.config import EpisodeConfig
from carpark_mj.layouts import make_layout
from carpark_mj.mdp.terminations import find_hits, is_parked, judge

judge_jit = jax.jit(judge, static_argnums=0)
find_hits_jit = jax.jit(find_hits)

WU = 0.5625  # m
BAY_SIZE = (6.0, 3.0)  # a car of 4 x 2 m has 1 m and 0.5 m to spare on each side
TILT = 1e-4  # what the thresholds are probed with, far above float32 rounding

# Pose in the bay's frame (m, m, deg), speed, whether it counts as parked.
CASES = {
    "tanner": [
        ((0.0, 0.0, 0.0), 0.0, True),
        ((1.001 * WU - TILT, 0.0, 0.0), 0.0, True),
        ((1.001 * WU + TILT, 0.0, 0.0), 0.0, False),
        ((0.0, -1.001 * WU + TILT, 0.0), 0.0, True),
        ((0.0, -1.001 * WU - TILT, 0.0), 0.0, False),
        ((0.56, 0.56, 0.0), 0.0, True),  # a square, not a circle
        ((0.0, 0.0, 90.0), 3.0, True),  # any heading, any speed
        ((0.5, -0.5, 45.0), -2.0, True),
    ],
    "strict": [
        ((0.0, 0.0, 0.0), 0.0, True),
        ((0.0, 0.0, 180.0), 0.0, True),  # nose out
        ((1.0 - TILT, 0.5 - TILT, 0.0), 0.0, True),  # in the corner, on the lines
        ((1.0 + TILT, 0.0, 0.0), 0.0, False),
        ((0.0, 0.5 + TILT, 0.0), 0.0, False),
        ((-1.0 - TILT, 0.0, 180.0), 0.0, False),
        ((0.0, 0.0, 4.99), 0.0, True),
        ((0.0, 0.0, 5.01), 0.0, False),
        ((0.0, 0.0, -4.99), 0.0, True),
        ((0.0, 0.0, -5.01), 0.0, False),
        ((0.0, 0.0, 184.99), 0.0, True),
        ((0.0, 0.0, 174.9), 0.0, False),
        ((0.0, 0.0, 90.0), 0.0, False),
        ((0.0, 0.0, 0.0), 0.2 - TILT, True),
        ((0.0, 0.0, 0.0), 0.2 + TILT, False),
        ((0.0, 0.0, 0.0), -0.2 + TILT, True),
        ((0.0, 0.0, 0.0), -0.2 - TILT, False),
        # Turned by 4 deg a corner leaves the lines: 2 sin 4 + cos 4 = 1.137 m half
        # width, 0.363 m to spare.
        ((0.0, 0.362, 4.0), 0.0, True),
        ((0.0, 0.364, 4.0), 0.0, False),
    ],
    "precise": [
        ((0.0, 0.0, 0.0), 0.0, True),
        ((0.0, 0.0, 180.0), 0.0, True),
        ((0.2 - TILT, 0.0, 0.0), 0.0, True),
        ((0.2 + TILT, 0.0, 0.0), 0.0, False),
        ((0.0, -0.2 - TILT, 0.0), 0.0, False),
        ((0.15, 0.15, 0.0), 0.0, False),  # a circle, not a square
        ((0.14, 0.14, 0.0), 0.0, True),
        ((0.0, 0.0, 2.99), 0.0, True),
        ((0.0, 0.0, 3.01), 0.0, False),
        ((0.0, 0.0, -177.01), 0.0, True),
        ((0.0, 0.0, -176.99), 0.0, False),
        ((0.0, 0.0, 0.0), 0.05 - TILT, True),
        ((0.0, 0.0, 0.0), 0.05 + TILT, False),
        ((0.0, 0.0, 0.0), -0.05 - TILT, False),
    ],
}
# The bay lies anywhere and points anywhere; the rules are those of its own frame.
BAYS = [(0.0, 0.0, 0.0), (3.0, -18.0, math.pi / 2), (-7.0, 5.0, 2.5)]


@pytest.mark.parametrize("bay", BAYS)
@pytest.mark.parametrize("rule", sorted(CASES))
def test_each_parked_rule_holds_up_to_its_thresholds_and_no_further(rule, bay):
    local = np.array([pose for pose, _, _ in CASES[rule]])
    local[:, 2] = np.radians(local[:, 2])
    # A pose in the bay's frame is the bay's rigid motion applied to it.
    vehicle = cars(moved(local, bay), speed=[speed for _, speed, _ in CASES[rule]])
    got = is_parked(rule, vehicle, jnp.array(bay), jnp.array(BAY_SIZE))
    expected = np.array([parked for _, _, parked in CASES[rule]])
    wrong = [CASES[rule][k] for k in np.flatnonzero(np.asarray(got) != expected)]
    assert wrong == []


@pytest.mark.parametrize("rule", ["strict", "precise"])
def test_sliding_sideways_counts_as_speed(rule):
    vehicle = cars((0.0, 0.0, 0.0), speed=0.04, sideways=0.3)
    assert not is_parked(rule, vehicle, jnp.zeros(3), jnp.array(BAY_SIZE))


def random_lots(rng, count):
    """Lots of 3 moving agents, 2 parked cars and 3 walls, crowded into 20 m."""

    def poses(*shape):
        return np.float32(rng.uniform([-10, -10, -3.1], [10, 10, 3.1], (*shape, 3)))

    start, end = poses(count, 3), poses(count, 3)
    end = start + 0.15 * (end - start)
    share = np.linspace(0.25, 1.0, 4)[:, None]
    trace = np.float32(start[..., None, :] * (1 - share) + end[..., None, :] * share)
    size = np.float32(rng.uniform((3.0, 1.5), (5.0, 2.0), (count, 3, 2)))
    walls, wall_size = poses(count, 3), rng.uniform(0.5, 4.0, (count, 3, 2))
    return (
        cars(trace[..., -1, :], size=size, trace=trace),
        poses(count, 4),
        walls,
        np.float32(wall_size),
    )


def test_hits_agree_with_shapely_at_every_traced_instant():
    count = 1500
    rng = np.random.default_rng(0)
    vehicle, bays, walls, wall_size = random_lots(rng, count)
    parked_bay = np.array([2, 0])
    parked_size = np.float32([[4.2, 1.8], [4.6, 1.9]])
    template = lot(bays[0], walls[0])

    def hits(vehicle, bay_pose, wall_pose, wall_size):
        layout = template.replace(
            bay_pose=bay_pose, wall_pose=wall_pose, wall_size=wall_size
        )
        return find_hits(layout, vehicle, bay_pose[parked_bay], parked_size)

    got = jax.jit(jax.vmap(hits))(vehicle, bays, walls, wall_size)
    own = np.asarray(vehicle.trace_w), np.asarray(vehicle.size)[:, :, None]

    def check(got, other_pose, other_size, mask=True):
        """The agents' boxes against (lots, 1, others, traces or 1) other boxes."""
        expected, certain = overlap_oracle(
            own[0][:, :, None], own[1][:, :, None], other_pose, other_size
        )
        expected = (expected & mask).any(axis=(2, 3))
        certain = (certain | ~np.asarray(mask)).all(axis=(2, 3))
        np.testing.assert_array_equal(np.asarray(got)[certain], expected[certain])
        assert (~certain).sum() <= 5
        assert 0.1 < expected.mean() < 0.9  # both answers are well represented

    others = ~np.eye(3, dtype=bool)[None, :, :, None]
    check(got[0], own[0][:, None], own[1][:, None], others)
    check(got[1], bays[:, parked_bay][:, None, :, None], parked_size[:, None])
    check(got[2], walls[:, None, :, None], wall_size[:, None, :, None])


def crossing(trace_between):
    """Agent 0 passes through agent 1 (standing) from one instant to the next."""
    x = [-6.0, 0.0, 6.0, 6.0] if trace_between else [6.0, 6.0, 6.0, 6.0]
    moving = [(value, 0.0, 0.0) for value in x]
    standing = [(0.0, 0.0, math.pi / 2)] * 4
    return cars([(6.0, 0.0, 0.0), (0.0, 0.0, math.pi / 2)], trace=[moving, standing])


FAR_LOT = lot([(30.0, 0.0, 0.0), (30.0, 10.0, 0.0), (30.0, 20.0, 0.0)])
NO_CARS = jnp.zeros((0, 3)), jnp.zeros((0, 2))


def test_a_car_that_passes_through_another_between_two_instants_is_caught():
    hit_agent, hit_parked_car, hit_wall = find_hits_jit(
        FAR_LOT, crossing(True), *NO_CARS
    )
    np.testing.assert_array_equal(hit_agent, [True, True])
    assert not (hit_parked_car | hit_wall).any()
    # At the end of the step alone nothing is to be seen.
    hit_agent, _, _ = find_hits_jit(FAR_LOT, crossing(False), *NO_CARS)
    assert not hit_agent.any()


def test_padding_walls_hit_nobody():
    layout = lot([(30.0, 0.0, 0.0)], walls=[(0.0, 0.0, 0.0)])
    vehicle = cars([(0.0, 0.0, 0.0)])
    assert find_hits(layout, vehicle, *NO_CARS)[2].all()
    layout = layout.replace(wall_mask=jnp.zeros(1, bool))
    assert not find_hits(layout, vehicle, *NO_CARS)[2].any()


def test_discs_are_hit_where_shapely_says_and_only_if_they_count():
    rng = np.random.default_rng(3)
    count = 400
    pose = np.float32(rng.uniform((-4, -4, -3), (4, 4, 3), (count, 1, 3)))
    template = lot([(30.0, 0.0, 0.0)], discs=[(1.0, 0.5, 0.3), (-2.0, -1.0, 0.8)])

    def hit(pose, layout):
        return find_hits(layout, cars(pose), *NO_CARS)[2]

    run = jax.jit(jax.vmap(hit, (0, None)))
    centres = shapely.points([(1.0, 0.5), (-2.0, -1.0)])
    own = polygons(pose[:, 0], np.full((count, 2), CAR))
    gap = shapely.distance(own[:, None], centres) - np.array([0.3, 0.8])
    for mask in ([True, True], [True, False], [False, False]):
        layout = template.replace(disc_mask=jnp.array(mask))
        expected = ((gap < 0) & mask).any(axis=1)
        certain = (np.abs(gap) > 1e-4).all(axis=1)
        np.testing.assert_array_equal(
            np.asarray(run(pose, layout))[certain, 0], expected[certain]
        )
    assert 0.2 < (gap < 0).any(axis=1).mean() < 0.8


def judged(vehicle, rule="strict", step=1, active=True, layout=FAR_LOT, goal=None):
    """Events of agents whose goals are bays 0, 1, …, with a parked car in bay 2."""
    count = vehicle.size.shape[0]
    return judge_jit(
        EpisodeConfig(parked_rule=rule, max_steps=10),
        layout,
        vehicle,
        jnp.arange(count) if goal is None else jnp.array(goal),
        layout.bay_pose[jnp.array([2])],
        jnp.array([[4.0, 2.0]]),
        jnp.full(count, step),
        jnp.broadcast_to(jnp.asarray(active), (count,)),
    )


AWAY = (0.0, 0.0, 0.0)
IN_BAY_0 = (30.0, 0.0, 0.0)
ON_THE_PARKED_CAR = (30.0, 20.0, 0.0)


def flags(events):
    """The four exclusive outcomes of every agent, as a word each."""
    names = ("parked", "crashed", "timed_out", "diverged")
    table = np.stack([np.asarray(getattr(events, name)) for name in names], axis=1)
    assert (table.sum(axis=1) <= 1).all()
    np.testing.assert_array_equal(np.asarray(events.done), table.any(axis=1))
    return [names[row.argmax()] if row.any() else "drives on" for row in table]


def test_a_car_standing_in_its_bay_has_parked_and_one_away_drives_on():
    assert flags(judged(cars([IN_BAY_0, AWAY]))) == ["parked", "drives on"]


def test_parking_in_the_bay_of_another_agent_is_no_parking():
    events = judged(cars([IN_BAY_0, AWAY]), goal=[1, 0])
    assert flags(events) == ["drives on", "drives on"]


def test_both_agents_of_a_collision_crash():
    events = judged(crossing(True))
    assert flags(events) == ["crashed", "crashed"]
    np.testing.assert_array_equal(events.hit_agent, [True, True])
    assert not (events.hit_parked_car | events.hit_wall).any()


def test_a_crash_says_what_was_hit():
    layout = FAR_LOT.replace(
        wall_pose=jnp.array([[0.0, 10.0, 0.0]]),
        wall_size=jnp.ones((1, 2)),
        wall_mask=jnp.ones(1, bool),
    )
    events = judged(cars([ON_THE_PARKED_CAR, (0.0, 10.5, 0.0)]), layout=layout)
    assert flags(events) == ["crashed", "crashed"]
    np.testing.assert_array_equal(events.hit_parked_car, [True, False])
    np.testing.assert_array_equal(events.hit_wall, [False, True])
    np.testing.assert_array_equal(events.hit_agent, [False, False])


@pytest.mark.parametrize(("step", "outcome"), [(9, "drives on"), (10, "timed_out")])
def test_an_episode_times_out_at_max_steps_and_no_earlier(step, outcome):
    assert flags(judged(cars([AWAY]), step=step)) == [outcome]


def test_parking_and_crashing_in_the_last_step_are_no_time_out():
    vehicle = cars([IN_BAY_0, ON_THE_PARKED_CAR])
    assert flags(judged(vehicle, step=10)) == ["parked", "crashed"]


@pytest.mark.parametrize(
    ("rule", "outcome"),
    [("strict", "crashed"), ("precise", "crashed"), ("tanner", "parked")],
)
def test_a_car_that_touches_another_on_its_way_into_the_bay(rule, outcome):
    # Agent 0 stands in its bay now; earlier in the step it was on the parked car.
    trace = [[ON_THE_PARKED_CAR, IN_BAY_0], [AWAY, AWAY]]
    events = judged(cars([IN_BAY_0, AWAY], trace=trace), rule=rule)
    assert flags(events) == [outcome, "drives on"]
    np.testing.assert_array_equal(events.hit_parked_car, [outcome == "crashed", False])


@pytest.mark.parametrize("rule", ["strict", "precise", "tanner"])
def test_a_diverged_car_neither_parks_nor_crashes_nor_times_out(rule):
    vehicle = cars([IN_BAY_0, ON_THE_PARKED_CAR], finite=False)
    events = judged(vehicle, rule=rule, step=10)
    assert flags(events) == ["diverged", "diverged"]
    assert not (events.hit_agent | events.hit_parked_car | events.hit_wall).any()


@pytest.mark.parametrize("finite", [True, False])
def test_finished_agents_have_no_events(finite):
    vehicle = cars([IN_BAY_0, ON_THE_PARKED_CAR], finite=finite)
    events = judged(vehicle, step=10, active=False)
    assert flags(events) == ["drives on", "drives on"]
    assert not (events.hit_agent | events.hit_parked_car | events.hit_wall).any()


def test_an_agent_that_hits_a_finished_one_crashes_and_the_finished_one_does_not():
    events = judged(crossing(True), active=jnp.array([True, False]))
    assert flags(events) == ["crashed", "drives on"]


def random_events(rule, motion=None):
    """Events of a batch of random states, their poses moved if asked."""
    rng = np.random.default_rng(1)
    count = 1000
    vehicle, bays, walls, wall_size = random_lots(rng, count)
    # Half of the first agents stand in or almost in their bays.
    near = rng.normal(0, (0.2, 0.2, 0.04), (count, 3))
    pose = np.array(vehicle.pose_w)
    trace = np.array(vehicle.trace_w)
    half = slice(0, count // 2)
    pose[half, 0] = (bays[:, 0] + near)[half]
    trace[half, 0] = pose[half, 0, None]
    speed = rng.normal(0, 0.1, (count, 3))
    finite = rng.uniform(size=(count, 3)) > 0.1
    vehicle = cars(pose, speed, size=vehicle.size, trace=trace, finite=finite)
    step = rng.integers(5, 12, (count, 3))
    active = rng.uniform(size=(count, 3)) > 0.1
    if motion is not None:
        vehicle = moved_cars(vehicle, motion)
        bays, walls = moved(bays, motion), moved(walls, motion)
    template = lot(bays[0], walls[0], bay_size=(6.5, 3.5))

    def one(vehicle, bay_pose, wall_pose, wall_size, step, active):
        layout = template.replace(
            bay_pose=bay_pose, wall_pose=wall_pose, wall_size=wall_size
        )
        return judge(
            EpisodeConfig(parked_rule=rule, max_steps=10),
            layout,
            vehicle,
            jnp.arange(3),
            bay_pose[3:4],
            jnp.array([[4.0, 2.0]]),
            step,
            active,
        )

    return jax.device_get(
        jax.jit(jax.vmap(one))(vehicle, bays, walls, wall_size, step, active)
    )


@pytest.mark.parametrize("rule", ["strict", "precise", "tanner"])
def test_outcomes_exclude_each_other_in_random_states(rule):
    events = random_events(rule)
    outcomes = [events.parked, events.crashed, events.timed_out, events.diverged]
    assert (np.sum(outcomes, axis=0) <= 1).all()
    assert all(flag.sum() >= 10 for flag in outcomes)  # each of them occurs
    hits = events.hit_agent | events.hit_parked_car | events.hit_wall
    np.testing.assert_array_equal(hits, events.crashed)


@pytest.mark.parametrize("rule", ["strict", "precise", "tanner"])
def test_outcomes_do_not_depend_on_the_frame(rule):
    here, there = random_events(rule), random_events(rule, (12.0, -7.0, 0.9))
    for name in ("parked", "crashed", "timed_out", "diverged"):
        differ = (getattr(here, name) != getattr(there, name)).sum()
        # 3000 agents; one may lie within float32 rounding of a threshold.
        assert differ <= 1, name


def test_the_parked_cars_of_a_full_tanner_lot_hit_no_wall_and_not_each_other():
    layout = make_layout("tanner")
    size = jnp.broadcast_to(jnp.array([4.255, 1.799]), (36, 2))
    vehicle = cars(layout.bay_pose, size=size)
    hits = find_hits_jit(layout, vehicle, *NO_CARS)
    assert not np.any(hits)
    moved_layout = moved_lot(layout, (0.1, 0.2, 0.3))
    vehicle = moved_cars(vehicle, (0.1, 0.2, 0.3))
    assert not np.any(find_hits_jit(moved_layout, vehicle, *NO_CARS))


def scaled_hits(scale, gap=1.0):
    """Who hits what with scaled hitboxes: pairs and single cars, all `gap` apart."""
    layout = lot([(100.0, 0.0, 0.0)], walls=[(0.0, 20.0, 0.0)], wall_size=(4.0, 1.0))
    length, width = CAR
    vehicle = cars(
        [
            (0.0, 0.0, 0.0),
            (length + gap, 0.0, 0.0),  # ahead of agent 0
            (30.0, 0.0, 0.0),
            (0.0, 19.5 - gap - width / 2, 0.0),  # beside the wall
        ]
    )
    parked = jnp.array([[30.0, width + gap, 0.0]])  # beside agent 2
    scale = None if scale is None else jnp.float32(scale)
    return np.array(find_hits_jit(layout, vehicle, parked, jnp.array([CAR]), scale))


def test_a_hitbox_scale_multiplies_length_and_width_of_all_cars_and_of_no_wall():
    """A gap of 1 m: closed at 5 / 4 nose to tail, 3 / 2 side by side, 2 at a wall."""
    nothing = np.zeros((3, 4), bool)
    for scale, hit in ((1.24, ()), (1.26, (0, 1)), (1.49, (0, 1)), (1.51, (0, 1, 2))):
        expected = nothing.copy()
        expected[0, [i for i in hit if i < 2]] = True
        expected[1, [i for i in hit if i == 2]] = True
        np.testing.assert_array_equal(scaled_hits(scale), expected, err_msg=f"{scale}")
    assert not scaled_hits(1.99)[2].any()
    assert scaled_hits(2.01)[2].tolist() == [False, False, False, True]


def test_a_hitbox_scale_of_one_changes_nothing():
    for gap in (-0.5, 1e-4, 1.0):
        np.testing.assert_array_equal(scaled_hits(1.0, gap), scaled_hits(None, gap))


def test_scaled_hitboxes_do_not_make_parking_harder():
    layout = lot([(0.0, 0.0, 0.0)], bay_size=(4.2, 2.2))
    events = judge_jit(
        EpisodeConfig(),
        layout,
        cars([(0.0, 0.0, 0.0)]),
        jnp.zeros(1, int),
        *NO_CARS,
        jnp.ones(1, int),
        jnp.ones(1, bool),
        hitbox_scale=jnp.float32(3.0),
    )
    assert events.parked.all()
