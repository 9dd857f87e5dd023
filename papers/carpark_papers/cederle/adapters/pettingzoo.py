"""The junction as a PettingZoo environment."""

from typing import Any

from carpark_mj.wrappers.pettingzoo import AgentsParallelEnv
from carpark_papers.cederle.adapters.common import (
    JunctionScreen,
    junction_env,
    observation_box,
)


def junction_parallel_env(
    render_mode: str | None = None, camera: str = "topdown", **options: Any
) -> AgentsParallelEnv:
    """A junction whose agents have one episode each; options as `parallel_env`.

    The others are fields of `JunctionConfig` but `respawn`.

    Examples:
        >>> env = junction_parallel_env(scenario="3av-hd", observation="image")
        >>> observations, infos = env.reset(seed=0)
    """
    env = junction_env(**options)
    screen = JunctionScreen(env, camera)
    fps = 1 / env.config.sim.ctrl_dt
    return AgentsParallelEnv(env, observation_box(env), screen, render_mode, fps)
