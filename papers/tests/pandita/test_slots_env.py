"""The task of Pandita 2022: what is observed and paid, and how episodes end."""

import dataclasses
import math

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from carpark_mj.env import ParkingEnv
from carpark_mj.mdp.terminations import is_parked
from carpark_mj.registry import environment
from carpark_papers.pandita.layouts import SlotsConfig
from carpark_papers.pandita.slots_env import slots_config

SLOTS = "carpark_mj/Slots-v0"
WAIT = jnp.zeros((1, 2))


@pytest.fixture(scope="module")
def task():
    return ParkingEnv(slots_config({}))


@pytest.fixture(scope="module")
def step(task):
    return jax.jit(task.step)


@pytest.fixture(scope="module")
def start(task):
    return jax.jit(task.reset)(jax.random.key(0))[0]


def standing(task, state, *pose, steps=0):
    """The car stands at a pose (x, y, heading) after so many steps."""
    physics = task.physics
    made = physics.init(jnp.array([pose], jnp.float32), state.physics.vehicle)
    made = state.replace(physics=made, motion=physics.read(made))
    return made.replace(step=jnp.full(1, steps, jnp.int32))


@pytest.mark.parametrize(
    ("layout", "desired"),
    [
        ("slots", (-0.06, 0.14, 0, 0, 0, 1)),
        ("slots_diagonal", (-0.09, 0.14, 0, 0, -0.6, 0.8)),
        ("slots_parallel", (-0.09, 0.10, 0, 0, -1, 0)),
    ],
)
def test_the_car_at_the_start_and_the_goal_are_six_numbers(layout, desired):
    env = gymnasium.make(SLOTS, layout=layout)
    seen, _ = env.reset(seed=0)
    at = (0.1, 0, 0, 0, -1, 0)
    np.testing.assert_allclose(seen["observation"], at, atol=1e-5)
    np.testing.assert_array_equal(seen["observation"], seen["achieved_goal"])
    np.testing.assert_allclose(seen["desired_goal"], desired, atol=1e-6)


def test_full_pedal_for_a_step_moves_the_car_as_highway_env_would():
    # Speeds 0, 1/3 and 2/3 m/s for 1/15 s each: 1/15 m, and 1 m/s at the end.
    env = gymnasium.make_vec(SLOTS, 2)
    env.reset(seed=0)
    seen, reward, terminated, truncated, _ = env.step(np.tile([0.0, 1.0], (2, 1)))
    achieved = seen["achieved_goal"]
    expected = [[0.1 - 1 / 1500, 0, -1 / 5, 0, -1, 0]] * 2
    np.testing.assert_allclose(achieved, expected, atol=1e-5)
    np.testing.assert_array_equal(seen["observation"], achieved)
    x, y = 16 - 1 / 15, 14
    norm = math.sqrt(x / 100 + 0.3 * y / 100 + 0.02 + 0.02)
    np.testing.assert_allclose(reward, -norm, atol=1e-5)
    assert not (terminated | truncated).any()


def test_every_other_slot_holds_a_car_and_there_is_one_goal(start):
    goal, bays = start.goal[0], start.parked_cars.bay
    assert int(goal) == 2
    assert sorted(bays.tolist()) == [k for k in range(12) if k != 2]
    other = slots_config({"layout": SlotsConfig(slots_per_row=3, goal_slot=None)})
    assert other.num_parked_cars == 5
    assert slots_config({"parked_cars": 0}).num_parked_cars == 0
    assert slots_config({"layout": "slots_single"}).num_parked_cars == 1
    env = ParkingEnv(other)
    keys = jax.random.split(jax.random.key(1), 60)
    states, _ = jax.jit(jax.vmap(env.reset))(keys)
    goals = states.goal[:, 0]
    assert set(goals.tolist()) == set(range(6))
    np.testing.assert_array_equal(
        goals, np.argmax(np.asarray(states.layout.goal_mask), axis=1)
    )
    assert not (states.parked_cars.bay == goals[:, None]).any()


@pytest.mark.parametrize(
    ("pose", "near"),
    [
        ((-6, 14, math.pi / 2), True),
        ((-6.6, 14, math.pi / 2), True),
        ((-6.7, 14, math.pi / 2), False),
        ((-6, 11.9, math.pi / 2), True),
        ((-6, 11.8, math.pi / 2), False),
        ((-6, 14, math.pi / 2 + 0.25), True),
        ((-6, 14, math.pi / 2 - 0.30), False),
        ((-6, 14, -math.pi / 2), False),
    ],
)
def test_the_goal_is_reached_within_the_specified_distances(
    task, step, start, pose, near
):
    # 0.64 m along x, 2.13 m along y (obstacles stand at the far end), 0.28 rad.
    after, timestep = step(standing(task, start, *pose), WAIT)
    assert bool(timestep.terminated[0]) == bool(timestep.events.parked[0]) == near
    assert not timestep.truncated.any()
    assert bool(after.active[0]) != near
    assert (float(timestep.reward[0]) > -0.08) == near


