"""The example of a mover: a cart on a rail, from a package outside the library."""

import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.packages import PACKAGES
from helpers.sliding import SlidePhysics, placed
from helpers.states import any_hit

from carpark_mj import extensions
from carpark_mj.config import MOVERS, EnvConfig, MetricsConfig, RayConfig, SpawnConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.geometry.obstacles import Movers
from carpark_mj.mdp.collisions import find_hits
from carpark_mj.observations import ContinuousObservation
from carpark_mj.obstacles import trace_still
from carpark_mj.policy.named import zero_policy
from carpark_mj.rendering.recording import record, recording_stage, snapshot
from carpark_mj.rendering.renderer import LotRenderer
from carpark_mj.scene.build import drivable_scene
from carpark_mj.scene.looks import MOVER

FOLDER = PACKAGES / "rail_cart"
TRACES = 4  # of `SlidePhysics`


@pytest.fixture(scope="module")
def cart():
    """The class of carts, found by its name as an extension."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(FOLDER))
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
    np.testing.assert_allclose(
        timestep.metrics["min_clearance_mover"][before, 0], expected[before], atol=1e-4
    )
    np.testing.assert_allclose(
        timestep.metrics["min_collision_time_mover"][before, 0],
        expected[before] / 2.0,
        atol=1e-4,
    )
    # The lot's cart goes on while the agent begins anew, and turns at the end.
    xy = after.movers.groups[0].pose_w[:, 0, 0]
    np.testing.assert_allclose(xy, -7.0 + 0.4 * np.arange(1, 21), atol=1e-4)
    back = jax.jit(env.step)(set_out(state, mover, 15.9), jnp.zeros((1, 2)))[0]
    [box] = back.movers.groups
    np.testing.assert_allclose(box.pose_w[0, 0], 8.0 - 0.3, atol=1e-5)
    np.testing.assert_allclose(box.velocity_w[0], [-2.0, 0.0])


def test_who_begins_an_episode_keeps_clear_of_it(cart):
    mover = cart(start=(-8.0, -3.0), end=(8.0, 3.0), size=(9.0, 6.0), speed=3.0)
    config = EnvConfig(
        num_agents=2,
        num_parked_cars=0,
        movers=(mover,),
        spawn=SpawnConfig(num_candidates=1),
    )
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


def test_pictures_show_it_where_it_is(cart):
    mover = cart(start=(-6.0, 2.0), end=(6.0, 2.0), size=(3.0, 2.0))
    config = EnvConfig(num_agents=1, num_parked_cars=0, movers=(mover,))
    env = ParkingEnv(config, SlidePhysics())
    recording = record(env, zero_policy(env.action_spec), 10, 0)
    renderer = LotRenderer(recording_stage(env, recording), "topdown", (640, 640))
    try:
        for index in (0, 35):
            seen = snapshot(recording, index)
            [box] = seen.movers
            renderer.place(seen)
            picture = renderer.draw(seen, "topdown")
            x, y = renderer.project(np.array([*box.pose_w[0, :2], 1.1]), "topdown")
            colour, yellow = picture[round(y), round(x)] / 255, np.array(MOVER[:3])
            lengths = np.linalg.norm(colour) * np.linalg.norm(yellow)
            assert colour @ yellow > 0.98 * lengths
            x, y = renderer.project(np.array([0.0, -10.0, 0.0]), "topdown")
            asphalt = picture[round(y), round(x)].astype(float)
            assert np.ptp(asphalt) < 25
    finally:
        renderer.close()
    start, nobody = recording.pose_w[0, 0], np.zeros((0, 3))
    spec = drivable_scene(recording.layout, env.vehicle, start, nobody, movers=[box])
    model = spec.compile()
    where = model.body("mover0").pos[:2]
    np.testing.assert_allclose(where, box.pose_w[0, :2], atol=1e-5)
    np.testing.assert_allclose(model.geom("mover0").size[:2], [1.5, 1.0])
