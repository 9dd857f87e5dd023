"""What changes in the course of a training, and when it ends."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.learning import SMALL, sliding_learner

from carpark_mj.config import EnvConfig, SpawnConfig, insert
from carpark_mj.policy import checkpoints, runs
from carpark_mj.training.loop import read_metrics
from carpark_mj.training.ppo.collect import TrainingState, no_steps
from carpark_mj.training.ppo.config import CurriculumConfig, PPOConfig
from carpark_mj.training.ppo.learn import crash_scale, discount, schedule, training_env
from carpark_mj.training.ppo.learner import Learner
from carpark_mj.training.ppo.train import train

BUDGET = {"num_steps": 64 * 100, "unroll_length": 16, "minutes": 1.0}  # 100 updates
CONFIG = insert(SMALL, BUDGET | {"eval_episodes": 0, "video_seconds": 0.0})
PRESENT = 40  # steps of present agents in an update, where not all always are


class SlowLearner(Learner):
    """Its updates learn nothing but take time, on a clock of its own."""

    def __init__(self, config, update_seconds):
        super().__init__(config)
        self.now = 1e6  # clocks do not begin at 0
        self._update_seconds = update_seconds

    def build(self):
        zero = jnp.zeros(())
        none = {name: zero for name in TrainingState.__dataclass_fields__}
        lots = jnp.zeros(self.config.num_lots)
        count, steps = jnp.zeros((), jnp.int32), no_steps()
        return TrainingState(**none | {"update": count, "steps": steps, "env": lots})

    def compile(self, scheduled=False):
        def update(state):
            self.now += self._update_seconds
            metrics = {
                "progress": self.config.progress(state.update, state.seconds),
                "skipped": 0,
                "episode/parked": 0.0,
                "episode/crashed": 0.0,
            }
            steps = state.steps + PRESENT
            return state.replace(update=state.update + 1, steps=steps), metrics

        return update


def trained(folder, update_seconds, **changes):
    """Whether training was done, and the metrics of all its updates."""
    config = dataclasses.replace(CONFIG, **changes)
    learner = SlowLearner(config, update_seconds)
    (outcome,) = train(learner, [folder], lambda: learner.now)
    return outcome == "done", read_metrics(folder)


def test_a_slow_machine_stops_at_the_end_of_the_schedules(tmp_path):
    done, rows = trained(tmp_path, 0.7)
    progress = np.array([row["progress"] for row in rows])
    assert done
    assert len(rows) == 87  # of 0.7 s in 60 s after the first
    assert progress[0] == 0.0
    assert (np.diff(progress) > 0).all()
    # The last update has the rate of the end but for one step of the schedule.
    rate = schedule(1e-3, 1e-4, progress[-1])
    assert 1e-4 < rate < 1e-4 + 0.9e-3 * 0.7 / 60 + 1e-9


@pytest.mark.parametrize(("seconds", "minutes"), [(0.1, 1.0), (1e4, 0.0)])
def test_all_steps_are_made_in_time_or_without_minutes(tmp_path, seconds, minutes):
    done, rows = trained(tmp_path, seconds, minutes=minutes)
    assert done
    progress = [row["progress"] for row in rows]
    np.testing.assert_allclose(progress, np.arange(100) / 100, atol=1e-7)


def test_a_resumed_run_has_the_minutes_that_are_left(tmp_path):
    done, rows = trained(tmp_path, 7.0, time_limit=0.5)
    assert not done
    assert len(rows) == 5  # of 7 s in 30 s
    done, rows = trained(tmp_path, 7.0)
    assert done
    assert len(rows) == 11  # of 7 s in 60 s; the first of either start is free
    counted = [0, 0, 1, 2, 3, 4, 4, 5, 6, 7, 8]
    by_time = np.array(counted) * 7 / 60
    np.testing.assert_allclose(
        [row["progress"] for row in rows],
        np.maximum(by_time, np.arange(11) / 100),
        rtol=1e-6,
    )
    done, again = trained(tmp_path, 7.0)  # nothing is left
    assert done
    assert again == rows


def test_the_budget_is_of_steps_of_present_agents(tmp_path):
    # One or two agents in each of two lots, three on average, for 16 steps.
    expected, env = 3 * 16, dataclasses.replace(CONFIG.env, min_agents=1)
    changes = {"env": env, "num_steps": 50 * expected, "critic_steps": 10 * expected}
    trained(tmp_path, 0.7, time_limit=0.5, **changes)
    done, rows = trained(tmp_path, 0.7, **changes)  # resumed: the count goes on
    assert done
    assert len(rows) == 50
    assert dataclasses.replace(CONFIG, **changes).critic_updates == 10
    made = PRESENT * np.arange(1, len(rows) + 1)
    assert [row["env_steps"] for row in rows] == made.tolist()
    assert rows[-1]["steps_per_second"] == pytest.approx(PRESENT / 0.7, rel=1e-5)
    header = checkpoints.read_header(runs.latest_checkpoint(tmp_path))
    assert header["env_steps"] == made[-1]


PROGRESS = jnp.linspace(0.0, 1.0, 21)
SCALE = 3.0
CHANGES = {"num_lots": 16, "unroll_length": 40, "num_steps": 128_000}  # 100 updates
CHANGES |= {"curriculum": CurriculumConfig(crash_scale=SCALE, crash_until=0.5)}
STARTS = insert(SMALL, CHANGES | {"env.episode.max_steps": 30})


@pytest.mark.parametrize(
    ("end", "until", "progress", "expected"),
    [
        (3.0, 0.5, [0.0, 0.125, 0.25, 0.5, 0.75, 1.0], [1.0, 1.5, 2.0, 3.0, 3.0, 3.0]),
        (0.0, 1.0, [0.0, 0.25, 1.0], [1.0, 0.75, 0.0]),
        (4.0, 0.0, [0.0, 0.01, 1.0], [4.0, 4.0, 4.0]),
    ],
)
def test_the_crash_penalty_rises_linearly_to_its_scale(end, until, progress, expected):
    config = CurriculumConfig(crash_scale=end, crash_until=until)
    found = [crash_scale(config, jnp.float32(x)) for x in progress]
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_the_horizon_changes_linearly_and_the_discount_with_it():
    # 100 steps until 0.3, 500 from 0.8; 200 after a quarter of the way, 300 at half.
    config = PPOConfig(discount=0.99, curriculum=CurriculumConfig(discount_end=0.998))
    progress = jnp.array([0.0, 0.3, 0.425, 0.55, 0.8, 1.0])
    found = discount(config, progress)
    horizon = np.array([100.0, 100.0, 200.0, 300.0, 500.0, 500.0])
    np.testing.assert_allclose(found, 1 - 1 / horizon, atol=1e-7)


def test_without_a_curriculum_nothing_changes():
    config = PPOConfig(discount=0.987, env=EnvConfig(spawn=SpawnConfig(0.3, 5.0, 0.1)))
    assert config.curriculum == CurriculumConfig()
    np.testing.assert_array_equal(crash_scale(config.curriculum, PROGRESS), 1.0)
    np.testing.assert_array_equal(discount(config, PROGRESS), np.float32(0.987))
    assert training_env(config) == config.env


def test_the_training_s_environment_differs_in_its_starts_only():
    ratios = {"conflict_ratio": 0.3, "reverse_ratio": 0.2, "misaligned_ratio": 0.1}
    starts = CurriculumConfig(**ratios)
    config = PPOConfig(curriculum=starts, env=EnvConfig(num_agents=3))
    env = training_env(config)
    spawn = dataclasses.replace(config.env.spawn, **ratios)
    assert env == dataclasses.replace(config.env, spawn=spawn)
    assert Learner(config).env.env.config == env
    # One of them alone leaves the others as they are in the environment.
    only = CurriculumConfig(conflict_ratio=0.3)
    env = training_env(dataclasses.replace(config, curriculum=only))
    assert env.spawn == dataclasses.replace(config.env.spawn, conflict_ratio=0.3)


def test_only_the_crash_term_to_learn_from_is_scaled():
    """In the same unroll at the start and at the end of the training.

    All drive ahead, at 2.5 m/s, so that many crash.
    """
    learner = sliding_learner(STARTS)
    state, collect = learner.init(), jax.jit(learner._collect)
    ahead = jnp.array([0.0, 5.0, 0.0, 0.0])  # to the means and widths of the actions
    policy = jax.tree.map(lambda x: x + ahead if x.shape == (4,) else x, state.policy)
    found = []
    for update in (0, STARTS.num_updates):
        now = dataclasses.replace(state, policy=policy, update=jnp.int32(update))
        found.append(jax.device_get(collect(now, jax.random.key(1))[1:]))
    (start, totals), (end, same) = found
    np.testing.assert_array_equal(start.observation, end.observation)
    crash = totals.reward_terms["crash"]
    assert (crash < 0).sum() >= 3
    extra = (end.reward - start.reward).sum(axis=0)
    np.testing.assert_allclose(extra, (SCALE - 1) * crash, atol=1e-5)
    penalty = (SCALE - 1) * STARTS.env.reward.crash
    changes = np.unique((end.reward - start.reward).round(4))
    np.testing.assert_allclose(changes, [-penalty, 0.0])
    assert ((end.reward != start.reward) <= (end.terminated > 0)).all()
    # What is reported knows nothing of it.
    jax.tree.map(np.testing.assert_array_equal, totals, same)
    reported = sum(totals.reward_terms.values())
    np.testing.assert_allclose(start.reward.sum(axis=0), reported, atol=1e-5)