def test_a_crash_comes_before_the_timeout_and_that_before_the_goal(task, step, start):
    reached, crash = (-6.0, 14.0, math.pi / 2), (-8.2, 14.0, math.pi / 2)
    ends = {}
    for name, pose in (("reached", reached), ("crash", crash), ("away", (0, 0, 0))):
        for steps in (0, 149):
            _, timestep = step(standing(task, start, *pose, steps=steps), WAIT)
            events = timestep.events
            ends[name, steps] = [
                kind
                for kind in ("parked", "crashed", "timed_out", "diverged")
                if getattr(events, kind)[0]
            ]
            crashed = bool(events.crashed[0])
            norm = -float(timestep.reward[0]) - 4.0 * crashed
            assert 0.0 <= norm < 0.6
            terminal = crashed or bool(events.parked[0])
            assert bool(timestep.terminated[0]) == terminal
            assert bool(timestep.truncated[0]) == bool(events.timed_out[0])
    assert ends == {
        ("reached", 0): ["parked"],
        ("reached", 149): ["timed_out"],
        ("crash", 0): ["crashed"],
        ("crash", 149): ["crashed"],
        ("away", 0): [],
        ("away", 149): ["timed_out"],
    }


def test_standing_strictly_parked_tail_in_ends_nothing(task, step, start):
    backed_in = -6.0, 14.0, -math.pi / 2
    after, timestep = step(standing(task, start, *backed_in, steps=10), WAIT)
    layout, goal = start.layout, start.goal
    bay = layout.bay_pose[goal], layout.bay_size[goal]
    assert is_parked("strict", timestep.motion, *bay).all()
    assert not timestep.events.done.any()
    assert after.active.all()
    _, timestep = step(standing(task, start, *backed_in, steps=149), WAIT)
    assert timestep.events.timed_out.all()


def test_an_episode_has_150_steps_of_a_fifth_of_a_second():
    env = gymnasium.make(SLOTS)
    env.reset(seed=0)
    for number in range(1, 151):
        *_, terminated, truncated, info = env.step(np.zeros(2, np.float32))
        assert not terminated
        assert truncated == (number == 150)
    assert info == {"is_success": False, "crashed": False}
    config = env.unwrapped._batch.env.config
    assert config.sim.ctrl_dt == 0.2
    assert config.sim.num_substeps == config.sim.num_traces == 3


def test_real_cars_have_the_same_task():
    config = slots_config({"config": "slots", "layout": "slots_parallel"})
    assert (config.physics, config.vehicle) == ("mjx", "compact")
    task, his = ParkingEnv(config), ParkingEnv(slots_config({}))
    state, seen = jax.eval_shape(task.reset, jax.random.key(0))
    _, timestep = jax.eval_shape(task.step, state, WAIT)
    assert seen.shape == timestep.observation.shape == (1, his.observation_size)
    assert his.observation_size == 12
    same = dataclasses.replace(
        environment("pandita"), vehicle="compact", physics="mjx", sim=config.sim
    )
    assert environment("slots") == same


@pytest.mark.parametrize("pedal", [-1.0, 1.0])
def test_a_car_that_drives_straight_on_stays_in_the_observation_space(pedal):
    env = gymnasium.make(SLOTS)
    env.reset(seed=0)
    done = False
    while not done:
        observation, _, terminated, truncated, _ = env.step(np.float32([0.0, pedal]))
        assert observation in env.observation_space
        done = terminated or truncated


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"rule": "strict"}, TypeError, "keyword argument 'rule'; choose from"),
        ({"parked_cars": 12}, ValueError, "num_parked_cars must be at most 11 .* 12"),
        ({"layout": "slot"}, ValueError, "unknown layout 'slot'; choose from"),
    ],
)
def test_impossible_options_are_refused(options, error, message):
    with pytest.raises(error, match=message):
        gymnasium.make(SLOTS, **options)


def test_rewards_are_highway_envs():
    gym = pytest.importorskip("highway_env.envs.parking_env")
    theirs = gym.ParkingEnv()
    achieved, desired = np.random.default_rng(0).uniform(-1, 1, (2, 100, 6))
    ours = gymnasium.make(SLOTS).unwrapped
    for a, b in zip(achieved, desired, strict=True):
        expected = theirs.compute_reward(a, b, {}, 0.5)
        assert ours.compute_reward(a, b, {}) == pytest.approx(expected, abs=1e-6)


def test_cars_crash_in_the_steps_in_which_highway_envs_do(task, start):
    kinematics = pytest.importorskip("highway_env.vehicle.kinematics")
    objects = pytest.importorskip("highway_env.vehicle.objects")
    num, steps = 48, 40
    rng = np.random.default_rng(0)
    controls = rng.uniform([-1.0, 0.3], [1.0, 1.0], (num, 2)).astype(np.float32)
    states = jax.tree.map(lambda x: jnp.stack([x] * num), start)
    drive = jax.jit(jax.vmap(task.step))
    ours = np.full(num, steps)
    for number in range(steps):
        states, timestep = drive(states, jnp.asarray(controls)[:, None])
        crashed = np.asarray(timestep.events.crashed[:, 0])
        ours[crashed] = number
    theirs = np.full(num, steps)
    for row, (steer, pedal) in enumerate(controls.astype(float)):
        car = kinematics.Vehicle(None, [10.0, 0.0], math.pi, 0.0)
        solid = [
            kinematics.Vehicle(None, [x, y], yaw, 0.0)
            for x, y, yaw in np.asarray(start.parked_cars.pose_w, float)
        ]
        solid += [
            objects.Obstacle(None, [x, y])
            for x, y, _ in np.asarray(start.layout.wall_pose, float)
        ]
        for substep in range(3 * steps):
            car.act({"steering": steer * math.pi / 4, "acceleration": pedal * 5.0})
            car.step(1 / 15)
            for other in solid:
                # Without its look ahead by a substep, which takes a car that turns
                # away in time for crashed.
                car.handle_collisions(other, 0.0)
            if car.crashed:
                theirs[row] = substep // 3
                break
    assert (theirs < steps).sum() > num / 3
    np.testing.assert_array_equal(ours, theirs)
