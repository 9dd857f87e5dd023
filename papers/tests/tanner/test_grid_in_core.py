"""What the core makes of the study's tasks: integer actions, starts, refusals."""

import dataclasses
from pathlib import Path

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from helpers.exporting import observations, untrained
from helpers.scenes import cars, lot
from helpers.states import parked_in, state_of
from helpers.transitions import no_events

import carpark_mj
from carpark_mj.config import (
    REWARDS,
    EnvConfig,
    GoalConfig,
    GoalRewards,
    RandomizationConfig,
    RewardConfig,
    SimConfig,
    SpawnConfig,
)
from carpark_mj.env import ParkingEnv
from carpark_mj.mdp.actions import action_spec, parse
from carpark_mj.mdp.goals import tracks
from carpark_mj.mdp.parked_cars import relocate_parked_cars
from carpark_mj.observations import make_fields
from carpark_mj.planning.policy import planner_policy
from carpark_mj.policy.loading import LoadedPolicy
from carpark_mj.registry import environment
from carpark_mj.spawning.reset_options import ResetOptions, check_starts
from carpark_mj.suite.evaluation import suite_env
from carpark_mj.types import NO_BAY
from carpark_mj.wrappers.goal import GoalParking, goal_config
from carpark_papers.tanner.environments import (
    TANNER_DYNAMIC,
    TANNER_FIXED,
    TANNER_QLEARNING,
)
from carpark_papers.tanner.grid import FINE
from carpark_papers.tanner.observation import TannerObservation
from carpark_papers.tanner.q_learning.tables import cardinalities, make_table_policy


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"sim": SimConfig(emergency_brake=0.3)}, "emergency_brake must be 0, not 0.3"),
        (
            {"randomization": RandomizationConfig(mass=(0.9, 1.1))},
            "in grid physics randomization has no effect",
        ),
        ({"reward": RewardConfig(reeds_shepp_reach=8.0)}, "reach must be 0, not 8"),
        ({"spawn": SpawnConfig(misaligned_ratio=0.1)}, "misaligned_ratio 0.1 needs"),
        ({"spawn": SpawnConfig(reverse_ratio=0.1)}, "reverse_ratio 0.1 needs"),
        (
            {"reward": RewardConfig(route=True)},
            "route True needs goals.dynamic = False",
        ),
    ],
)
def test_settings_of_cars_that_steer_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        EnvConfig(physics="grid", num_parked_cars=0, **settings)


def test_planner_deployment_and_suite_refuse_the_grid():
    with pytest.raises(ValueError, match="brakes, not those of grid physics"):
        planner_policy(ParkingEnv(environment("tanner-fixed")))
    with pytest.raises(ValueError, match="steers a car, not one of grid physics"):
        suite_env(TANNER_QLEARNING, "strict")
    models = pytest.importorskip("carpark_formats.onnx.models")
    with pytest.raises(ValueError, match="reads the whole state"):
        models.require_outside(TANNER_DYNAMIC)


def test_on_the_grid_controls_are_indices_too():
    fixed = parse(TANNER_QLEARNING, jnp.array([[2, 0], [3, 0]]))
    assert fixed.controls.tolist() == [[2, 0], [2, 0]]
    assert (fixed.controls.dtype, fixed.goal_choice) == (jnp.int32, None)
    assert fixed.invalid.tolist() == [False, True]
    chosen = parse(TANNER_DYNAMIC, jnp.array([[2, 3, 1], [2, 3, -1]]))
    assert chosen.controls.tolist() == [[2, 3], [2, 3]]
    assert chosen.goal_choice.tolist() == [1, 0]
    assert chosen.invalid.tolist() == [False, True]
    assert not parse(TANNER_DYNAMIC, action_spec(TANNER_DYNAMIC).middle[None]).invalid


@pytest.mark.parametrize("action", [[np.nan, 0.0], [0.9, 0.0]])
def test_gymnasium_actions_are_integers(action):
    env = gymnasium.make("carpark_mj/Park-v0", config="tanner-fixed")
    env.reset(seed=0)
    with pytest.raises(ValueError, match=f"integers, not {action[0]} .lot 0, agent 0"):
        env.step(np.array(action))
    env.step(np.array([1.0, 0.0]))


def test_gymnasium_and_pettingzoo_take_indices_as_actions():
    env = gymnasium.make("carpark_mj/Park-v0", config="tanner-qlearning").unwrapped
    check_env(env, skip_render_check=True)
    assert env.action_space == gymnasium.spaces.MultiDiscrete([3, 3], dtype=np.int32)
    pytest.importorskip("pettingzoo")
    env = carpark_mj.parallel_env(config="tanner-fixed", agents=2)
    env.reset(seed=0)
    assert env.action_space("agent_0").shape == (2,)
    env.step({agent: env.action_space(agent).sample() for agent in env.agents})


