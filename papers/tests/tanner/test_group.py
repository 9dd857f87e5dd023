"""Runs side by side: each is the one that would be trained alone."""

import dataclasses
import shutil
from collections.abc import Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from carpark_mj.config import GivingWayConfig, RewardConfig, insert
from carpark_mj.mdp.rewards import GoalRewards
from carpark_mj.policy import runs
from carpark_mj.policy.checkpoints import CheckpointError
from carpark_mj.policy.networks import NetworkConfig
from carpark_mj.training.loop import read_metrics
from carpark_mj.training.ppo.collect import TrainingState
from carpark_mj.training.ppo.config import PPOConfig
from carpark_mj.training.ppo.group import GroupLearner, make_learner, program
from carpark_mj.training.ppo.learner import Learner
from carpark_mj.training.ppo.train import MAX_SKIPPED, load_or_init, train
from carpark_mj.training.run_folder import (
    MAX_SEEDS,
    list_settings,
    parse_seeds,
    read_runs,
)
from carpark_papers.tanner.environments import TANNER_DYNAMIC, TANNER_FIXED

FIXED = PPOConfig(
    num_steps=4 * 2 * 2 * 8,  # four updates
    num_lots=2,
    unroll_length=8,
    num_minibatches=2,
    num_epochs=2,
    checkpoint_minutes=1e-9,  # after every update
    curriculum=dataclasses.replace(PPOConfig().curriculum, discount_end=0.995),
    networks=NetworkConfig((16,), (16,), encoder="flat"),
    env=dataclasses.replace(TANNER_FIXED, num_agents=2, num_parked_cars=4),
)
# No weight of the rewards that can differ is 0.
DYNAMIC = dataclasses.replace(
    FIXED,
    env=dataclasses.replace(
        TANNER_DYNAMIC,
        num_agents=2,
        num_parked_cars=4,
        observation=dataclasses.replace(
            TANNER_DYNAMIC.observation, global_information=True
        ),
        giving_way=GivingWayConfig("G,G,A", bad_goal=-0.2),
        reward=RewardConfig(
            extra={"approach": 0.6, "smoothness": 2.0, "reverse": 5.0},
            goals=GoalRewards(stop_explore=-0.03, continue_goal=0.04, stop_goal=-0.02),
        ),
    ),
)


def halved(config: PPOConfig) -> PPOConfig:
    """The config with half of every number that can differ in a group."""
    shared = dict(list_settings(program(config)))
    values = {
        path: value / 2
        for path, value in list_settings(config)
        if shared[path] == 0.0 and type(value) is float
    }
    assert len(values) > 20
    return insert(config, values)


def trained(
    configs: Sequence[PPOConfig], *updates: int
) -> tuple[list[TrainingState], ...]:
    """The states of runs after so many updates, rising numbers."""
    learner = make_learner(configs)
    update, state, states = learner.compile(), learner.init(), []
    for number in range(1, updates[-1] + 1):
        state, _ = update(state)
        if number in updates:
            states.append(learner.split(host(state)))
    return tuple(states)


def host(state: TrainingState) -> TrainingState:
    """A copy as numpy arrays, keys by their data."""

    def copy(leaf):
        is_key = jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)
        return np.array(jax.random.key_data(leaf) if is_key else leaf)

    return jax.tree.map(copy, state)


def assert_same(one: TrainingState, other: TrainingState) -> None:
    """A batched matrix product rounds otherwise, by some 1e-7 of a sum's terms.

    The statistics' sums of squares are of about 1e3.
    """
    paths, _ = jax.tree_util.tree_flatten_with_path(one)
    for (path, a), b in zip(paths, jax.tree.leaves(other), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-5, err_msg=str(path))


def largest_change(one: TrainingState, other: TrainingState) -> float:
    leaves = zip(
        jax.tree.leaves(one.policy), jax.tree.leaves(other.policy), strict=True
    )
    return max(float(np.abs(a - b).max()) for a, b in leaves)


def test_a_run_of_a_group_is_the_one_with_its_seed():
    seeds = (3, 2**32 - 1)
    configs = [dataclasses.replace(FIXED, seed=seed) for seed in seeds]
    (together,) = trained(configs, 2)
    for config, state in zip(configs, together, strict=True):
        ((alone,),) = trained([config], 2)
        assert_same(state, alone)
    assert largest_change(*together) > 0.1


