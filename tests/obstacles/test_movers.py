"""Movers: how they go on and what they must be; the example, a cart on a rail."""

import dataclasses
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.programs import ROOT
from helpers.registering import restore_after
from helpers.scenes import cars, lot
from helpers.sliding import SlidePhysics, placed
from helpers.states import any_hit, state_of

from carpark_mj import extensions
from carpark_mj.config import (
    MOVERS,
    EnvConfig,
    MetricsConfig,
    Mover,
    ObstacleKind,
    RayConfig,
    SpawnConfig,
)
from carpark_mj.env import ParkingEnv
from carpark_mj.geometry import obstacles as near
from carpark_mj.geometry.obstacles import Boxes, Discs, Movers
from carpark_mj.mdp.collisions import find_hits
from carpark_mj.observations import ContinuousObservation
from carpark_mj.obstacles import (
    begin_movers,
    hit_kinds,
    make_movers,
    step_movers,
    trace_still,
)
from carpark_mj.policy.runs import from_dict
from carpark_mj.scene.build import drivable_scene
from carpark_mj.vehicle import COMPACT

LOT = lot([(30.0, 0.0, 0.0)])
KEY = jax.random.key(0)


@dataclasses.dataclass(frozen=True)
class Hands(Mover):
    """What a test makes of the hands of a clock: a box and two discs.

    Its state counts the steps; `faults` replace what it makes in the second one.
    """

    faults: tuple = ()
    mover: str = "hands"

    def init(self, key, layout):
        return dict(self.faults).get("init", jnp.int32(0))

    def step(self, key, state, lot, dt):
        return dict(self.faults).get("state", state + 1)

    def obstacles(self, state):
        made = dict(self.faults).get("obstacles")
        if made is not None:
            return made(state)
        pose = jnp.array([[3.0 * state, 0.0, 3.0 - state]])
        box = Boxes(pose, jnp.array([[2.0, 1.0]]))
        there = jnp.stack([state > 0, state < 9])
        centre = jnp.array([[0.0, 5.0], [0.0, -5.0]]) + 2.0 * state
        return box, Discs(centre, jnp.array([0.3, 0.4]), mask=there)


def state_with(mover, count=5):
    """A state of one agent at the origin, with a mover, traced `count` times."""
    pose = np.zeros((1, 3))
    motion = cars(pose, trace=np.zeros((1, count, 3)))
    movers = trace_still(begin_movers([mover], LOT, KEY), count)
    return state_of(LOT, motion, 0, movers=movers)


def test_movers_go_straight_and_new_ones_appear_at_once():
    mover, state = Hands(), state_with(Hands())
    after = step_movers([mover], state, 0.2, KEY)
    box, discs = after.groups
    share = np.arange(1, 6) / 5
    np.testing.assert_allclose(box.trace_w[0, :, 0], 3 * share, atol=1e-6)
    np.testing.assert_allclose(box.trace_w[0, :, 2], 3 - share, atol=1e-6)
    np.testing.assert_allclose(box.pose_w[0], [3, 0, 2])
    np.testing.assert_allclose(discs.trace_w[0], [[2, 7]] * 5)  # came
    np.testing.assert_allclose(discs.trace_w[1, :, 1], -5 + 2 * share, atol=1e-6)
    assert {group.kind for group in after.groups} == {ObstacleKind.MOVER}


def test_a_heading_turns_the_short_way():
    def turned(state):
        yaw = jnp.where(state > 0, -3.1, 3.1)
        return [Boxes(jnp.array([[0.0, 0.0, 1.0]]) * yaw, jnp.ones((1, 2)))]

    mover = Hands((("obstacles", turned),))
    [box] = step_movers([mover], state_with(mover, 2), 0.2, KEY).groups
    yaw = np.cos(box.trace_w[0, :, 2])
    np.testing.assert_allclose(yaw, np.cos([np.pi, 3.1]), atol=1e-6)


