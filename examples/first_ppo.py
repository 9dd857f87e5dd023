"""CleanRL's PPO for continuous actions on `FirstPark-v0`, with CleanRL's defaults.

pip install -e . gymnasium torch
python examples/first_ppo.py

Batches of CleanRL's size come from 64 lots of `gymnasium.make_vec` instead of one, and
the learning rate is constant. CleanRL's wrappers that normalise are left out:
observations and rewards are of order 1.
"""

import dataclasses
import itertools
import time

import gymnasium
import numpy as np
import torch
from torch import nn
from torch.distributions import Normal

import carpark_mj  # noqa: F401  # registers the id
from carpark_mj.cli.flags import read_flags
from carpark_mj.cli.process import enable_output_fusion, enter
from carpark_mj.config.checks import CheckedConfig, Count

NAME = "carpark_mj/FirstPark-v0"
DISCOUNT, GAE_LAMBDA, CLIP, EPOCHS, MINIBATCHES = 0.99, 0.95, 0.2, 10, 32


@dataclasses.dataclass(frozen=True)
class Settings(CheckedConfig):
    """Settings of the example.

    Attributes:
        steps: steps of training, of all lots together.
        lots: number of lots simulated at once.
        unroll: steps of each lot between updates.
        seed: seed of training; evaluation has another.
        episodes: number of episodes of the evaluation.
    """

    steps: Count = 400_000
    lots: Count = 64
    unroll: Count = 32
    seed: int = 0
    episodes: Count = 512


def network(sizes: tuple[int, ...], gain: float) -> nn.Sequential:
    """Tanh between linear layers, orthogonal weights, `gain` in the last."""
    layers: list[nn.Module] = []
    for before, after in itertools.pairwise(sizes):
        layer = nn.Linear(before, after)
        last = len(layers) == 2 * (len(sizes) - 2)
        nn.init.orthogonal_(layer.weight, gain if last else 2**0.5)
        nn.init.zeros_(layer.bias)
        layers += [layer, nn.Tanh()]
    return nn.Sequential(*layers[:-1])


class Agent(nn.Module):
    """Actor and critic of two hidden layers each."""

    def __init__(self, observation: int, action: int) -> None:
        """Makes the networks from the numbers of an observation and an action."""
        super().__init__()
        self.mean = network((observation, 64, 64, action), 0.01)
        self.critic = network((observation, 64, 64, 1), 1.0)
        self.log_std = nn.Parameter(torch.zeros(action))

    def policy(self, observation: torch.Tensor) -> Normal:
        """The distribution of actions; those out of range are clipped."""
        return Normal(self.mean(observation), self.log_std.exp())

    def value(self, observation: torch.Tensor) -> torch.Tensor:
        """The discounted sum of rewards to come."""
        return self.critic(observation)[..., 0]


def main(settings: Settings) -> None:
    """Trains and evaluates."""
    begun = time.perf_counter()
    enable_output_fusion()  # before JAX computes anything
    torch.set_num_threads(1)  # JAX has the other core
    torch.manual_seed(settings.seed)
    lots = gymnasium.make_vec(NAME, settings.lots)
    seen, _ = lots.reset(seed=settings.seed)
    observation = torch.from_numpy(np.array(seen))
    agent = Agent(observation.shape[1], lots.single_action_space.shape[0])
    optimizer = torch.optim.Adam(agent.parameters(), 3e-4, eps=1e-5)
    size = settings.lots * settings.unroll
    steps, parked, ended = 0, 0, 0
    for number in range(1, -(-settings.steps // size) + 1):
        batch = []
        for _ in range(settings.unroll):
            with torch.no_grad():
                policy, value = agent.policy(observation), agent.value(observation)
                action = policy.sample()
            seen, reward, terminated, truncated, infos = lots.step(action.numpy())
            done = terminated | truncated
            if done.any():
                parked += infos["final_info"]["is_success"].sum()
                ended += done.sum()
            log_prob = policy.log_prob(action).sum(-1)
            others = torch.tensor(reward), torch.tensor(done).float()
            batch.append((observation, action, log_prob, value, *others))
            observation = torch.from_numpy(np.array(seen))
        with torch.no_grad():
            last = agent.value(observation)
        update(agent, optimizer, batch, last)
        steps += size
        if number % 20 == 0:
            seconds, rate = time.perf_counter() - begun, parked / max(ended, 1)
            print(f"{seconds:4.0f} s {steps:>9,} steps {rate:6.1%} parked", flush=True)
            parked, ended = 0, 0
    rate = evaluate(agent, settings)
    seconds = time.perf_counter() - begun
    print(
        f"held out: {rate:.1%} of {settings.episodes} episodes parked, "
        f"{steps:,} steps, {seconds:.0f} s"
    )


def update(
    agent: Agent, optimizer: torch.optim.Optimizer, batch: list, last: torch.Tensor
) -> None:
    """An update of PPO from steps of all lots and the values after the last step."""
    seen, action, before, value, reward, done = map(
        torch.stack, zip(*batch, strict=True)
    )
    gain, ahead, following = torch.zeros_like(value), torch.zeros_like(last), last
    for t in reversed(range(len(batch))):
        goes_on = 1.0 - done[t]
        error = reward[t] + DISCOUNT * following * goes_on - value[t]
        ahead = error + DISCOUNT * GAE_LAMBDA * goes_on * ahead
        gain[t], following = ahead, value[t]
    flat = [x.flatten(0, 1) for x in (seen, action, before, value, gain, gain + value)]
    for _ in range(EPOCHS):
        for rows in torch.randperm(len(flat[0])).chunk(MINIBATCHES):
            seen, action, before, value, gain, target = (x[rows] for x in flat)
            ratio = (agent.policy(seen).log_prob(action).sum(-1) - before).exp()
            gain = (gain - gain.mean()) / (gain.std(correction=0) + 1e-8)
            clipped = ratio.clamp(1.0 - CLIP, 1.0 + CLIP)
            actor_loss = -torch.min(ratio * gain, clipped * gain).mean()
            now = agent.value(seen)
            near = value + (now - value).clamp(-CLIP, CLIP)
            error = torch.max((now - target) ** 2, (near - target) ** 2).mean()
            optimizer.zero_grad()
            (actor_loss + 0.25 * error).backward()
            nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
            optimizer.step()


@torch.no_grad()
def evaluate(agent: Agent, settings: Settings) -> float:
    """The rate of parking of the mean action in the first episodes of new lots."""
    lots = gymnasium.make_vec(NAME, settings.episodes)
    seen, _ = lots.reset(seed=settings.seed + 10**6)
    running, parked = np.ones(settings.episodes, bool), 0
    while running.any():
        action = agent.policy(torch.from_numpy(np.array(seen))).mean
        seen, _, terminated, truncated, infos = lots.step(action.numpy())
        done = (terminated | truncated) & running
        if done.any():
            parked += (infos["final_info"]["is_success"] & done).sum()
        running &= ~done
    return parked / settings.episodes


def run() -> None:
    """Trains with the settings on the command line."""
    main(read_flags(Settings, description=__doc__))


if __name__ == "__main__":
    enter("first_ppo", "first_ppo:run")