def test_any_encoder_may_say_what_reveals_the_goal():
    task = dataclasses.replace(
        TANNER_QLEARNING, episode=goal_config({}).episode, reward=REWARDS["pose"]
    )
    assert {field.name for field in make_fields(task)} == {"level", "bearing"}
    assert [field.name for field in GoalParking(task).fields] == ["level"]


def test_on_the_grid_a_car_has_a_point_a_heading_and_a_level():
    env = ParkingEnv(
        EnvConfig(layout="square", vehicle="tanner", num_agents=1, physics="grid")
    )
    size, level = FINE.point_size, 4 * FINE.point_size / 0.2
    pose = jnp.array([[8 * size, -16 * size, jnp.pi / 2]])
    asked = ResetOptions(pose, jnp.array([2 * level]), jnp.array([3]))
    reset = jax.jit(lambda options: env.reset(jax.random.key(0), options=options)[0])
    state = reset(asked)
    check_starts(env.config, asked, state)
    np.testing.assert_allclose(state.motion.pose_w, pose, atol=1e-5)
    assert int(state.physics.level[0]) == 2
    between = asked.replace(pose=pose + 0.3 * size)
    slower = asked.replace(speed=jnp.array([1.4 * level]))
    for wrong in (between, slower):
        with pytest.raises(ValueError, match=r"agent 0: no car can .* exactly"):
            check_starts(env.config, wrong, reset(wrong))


@pytest.mark.parametrize("config", [TANNER_FIXED, TANNER_DYNAMIC], ids=["fixed", "dyn"])
def test_all_starts_of_the_study_s_tasks_keep_their_distance(config):
    env = ParkingEnv(config)
    agents, spec = env.num_agents, env.action_spec

    def run(key):
        state, _ = env.reset(key)

        def step(state, key):
            action = jax.random.randint(key, (agents, spec.size), 0, 5)
            action = jnp.minimum(action, jnp.array(spec.choices) - 1)
            state, timestep = env.step(state, action)
            return state, (state.motion.xy, timestep.events.done)

        first = state.motion.xy
        return first, jax.lax.scan(step, state, jax.random.split(key, 60))[1]

    keys = jax.random.split(jax.random.key(4), 64)
    first, (xy, done) = jax.device_get(jax.jit(jax.vmap(run))(keys))
    least = config.spawn.min_distance - 1e-4

    def gaps(xy):
        gap = np.linalg.norm(xy[..., :, None, :] - xy[..., None, :, :], axis=-1)
        return np.where(np.eye(agents, dtype=bool), np.inf, gap).min(axis=-1)

    assert gaps(first).min() > least
    # Of agents that begin in one step the first to be placed may be too near to where
    # the next one ended; alone they keep their distance to all.
    alone = done.sum(axis=2) == 1
    assert (done.any(axis=2) & alone).sum() > 50
    assert gaps(xy)[alone][done[alone]].min() > least


def test_agents_that_choose_begin_with_starts_of_all_kinds():
    three = GoalConfig(dynamic=True, num_tracked_bays=3)

    def goals(**spawn):
        changed = dataclasses.replace(TANNER_DYNAMIC.spawn, close_ratio=0.5, **spawn)
        task = dataclasses.replace(TANNER_DYNAMIC, spawn=changed, goals=three)
        env = ParkingEnv(task)
        keys = jax.random.split(jax.random.key(5), 200)
        state, _ = jax.jit(jax.vmap(env.reset))(keys)
        assert state.tracked_bays is not None
        goal, tracked = np.asarray(state.goal), np.asarray(state.tracked_bays)
        has = goal != NO_BAY
        assert (tracked == goal[..., None]).any(axis=-1)[has].all()
        taken = goal[:, :, None] == goal[:, None, :]
        shared = (taken & has[:, :, None]).sum(axis=2) > 1
        return has.mean(), shared.mean()

    assert goals(kinds_at_reset=False) == (0.0, 0.0)
    close, alone = goals(conflict_ratio=0.0)
    assert 0.15 < close <= 0.27  # half of the close ones, if they track the bay
    has, shared = goals(conflict_ratio=0.5)
    # Those in conflict as well, if anybody's goal is among their bays.
    assert has > close + 0.03
    assert shared > alone + 0.06


