"""PPO in one file, after CleanRL's: torch learns from lots that JAX simulates.

pip install -e ".[eval]" torch
python examples/cleanrl_ppo.py

Every agent of every lot is an environment; all share one policy. It prints and draws
the parked rate during training, and measures it on other seeds. Success is `strict`:
within the lines, straight, at rest. With `--cameras` agents know others and walls
from the pictures of four cameras only.
"""

import dataclasses
import os
import time
from pathlib import Path
from typing import Any

import jax
import torch
from matplotlib.figure import Figure
from torch import nn
from torch.distributions import Normal

from carpark_mj.cameras.encoder import CameraObservation
from carpark_mj.cli.flags import read_flags
from carpark_mj.cli.process import enable_output_fusion, enter
from carpark_mj.config import EnvConfig, EpisodeConfig, RayConfig, RingConfig
from carpark_mj.config.checks import CheckedConfig, Count, NonNegative, Positive, Ratio
from carpark_mj.env import ParkingEnv
from carpark_mj.files import require_writable
from carpark_mj.tasks.environment import JointEnv
from carpark_mj.wrappers.torch_batch import TorchBatch


@dataclasses.dataclass(frozen=True)
class Settings(CheckedConfig):
    """Settings of the example.

    Attributes:
        minutes: duration of training [min].
        lots: number of lots simulated at once.
        agents: number of agents in a lot.
        layout: layout of the lots.
        cameras: observe pictures, and otherwise only the own motion and the goal.
        seed: seed of training; evaluation has another.
        unroll: steps between updates.
        epochs: passes over the steps of an update.
        minibatches: minibatches in an epoch.
        learning_rate: learning rate at the start; falls to a tenth.
        discount: discount factor per step.
        gae_lambda: lambda of generalised advantage estimation.
        clip: clipping range of the probability ratio.
        entropy: weight of the entropy bonus.
        episodes: least number of episodes of the evaluation.
        out: picture of the learning curve.
    """

    minutes: Positive = 12.0
    lots: Count = 64
    agents: Count = 2
    layout: str = "square"
    cameras: bool = False
    seed: int = 0
    unroll: Count = 64
    epochs: Count = 4
    minibatches: Count = 16
    learning_rate: Positive = 1e-3
    discount: Ratio = 0.99
    gae_lambda: Ratio = 0.92
    clip: Positive = 0.2
    entropy: NonNegative = 1e-3
    episodes: Count = 1024
    out: Path = Path("cleanrl_ppo.png")


class Agent(nn.Module):
    """Actor and critic, which share what looks at pictures.

    Observations (...) are vectors, or dictionaries of a `vector` and pictures.
    """

    def __init__(self, observation: Any, action: int) -> None:
        """Two hidden layers each.

        Args:
            observation: any observations.
            action: numbers of an action.
        """
        super().__init__()
        if isinstance(observation, dict):
            self.eye = nn.Sequential(
                *(nn.LazyConv2d(32, 8, 4), nn.ReLU()),
                *(nn.LazyConv2d(64, 4, 2), nn.ReLU()),
                *(nn.LazyConv2d(64, 3), nn.ReLU()),
                *(nn.Flatten(), nn.LazyLinear(128), nn.ReLU()),
            )
        size = self.features(observation).shape[-1]

        def network(outputs: int, gain: float) -> nn.Sequential:
            layers = (nn.Linear(size, 128), nn.Linear(128, 128))
            head = nn.Linear(128, outputs)
            for layer in layers:
                nn.init.orthogonal_(layer.weight, 2**0.5)
            nn.init.orthogonal_(head.weight, gain)
            return nn.Sequential(layers[0], nn.Tanh(), layers[1], nn.Tanh(), head)

        self.mean, self.critic = network(action, 0.01), network(1, 1.0)
        self.log_std = nn.Parameter(torch.full((action,), -0.5))

    def features(self, observation: Any) -> torch.Tensor:
        """Numbers (..., size) of observations."""
        if not isinstance(observation, dict):
            return observation
        pictures = [x for name, x in observation.items() if name != "vector"]
        stacked = torch.cat(pictures, dim=-3) / 255.0
        seen = self.eye(stacked.flatten(0, -4)).unflatten(0, stacked.shape[:-3])
        return torch.cat([observation["vector"], seen], dim=-1)

    def policy(self, observation: Any) -> Normal:
        """The distribution of actions; those out of range are clipped."""
        return Normal(self.mean(self.features(observation)), self.log_std.exp())

    def value(self, observation: Any) -> torch.Tensor:
        """The discounted sum of rewards to come."""
        return self.critic(self.features(observation))[..., 0]