def test_runs_may_differ_in_every_number_that_is_data():
    """In all of them at once, and in each alone."""
    paths = ("learning_rate", "entropy_cost", "discount", "gae_lambda")
    paths += ("env.reward.time", "env.reward.progress", "env.reward.goals.stop_explore")
    paths += ("env.reward.extra.approach",)
    paths += ("env.giving_way.bad_goal", "env.episode.hitbox_scale")
    settings = dict(list_settings(DYNAMIC))
    # Nobody has crashed yet that half a car would not, but a larger one does.
    factors = {path: 4.0 if "hitbox" in path else 0.5 for path in paths}
    changed = [insert(DYNAMIC, {p: settings[p] * factors[p]}) for p in paths]
    configs = [DYNAMIC, halved(DYNAMIC)]
    (first, _, *others), together = trained([*configs, *changed], 1, 3)
    for config, state in zip(configs, together[:2], strict=True):
        ((alone,),) = trained([config], 3)
        assert_same(state, alone)
    # A hundred times the tolerance.
    assert largest_change(*together[:2]) > 1e-3
    for path, other in zip(paths, others, strict=True):
        # Measured 5e-5 of the entropy cost; equal settings differ by at most 1e-7.
        assert largest_change(first, other) > 1e-5, path


def test_a_program_is_decided_by_all_but_seeds_names_and_data():
    names = insert(FIXED, {"seed": 7, "name": "x", "runs_dir": "y", "eval_episodes": 1})
    assert hash(program(names)) == hash(program(FIXED))
    assert program(names) == program(halved(FIXED)) == program(FIXED)
    for path, value in {
        "num_lots": 4,
        "num_steps": 10**6,
        "curriculum.discount_end": 0.0,
        "averaged_updates": 3,
        "env.num_agents": 4,
        "env.reward.route": True,
        "env.giving_way.scheme": "L,L,S",
        "env.reward.goals.stop_goal": -1.0,  # a branch: it is None in the other
        "networks.value_layers": (8,),
    }.items():
        assert program(insert(FIXED, {path: value})) != program(FIXED)


def test_runs_of_two_programs_are_refused():
    other = dataclasses.replace(FIXED, unroll_length=4)
    with pytest.raises(ValueError, match="the same unroll_length, not 8 and 4"):
        make_learner([FIXED, FIXED, other])
    longer = dataclasses.replace(FIXED, env=DYNAMIC.env)
    with pytest.raises(ValueError, match="side by side must have the same env"):
        make_learner([FIXED, longer])


@pytest.fixture(scope="module")
def stopped(tmp_path_factory):
    """Two runs stopped after two updates, and the group they were."""
    folder = tmp_path_factory.mktemp("runs")
    configs = [dataclasses.replace(FIXED, seed=seed) for seed in (0, 1)]
    folders = [folder / str(config.seed) for config in configs]
    for path in folders:
        path.mkdir()
    limited = GroupLearner([dataclasses.replace(c, time_limit=1.0) for c in configs])
    ticks = iter(range(10**6))
    outcomes = train(limited, folders, lambda: 4.0 * next(ticks))
    assert outcomes == ["stopped", "stopped"]
    return configs, folders


def copied(folders: Sequence[Path], target: Path) -> list[Path]:
    return [Path(shutil.copytree(f, target / f.name)) for f in folders]


def test_a_run_of_a_group_goes_on_alone_as_in_the_group(stopped, tmp_path):
    configs, folders = stopped
    done = int(read_metrics(folders[0])[-1]["update"])
    assert 0 < done < FIXED.num_updates
    together, alone = copied(folders, tmp_path / "a"), copied(folders, tmp_path / "b")
    assert train(make_learner(configs), together) == ["done", "done"]
    assert train(make_learner(configs[1:]), alone[1:]) == ["done"]
    ((whole,),) = trained(configs[1:], FIXED.num_updates)
    for folder in (together[1], alone[1]):
        assert [row["update"] for row in read_metrics(folder)] == [1, 2, 3, 4]
        assert_same(host(load_or_init(Learner(configs[1]), [folder])), whole)