def test_the_study_s_fixed_goals_may_repeat():
    spawn = dataclasses.replace(TANNER_FIXED.spawn, close_ratio=0.0, conflict_ratio=0.0)
    config = dataclasses.replace(
        TANNER_FIXED, num_agents=1, num_parked_cars=3, layout="square", spawn=spawn
    )
    again = 0
    for may_repeat in (True, False):
        goals = dataclasses.replace(config.goals, may_repeat=may_repeat)
        episode = dataclasses.replace(config.episode, max_steps=1)
        task = dataclasses.replace(config, goals=goals, episode=episode)
        env = ParkingEnv(task)

        def run(key, env=env):
            state, _ = env.reset(key)
            action = jnp.array([[2, 3]])
            return state.goal, env.step(state, action)[0].goal

        keys = jax.random.split(jax.random.key(6), 3600)
        old, new = jax.device_get(jax.jit(jax.vmap(run))(keys))
        again = (old == new).sum()
        # Every 36th of 3600: deviation 10, five of them.
        assert abs(again - 100) < 50 if may_repeat else again == 0


def test_the_tanner_reward_preset_has_the_numbers_of_table_c9():
    # Tanner 2022, table C.9 (PPO): sums over an episode, paid a share each step.
    weights = dataclasses.asdict(REWARDS["tanner"])
    del weights["goals"]  # of dynamic goals, `test_dynamic_goals`
    del weights["route"], weights["reeds_shepp_reach"]  # how progress is measured
    assert weights == {
        "park": 1.0,
        "crash": 1.0,
        "time": 0.2,
        "extra": {"approach": 0.15, "smoothness": 0.05, "reverse": 0.1},
        "progress": 0.0,
        "alignment": 0.0,
        "closeness": 0.0,
    }
    assert REWARDS["tanner"].goals == GoalRewards()


def test_agents_and_parked_cars_share_one_list():
    # Six bays in a row, 10 m apart. Of two cars each the agents at 0 and 6 track each
    # other and the one at 10.
    row = lot([(10.0 * k, 0.0, 0.0) for k in range(6)])
    config = EnvConfig(
        spawn=SpawnConfig(relocation="random"),
        observation=TannerObservation(tracked_cars=2),
    )
    motion = cars([(0.0, 0.0, 0.0), (6.0, 0.0, 0.0)])
    state = state_of(row, motion, [0, 5], parked_cars=parked_in(row, [1, 2, 3, 4]))
    events = no_events(2, parked=jnp.array([True, False]))

    @jax.jit
    @jax.vmap
    def relocated(key):
        return relocate_parked_cars(config, state, events, key).bay

    moved = np.asarray(relocated(jax.random.split(jax.random.key(0), 1000))) == 0
    np.testing.assert_allclose(moved.mean(axis=0), [0, *[1 / 3] * 3], atol=0.08)


def table_policy(env, seed=1):
    sizes, choices = cardinalities(env), env.physics_config.choices
    shape = np.prod(sizes), np.prod(choices)
    table = jax.random.normal(jax.random.key(seed), shape)
    policy = make_table_policy(table, sizes, choices)
    return LoadedPolicy(env, policy, 0, Path("none"))


@pytest.mark.parametrize(
    ("name", "make"),
    [("tanner-dynamic", untrained), ("tanner-qlearning-rings", table_policy)],
)
def test_an_exported_model_acts_like_its_policy(name, make):
    models = pytest.importorskip("carpark_formats.onnx.models")
    env = environment(name)
    loaded, seen = make(env), observations(env, 1000)
    model = models.make_model(loaded)
    assert models.model_differences(model, loaded, seen).max() <= 1e-5
    other = make(env, seed=2)
    assert models.model_differences(model, other, seen).max() > 0.01
    if name == "tanner-qlearning-rings":
        np.testing.assert_array_equal(seen, np.round(seen))
        assert models.rounding_error(loaded, seen) == 0.0


def test_absent_agents_fill_no_place_in_a_list_of_nearest_cars():
    config = EnvConfig(
        num_agents=5,
        num_parked_cars=2,
        physics="grid",
        observation=TannerObservation(tracked_cars=6),
    )
    env = ParkingEnv(config)
    state, seen = jax.jit(env.reset)(jax.random.key(0), num_present=jnp.int32(1))
    start = [field.group for field in make_fields(config)].index("car")
    cars = seen[0, start:].reshape(6, -1)
    assert (cars[:2, 0] >= 0.0).all()
    np.testing.assert_array_equal(cars[2:], -1.0)
    assert not tracks(config, state)[0].any()
