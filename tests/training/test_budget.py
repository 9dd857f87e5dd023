"""A training of some minutes: its end, its schedules, resumed runs, what it says."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from carpark_mj.config import EnvConfig
from carpark_mj.policy import checkpoints, runs
from carpark_mj.training.loop import read_metrics
from carpark_mj.training.ppo.collect import TrainingState, no_steps
from carpark_mj.training.ppo.config import PPOConfig
from carpark_mj.training.ppo.learn import schedule
from carpark_mj.training.ppo.learner import Learner
from carpark_mj.training.ppo.parts import PRESETS
from carpark_mj.training.ppo.train import announcement, train

CONFIG = PPOConfig(
    num_steps=64 * 100,  # 100 updates
    minutes=1.0,
    num_lots=2,
    num_minibatches=1,
    unroll_length=16,
    eval_episodes=0,
    video_seconds=0.0,
    env=EnvConfig(num_agents=2, physics="bicycle"),
)
PRESENT = 40  # steps of present agents in an update, where not all always are


class SlowLearner(Learner):
    """Its updates learn nothing but take time, on a clock of its own."""

    def __init__(self, config: PPOConfig, update_seconds: float) -> None:
        super().__init__(config)
        self.now = 1e6  # clocks do not begin at 0
        self._update_seconds = update_seconds

    def build(self) -> TrainingState:
        zero = jnp.zeros(())
        none = {name: zero for name in TrainingState.__dataclass_fields__}
        lots = jnp.zeros(self.config.num_lots)
        count, steps = jnp.zeros((), jnp.int32), no_steps()
        return TrainingState(**none | {"update": count, "steps": steps, "env": lots})

    def compile(self):
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


def test_a_fast_machine_makes_all_steps(tmp_path):
    done, rows = trained(tmp_path, 0.1)
    assert done
    np.testing.assert_allclose(
        [row["progress"] for row in rows], np.arange(100) / 100, atol=1e-7
    )


def test_without_minutes_time_does_not_count(tmp_path):
    done, rows = trained(tmp_path, 1e4, minutes=0.0)
    assert done
    assert [row["progress"] for row in rows] == [
        float(np.float32(update) / np.float32(100)) for update in range(100)
    ]


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


def test_progress_is_the_further_of_steps_and_time_and_ends_at_1():
    assert CONFIG.progress(30, 12.0) == pytest.approx(0.3)
    assert CONFIG.progress(30, 42.0) == pytest.approx(0.7)
    assert CONFIG.progress(30, 61.0) == CONFIG.progress(100, 0.0) == 1.0


def test_a_run_says_before_how_long_it_takes():
    cpu = PRESETS["cpu"]
    whole = announcement(dataclasses.replace(cpu, minutes=0.0), 0, 0.0)
    assert whole.endswith("for 50 M steps, then evaluates and renders")
    resumed = announcement(cpu, 1000, 90.0)
    left = cpu.minutes - 1.5
    steps = (cpu.num_steps - 1000 * cpu.steps_per_update) / 1e6
    assert f"for at most {left:g} min or {steps:.1f} M steps" in resumed
