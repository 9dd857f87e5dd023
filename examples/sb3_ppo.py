"""Stable-Baselines3's PPO learns to park one car among sixteen on two cores.

pip install -e ".[sb3]" && python examples/sb3_ppo.py

It writes a learning curve and prints the rates of whole episodes on other seeds;
success is `strict`: within the lines, straight and at rest. With `--cameras` the car
knows others and walls from the pictures of four cameras only.
"""

import dataclasses
from pathlib import Path

from carpark_mj.cli.process import enable_output_fusion

enable_output_fusion()  # before JAX computes anything

import torch  # noqa: E402
from sb3_curve import Curve, rates  # noqa: E402
from stable_baselines3 import PPO  # noqa: E402
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize  # noqa: E402

from carpark_mj.cameras.encoder import CameraObservation  # noqa: E402
from carpark_mj.cli.flags import read_flags  # noqa: E402
from carpark_mj.cli.process import enter  # noqa: E402
from carpark_mj.config import EnvConfig, RayConfig, RingConfig, SpawnConfig  # noqa: E402
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
        cameras: observe pictures, and otherwise only the own motion and the goal.
        seed: seed of training; evaluation has another.
        episodes: number of episodes of the evaluation.
        out: picture of the learning curve.
    """

    minutes: Positive = 14.0
    lots: Count = 256
    layout: str = "square"
    cameras: bool = False
    seed: int = 0
    episodes: Count = 1024
    out: Path = Path("sb3_ppo.png")


def main(settings: Settings) -> None:
    """Trains, plots and evaluates."""
    require_writable(settings.out)  # before the work
    torch.set_num_threads(1)  # JAX has the other core, and theirs would fight
    name, layout = "carpark_mj/Park-v0", settings.layout
    # Three in ten episodes of training are reverse starts.
    config, keys = EnvConfig(layout=layout), None
    if settings.cameras:
        seen = CameraObservation(0, 0, rings=RingConfig(), rays=RayConfig())
        config, keys = dataclasses.replace(config, observation=seen), ["vector"]
    spawn = SpawnConfig(reverse_ratio=0.3)
    training = dataclasses.replace(config, spawn=spawn)
    env = VecMonitor(ParkVecEnv(name, settings.lots, config=training))
    env = VecNormalize(env, norm_reward=False, norm_obs_keys=keys)
    curve = Curve(settings.minutes)
    model = PPO(
        "MultiInputPolicy" if settings.cameras else "MlpPolicy",
        env,
        n_steps=32,
        batch_size=512,
        n_epochs=4,
        learning_rate=lambda left: 5e-5 + 1.45e-3 * curve.progress_left(left),
        gamma=0.99,
        gae_lambda=0.95,
        ent_coef=2e-3,
        max_grad_norm=1.0,
        policy_kwargs={
            "net_arch": [128, 128],
            "log_std_init": -0.5,
            "activation_fn": torch.nn.SiLU,
        },
        stats_window_size=1000,
        seed=settings.seed,
        device="cpu",
    )
    model.learn(10**9, callback=curve)
    curve.plot(settings.out, f"PPO on {name}, {layout}")
    fresh = VecMonitor(ParkVecEnv(name, settings.lots, config=config))
    fresh = VecNormalize(fresh, training=False, norm_reward=False, norm_obs_keys=keys)
    fresh.obs_rms = env.obs_rms
    fresh.seed(settings.seed + 10**6)
    found = rates(model, fresh, settings.episodes)
    print(", ".join(f"{end} {rate:.1%}" for end, rate in found.items()))


def run() -> None:
    """Trains with the settings on the command line."""
    main(read_flags(Settings, description=__doc__))


if __name__ == "__main__":
    enter("sb3_ppo", "sb3_ppo:run")
