"""An untrained policy, small enough to save in a moment, and its card."""

from carpark_mj.config import EnvConfig
from carpark_mj.policy.networks import NetworkConfig
from carpark_mj.training.ppo.config import PPOConfig

TINY = PPOConfig(
    name="secret",
    runs_dir="/somewhere",
    seed=7,
    num_lots=2,
    num_minibatches=2,
    networks=NetworkConfig((16,), (16,)),
    env=EnvConfig(physics="bicycle", num_parked_cars=4),
)
CARD = """## tiny

| | |
|---|---|
| task | none: it was not trained |
| training | `python train/ppo.py --seed 7` |
| steps | 0 |
| seed | 7 |
| device | two CPU cores, 0 min |

| evaluation | episodes | parked | crashed | timed out |
|---|---:|---:|---:|---:|
| `python eval/evaluate.py tiny` | 1,024 | 1.0 % (0.5 … 1.8) | 95.0 % (93.5 … 96.2) | 4.0 % (3.0 … 5.4) |

Limits:

- It does not park.
"""  # noqa: E501