@pytest.mark.parametrize("crowded", [False, True])
def test_it_is_hit_at_any_traced_instant_and_by_its_kind(monkeypatch, crowded):
    monkeypatch.setattr(near, "MANY_PAIRS", 0 if crowded else 10**9)

    @dataclasses.dataclass(frozen=True)
    class Gate(Hands):
        kind = ObstacleKind.WALL

    def passing(state):  # from 6 m on one side to 6 m on the other
        centre = jnp.array([[0.0, -6.0]]) + 12.0 * state * jnp.array([0.0, 1.0])
        return [Discs(centre, jnp.array([0.3]))]

    for kind, other in ((Hands, "wall"), (Gate, "mover")):
        mover = kind((("obstacles", passing),))
        state = state_with(mover)
        assert not any_hit(find_hits(state)).any()
        hits = find_hits(state.replace(movers=step_movers([mover], state, 0.2, KEY)))
        assert any_hit(hits).all()
        assert not hits.get(other, jnp.zeros(1)).any()
    contacts = state.motion.replace(touched=jnp.zeros((1, 3), bool))
    state = state.replace(motion=contacts)  # physics whose world has no movers
    hits = find_hits(state.replace(movers=step_movers([mover], state, 0.2, KEY)))
    assert hits["wall"].all()


@dataclasses.dataclass(frozen=True)
class Follower(Mover):
    """Stands 2 m beyond the last obstacle that it sees of others."""

    mover: str = "follower"

    def init(self, key, layout):
        return jnp.zeros(())

    def begin(self, key, layout, others):
        return jnp.float32(2.0) + others[-1].pose_w[0, 0]

    def step(self, key, state, lot, dt):
        [other] = lot.movers.groups
        return jnp.float32(2.0) + other.pose_w[0, 0]

    def obstacles(self, state):
        return [Discs(jnp.stack([state, 0.0 * state])[None], jnp.array([0.3]))]


def test_each_sees_the_others_where_they_are_by_then():
    wall = Boxes(jnp.array([[5.0, 0.0, 0.0]]), jnp.ones((1, 2)))
    movers = [Follower(), Follower()]
    begun = begin_movers(movers, LOT, KEY, [wall])
    assert [float(group.pose_w[0, 0]) for group in begun.groups] == [7.0, 9.0]
    motion = cars(np.zeros((1, 3)), trace=np.zeros((1, 4, 3)))
    state = state_of(LOT, motion, 0, movers=trace_still(begun, 4))
    after = step_movers(movers, state, 0.2, KEY)
    assert [float(group.pose_w[0, 0]) for group in after.groups] == [11.0, 13.0]


def boxes_of(size, mask=None):
    """Obstacles in which one box has arrays of given shapes."""
    return lambda state: [Boxes(jnp.zeros((2, 3)), jnp.ones(size), mask=mask)]


@pytest.mark.parametrize(
    ("faults", "message"),
    [
        ({"obstacles": boxes_of(2)}, r"size is of shape \(2,\), not \(2, 2\)"),
        ({"obstacles": boxes_of((2, 2), jnp.ones((2, 1)))}, "mask is of shape"),
    ],
)
def test_obstacles_keep_their_shapes(faults, message):
    mover = Hands(tuple(faults.items()))
    with pytest.raises(ValueError, match=rf"'hands'.*{message}"):
        step_movers([mover], state_with(mover), 0.2, KEY)


def test_names_are_those_of_the_registry(monkeypatch):
    restore_after(monkeypatch, MOVERS)
    MOVERS.register("hands", Hands())
    with pytest.raises(ValueError, match="'hands'"):
        MOVERS.register("hands", Hands((("init", 1),)))
    with pytest.raises(ValueError, match=r"'feet'.*hands"):
        EnvConfig(movers=("feet",))
    ghost = type("Ghost", (Hands,), {"kind": ObstacleKind.AGENT})()
    with pytest.raises(ValueError, match=r"'hands'.*AGENT"):
        EnvConfig(movers=(ghost,))
    config = EnvConfig(movers=("hands", Hands()))
    assert make_movers(config.movers) == (Hands(), Hands())
    assert from_dict(EnvConfig, dataclasses.asdict(config)) == config


def test_without_movers_nothing_is_kept_or_reported():
    assert jax.tree.leaves(Movers()) == []
    assert ObstacleKind.MOVER not in hit_kinds(())
    assert ObstacleKind.MOVER in hit_kinds((Hands(),))


TRACES = 4  # of `SlidePhysics`


@pytest.fixture(scope="module")
def cart():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOT / "examples" / "extensions" / "rail_cart"))
        patch.setenv(extensions.VARIABLE, "rail_cart")
        patch.setattr(extensions, "_loaded", set(extensions._loaded))
        patch.setattr(MOVERS, "_parts", dict(MOVERS._parts))
        yield type(MOVERS["rail_cart"])
    sys.modules.pop("rail_cart", None)


def set_out(state, mover, way):
    """The state with the cart on its way, so many metres from the start."""
    way = jnp.float32(way)
    groups = tuple(mover.obstacles(way))
    return state.replace(movers=trace_still(Movers((way,), (groups,)), TRACES))