def main(settings: Settings) -> None:
    """Trains, draws and evaluates."""
    require_writable(settings.out)  # before the work
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
    enable_output_fusion()  # both before JAX computes anything
    torch.manual_seed(settings.seed)
    config = EnvConfig(
        layout=settings.layout,
        num_agents=settings.agents,
        episode=EpisodeConfig(final_observation=True),
    )
    if settings.cameras:
        seen = CameraObservation(0, 0, rings=RingConfig(), rays=RayConfig())
        config = dataclasses.replace(config, observation=seen)
    lots = TorchBatch(ParkingEnv(config), settings.lots)
    if lots.device.type == "cpu":
        torch.set_num_threads(1)  # JAX has the other core
    observation = lots.reset(settings.seed)
    agent = Agent(jax.tree.map(torch.Tensor.cpu, observation), 2).to(lots.device)
    optimizer = torch.optim.Adam(agent.parameters(), settings.learning_rate, eps=1e-5)
    scheduled = settings.learning_rate

    begun, points, ends = time.perf_counter(), [], []
    steps = 0
    while (gone := (time.perf_counter() - begun) / 60 / settings.minutes) < 1.0:
        optimizer.param_groups[0]["lr"] = scheduled * (1.0 - 0.9 * gone)
        batch = []
        for _ in range(settings.unroll):
            with torch.no_grad():
                policy, value = agent.policy(observation), agent.value(observation)
                action = policy.sample()
                step = lots.step(action)
                # Bootstrap the value of truncated episodes.
                rest = settings.discount * agent.value(step.final_observation)
            done = step.terminated | step.truncated
            batch.append(
                {
                    "observation": observation,
                    "action": action,
                    "log_prob": policy.log_prob(action).sum(-1),
                    "value": value,
                    "reward": step.reward + rest * step.truncated,
                    "done": done.float(),
                }
            )
            ends.append((step.success.sum(), done.sum()))
            observation = step.observation
        data = jax.tree.map(lambda *tensors: torch.stack(tensors), *batch)
        with torch.no_grad():
            advantage = gae(settings, data, agent.value(observation))
        data |= {"advantage": advantage, "target": advantage + data["value"]}
        update(settings, agent, optimizer, data)
        steps += done.numel() * settings.unroll
        parked, ended = (sum(x).item() for x in zip(*ends, strict=True))
        if ended >= 2000:
            points.append((steps, parked / ended))
            ends = []
            minutes = (time.perf_counter() - begun) / 60
            print(f"{minutes:5.1f} min {steps:>11,} steps {parked / ended:6.1%} parked")
            draw(settings, points)
    rate, episodes = evaluate(agent, config, settings)
    print(f"held out: {rate:.1%} of {episodes} episodes parked")


def gae(settings: Settings, data: dict, last_value: torch.Tensor) -> torch.Tensor:
    """Advantages (unroll, lots, agents) of the steps."""
    advantage, total = torch.zeros_like(data["reward"]), 0.0
    following = last_value
    for t in reversed(range(settings.unroll)):
        goes_on = settings.discount * (1.0 - data["done"][t])
        delta = data["reward"][t] + goes_on * following - data["value"][t]
        total = delta + settings.gae_lambda * goes_on * total
        advantage[t], following = total, data["value"][t]
    return advantage


def update(
    settings: Settings, agent: Agent, optimizer: torch.optim.Optimizer, data: dict
) -> None:
    """Some epochs of PPO's clipped loss."""
    flat = jax.tree.map(lambda tensor: tensor.flatten(0, 2), data)
    count = len(flat["reward"])
    for _ in range(settings.epochs):
        order = torch.randperm(count, device=flat["reward"].device)
        for rows in order.chunk(settings.minibatches):
            part = jax.tree.map(lambda tensor: tensor[rows], flat)  # noqa: B023
            policy = agent.policy(part["observation"])
            log_prob = policy.log_prob(part["action"]).sum(-1)
            ratio = (log_prob - part["log_prob"]).exp()
            clipped = ratio.clamp(1.0 - settings.clip, 1.0 + settings.clip)
            gain = part["advantage"]
            gain = (gain - gain.mean()) / (gain.std(correction=0) + 1e-8)  # also of one
            actor_loss = -torch.min(ratio * gain, clipped * gain).mean()
            error = agent.value(part["observation"]) - part["target"]
            entropy = policy.entropy().sum(-1).mean()
            loss = actor_loss + 0.5 * (error**2).mean() - settings.entropy * entropy
            optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(agent.parameters(), 1.0)
            optimizer.step()


@torch.no_grad()
def evaluate(agent: Agent, config: EnvConfig, settings: Settings) -> tuple[float, int]:
    """The rate of parking of the mean action, one episode of each agent of new lots."""
    number = -(-settings.episodes // settings.agents)
    lots = TorchBatch(JointEnv(config), number, restart=False)
    observation, parked = lots.reset(settings.seed + 10**6), 0
    for _ in range(config.episode.max_steps):
        step = lots.step(agent.policy(observation).mean)
        observation, parked = step.observation, parked + step.success.sum().item()
    episodes = number * settings.agents
    return parked / episodes, episodes


def draw(settings: Settings, points: list[tuple[int, float]]) -> None:
    """Draws the learning curve."""
    figure = Figure(figsize=(6, 4))
    axes = figure.subplots()
    axes.plot(*zip(*points, strict=True))
    axes.set(xlabel="agent steps", ylabel="share of episodes parked", ylim=(0, 1))
    axes.set_title(f"PPO, {settings.agents} agents, {settings.layout}")
    axes.grid(alpha=0.3)
    figure.savefig(settings.out, dpi=120, bbox_inches="tight")


def run() -> None:
    """Trains with the settings on the command line."""
    main(read_flags(Settings, description=__doc__))


if __name__ == "__main__":
    enter("cleanrl_ppo", "cleanrl_ppo:run")
