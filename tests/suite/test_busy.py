"""The busy cases: what the stored ones are, scripts give cars time to stop."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.sliding import SlidePhysics, start

from carpark_mj.config import EnvConfig, EpisodeConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.movers.scripted import ScriptedBox, ScriptedPerson
from carpark_mj.spawning.reset_options import ResetOptions
from carpark_mj.suite.busy import CART, CASES, GROUPS, HALF_X, BusyAisle
from carpark_mj.suite.evaluation import suite_env
from carpark_mj.suite.levels import find_level, pick_cases
from carpark_mj.vehicle import preset

MM = 1e-3  # m


@pytest.fixture(scope="module")
def cases():
    return pick_cases("busy", CASES)


def test_a_group_has_200_cases_in_which_one_kind_of_thing_moves(cases):
    names, counts = np.unique(cases.kind, return_counts=True)
    assert dict(zip(names, counts, strict=True)) == dict.fromkeys(GROUPS, 200)
    person, box, crowd = cases.start.movers
    moves = np.stack([person.present, box.present, crowd.present.any(axis=1)], axis=1)
    wanted = {"crossing": 0, "dart_out": 0, "backing_out": 1, "cart": 1}
    column = [wanted.get(kind, 2) for kind in cases.kind]
    np.testing.assert_array_equal(moves, np.eye(3, dtype=bool)[column])
    # All of it lies between the car and its goal, which the lot has.
    goal, layouts = np.asarray(cases.start.options.goal)[:, 0], cases.layouts
    rows = np.arange(CASES)
    assert np.asarray(layouts.bay_mask)[rows, goal].all()
    x = np.asarray(layouts.bay_pose)[rows, goal, 0]
    scripted = cases.kind != "crowded_aisle"
    ahead = np.asarray(person.start)[:, 0]
    start = np.asarray(cases.start.options.pose)[:, 0, 0]
    assert ((start + 4.0 < ahead) & (ahead < x))[scripted].all()
    assert ((start > 3.0 - HALF_X - MM) & (start < 4.0 - HALF_X + MM)).all()


def test_the_level_keeps_the_car_and_the_rules_of_the_suite():
    base = suite_env(EnvConfig(), "strict")
    own = find_level("busy").env(base)
    changed = {"layout", "num_parked_cars", "movers", "metrics"}
    for field in dataclasses.fields(base):
        same = getattr(own, field.name) == getattr(base, field.name)
        assert same == (field.name not in changed), field.name
    assert find_level("normal").env(base) is base


def place(mover, way):
    """Where a script is so many seconds after it set out."""
    state = mover.init(jax.random.key(0), None)
    return np.asarray(dataclasses.replace(state, clock=jnp.float32(way)).pose)


def test_scripts_go_straight_slow_down_and_return():
    person = ScriptedPerson(speed=2.0, distance=5.0, direction=np.pi / 2)
    np.testing.assert_allclose(place(person, -1.0), [0, 0, 0])
    np.testing.assert_allclose(place(person, 1.5), [0, 3.0, 0], atol=1e-5)
    np.testing.assert_allclose(place(person, 9.0), [0, 5.0, 0], atol=1e-5)
    cart = ScriptedBox(speed=1.0, slowing=0.25, distance=5.0, size=CART)
    # From 1 m/s at 0.25 m/s² it stops after 2 m and 4 s.
    np.testing.assert_allclose(place(cart, 2.0), [1.5, 0, 0], atol=1e-5)
    np.testing.assert_allclose(place(cart, 60.0), [2.0, 0, 0], atol=1e-5)
    car = ScriptedBox(speed=1.0, distance=3.0, pause=2.0, returns=True)
    np.testing.assert_allclose(place(car, 5.0), [3.0, 0, 0], atol=1e-5)
    np.testing.assert_allclose(place(car, 6.5), [1.5, 0, 0], atol=1e-5)
    np.testing.assert_allclose(place(car, 60.0), [0, 0, 0], atol=1e-5)


def test_the_first_trigger_sets_a_script_out():
    for begins, trigger in (
        (3, {"near": 4.5}),
        (2, {"after": 0.9}),
        (2, {"near": 4.5, "after": 0.9}),
        (1, {"trigger": 6.5}),
    ):
        person = ScriptedPerson(**{"trigger": 0.0, "yields": False} | trigger)
        script, count = person.init(jax.random.key(0), None), 0
        for x in (-7.0, -6.0, -5.0, -4.0, -3.0):
            pose = jnp.array([[x, 0.0, 0.0], [50.0, 0.0, 0.0], [60.0, 0.0, 0.0]])
            script = person.step(jax.random.key(0), script, start(pose=pose)[2], 0.4)
            if script.clock >= 0.0:
                break
            count += 1
        assert count == begins, trigger


@pytest.fixture(scope="module")
def drive():
    """Drives a car along the aisle while a person crosses ahead of it."""
    person = ScriptedPerson(
        start=(0.0, 3.0, 0.0), direction=-np.pi / 2, speed=1.2, trigger=11.0
    )
    config = EnvConfig(
        layout=BusyAisle((7.0, 7.0)),
        num_agents=1,
        num_parked_cars=0,
        movers=(person,),
        episode=EpisodeConfig(respawn=False),
    )
    env = ParkingEnv(config, SlidePhysics())

    @jax.jit
    def run(x, looks, pace=1.0):
        pose = jnp.stack([x, 0.0, 0.0])[None]
        options = ResetOptions(pose=pose, goal=jnp.array([9]))
        state, _ = env.reset_to_layout(
            BusyAisle((7.0, 7.0)).generate(jax.random.key(0)),
            jax.random.key(1),
            None,
            options,
        )

        def step(state, _):
            motion, [group] = state.motion, state.movers.groups
            nose = motion.pose_w[0, 0] + motion.size[0, 0] / 2
            ahead = group.pose_w[0] - jnp.stack([nose, motion.pose_w[0, 1]])
            near = (ahead[0] > -1.0) & (ahead[0] < 2.5) & (jnp.abs(ahead[1]) < 3.0)
            pedal = jnp.where(near & looks, 0.0, pace)
            after, timestep = env.step(state, jnp.stack([0.0, pedal])[None])
            return after, (timestep.events.hit_person[0], group.pose_w[0, 1])

        return jax.lax.scan(step, state, length=60)[1]

    return run


@pytest.mark.parametrize("looks", [True, False])
def test_who_stops_for_people_hits_nobody_and_others_do(drive, looks):
    hits = []
    for x in np.linspace(-12.0, -10.0, 5, dtype=np.float32):
        hit, y = drive(x, looks)
        hits.append(bool(hit.any()))
        assert y[0] == 3.0
        if looks:  # nor does the person wait for ever
            assert y.min() < -1.9
    assert any(hits) != looks


@pytest.mark.parametrize(("gap", "crosses"), [(0.12, False), (0.25, True)])
def test_a_person_passes_before_a_car_that_stands(drive, gap, crosses):
    length = preset(EnvConfig().vehicle).length
    x = np.float32(-ScriptedPerson().size[0] / 2 - gap - length / 2)
    hit, y = drive(x, False, 0.0)
    assert not hit.any()
    assert (y.min() < -1.9) == crosses
