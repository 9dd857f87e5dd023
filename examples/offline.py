"""Learns from recorded episodes without driving: behaviour cloning, or IQL.

pip install -e ".[eval,planner,minari]" torch
carpark_mj record planner --environment first --episodes 1000 --noise 0.3 --out data
python examples/offline.py --data data
python examples/offline.py --data data --method iql

Implicit Q-learning (Kostrikov et al. 2021, arXiv 2110.06169) weighs the recorded
actions by how much better than usual they are; behaviour cloning weighs them equally.
"""

import copy
import dataclasses
import json
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from torch import nn

import carpark_mj
from carpark_mj.cli.flags import read_flags
from carpark_mj.cli.process import enter
from carpark_mj.config import EnvConfig
from carpark_mj.config.checks import CheckedConfig, Count, NonNegative, Ratio
from carpark_mj.policy.runs import from_dict

ROWS = ("observations", "next_observations", "actions", "rewards", "terminations")


@dataclasses.dataclass(frozen=True)
class Settings(CheckedConfig):
    """Settings of the example.

    Attributes:
        data: folder of `carpark_mj record`.
        method: behaviour cloning or implicit Q-learning.
        steps: gradient steps.
        batch: rows of a gradient step.
        seed: of training.
        episodes: held-out episodes of the evaluation.
        discount: of rewards, per step.
        expectile: of the actions by which IQL values a state.
        temperature: how strongly IQL prefers better actions.
        out: folder of the evaluation.
    """

    data: str = "data"
    method: Literal["bc", "iql"] = "bc"
    steps: Count = 10_000
    batch: Count = 256
    seed: int = 0
    episodes: Count = 1024
    discount: Ratio = 0.99
    expectile: Ratio = 0.7
    temperature: NonNegative = 3.0
    out: str = "runs/offline"


class Network(nn.Module):
    """Two hidden layers on normalised numbers."""

    def __init__(self, rows: torch.Tensor, outputs: int, *last: nn.Module) -> None:
        """Normalises by the mean and deviation of some rows (n, size)."""
        super().__init__()
        self.register_buffer("mean", rows.mean(0))
        self.register_buffer("deviation", rows.std(0).clamp(min=0.1))
        layers = nn.Linear(rows.shape[1], 256), nn.ReLU(), nn.Linear(256, 256)
        self.layers = nn.Sequential(*layers, nn.ReLU(), nn.Linear(256, outputs), *last)

    def forward(self, rows: torch.Tensor) -> torch.Tensor:
        """Numbers (n, outputs)."""
        return self.layers((rows - self.mean) / self.deviation)


class Critics(nn.Module):
    """Two values of an action, and the value of a state."""

    def __init__(self, seen: torch.Tensor, action: torch.Tensor) -> None:
        """Makes the networks for recorded rows."""
        super().__init__()
        both = torch.cat([seen, action], -1)
        self.actions = nn.ModuleList([Network(both, 1) for _ in range(2)])
        self.state = Network(seen, 1)

    def values(self, seen: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        """Of the actions (2, n)."""
        both = torch.cat([seen, action], -1)
        return torch.stack([critic(both)[:, 0] for critic in self.actions])


def learn(settings: Settings, rows: dict[str, torch.Tensor]) -> nn.Module:
    """The actor of recorded transitions."""
    torch.set_num_threads(1)
    torch.manual_seed(settings.seed)
    seen, action = rows["observations"], rows["actions"]
    actor, critics = Network(seen, action.shape[1], nn.Tanh()), Critics(seen, action)
    targets = copy.deepcopy(critics)
    optimizer = torch.optim.Adam([*actor.parameters(), *critics.parameters()], 3e-4)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, settings.steps)
    for step in range(1, settings.steps + 1):
        chosen = torch.randint(len(seen), (settings.batch,))
        now = {name: value[chosen] for name, value in rows.items()}
        seen_now, acted = now["observations"], now["actions"]
        weight, loss = torch.ones(settings.batch), torch.zeros(())
        if settings.method == "iql":
            with torch.no_grad():
                best = targets.values(seen_now, acted).min(0).values
                after = critics.state(now["next_observations"])[:, 0]
                goes_on = 1.0 - now["terminations"]
                goal = now["rewards"] + settings.discount * goes_on * after
            gain = best - critics.state(seen_now)[:, 0]
            share = (settings.expectile - (gain < 0).float()).abs()
            values = critics.values(seen_now, acted)
            loss = (share * gain**2).mean() + ((values - goal) ** 2).mean()
            weight = (settings.temperature * gain.detach()).exp().clamp(max=100.0)
        missed = ((actor(seen_now) - acted) ** 2).sum(-1)
        loss = loss + (weight * missed).mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
        for old, new in zip(targets.parameters(), critics.parameters(), strict=True):
            old.data.lerp_(new.data, 0.005)
        if step % 2000 == 0:
            print(f"{step:>7,} steps, mean squared error {missed.mean():.4f}")
    return actor


def main(settings: Settings) -> None:
    """Learns and evaluates."""
    folder = Path(settings.data)
    about = json.loads((folder / "recording.json").read_text())
    with np.load(folder / "episodes.npz") as arrays:
        rows = {name: torch.tensor(arrays[name], dtype=torch.float32) for name in ROWS}
    print(f"{len(rows['rewards']):,} steps, {about['parked']:.1%} of episodes parked")
    actor = learn(settings, rows)
    env = from_dict(EnvConfig, about["environment"]["config"])
    policy = carpark_mj.from_torch(actor, env)
    carpark_mj.evaluate(policy, episodes=settings.episodes, out=settings.out)


def run() -> None:
    """Learns with the settings on the command line."""
    main(read_flags(Settings, description=__doc__))


if __name__ == "__main__":
    enter("offline", "offline:run")
