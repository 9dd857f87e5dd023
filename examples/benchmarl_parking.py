"""BenchMARL's algorithms park four cars in one lot; one command each.

pip install -e ".[torchrl,eval]"
python examples/benchmarl_parking.py --algorithm ippo
python examples/benchmarl_parking.py --algorithm mappo

It prints outcomes of evaluated episodes during training (with the starts of training),
draws the curve, and measures the rates on held-out lots; Ctrl-C ends the training
early. Success is `strict`: within the lines, straight, at rest.
On a GPU JAX and torch share the memory, so JAX must not preallocate all of it.
"""

import dataclasses
import json
import os
from pathlib import Path
from typing import Literal

import torch
from benchmarl.algorithms import algorithm_config_registry
from benchmarl.experiment import Experiment, ExperimentConfig
from benchmarl.models.mlp import MlpConfig
from matplotlib.figure import Figure
from torchrl.envs.utils import ExplorationType, set_exploration_type

from carpark_mj.cli.flags import read_flags
from carpark_mj.cli.process import enable_output_fusion, enter, patient_interrupts
from carpark_mj.config import EnvConfig, SpawnConfig
from carpark_mj.config.checks import CheckedConfig, Count
from carpark_mj.wrappers.benchmarl import ParkingTask, Rates, ending_rates
from carpark_mj.wrappers.torchrl import TorchRLParking

UNROLL = 64  # steps of a lot between updates
LARGEST_MINIBATCH = 4096  # steps of a lot
OFF_POLICY = ("maddpg", "iql", "vdn", "qmix")  # learn more often from fewer steps


@dataclasses.dataclass(frozen=True)
class Settings(CheckedConfig):
    """Settings of the example.

    Attributes:
        algorithm: algorithm of BenchMARL; the first three have continuous actions.
        agents: number of agents in a lot.
        parked_cars: number of parked cars in a lot.
        layout: layout of the lots.
        frames: steps of lots to train for, each a step of all its agents.
        lots: number of lots simulated at once; default 32, on a GPU 4096 or,
            off-policy, 1024.
        evaluations: number of evaluations, the last one at the end of training.
        seed: seed of training; the held-out lots have another.
        out: folder of the results.
    """

    algorithm: Literal["ippo", "mappo", "maddpg", "iql", "vdn", "qmix"] = "ippo"
    agents: Count = 4
    parked_cars: int = 16
    layout: str = "square"
    frames: Count = 24_000_000
    lots: Count | None = None
    evaluations: Count = 10
    seed: int = 0
    out: Path = Path("runs/benchmarl")


class Curve(Rates):
    """Prints and draws the rates of evaluations."""

    def __init__(self, path: Path, title: str) -> None:
        """Draws into `path`."""
        super().__init__()
        self._path, self._title = path, title

    def on_evaluation_end(self, rollouts) -> None:
        """Prints the rates, and redraws the curve."""
        super().on_evaluation_end(rollouts)
        row = self.history[-1]
        print(f"\n{row['frames']:>12,} frames: {words(row)}", flush=True)
        figure = Figure(figsize=(6, 4))
        axes = figure.subplots()
        for name in ("parked", "crashed", "truncated"):
            points = [(row["frames"], row[name]) for row in self.history]
            axes.plot(*zip(*points, strict=True), label=name)
        axes.set(xlabel="steps of a lot", ylim=(0, 1), title=self._title)
        axes.set_ylabel("share of episodes")
        axes.grid(alpha=0.3)
        axes.legend()
        figure.savefig(self._path, dpi=120, bbox_inches="tight")


def words(rates: dict[str, float]) -> str:
    """Rates as text."""
    names = ("parked", "crashed", "truncated")
    return ", ".join(f"{name} {rates[name]:.1%}" for name in names)


def experiment_config(settings: Settings, folder: Path) -> ExperimentConfig:
    """BenchMARL's settings for many lots at once on one device."""
    device = "cuda:0" if torch.cuda.is_available() else "cpu"
    if device == "cpu":
        torch.set_num_threads(1)  # JAX has the other core
    many = 1024 if settings.algorithm in OFF_POLICY else 4096
    lots = settings.lots or (32 if device == "cpu" else many)
    batch = lots * UNROLL
    updates = max(1, round(settings.frames / batch / settings.evaluations))
    config = ExperimentConfig.get_from_yaml()
    config.sampling_device = config.train_device = config.buffer_device = device
    config.lr, config.clip_grad_val, config.adam_eps = 1e-3, 1.0, 1e-5
    config.max_n_frames = updates * settings.evaluations * batch
    config.on_policy_n_envs_per_worker = config.off_policy_n_envs_per_worker = lots
    config.on_policy_collected_frames_per_batch = batch
    config.on_policy_n_minibatch_iters = 4
    config.on_policy_minibatch_size = min(batch // 16, LARGEST_MINIBATCH)
    config.off_policy_collected_frames_per_batch = batch
    config.off_policy_n_optimizer_steps = 128
    config.off_policy_train_batch_size = 1024
    config.evaluation_interval = updates * batch
    config.evaluation_episodes = min(lots, 256)
    config.render, config.create_json = False, False
    config.loggers, config.save_folder = ["csv"], str(folder)
    config.checkpoint_at_end = True
    return config


def held_out_rates(experiment: Experiment, options: dict, seed: int) -> dict:
    """Rates of the deterministic policy in the first episodes of 256 fresh lots."""
    env = TorchRLParking(256, seed=seed + 10**6, **options)
    steps = experiment.max_steps
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        rollout = env.rollout(steps, experiment.policy, break_when_any_done=False)
    over = rollout["next", "done"][..., 0].long()
    return ending_rates(rollout[over.cumsum(dim=1) == over])


def main(settings: Settings) -> None:
    """Trains, draws and evaluates."""
    # Before JAX computes anything.
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
    enable_output_fusion()
    name = f"{settings.algorithm}-{settings.seed}"
    folder = settings.out.resolve() / name
    folder.mkdir(parents=True, exist_ok=True)
    options = {
        "agents": settings.agents,
        "parked_cars": settings.parked_cars,
        "layout": settings.layout,
    }
    algorithm = algorithm_config_registry[settings.algorithm].get_from_yaml()
    if settings.algorithm in ("ippo", "mappo"):
        algorithm.entropy_coef = 1e-3
    title = f"{settings.algorithm.upper()}, {settings.agents} agents, {settings.layout}"
    curve = Curve(folder / "curve.png", title)
    # Three in ten episodes of training are reverse starts.
    training = EnvConfig(spawn=SpawnConfig(reverse_ratio=0.3))
    experiment = Experiment(
        task=ParkingTask.PARK.get_task(options | {"config": training}),
        algorithm_config=algorithm,
        model_config=MlpConfig.get_from_yaml(),
        critic_model_config=MlpConfig.get_from_yaml(),
        seed=settings.seed,
        config=experiment_config(settings, folder),
        callbacks=[curve],
    )
    try:
        experiment.run()
    except KeyboardInterrupt:
        print("stopped; evaluating what has been learnt", flush=True)
    found = held_out_rates(experiment, options, settings.seed)
    episodes = 256 * settings.agents
    print(f"{name}, {episodes} episodes in held-out lots: {words(found)}")
    results = {"held_out": found, "evaluations": curve.history}
    (folder / "rates.json").write_text(json.dumps(results, indent=2))


def run() -> None:
    """Trains with the settings on the command line."""
    with patient_interrupts():  # stopped, it evaluates the policy so far
        main(read_flags(Settings, description=__doc__))


if __name__ == "__main__":
    enter("benchmarl_parking", "benchmarl_parking:run")
