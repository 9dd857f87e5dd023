"""Traits of back ends are honoured, and back ends without them refused."""

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.registering import restore_after
from helpers.scenes import cars, lot
from helpers.states import HandPhysics, hand_cars
from helpers.transitions import transition

from carpark_mj.config import (
    PHYSICS,
    EnvConfig,
    EpisodeConfig,
    PhysicsConfig,
    RandomizationConfig,
    RewardConfig,
    SpawnConfig,
)
from carpark_mj.env import ParkingEnv
from carpark_mj.mdp.progress import effort
from carpark_mj.physics.bicycle import BicyclePhysics
from carpark_mj.planning.policy import planner_policy
from carpark_mj.play.driving import DrivenLot
from carpark_mj.policy.named import zero_policy
from carpark_mj.policy.runs import from_dict
from carpark_mj.suite.evaluation import suite_env
from carpark_mj.wrappers.options import observation_space

BASE = EnvConfig(
    num_agents=2,
    num_parked_cars=0,
    physics="bicycle",
    spawn=SpawnConfig(close_ratio=0.0),
    episode=EpisodeConfig(respawn=False),
)


HEAVIER = RandomizationConfig(mass=(0.9, 1.1))


@dataclasses.dataclass(frozen=True)
class Trial(PhysicsConfig):
    """The bicycle, said to be something else."""

    back_end: str = "trial"
    continuous: int = 2  # pyright: ignore
    steers: bool = True
    actuated: bool = True
    contacts: bool = False
    randomized: bool = True
    keeps_ranges: bool = True
    branches: tuple[int, ...] = ()
    fussy: bool = False

    def check(self, config):
        if self.fussy:
            raise ValueError("fussy trial")

    @property
    def choices(self):
        return self.branches

    def make(self, config, layout, vehicle):
        return TrialPhysics(self, config.sim)


class TrialPhysics(BicyclePhysics):
    """Drives on by the first two controls; remembers how many it was given."""

    def __init__(self, config, sim):
        super().__init__(sim)
        self.config = config

    def step(self, state, controls):
        self.given = controls.shape, controls.dtype
        return super().step(state, controls[..., :2].astype(jnp.float32))


def trial(config=BASE, **traits):
    """An environment on a back end with these traits."""
    return ParkingEnv(dataclasses.replace(config, physics=Trial(**traits)))


@pytest.mark.parametrize("contacts", [False, True])
def test_finished_cars_roll_on_with_contacts_only(contacts):
    env = trial(contacts=contacts)
    state, _ = jax.jit(env.reset)(jax.random.key(0))
    physics = env.physics.set_speed(state.physics, jnp.array([2.0, 2.0]))
    motion = env.physics.read(physics)
    active = jnp.array([True, False])
    state = state.replace(physics=physics, motion=motion, active=active)
    start = motion.pose_w
    after, _ = jax.jit(env.step)(state, jnp.zeros((2, 2)))
    moved = np.linalg.norm((after.motion.pose_w - start)[:, :2], axis=1)
    assert moved[0] > 0.3
    assert (moved[1] > 0.05) == contacts
    assert after.motion.speed[1] < 1.9 < after.motion.speed[0]  # it brakes


@pytest.mark.parametrize(
    ("continuous", "branches", "dtype"),
    [(2, (), jnp.float32), (3, (4,), jnp.float32), (0, (5, 7, 2), jnp.int32)],
)
@pytest.mark.parametrize("steers", [True, False])
def test_the_back_end_gets_the_controls_that_it_declares(
    continuous, branches, dtype, steers
):
    env = trial(continuous=continuous, branches=branches, steers=steers)
    size = continuous + len(branches)
    assert env.action_spec.continuous == continuous
    assert (env.action_spec.size, env.action_spec.choices) == (size, branches)
    state, _ = jax.eval_shape(env.reset, jax.random.key(0))
    jax.eval_shape(env.step, state, jnp.zeros((2, size), dtype))
    assert env.physics.given == ((2, size), dtype)


def test_an_object_of_ones_own_brings_its_traits():
    given = TrialPhysics(Trial(continuous=4, keeps_ranges=False), BASE.sim)
    env = ParkingEnv(BASE, physics=given)
    assert env.physics is given
    assert env.config.physics_config is given.config
    assert env.action_spec.size == 4


REFUSED = [
    ({"contacts": True}, {"episode": EpisodeConfig(hitbox_scale=1.5)}, "hitbox"),
    ({"steers": False}, {"spawn": SpawnConfig(reverse_ratio=0.5)}, "reverse_ratio"),
    ({"steers": False}, {"reward": RewardConfig(route=True)}, "route"),
    ({"randomized": False}, {"randomization": HEAVIER}, "randomization"),
    ({"fussy": True}, {}, "fussy"),
]


@pytest.mark.parametrize(("traits", "changes", "named"), REFUSED)
def test_what_a_back_end_cannot_do_is_refused(traits, changes, named):
    assert dataclasses.replace(BASE, **changes, physics=Trial())
    with pytest.raises(ValueError, match=rf"(?=.*{named})(?=.*trial)"):
        dataclasses.replace(BASE, **changes, physics=Trial(**traits))


def test_what_needs_cars_refuses_what_does_not_steer():
    sliding, obeying = trial(steers=False), trial(actuated=False)
    with pytest.raises(ValueError, match="trial"):
        suite_env(sliding.config, "strict")
    with pytest.raises(ValueError, match="trial"):
        DrivenLot(sliding, zero_policy(sliding.action_spec), 0, lambda lot: lot)
    for env in (sliding, obeying):
        with pytest.raises(ValueError, match=r"planner .* trial"):
            planner_policy(env)
    assert suite_env(obeying.config, "strict")


def test_cars_faster_than_in_a_car_park_have_wider_observations():
    slow, fast = (
        observation_space(dataclasses.replace(BASE, physics=Trial(keeps_ranges=keeps)))
        for keeps in (True, False)
    )
    assert (fast.high >= slow.high).all()
    assert (fast.high > slow.high).any()


def test_effort_is_in_shares_of_what_the_back_end_says():
    class Spinner(Trial):
        def turn(self, before, after, ctrl_dt):
            return abs(after.yaw_rate) * ctrl_dt

        def largest_turn(self, vehicle, ctrl_dt):
            return 3.0 * ctrl_dt

        def top_speed(self, vehicle, ctrl_dt):
            return 8.0

    config, poses = dataclasses.replace(BASE, physics=Spinner()), [(0.0, 0.0, 0.0)] * 2
    before, after = cars(poses), cars(poses, [2.0, -4.0], yaw_rate=[1.5, -3.0])
    physics = {"physics": HandPhysics(hand_cars(before))}
    place = lot([(0.0, 0.0, 0.0)])
    turn, speed = effort(config, transition(config, place, before, after, physics))
    np.testing.assert_allclose(turn, [0.5, 1.0], rtol=1e-6)
    np.testing.assert_allclose(speed, [0.25, 0.5], rtol=1e-6)


@pytest.mark.parametrize("physics", ["bicycle", Trial(branches=(3,))])
def test_files_give_the_same_back_end_back(physics, monkeypatch):
    restore_after(monkeypatch, PHYSICS)
    PHYSICS.register("trial", Trial())
    config = dataclasses.replace(BASE, physics=physics)
    read = from_dict(EnvConfig, json.loads(json.dumps(dataclasses.asdict(config))))
    assert read == config
    assert type(read.physics) is type(physics)
