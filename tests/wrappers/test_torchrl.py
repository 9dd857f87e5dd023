"""A batch of lots as TorchRL sees it."""

import gymnasium
import numpy as np
import pytest

pytest.importorskip("torchrl")

import torch
from torchrl.envs import ActionMask, GymEnv, GymWrapper, TransformedEnv
from torchrl.envs.utils import check_env_specs

from carpark_mj.config import EnvConfig, GoalConfig, SensorConfig
from carpark_mj.wrappers.torchrl import TorchRLParking

SMALL = {"agents": 2, "parked_cars": 2, "physics": "bicycle"}
CHOSEN = EnvConfig(goals=GoalConfig(dynamic=True, num_tracked_bays=2))
CHOOSES = SMALL | {"config": CHOSEN, "discrete": True}
PARK = "carpark_mj/Park-v0"
LOTS = 8
MAX_STEPS = EnvConfig().episode.max_steps


@pytest.fixture(scope="module")
def env():
    return TorchRLParking(LOTS, seed=0, **SMALL)


@pytest.fixture(scope="module")
def rollout(env):
    """250 steps: lots end and are reset apart from each other."""
    action = torch.zeros(LOTS, 2, 2)
    action[:, 0, 1] = 1.0  # straight ahead; agent 1 stands, or backs up in every other
    action[::2, 1, 1] = -1.0
    env.set_seed(0)
    return env.rollout(
        250,
        lambda step: step.set(("agents", "action"), action),
        break_when_any_done=False,
    )


@pytest.mark.parametrize(
    "options",
    [
        SMALL,
        SMALL | {"discrete": True},
        {"config": EnvConfig(num_agents=3, min_agents=1, physics="bicycle")},
        CHOOSES,
    ],
    ids=["continuous", "discrete", "absent", "masked"],
)
def test_torchrl_accepts_the_environment(options):
    check_env_specs(TorchRLParking(3, seed=0, **options))


def test_samples_of_unbounded_observations_are_numbers():
    noisy = EnvConfig(physics="bicycle", sensors=SensorConfig(position_noise=0.1))
    spec = TorchRLParking(2, config=noisy).observation_spec
    assert torch.isfinite(spec.rand()["agents", "observation"]).all()


def test_agents_stay_done_observe_zeros_and_earn_nothing(rollout):
    before = rollout["agents", "done"][..., 0]
    after = rollout["next", "agents"]
    assert before.any()
    assert after["terminated"][before].all()
    assert not after["truncated"][before].any()
    assert not after["observation"][before].any()
    assert not after["reward"][before].any()
    # In the step in which it ends an agent still sees where.
    ends = after["done"][..., 0] & ~before
    assert after["observation"][ends].any(dim=-1).all()
    crashed = after["info", "crashed"]
    assert crashed[ends & (after["truncated"][..., 0] == 0)].any()
    assert not crashed[before].any()


def test_only_a_lot_whose_agents_are_all_done_is_reset(rollout):
    over = rollout["next", "done"][..., 0]
    done = rollout["next", "agents", "done"].all(2)[..., 0]
    np.testing.assert_array_equal(over, done)
    steps = over.nonzero()[:, 1]
    assert len(steps.unique()) > 1  # not all at once
    first, following = rollout[:, :-1], rollout[:, 1:]
    over = over[:, :-1]
    # After the end agents are there again; elsewhere time goes on.
    assert not following["agents", "done"][over].any()
    assert following["agents", "observation"][over].any(dim=-1).all()
    for name in ("observation", "done"):
        before, after = first["next", "agents", name], following["agents", name]
        np.testing.assert_array_equal(after[~over], before[~over])


def test_a_lot_cut_by_time_is_truncated_not_terminated(rollout):
    over = rollout["next", "done"][..., 0]
    by_time = rollout["next", "agents", "truncated"].any(2)[..., 0]
    assert (over & by_time).any()
    assert (over & ~by_time).any()
    for lot in range(LOTS):  # resets of other lots do not touch its clock
        ends = np.flatnonzero(over[lot])
        lengths = np.diff(ends, prepend=-1)
        np.testing.assert_array_equal(lengths == MAX_STEPS, by_time[lot][ends])
    np.testing.assert_array_equal(rollout["next", "truncated"][..., 0], over & by_time)
    np.testing.assert_array_equal(
        rollout["next", "terminated"][..., 0], over & ~by_time
    )


def test_the_same_seed_gives_the_same_lots(env, rollout):
    assert env.group_map == {"agents": ["agent_0", "agent_1"]}
    env.set_seed(0)
    again, first = env.reset(), rollout["agents", "observation"][:, 0]
    np.testing.assert_array_equal(again["agents", "observation"], first)
    assert (env.reset()["agents", "observation"] != 0).any()


def test_discrete_actions_are_rows_of_the_table(env):
    """The middle row brakes, as zeros do."""
    discrete = TorchRLParking(LOTS, discrete=True, **SMALL)
    rows, results = torch.full((LOTS, 2), 38), []
    for one, action in ((discrete, rows), (env, torch.zeros(LOTS, 2, 2))):
        one.set_seed(3)
        after = one.step(one.reset().set(("agents", "action"), action))
        results.append(after["next", "agents", "observation"])
    assert discrete.action_spec["agents", "action"].space.n == 77
    np.testing.assert_allclose(*results, atol=1e-5)


def test_action_mask_of_torchrl_keeps_to_bays_that_are_tracked():
    env = TransformedEnv(
        TorchRLParking(3, seed=0, **CHOOSES),
        ActionMask(("agents", "action"), ("agents", "action_mask")),
    )
    rollout = env.rollout(20, break_when_any_done=False)
    masks, actions = rollout["agents", "action_mask"], rollout["agents", "action"]
    assert masks.gather(-1, actions[..., None]).all()
    assert masks.shape == (3, 20, 2, 77 * 3)


def test_torchrls_own_gymnasium_wrappers_drive_it():
    options = {"physics": "bicycle", "parked_cars": 2}
    single = GymEnv(PARK, **options)
    many = GymWrapper(gymnasium.make_vec(PARK, 3, **options))
    for env, shape in ((single, (4, 1)), (many, (3, 4, 1))):
        check_env_specs(env)
        assert env.rollout(4)["next", "reward"].shape == shape
