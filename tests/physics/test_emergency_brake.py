"""Emergency braking by hand; `test_pedestrians` has drivers who drive at people."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import cars, lot
from helpers.states import state_of

from carpark_mj.config import EnvConfig, RewardConfig, SimConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.geometry.obstacles import Boxes, Discs, Movers, ObstacleKind
from carpark_mj.physics import emergency_brake
from carpark_mj.physics.emergency_brake import override
from carpark_mj.physics.mjx import MjxPhysics
from carpark_mj.types import NO_BAY, ParkedCars
from carpark_mj.vehicle import COMPACT, make_vehicle

GAP = 0.3  # m, that it keeps
SIM = SimConfig(emergency_brake=GAP)
RADIUS = 0.3  # m
ASIDE = emergency_brake.ASIDE[ObstacleKind.PERSON]
VEHICLE = make_vehicle(COMPACT)
PHYSICS = MjxPhysics(SimConfig())
PLACE = lot([(30.0, 0.0, 0.0)])
SIZE = COMPACT.length, COMPACT.width
HALF = SIZE[0] / 2, SIZE[1] / 2
COASTS = jnp.zeros(2)


def scene(speed, *people, present=True, steering=0.0, kind=ObstacleKind.PERSON):
    """A car at the origin, and people (x, y, vx, vy)."""
    there = jnp.array(people, jnp.float32).reshape(-1, 4)
    radius, mask = jnp.full(len(there), RADIUS), jnp.full(len(there), present)
    discs = Discs(there[:, :2], radius, there[:, 2:], mask, kind=kind)
    motion = cars([(0.0, 0.0, 0.0)], speed=speed, steering=steering, size=SIZE)
    vehicle = jax.tree.map(lambda x: x[None], VEHICLE)
    state = state_of(PLACE, motion, 0, movers=Movers((), ((discs,),)))
    return dataclasses.replace(state, physics=PHYSICS.init(motion.pose_w, vehicle))


@functools.partial(jax.jit, static_argnums=2)
def pedal(state, controls, sim=SIM):
    """The pedal that the car gets."""
    return override(sim, state, jnp.asarray(controls)[None])[0, 1]


def stop(speed):
    """Way of full braking by 4 m/s² in steps of 0.2 s, of less in the last."""
    last = speed % 0.8
    return (speed**2 - last**2) / 8 + last / 2 * 0.2


# Speed [m/s] and pedal; the way of a step that accelerates by 2 m/s² or brakes by up to
# 4 m/s², and then of a stop [m].
WAYS = {
    (2.0, 0.0): 2.0 * 0.2 + stop(2.0),
    (2.0, 1.0): 2.2 * 0.2 + stop(2.4),
    (2.0, -1.0): 1.6 * 0.2 + stop(1.2),
    (3.0, 1.0): 3.0 * 0.2 + stop(3.0),  # as fast as it can
    (0.0, 1.0): 0.2 * 0.2 + stop(0.4),
    (0.0, 0.5): 0.1 * 0.2 + stop(0.2),
    (-1.0, -1.0): 1.2 * 0.2 + stop(1.4),
}


@pytest.mark.parametrize(("speed", "command"), WAYS)
def test_it_brakes_where_a_stop_leaves_less_than_the_gap(speed, command):
    side = np.sign(speed or command)
    for more, brakes in ((-0.02, True), (0.02, False)):
        gap = WAYS[speed, command] + GAP + ASIDE + more
        x = side * (HALF[0] + gap + RADIUS)
        stop = -np.sign(speed) if brakes else command
        got = pedal(scene(speed, (x, 0.0, 0.0, 0.0)), [0.0, command])
        assert float(got) == pytest.approx(stop)


BESIDE = HALF[1] + RADIUS
# A car at 1 m/s with the pedal released.
OTHERS = {
    "behind": ((-HALF[0] - RADIUS - 0.1, 0.0, 0.0, 0.0), 0.0, False),
    "beside it, close": ((1.0, BESIDE + 0.05, 0.0, 0.0), 0.0, False),
    "where it turns": ((HALF[0], BESIDE + 0.05, 0.0, 0.0), 1.0, True),
    "where the tail swings": ((-HALF[0] + 0.1, -BESIDE - 0.02, 0.0, 0.0), 1.0, True),
    "about to come before it": ((HALF[0] + 0.5, BESIDE + 0.3, 0.0, -1.3), 0.0, True),
    "about to leave its way": ((HALF[0] + 1.0, BESIDE + 0.2, 0.0, 1.3), 0.0, False),
}


@pytest.mark.parametrize("who", OTHERS)
def test_it_brakes_for_whom_it_would_drive_at(who):
    person, steering, brakes = OTHERS[who]
    angle = steering * COMPACT.max_steering
    got = pedal(scene(1.0, person, steering=angle), [steering, 0.0])
    assert bool(got < 0.0) == brakes


def test_the_steering_is_held_while_it_brakes():
    near, far = (HALF[0] + 0.5, 0.0, 0.0, 0.0), (HALF[0] + 5.0, 0.0, 0.0, 0.0)
    for person, brakes in ((near, True), (far, False)):
        state = scene(1.0, person, steering=0.25 * COMPACT.max_steering)
        steer = override(SIM, state, jnp.array([[-1.0, 0.0]]))[0, 0]
        assert float(steer) == pytest.approx(0.25 if brakes else -1.0)


def test_cars_turn_wider_than_they_steer():
    """Somebody beyond the circle of the front corner is in danger at speed."""
    radius = COMPACT.wheelbase / np.tan(COMPACT.max_steering)
    centre = np.array([-COMPACT.centre_offset, radius])
    corner = np.hypot(HALF[0] + COMPACT.centre_offset, HALF[1] + radius)
    way = 2.0 * 0.2 + 2.0**2 / 8 + GAP
    ahead = way / radius + np.arctan2(HALF[0] + COMPACT.centre_offset, HALF[1] + radius)
    towards = np.array([np.sin(ahead), -np.cos(ahead)])
    for more, brakes in ((0.02, True), (0.6, False)):
        x, y = centre + (corner + RADIUS + ASIDE + more) * towards
        state = scene(2.0, (x, y, 0.0, 0.0), steering=COMPACT.max_steering)
        assert bool(pedal(state, [1.0, 0.0]) < 0.0) == brakes


def test_people_and_movers_who_are_there_count():
    near, controls = (HALF[0] + 0.5, 0.0, 0.0, 0.0), jnp.array([[0.3, 0.7]])
    for kind in ObstacleKind.PERSON, ObstacleKind.MOVER, ObstacleKind.DRIVER:
        assert float(pedal(scene(1.0, near, kind=kind), controls[0])) == -1.0
    absent = scene(1.0, near, present=False)
    assert float(pedal(absent, controls[0])) == pytest.approx(0.7)
    alone = scene(1.0)
    parked = ParkedCars(jnp.zeros(1, int), jnp.array([[5.0, 0, 0]]), jnp.ones((1, 2)))
    alone = dataclasses.replace(alone, parked_cars=parked, movers=Movers())
    assert override(SIM, alone, controls) is controls


def test_brakes_that_hold_less_or_later_begin_earlier():
    state = scene(2.0, (HALF[0] + RADIUS + 2.0, 0.0, 0.0, 0.0))
    others = {"surface": "ice", "grade_x": 0.2, "pedal_delay": 0.5}
    assert pedal(state, COASTS) == 0.0
    for setting, value in others.items():
        sim = dataclasses.replace(SIM, **{setting: value})
        assert pedal(state, COASTS, sim) == -1.0, setting


def driven(sim, start, wanted, discs=None, brakes=True, parked=None):
    """Whether the first car hits the discs, the parked cars or the second; its speed.

    By step, (40,) each.
    """
    physics, count = MjxPhysics(sim), len(start)
    vehicle = jax.tree.map(lambda x: jnp.stack([x] * count), VEHICLE)
    movers = Movers((), ((discs,),) if discs else ())

    def step(moving, _):
        motion = physics.read(moving)
        state = state_of(PLACE, motion, jnp.zeros(count, int), movers=movers)
        state = dataclasses.replace(state, physics=moving)
        if parked:
            state = dataclasses.replace(state, parked_cars=parked)
        controls = jnp.where(brakes, override(sim, state, wanted), wanted)
        moving = physics.step(moving, controls)
        after = physics.read(moving)
        trace = after.trace_w[:, :, None]
        fixed = discs or (parked and Boxes(parked.pose_w, parked.size))
        other = fixed or Boxes(trace[1], after.size[1])
        return moving, (other.overlap(trace[0], after.size[0]).any(), after.speed[0])

    return jax.lax.scan(step, physics.init(start, vehicle), length=40)[1]


def test_cars_that_slide_down_an_icy_slope_stop_before_people():
    """On locked wheels cars leave their arcs, and drift across the slope."""
    count, people = 64, 8
    sim = dataclasses.replace(SIM, surface="ice", grade_x=0.05)
    turn, away = jax.random.uniform(jax.random.key(2), (2, count, people))
    away, angle = 4.0 + 5.0 * away, 2.0 * jnp.pi * turn
    place = jnp.stack([away * jnp.cos(angle), away * jnp.sin(angle)], axis=-1)

    def one(yaw, gear, place):
        still = jnp.full(people, RADIUS), jnp.zeros((people, 2))
        discs = Discs(place, *still, kind=ObstacleKind.PERSON)
        wanted = jnp.stack([0.6 * gear, gear])[None]
        return driven(sim, jnp.stack([0.0 * yaw, 0.0 * yaw, yaw])[None], wanted, discs)

    yaw = jnp.linspace(-jnp.pi, jnp.pi, count)
    gear = jnp.where(jnp.arange(count) % 4 == 0, -1.0, 1.0)
    hit, speed = jax.device_get(jax.jit(jax.vmap(one))(yaw, gear, place))
    assert not hit.any()
    assert (np.abs(speed) > 1.0).mean() > 0.1  # they drive for all that


def test_cars_that_drive_at_each_other_hardly_ever_touch():
    """Where both move, the way of the other is a guess."""

    def one(place, brakes):
        x, y, yaw, steer = place
        start = jnp.array([[0.0, 0.0, 0.0], [7.0 + 2.0 * x, 5.0 * y, 3.0 * yaw]])
        wanted = jnp.array([[0.0, 1.0], [steer, 1.0]])
        return driven(SIM, start, wanted, brakes=brakes)[0].any()

    place = jax.random.uniform(jax.random.key(3), (256, 4), minval=-1.0)
    run = jax.jit(jax.vmap(one, (0, None)))
    assert run(place, False).mean() > 0.3
    assert run(place, True).mean() < 0.02


def between(gap, speed=0.0, bay=0):
    """A car between a parked car ahead and a wall behind, both at a gap."""
    x = HALF[0] + gap + 1.0
    parked = ParkedCars(
        jnp.array([bay]), jnp.array([[x, 0.0, 0.0]]), jnp.full((1, 2), 2.0)
    )
    place = lot([(30.0, 0.0, 0.0)], [(-x, 0.0, 0.0)], wall_size=(2.0, 2.0))
    state = dataclasses.replace(scene(speed), layout=place, movers=Movers())
    return dataclasses.replace(state, parked_cars=parked)


def test_manoeuvres_end_before_what_stands():
    """The large gap of emergency braking is not kept to it."""
    sim = SimConfig(emergency_brake=GAP, manoeuvre_brake=ASIDE)
    for (speed, command), way in WAYS.items():
        for more, brakes in ((-0.02, True), (0.02, False)):
            got = pedal(between(way + ASIDE + more, speed), [0.0, command], sim)
            stop = -np.sign(speed) if brakes else command
            assert float(got) == pytest.approx(stop)
    # Both ways are closed, but the car may steer where it stands.
    near = between(0.5 * ASIDE)
    for command in (-1.0, 1.0):
        got = override(sim, near, jnp.array([[0.4, command]]))
        np.testing.assert_allclose(got, [[0.4, 0.0]], atol=1e-6)
    free = between(0.5 * ASIDE, bay=NO_BAY)
    assert float(pedal(free, [0.0, 1.0], sim)) == 1.0


def test_a_drive_that_lags_pushes_on():
    sim, state = (
        SimConfig(manoeuvre_brake=ASIDE),
        between(WAYS[0.0, 1.0] + ASIDE + 0.05),
    )
    lags = dataclasses.replace(VEHICLE, drive_lag=jnp.float32(0.25))
    physics = PHYSICS.init(state.motion.pose_w, jax.tree.map(lambda x: x[None], lags))
    for moving, wanted in ((state.physics, 1.0), (physics, 0.0)):
        state = dataclasses.replace(state, physics=moving)
        assert float(pedal(state, [0.0, 1.0], sim)) == wanted


def test_brakes_stop_cars_within_a_step():
    speed = jnp.array([0.06, 0.1, 0.3, 0.5, 0.79, -0.1, -0.5])

    @functools.partial(jax.jit, static_argnums=0)
    def after(sim):
        physics, count = MjxPhysics(sim), len(speed)
        vehicle = jax.tree.map(lambda x: jnp.stack([x] * count), VEHICLE)
        moving = physics.set_speed(physics.init(jnp.zeros((count, 3)), vehicle), speed)
        brake = emergency_brake.stop(sim, vehicle, physics.read(moving))
        controls = jnp.stack([jnp.zeros(count), brake], axis=-1)
        return physics.read(physics.step(moving, controls)).speed

    assert np.abs(after(SIM)).max() < 0.04
    # Uphill they roll back until the holding brake has closed.
    assert np.abs(after(dataclasses.replace(SIM, grade_x=0.1))).max() < 0.2


def test_cars_hardly_ever_touch_what_stands():
    count, sim = 256, SimConfig(manoeuvre_brake=0.01)
    keys = jax.random.split(jax.random.key(4), 3)
    turn, away, yaw = jax.random.uniform(keys[0], (3, count, 6))
    away, angle = 4.0 + 3.0 * away, 2.0 * jnp.pi * turn
    place = [away * jnp.cos(angle), away * jnp.sin(angle), 6.0 * yaw]
    place, size = jnp.stack(place, axis=-1), jnp.ones((6, 2))
    commands = jax.random.uniform(keys[1], (count, 2), minval=-1.0)

    def one(place, wanted, brakes):
        parked = ParkedCars(jnp.zeros(6, int), place, size)
        start = jnp.zeros((1, 3))
        return driven(sim, start, wanted[None], brakes=brakes, parked=parked)

    run = jax.jit(jax.vmap(one, (0, 0, None)))
    assert run(place, commands, False)[0].any(axis=1).mean() > 0.3
    hit, speed = jax.device_get(run(place, commands, True))
    assert hit.any(axis=1).mean() < 0.02
    assert (np.abs(speed) > 0.3).mean() > 0.2  # they drive for all that


@pytest.mark.parametrize("brake", ["", "emergency_brake", "manoeuvre_brake"])
def test_the_program_of_a_step_brakes_only_where_asked_to(brake):
    sim, people = SimConfig(), ("pedestrians:number=1",)
    sim = dataclasses.replace(sim, **{brake: GAP} if brake else {})
    env = ParkingEnv(EnvConfig(num_agents=1, sim=sim, movers=people))
    state, _ = jax.eval_shape(env.reset, jax.random.key(0))
    program = jax.make_jaxpr(env.step)(state, jnp.zeros((1, 2)))
    text = program.pretty_print(name_stack=True)
    assert ("emergency_brake" in text) == bool(brake)


def test_the_reward_counts_the_steps_in_which_brakes_override_the_driver():
    config = EnvConfig(
        num_agents=1,
        sim=SimConfig(manoeuvre_brake=0.05),
        reward=RewardConfig(extra={"automatic_braking": 1.0}),
    )
    env, lots = ParkingEnv(config), 16
    full = jnp.zeros((lots, 1, 2)).at[..., 1].set(1.0)

    def step(state, _):
        after, timestep = jax.vmap(env.step)(state, full)
        speed = state.motion.speed, timestep.motion.speed
        paid = timestep.reward_terms["automatic_braking"]
        return after, (*speed, paid, timestep.events.done)

    def drive(keys):
        state, _ = jax.vmap(env.reset)(keys)
        return jax.lax.scan(step, state, length=60)[1]

    got = jax.device_get(jax.jit(drive)(jax.random.split(jax.random.key(0), lots)))
    before, after, paid, done = (x[..., 0] for x in got)
    assert set(np.unique(paid)) == {-1.0, 0.0}
    top = before > 0.95 * COMPACT.max_speed
    brakes = np.abs(after) <= np.maximum(before, emergency_brake.STANDING)
    assert brakes[(paid < 0.0) & ~done].all()
    assert (after > before)[(paid == 0.0) & ~done & ~top].all()
