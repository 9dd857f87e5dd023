"""A batch of junctions as one TorchRL environment, agents grouped as `agents`."""

# It may be absent.
# pyright: basic, reportMissingImports=false

from typing import Any

import torch

from carpark_mj.wrappers.torchrl import TorchRLAgents
from carpark_papers.cederle.adapters.common import (
    JunctionScreen,
    junction_env,
    observation_box,
)


class TorchRLJunction(TorchRLAgents):
    """Junctions whose agents have one episode each; see `TorchRLAgents`.

    Actions are one of four, or with `action="scalar"` a number in [-1, 1].
    """

    success = "arrived"

    def __init__(
        self,
        junctions: int = 1,
        *,
        device: torch.device | str | None = None,
        seed: int | None = None,
        **options: Any,
    ) -> None:
        """Builds junctions from fields of `JunctionConfig` but `respawn`.

        The device must be JAX's (None = that); junction i has `seed` + i, None =
        unpredictable.
        """
        env = junction_env(**options)
        super().__init__(
            env,
            observation_box(env),
            JunctionScreen(env),
            junctions,
            {"discrete": env.config.action == "index"},
            device,
        )
        self._seed = seed