def test_a_standing_car_sees_it_come_and_is_hit(cart):
    # To a car of 0 m/s at the origin, facing it, from its tail 7 m off.
    mover = cart(start=(-8.0, 0.0), end=(8.0, 0.0), speed=2.0, size=(2.0, 1.0))
    config = EnvConfig(
        num_agents=1,
        num_parked_cars=0,
        movers=(mover,),
        metrics=MetricsConfig(safety=True),
        observation=ContinuousObservation(rays=RayConfig(4, 20.0)),
    )
    env = ParkingEnv(config, SlidePhysics())
    state, _ = jax.jit(env.reset)(jax.random.key(0))
    state = set_out(placed(env, state, [[0.0, 0.0, np.pi]]), mover, 1.0)
    front = -7.0 + 1.0  # of the cart
    gap = -front - env.vehicle.length / 2

    @jax.jit
    def drive(state):
        def step(state, _):
            after, timestep = env.step(state, jnp.zeros((1, 2)))
            return after, (after, timestep)

        return jax.lax.scan(step, state, length=20)[1]

    after, timestep = drive(state)
    expected = gap - 0.4 * np.arange(1, 21)  # 2 m/s, steps of 0.2 s
    crash = int(np.argmax(expected < 0))
    hit = np.asarray(timestep.events.hit_mover[:, 0])
    assert np.flatnonzero(hit)[0] == crash
    assert timestep.terminated[crash, 0]
    assert not timestep.events.hit_wall[: crash + 1].any()
    before = slice(0, crash)
    seen = timestep.observation[before, 0, -4:] * 20.0
    np.testing.assert_allclose(seen[:, 0], expected[before], atol=1e-4)
    speeds = {"min_clearance_mover": 1.0, "min_collision_time_mover": 2.0}
    for name, speed in speeds.items():
        measured = timestep.metrics[name][before, 0]
        np.testing.assert_allclose(measured, expected[before] / speed, atol=1e-4)
    # The lot's cart goes on while the agent begins anew, and turns at the end.
    xy = after.movers.groups[0].pose_w[:, 0, 0]
    np.testing.assert_allclose(xy, -7.0 + 0.4 * np.arange(1, 21), atol=1e-4)
    back = jax.jit(env.step)(set_out(state, mover, 15.9), jnp.zeros((1, 2)))[0]
    [box] = back.movers.groups
    np.testing.assert_allclose(box.pose_w[0, 0], 8.0 - 0.3, atol=1e-5)
    np.testing.assert_allclose(box.velocity_w[0], [-2.0, 0.0])


def test_an_exported_scene_has_it_where_it_is(cart):
    [box] = cart(start=(-6.0, 2.0), end=(6.0, 2.0), size=(3.0, 2.0)).obstacles(2.0)
    start, nobody = np.array([[0.0, -9.0, 0.0]]), np.zeros((0, 3))
    model = drivable_scene(LOT, COMPACT, start, nobody, movers=[box]).compile()
    np.testing.assert_allclose(model.body("mover0").pos[:2], (-4.0, 2.0), atol=1e-5)
    np.testing.assert_allclose(model.geom("mover0").size[:2], [1.5, 1.0])


def test_who_begins_an_episode_keeps_clear_of_it(cart):
    mover = cart(start=(-8.0, -3.0), end=(8.0, 3.0), size=(9.0, 6.0), speed=3.0)
    spawn, alone = SpawnConfig(num_candidates=1), {"num_parked_cars": 0}
    config = EnvConfig(num_agents=2, movers=(mover,), spawn=spawn, **alone)
    env = ParkingEnv(config, SlidePhysics())

    def touched(state):
        motion = state.motion
        still = jnp.repeat(motion.pose_w[:, None], TRACES, axis=1)
        there = trace_still(state.movers, TRACES)
        here = state.replace(motion=motion.replace(trace_w=still), movers=there)
        return any_hit(find_hits(here)) & state.active

    @jax.jit
    @jax.vmap
    def drive(key):
        state, _ = env.reset(key)

        def step(state, _):
            after, timestep = env.step(state, jnp.ones((2, 2)))
            begun = after.active & (timestep.events.done | ~state.active)
            return after, (begun, touched(after) & begun, timestep.events.hit_mover)

        first = touched(state)
        return first, jax.lax.scan(step, state, length=40)[1]

    first, (begun, hit, crashed) = drive(jax.random.split(jax.random.key(1), 200))
    assert not first.any()
    assert not hit.any()
    assert begun.sum() > 300
    assert crashed.sum() > 50
