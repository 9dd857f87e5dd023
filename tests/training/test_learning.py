"""PPO learns what can be learnt: to drive straight on into a wide bay."""

import json

import numpy as np
import pytest

from carpark_mj.config import (
    EnvConfig,
    EpisodeConfig,
    RayConfig,
    RingConfig,
    SpawnConfig,
)
from carpark_mj.observations import ContinuousObservation
from carpark_mj.policy.networks import NetworkConfig
from carpark_mj.training.ppo.config import PPOConfig
from carpark_mj.training.ppo.learner import Learner

LOT = {
    "format": "carpark_mj layout 1",
    "bays": [{"pose": [0.0, 0.0, 0.0], "size": [7.0, 4.0]}],
    "spawns": [{"pose": [-6.0, 0.0, 0.0], "size": [0.5, 0.2], "spread": 0.0}],
    "extent": [15.0, 6.0],
}
UPDATES = 40

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def rates(tmp_path_factory):
    """The share of episodes that ended parked, of every update."""
    path = tmp_path_factory.mktemp("lot") / "straight_on.json"
    path.write_text(json.dumps(LOT))
    env = EnvConfig(
        layout=str(path),
        num_agents=1,
        num_parked_cars=0,
        physics="bicycle",
        spawn=SpawnConfig(close_ratio=0.0),
        episode=EpisodeConfig(max_steps=50),
        observation=ContinuousObservation(0, 0, rings=RingConfig(), rays=RayConfig(0)),
    )
    config = PPOConfig(
        num_lots=64,
        unroll_length=50,
        num_minibatches=2,
        learning_rate=3e-3,
        networks=NetworkConfig((32,), (32,), encoder="flat"),
        env=env,
    )
    learner = Learner(config)
    update, state, rates = learner.compile(), learner.init(), []
    for _ in range(UPDATES):
        state, metrics = update(state)
        rates.append(float(metrics["episode/parked"]))
    return np.array(rates)


def test_at_first_it_hardly_ever_parks_and_soon_always(rates):
    assert rates[:3].mean() < 0.2
    assert rates[-5:].mean() > 0.95
