"""Cars of several kinds in one lot: they fit where they are, and drive as alone."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from carpark_mj.mdp.spawning.respawn import first_poses, renew
from helpers.scenes import SlidePhysics, check_occupancy, fields_of, placed

from carpark_mj.config import (
    Distribution,
    EnvConfig,
    EpisodeConfig,
    FleetConfig,
    JitterConfig,
    ObservationConfig,
    RandomizationConfig,
    SimConfig,
    SpawnConfig,
)
from carpark_mj.env import ParkingEnv
from carpark_mj.fleet.randomization import make_fleet
from carpark_mj.geometry import box_inside
from carpark_mj.layouts import build, mixture
from carpark_mj.layouts.lot_config import LotConfig
from carpark_mj.mdp.goals import Occupancy, evolve, new_goal
from carpark_mj.mdp.parked_cars import AWAY, SLACK
from carpark_mj.observations import observation_size
from carpark_mj.physics.mjx import MjxPhysics
from carpark_mj.policy.runs import from_dict
from carpark_mj.vehicle import PRESETS, make_vehicle

AGENTS, PARKED = ("city", "suv", "van"), ("city", "sedan", "van")
CONFIG = EnvConfig(
    num_agents=4,
    num_parked_cars=20,
    occupancy=(0.05, 0.5),
    fleet=FleetConfig(AGENTS, (1.0, 1.0, 2.0), PARKED),
    jitter=JitterConfig(
        along=(-0.6, 0.3), across=(-0.4, 0.4), heading=(-0.1, 0.2), scale=(0.95, 1.02)
    ),
    observation=ObservationConfig(tracked_parked_cars=4),
)
KEYS, LOTS = 1000, 16

# Bays of every kind: for all, for all but vans, for city cars only, and parallel ones.
BAY_SIZES = [(5.3, 2.5)] * 14 + [(4.8, 2.4)] * 12 + [(3.9, 2.0)] * 8 + [(6.2, 2.0)] * 6


def mixed_lot():
    """Forty bays along two sides of a field on which cars spawn, 12 m from them."""
    x = np.linspace(-60, 60, 20)
    sides = [[(a, y, math.copysign(math.pi / 2, -y)) for a in x] for y in (-20, 20)]
    pose = np.concatenate(sides).astype(np.float32)
    order = np.random.default_rng(0).permutation(40)
    return build.assemble(
        (70.0, 30.0),
        build.bays(jnp.asarray(pose), jnp.array(BAY_SIZES)[order]),
        build.walls(jnp.array([[0.0, 29.0, 0.0]]), (140.0, 1.0)),
        build.spawns(jnp.zeros((1, 3)), (120.0, 10.0), np.pi),
    )


LAYOUT = mixed_lot()


@pytest.fixture(scope="module")
def env():
    return ParkingEnv(CONFIG, SlidePhysics())


@pytest.fixture(scope="module")
def started(env):
    """A thousand lots, just reset, and their observations."""
    reset = jax.jit(jax.vmap(lambda key: env.reset_to_layout(LAYOUT, key)))
    return reset(jax.random.split(jax.random.key(0), KEYS))


def check_lots(env, state):
    """Asserts of lots that everybody fits where he is or heads for."""
    state = jax.tree.map(np.asarray, state.replace(key=None))
    goal, bay = state.occupancy.goal, state.occupancy.parked_bay
    num_bays = LAYOUT.num_bays
    here = bay < num_bays
    # Absent cars count as bays of their own, so that all held bays must differ.
    own = num_bays + np.arange(bay.shape[-1])
    every = np.ones((*goal.shape[:-1], num_bays + bay.shape[-1]), bool)
    check_occupancy(goal, np.where(here, bay, own), every)
    size = np.asarray(LAYOUT.bay_size)
    slack = SLACK["strict"]
    assert (state.vehicle.size + slack <= size[goal] + 1e-5).all()
    parked_bay = np.where(here, bay, 0)
    fit = (state.parked_size <= size[parked_bay]).all(axis=-1)
    assert fit[here].all()
    pose = np.asarray(jax.vmap(env.parked_pose)(state))
    inside = box_inside(
        pose,
        state.parked_size,
        np.asarray(LAYOUT.bay_pose)[parked_bay],
        size[parked_bay] + 4e-4,  # float32 at 60 m
    )
    assert np.asarray(inside)[here].all()
    assert (pose[..., 0] >= AWAY)[~here].all()
    return here


def test_a_thousand_lots_start_with_everybody_where_he_fits(env, started):
    state, observation = started
    assert np.isfinite(observation).all()
    here = check_lots(env, state)
    # From 0.05 to 0.5 of 40 bays, each number as likely: 53 of a thousand.
    count = np.bincount(here.sum(axis=1), minlength=21)
    assert count.size == 21
    assert count[:2].sum() == 0
    assert count[2:].min() > 25  # 4 deviations


def kinds(size, names):
    """Index of the preset of footprints (..., 2), by their proportions."""
    shape = np.array([PRESETS[n].length / PRESETS[n].width for n in names])
    ratio = np.asarray(size[..., 0] / size[..., 1])
    return np.abs(ratio[..., None] - shape).argmin(axis=-1)


def test_presets_are_drawn_by_weight(started):
    state, _ = started
    # Vans find room in 20 of 40 bays, which four agents cannot all take: 1, 1, 2.
    share = np.bincount(kinds(state.vehicle.size, AGENTS).ravel(), minlength=3) / 4000
    np.testing.assert_allclose(share, [0.25, 0.25, 0.5], atol=0.035)  # 5 deviations
    here = np.asarray(state.occupancy.parked_bay) < LAYOUT.num_bays
    drawn = kinds(state.parked_size, PARKED)[here]
    assert np.bincount(drawn, minlength=3).min() > 0.25 * here.sum()


def test_jitter_fills_its_ranges_and_stays_in_them(started):
    state, _ = started
    wish = np.asarray(state.parked_offset).reshape(-1, 3)
    low, high = np.array([(-0.6, 0.3), (-0.4, 0.4), (-0.1, 0.2)]).T
    assert (wish >= low - 1e-6).all()
    assert (wish <= high + 1e-6).all()
    np.testing.assert_allclose(wish.min(axis=0), low, atol=0.01)
    np.testing.assert_allclose(wish.max(axis=0), high, atol=0.01)
    size = np.asarray(state.parked_size)
    presets = np.array([(PRESETS[n].length, PRESETS[n].width) for n in PARKED])
    scale = size / presets[kinds(size, PARKED)]
    np.testing.assert_allclose(scale[..., 0], scale[..., 1], rtol=1e-5)
    np.testing.assert_allclose([scale.min(), scale.max()], [0.95, 1.02], atol=1e-3)


def test_absent_parked_cars_are_not_seen_and_the_others_as_they_stand(env, started):
    state, observation = started
    named = fields_of(observation, env.config.observation)
    present = sum(named[f"parked_{k}_present"][:, 0, 0] for k in range(4))
    here = np.asarray(state.occupancy.parked_bay) < LAYOUT.num_bays
    np.testing.assert_array_equal(present, np.minimum(here.sum(axis=1), 4))
    gap = np.linalg.norm(
        np.asarray(jax.vmap(env.parked_pose)(state))[..., :2]
        - np.asarray(state.vehicle.pose_w)[:, :1, :2],
        axis=-1,
    )
    seen = np.linalg.norm(named["parked_0_position"][:, 0] * 20.0, axis=-1)
    np.testing.assert_allclose(seen, gap.min(axis=1), atol=1e-4)
    nearest = np.asarray(state.parked_size)[np.arange(KEYS), gap.argmin(axis=1)]
    np.testing.assert_allclose(named["parked_0_size"][:, 0] * 5.0, nearest, atol=1e-5)


@pytest.fixture(scope="module")
def step(env):
    return jax.jit(jax.vmap(env.step))


@pytest.fixture(scope="module")
def driven(env, started, step):
    """Thirty steps in which episodes end by chance, a third of them by parking."""
    state = jax.tree.map(lambda x: x[:LOTS], started[0])
    rng, states = np.random.default_rng(0), []
    for _ in range(30):
        end = rng.choice(3, (LOTS, 4), p=(0.5, 0.25, 0.25))
        last = env.config.episode.max_steps
        goal = np.asarray(LAYOUT.bay_pose)[np.asarray(state.occupancy.goal)]
        pose = np.where((end == 2)[..., None], goal, state.vehicle.pose_w)
        before = placed(env, state, pose).replace(
            step=jnp.asarray(np.where(end == 1, last, 0), jnp.int32)
        )
        state, timestep = step(before, jnp.zeros((LOTS, 4, 2)))
        states.append(
            jax.device_get(
                (before.replace(key=None), timestep, state.replace(key=None))
            )
        )
    assert step._cache_size() == 1
    return states


def test_everybody_still_fits_after_cars_have_come_and_gone(env, driven):
    parked = sum(int(t.events.parked.sum()) for _, t, _ in driven)
    assert parked > 200
    for before, _, after in driven:
        check_lots(env, after)
        # The parked cars of a lot stay what they are, however they move.
        np.testing.assert_array_equal(after.parked_size, before.parked_size)
        here = [x.occupancy.parked_bay < LAYOUT.num_bays for x in (before, after)]
        np.testing.assert_array_equal(*here)


def test_agents_change_cars_when_they_respawn_and_only_then(driven):
    seen, changed = set(), 0
    for before, timestep, after in driven:
        done = timestep.events.done
        for old, new in zip(
            jax.tree.leaves(before.physics.vehicle),
            jax.tree.leaves(after.physics.vehicle),
            strict=True,
        ):
            np.testing.assert_array_equal(old[~done], new[~done])
        changed += (before.vehicle.size != after.vehicle.size).any(-1)[done].sum()
        seen |= set(kinds(after.vehicle.size, AGENTS)[done])
        # Whoever finds no bay for his new car keeps goal and car; few do here.
        same = (before.occupancy.goal == after.occupancy.goal) & done
        assert (before.vehicle.size == after.vehicle.size)[same].all()
    assert seen == {0, 1, 2}
    assert changed > 200


# Five bays in a row, 20 m apart; cars 0 and 1 fit in the first three and in all.
ROW = build.assemble(
    (100.0, 40.0),
    build.bays(jnp.array([(20.0 * k, 30.0, 1.57) for k in range(5)]), (5.0, 2.5)),
    build.spawns(jnp.zeros((1, 3)), (10.0, 10.0), np.pi),
)
FITS = jnp.array([[True, True, True, False, False], [True] * 5])


def row(goal, parked_bay):
    return Occupancy(jnp.array([goal], jnp.int32), jnp.array(parked_bay, jnp.int32))


def test_the_farthest_car_that_fits_moves_to_where_an_agent_has_parked():
    xy = jnp.array([[100.0, 30.0]])
    agent, parked = jnp.array(0), jnp.array(True)
    # Car 0 is farther away in both cases and fits in bay 2 only.
    for goal, expected in ((2, [2, 1]), (3, [0, 3])):
        after = evolve(ROW, row(goal, [0, 1]), agent, xy, parked, FITS)
        np.testing.assert_array_equal(after.parked_bay, expected)
    # Neither an unfit car nor one that the lot has not comes.
    for cars in ([0, 5], [5, 5]):
        after = evolve(ROW, row(3, cars), agent, xy, parked, FITS)
        np.testing.assert_array_equal(after.parked_bay, cars)


def test_a_new_goal_fits_and_cars_make_way_to_bays_they_fit_in():
    goal_bays = jnp.array([True, True, False, True, True])
    xy, keys = jnp.array([[0.0, -30.0]]), jax.random.split(jax.random.key(0), 300)

    def drawn(before, parked_fits):
        draw = jax.jit(
            jax.vmap(
                lambda key: new_goal(
                    ROW, before, jnp.array(0), xy, 5.0, key, goal_bays, parked_fits
                )
            )
        )
        after = jax.device_get(draw(keys))
        return after.goal[:, 0], after.parked_bay

    # The old goal is 4, where car 0 does not fit: it makes way to 2 from 0 and 1.
    goal, bay = drawn(row(4, [0, 1]), FITS)
    assert set(goal) == {0, 1, 3}
    assert set(bay[goal == 0, 0]) == {2}
    assert set(bay[goal == 1, 1]) == {4}
    np.testing.assert_array_equal(bay[goal == 3], [[0, 1]] * (goal == 3).sum())
    # With 1 and 2 taken car 0 has nowhere to go, and its bay cannot be a goal.
    goal, _ = drawn(row(4, [0, 1, 2]), jnp.concatenate([FITS, FITS[1:]]))
    assert set(goal) == {1, 3}


def test_an_agent_for_whose_new_car_there_is_no_bay_keeps_its_goal():
    """It has parked, yet no car comes to its bay; where there is a bay, one comes."""

    def renewed(goal_bays):
        occupancy, _ = renew(
            SpawnConfig(),
            ROW,
            row(0, [1, 2]),
            jnp.zeros((1, 3)),
            jnp.array([True]),
            jnp.array([True]),
            jax.random.key(0),
            (goal_bays, FITS),
            lambda *_: None,
        )
        return occupancy

    renewed = jax.jit(renewed)
    nowhere = renewed(jnp.array([[True, False, False, False, False]]))
    np.testing.assert_array_equal(nowhere.goal, [0])
    np.testing.assert_array_equal(nowhere.parked_bay, [1, 2])
    somewhere = renewed(jnp.array([[True, False, False, False, True]]))
    np.testing.assert_array_equal(somewhere.goal, [4])
    assert 0 in somewhere.parked_bay


def test_agents_see_what_they_drive_only_with_a_fleet(env, started):
    state, observation = started
    named = fields_of(observation, env.config.observation)
    cars = state.physics.vehicle
    np.testing.assert_allclose(named["own_size"] * 5.0, cars.size, atol=1e-5)
    for index, name in enumerate(AGENTS):
        mine = kinds(state.vehicle.size, AGENTS) == index
        params = PRESETS[name]
        radius = params.wheelbase / math.tan(params.max_steering)
        expected = (params.wheelbase, params.centre_offset, radius)
        fields = ("own_wheelbase", "own_rear_axle", "own_turning_radius")
        for field, value in zip(fields, expected, strict=True):
            np.testing.assert_allclose(
                np.asarray(named[field])[mine] * 5.0, value, rtol=1e-5
            )
    alike = EnvConfig(fleet=FleetConfig(parked_cars=PARKED))
    mixed = EnvConfig(fleet=FleetConfig(AGENTS))
    sizes = [observation_size(x.observation) for x in (EnvConfig(), alike, mixed)]
    assert sizes == [59, 59, 64]


def test_a_collision_is_of_the_own_footprint(env, started, step):
    """A wall 2.1 m ahead of the centre: 1.77 m of city car, 2.28 of SUV."""
    state = jax.tree.map(lambda x: x[:LOTS], started[0])
    wall = jnp.broadcast_to(jnp.array([[0.0, 2.6, 0.0]]), state.layout.wall_pose.shape)
    pose = jnp.array([[20.0 * k, 0.0, math.pi / 2] for k in range(4)])
    state = placed(env, state, jnp.broadcast_to(pose, (LOTS, 4, 3)))
    state = state.replace(layout=state.layout.replace(wall_pose=wall))
    _, timestep = step(state, jnp.zeros((LOTS, 4, 2)))
    driven = kinds(state.vehicle.size, AGENTS)
    assert set(driven.ravel()) == {0, 1, 2}
    np.testing.assert_array_equal(timestep.events.hit_wall, driven > 0)


def test_a_van_does_not_spawn_across_a_lane_that_is_too_narrow_for_it(env):
    walls = jnp.array([[0.0, y, 0.0] for y in (-2.0, 2.0)])
    layout = build.assemble(
        (70.0, 40.0),
        build.bays(jnp.array([[0.0, 30.0, 0.0]]), (6.0, 3.0)),
        build.walls(walls, (100.0, 0.2)),
        build.spawns(jnp.zeros((1, 3)), (60.0, 0.2), np.pi),
    )
    size = jnp.array([[PRESETS["van"].length, PRESETS["van"].width]])
    blocked = env.fleet.blocked(layout, size, size, jnp.zeros((0, 2)), None)

    def spawn(key):
        return first_poses(SpawnConfig(), layout, row(0, []), key, blocked)

    pose = jax.jit(jax.vmap(spawn))(jax.random.split(jax.random.key(0), 300))
    x, y, yaw = np.asarray(pose)[:, 0].T
    length, width = np.asarray(size)[0]
    reach = (length * np.abs(np.sin(yaw)) + width * np.abs(np.cos(yaw))) / 2
    # Of 16 headings each 31 % fit: 1 in 400 lots has none.
    assert (np.abs(y) + reach > 1.9).mean() < 0.02
    assert np.ptp(x) > 40


@pytest.fixture(scope="module")
def circles():
    """Radius of the rear axle on full lock: a mixed batch, and each preset alone."""
    physics = MjxPhysics(SimConfig())
    names = list(PRESETS)
    cars = [make_vehicle(PRESETS[name]) for name in names]

    @jax.jit
    def drive(fleet):
        state = physics.init(jnp.zeros((len(names), 3)), fleet)
        controls = jnp.tile(jnp.array([1.0, 0.25]), (len(names), 1))

        def step(state, _):
            state = physics.step(state, controls)
            return state, physics.read(state)

        _, motion = jax.lax.scan(step, state, None, length=30)
        return motion.pose_w, motion.speed[-1] / motion.yaw_rate[-1]

    def together(*members):
        return jax.device_get(drive(jax.tree.map(lambda *x: jnp.stack(x), *members)))

    mixed = together(*cars)
    alone = [together(*[car] * len(names)) for car in cars]
    return names, mixed, alone


def test_cars_of_a_mixed_batch_turn_as_each_does_alone(circles):
    names, mixed, alone = circles
    for k, name in enumerate(names):
        np.testing.assert_allclose(mixed[0][:, k], alone[k][0][:, 0], atol=1e-4)
        assert mixed[1][k] == pytest.approx(alone[k][1][0], abs=1e-4), name
        params = PRESETS[name]
        # Tyres slip a little: 0.2 to 1.2 % of the kinematic radius were measured.
        kinematic = params.wheelbase / math.tan(params.max_steering)
        assert mixed[1][k] == pytest.approx(kinematic, rel=0.02), name
    assert len(set(np.round(mixed[1], 2))) == len(names)


def test_randomization_varies_about_each_agents_own_car(env):
    random = RandomizationConfig(mass=Distribution(width=0.1))
    nominal, key = env.fleet.draw_agents(jax.random.key(1))
    cars = make_fleet(random, nominal, 4, key)
    assert len(set(np.asarray(nominal.mass))) > 1
    ratio = np.asarray(cars.mass / nominal.mass)
    assert len(set(ratio)) == 4
    assert (np.abs(ratio - 1.0) <= 0.1 + 1e-5).all()
    np.testing.assert_array_equal(cars.wheelbase, nominal.wheelbase)


def test_without_a_fleet_lots_are_drawn_as_before_there_was_one():
    """Numbers of the commit before fleets: one start, and all respawning thrice."""
    env = ParkingEnv(EnvConfig(num_agents=3, num_parked_cars=6), SlidePhysics())
    state, _ = jax.jit(env.reset)(jax.random.key(3))
    assert state.parked_offset is None
    np.testing.assert_array_equal(state.occupancy.goal, [0, 33, 14])
    np.testing.assert_array_equal(state.occupancy.parked_bay, [5, 17, 18, 6, 20, 7])
    pose = np.float32(
        [
            [2.508445, -5.2641573, -2.4225798],
            [-11.513852, -4.9285283, -1.5336161],
            [11.427944, 3.1760793, 0.25358534],
        ]
    )
    np.testing.assert_array_equal(state.vehicle.pose_w, pose)
    step, over = jax.jit(env.step), jnp.full(3, 200, jnp.int32)
    for _ in range(3):
        state, _ = step(state.replace(step=over), jnp.zeros((3, 2)))
    np.testing.assert_array_equal(state.occupancy.goal, [0, 28, 10])
    np.testing.assert_array_equal(state.occupancy.parked_bay, [33, 17, 18, 6, 20, 7])
    pose = np.float32(
        [
            [4.2860045, -5.3582816, -0.34410906],
            [-11.035129, -0.3822224, 1.1468709],
            [0.3414365, 8.075193, 0.026807308],
        ]
    )
    np.testing.assert_array_equal(state.vehicle.pose_w, pose)
    key = jax.random.key_data(state.key)
    np.testing.assert_array_equal(key, np.uint32([2010313990, 928668099]))


BAD_CONFIGS = [
    (lambda: FleetConfig(("city",), (1.0, 2.0)), r"agent_weights must be one for each"),
    (lambda: FleetConfig(("city",), (-1.0,)), r"agent_weights must be positive"),
    (lambda: FleetConfig(parked_weights=(1.0,)), r"parked_weights .* of the 0 presets"),
    (lambda: JitterConfig(along=(0.2, -0.2)), r"jitter.along must be a lowest and"),
    (lambda: JitterConfig(heading=(0.0, 2.0)), r"jitter.heading .* within \[-1.571"),
    (lambda: JitterConfig(scale=(0.0, 1.0)), r"jitter.scale .* within \[0.5, 2\]"),
    (lambda: JitterConfig(across=(0.0, math.nan)), r"jitter.across must be"),
    (lambda: EnvConfig(occupancy=(0.2, 1.2)), r"occupancy .* within \[0, 1\]"),
]
# One-way aisles into which the compact, but not the van backs from a bay of 2.4 m.
NARROW = LotConfig(
    two_way=False,
    bay_width=(2.4, 2.4),
    bay_length=(5.2, 5.2),
    extra_aisle=(-3.0, -2.69),
)
BAD_ENVIRONMENTS = [
    (
        {"fleet": FleetConfig(("lorry",))},
        r"unknown vehicle 'lorry'; choose from \['city'",
    ),
    ({"fleet": FleetConfig(parked_cars=("bus",))}, r"unknown vehicle 'bus'"),
    (
        {"layout": "compact", "fleet": FleetConfig(("city", "van"))},
        r"fleet.agents: the van, 4.90 m x 1.90 m, fits with 0.1 m to spare in no bay",
    ),
    (
        {
            "layout": "street",
            "num_parked_cars": 1,
            "jitter": JitterConfig(scale=(1, 2)),
        },
        r"parked cars: the compact, 8.51 m x 3.60 m, fits with 0 m to spare in no bay",
    ),
    (
        {"layout": NARROW, "fleet": FleetConfig(("city", "van"))},
        r"the van needs an aisle of 4.74 m .* 2.40 m wide .* up to 4.63 m wide",
    ),
    ({"occupancy": (0.1, 0.9)}, r"needs num_parked_cars of at least 32, not 16"),
    (
        {"physics": "scene", "fleet": FleetConfig(("van",))},
        r"scene physics has cars of one",
    ),
]


@pytest.mark.parametrize(("make", "message"), BAD_CONFIGS)
def test_impossible_settings_are_refused(make, message):
    with pytest.raises(ValueError, match=message) as refusal:
        make()
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(("change", "message"), BAD_ENVIRONMENTS)
def test_impossible_fleets_are_refused_at_construction(change, message):
    with pytest.raises(ValueError, match=message) as refusal:
        ParkingEnv(EnvConfig(**change))
    assert "\n" not in str(refusal.value)


def test_a_car_that_turns_wide_is_refused_only_where_it_gets_into_no_bay():
    def make(layout, vehicle="van", physics="mjx"):
        config = EnvConfig(
            layout=layout, num_parked_cars=4, physics=physics, vehicle=vehicle
        )
        return ParkingEnv(config, SlidePhysics())

    with pytest.raises(ValueError, match="the van needs an aisle"):
        make(NARROW)
    make(NARROW, "suv")
    # One member is enough, or one of the widths that the aisles may have.
    make(mixture((NARROW, "street")))
    make(dataclasses.replace(NARROW, extra_aisle=(-3.0, -2.5)))
    make(NARROW, physics="grid")


def test_the_rule_in_force_decides_which_bays_a_van_can_aim_at():
    fleet = FleetConfig(("van",))
    config = EnvConfig(layout="compact", num_parked_cars=4, fleet=fleet)
    for rule in ("precise", "tanner"):
        episode = EpisodeConfig(parked_rule=rule)
        ParkingEnv(dataclasses.replace(config, episode=episode), SlidePhysics())
    with pytest.raises(ValueError, match=r"0\.1 m to spare"):
        ParkingEnv(config, SlidePhysics())


def test_a_fleet_has_flags_and_survives_its_config_file():
    import tyro

    flags = "--fleet.agents city suv --jitter.along -0.3 0.3 --occupancy 0.2 0.4"
    config = tyro.cli(EnvConfig, args=flags.split())
    assert config.fleet.agents == ("city", "suv")
    assert config.jitter.along == (-0.3, 0.3)
    assert config.occupancy == (0.2, 0.4)
    assert config.observation.own_car
    for kept in (config, CONFIG):
        assert from_dict(EnvConfig, dataclasses.asdict(kept)) == kept
