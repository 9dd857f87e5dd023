"""Stable-Baselines3's SAC with hindsight replay (HER) learns to drive to a pose.

pip install -e ".[sb3]" && python examples/sb3_her.py

It writes a learning curve and prints the rates of whole episodes on other seeds;
success is that of highway-env's parking, see `carpark_mj.tasks.goal_pose`.
"""

import dataclasses
from pathlib import Path

from carpark_mj.cli.process import enable_output_fusion

enable_output_fusion()  # before JAX computes anything

import torch  # noqa: E402
from sb3_curve import Curve, rates  # noqa: E402
from stable_baselines3 import SAC, HerReplayBuffer  # noqa: E402
from stable_baselines3.common.vec_env import VecMonitor  # noqa: E402

from carpark_mj.cli.flags import read_flags  # noqa: E402
from carpark_mj.cli.process import enter  # noqa: E402
from carpark_mj.config.checks import CheckedConfig, Count, Positive  # noqa: E402
from carpark_mj.files import require_writable  # noqa: E402
from carpark_mj.wrappers.sb3 import ParkVecEnv  # noqa: E402


@dataclasses.dataclass(frozen=True)
class Settings(CheckedConfig):
    """Settings of the example.

    Attributes:
        minutes: duration of training [min].
        lots: number of lots simulated at once.
        layout: layout of the lots.
        parked_cars: number of parked cars in a lot.
        seed: seed of training; evaluation has another.
        episodes: number of episodes of the evaluation.
        out: picture of the learning curve.
    """

    minutes: Positive = 15.0
    lots: Count = 32
    layout: str = "square"
    parked_cars: int = 0
    seed: int = 0
    episodes: Count = 256
    out: Path = Path("sb3_her.png")


def main(settings: Settings) -> None:
    """Trains, plots and evaluates."""
    require_writable(settings.out)  # before the work
    torch.set_num_threads(1)  # JAX has the other core, and theirs would fight
    name = "carpark_mj/ParkGoal-v0"
    options = {"layout": settings.layout, "parked_cars": settings.parked_cars}
    env = VecMonitor(ParkVecEnv(name, settings.lots, **options))
    curve = Curve(settings.minutes)
    model = SAC(
        "MultiInputPolicy",
        env,
        replay_buffer_class=HerReplayBuffer,
        replay_buffer_kwargs={"n_sampled_goal": 4, "copy_info_dict": True},
        buffer_size=500_000,
        batch_size=256,
        gamma=0.97,
        tau=0.02,
        learning_rate=1e-3,
        learning_starts=250 * settings.lots,  # whole episodes, for HER to relabel
        gradient_steps=8,
        policy_kwargs={"net_arch": [128, 128]},
        stats_window_size=500,
        seed=settings.seed,
        device="cpu",
    )
    model.learn(10**9, callback=curve)
    curve.plot(settings.out, f"SAC + HER on {name}, {settings.layout}")
    fresh = VecMonitor(ParkVecEnv(name, settings.lots, **options))
    fresh.seed(settings.seed + 10**6)
    found = rates(model, fresh, settings.episodes)
    print(", ".join(f"{end} {rate:.1%}" for end, rate in found.items()))


def run() -> None:
    """Trains with the settings on the command line."""
    main(read_flags(Settings, description=__doc__))


if __name__ == "__main__":
    enter("sb3_her", "sb3_her:run")