def test_a_killed_group_goes_on_from_its_last_common_checkpoint(stopped, tmp_path):
    configs, folders = stopped
    folders = copied(folders, tmp_path)
    newest = runs.checkpoint_files(folders[1])[-1]
    newest.unlink()
    state = load_or_init(make_learner(configs), folders)
    step = int(runs.checkpoint_files(folders[1])[-1].stem.removeprefix("step_"))
    assert (state.update == step // FIXED.steps_per_update).all()
    for file in runs.checkpoint_files(folders[0]):
        file.rename(file.with_name("step_999999999999.npz"))
    with pytest.raises(CheckpointError, match="resume them one by one"):
        load_or_init(make_learner(configs), folders)
    for file in runs.checkpoint_files(folders[1]):  # killed before its first
        file.unlink()
    with pytest.raises(CheckpointError, match="1 holds no checkpoint"):
        load_or_init(make_learner(configs), folders)


class Failing(GroupLearner):
    """Its second run drops every update."""

    def compile(self, scheduled=False):
        def update(state):
            skipped = state.skipped + jnp.array([0, 1])
            metrics = {
                "skipped": skipped,
                "episode/parked": jnp.zeros(2),
                "episode/crashed": jnp.zeros(2),
            }
            return state.replace(update=state.update + 1, skipped=skipped), metrics

        return update


def test_a_run_that_diverges_leaves_the_others_alone(tmp_path):
    config = dataclasses.replace(FIXED, num_steps=10 * FIXED.steps_per_update)
    folders = [tmp_path / "good", tmp_path / "bad"]
    for folder in folders:
        folder.mkdir()
    configs = [config, dataclasses.replace(config, seed=1)]
    assert train(Failing(configs), folders) == ["done", "diverged"]
    updates = [[int(row["update"]) for row in read_metrics(f)] for f in folders]
    assert updates == [[*range(1, 11)], [*range(1, MAX_SKIPPED)]]
    last = [runs.latest_checkpoint(folder).stem for folder in folders]
    steps = [10, MAX_SKIPPED - 1]
    assert last == [f"step_{n * config.steps_per_update:012d}" for n in steps]


def read(*arguments: str) -> list[PPOConfig]:
    """The runs of a command line, whose other arguments are the name and no seed."""

    def read_one(words: Sequence[str]) -> PPOConfig:
        if "--resume" in words:
            return dataclasses.replace(
                FIXED, resume=words[-1], name=" ".join(words[:-2])
            )
        seed = int(words[1]) if "--seed" in words else 0
        return dataclasses.replace(
            FIXED, seed=seed, name="" if seed else "".join(words)
        )

    return read_runs(arguments, read_one)


def test_seeds_and_several_folders_are_runs_with_names_of_their_own():
    assert parse_seeds("0..3") == [0, 1, 2, 3]
    assert parse_seeds("5, 1,7..8") == [5, 1, 7, 8]
    assert [(c.seed, c.name) for c in read("--seeds", "0..1")] == [(0, ""), (1, "")]
    named = read("--seeds=4,2", "sweep")
    assert [(c.seed, c.name) for c in named] == [(4, "sweep-4"), (2, "sweep-2")]
    assert read("name") == [dataclasses.replace(FIXED, name="name")]
    found = read("--resume", "a", "b", "--time-limit=3")
    assert [(c.resume, c.name) for c in found] == [
        ("a", "--time-limit=3"),
        ("b", "--time-limit=3"),
    ]


IMPOSSIBLE = [
    (["--seeds", "x"], "like 0..7 or 1,5,9, not 'x'"),
    (["--seeds", "-3"], "not '-3'"),
    (["--seeds"], "expected one argument"),
    (["--seeds", ""], "not ''"),
    (["--seeds", "3..1"], "must rise, .* not 3..1"),
    (["--seeds", f"0..{MAX_SEEDS}"], f"by less than {MAX_SEEDS}, not 0..1024"),
    (["--seeds", "1,0..4"], "must differ"),
    (["--seeds", str(2**32)], "seed must lie in"),
    (["--seeds", "0..1", "--seed", "5"], "not both: drop seed 5"),
    (["--seeds", "0..1", "--resume", "a"], "drop seeds"),
    (["--resume"], "expected at least one argument"),
]


@pytest.mark.parametrize(("arguments", "message"), IMPOSSIBLE)
def test_impossible_seeds_are_refused_in_a_sentence(arguments, message):
    with pytest.raises(ValueError, match=message) as caught:
        read(*arguments)
    assert "\n" not in str(caught.value)
