"""A lot as a PettingZoo environment, `carpark_mj.parallel_env(...)`."""

from typing import Any, Unpack

import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv
from pettingzoo.utils.env_logger import EnvLogger

from carpark_mj.config import EnvConfig
from carpark_mj.wrappers.batch import NumpyBatch
from carpark_mj.wrappers.joint import joint_env
from carpark_mj.wrappers.options import Options, configure
from carpark_mj.wrappers.screen import RENDER_MODES, Screen
from carpark_mj.wrappers.spaces import action_space, flat_action, observation_space

Results = tuple[
    dict[str, np.ndarray],
    dict[str, float],
    dict[str, bool],
    dict[str, bool],
    dict[str, dict[str, Any]],
]


def parallel_env(
    render_mode: str | None = None,
    camera: str = "topdown",
    **options: Unpack[Options],
) -> "ParkingParallelEnv":
    """A lot with several agents, each with one episode.

    Examples:
        >>> env = carpark_mj.parallel_env(layout="compact", agents=4)
        >>> observations, infos = env.reset(seed=0)

    Args:
        render_mode: `rgb_array`, `human` (a window, drawn at every step) or None.
        camera: of `render`; `topdown`, `overview`, `chase:K`, `driver:K`, `split:K`.
        **options: see `carpark_mj.wrappers.options.Options`.

    Raises:
        TypeError: unknown option.
        ValueError: impossible value.
    """
    if render_mode not in (None, *RENDER_MODES):
        raise ValueError(
            f"unknown render_mode {render_mode!r}; choose from {RENDER_MODES}"
        )
    return ParkingParallelEnv(configure(options), render_mode, camera)


class ParkingParallelEnv(ParallelEnv[str, np.ndarray, Any]):
    """Agents `agent_0`... park in a lot and leave when their episodes end.

    Actions out of range are clipped. Infos say `is_success` in the step in which an
    agent has parked, and `crashed` in that in which it has crashed.

    Attributes:
        agents: who is still driving.
        possible_agents: everyone; with `EnvConfig.min_agents` a lot may have fewer.
        state_space: of `state()`.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "name": "carpark_mj_v0",
        "render_modes": RENDER_MODES,
        "is_parallelizable": True,
    }

    def __init__(self, config: EnvConfig, render_mode: str | None, camera: str) -> None:
        """Builds the environment; see `parallel_env`."""
        self._env = joint_env(config)
        self._lots = NumpyBatch(self._env, 1, restart=False)
        self._screen = Screen(self._env, camera)
        self._observation: np.ndarray | None = None
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": 1 / config.sim.ctrl_dt}
        self.possible_agents = self._env.agents
        self.agents: list[str] = []
        # Of each agent its own, so that they can be seeded apart.
        self._spaces = {
            agent: (observation_space(config), action_space(self._env.action_spec))
            for agent in self.possible_agents
        }
        box, times = observation_space(config), config.num_agents
        self.state_space = spaces.Box(np.tile(box.low, times), np.tile(box.high, times))

    def observation_space(self, agent: str) -> spaces.Box:
        """The vector (observation_size,) of `docs/mdp.md`, float32."""
        return self._spaces[agent][0]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """Steer and pedal (2,) in [-1, 1]; see `carpark_mj.wrappers.spaces`."""
        return self._spaces[agent][1]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, dict[str, Any]]]:
        """Starts the lot anew.

        Args:
            seed: of this and all later lots; None continues the last one, and takes one
                from the operating system if there is none.
            options: unused.
        """
        self._observation = observation = self._lots.reset_numpy(seed)[0]
        self.agents = self.possible_agents
        active = self._by_agent(np.asarray(self._lots.state.active[0]))
        self.agents = [agent for agent, drives in active.items() if drives]
        self._show()
        return self._by_agent(observation), {agent: {} for agent in self.agents}

    def step(self, actions: dict[str, Any]) -> Results:
        """Steps all agents that are still driving.

        Args:
            actions: an element of `action_space` for each of `agents`.

        Raises:
            AssertionError: before `reset`, a missing agent, a wrong shape or NaN.
        """
        if self._observation is None:
            EnvLogger.error_step_before_reset()
        if not self.agents:
            EnvLogger.warn_step_after_terminated_truncated()
            return {}, {}, {}, {}, {}
        if actions.keys() != {*self.agents}:
            raise AssertionError(
                f"actions must be those of {self.agents}, not of {sorted(actions)}"
            )
        spec = self._env.action_spec
        action = np.zeros(self._lots.action_shape, spec.dtype)
        for agent, given in actions.items():
            action[0, self.possible_agents.index(agent)] = flat_action(given, spec)
        step = self._lots.step_numpy(action)
        self._observation = observation = step.observation[0]
        ends = step.reward, step.terminated, step.truncated, step.parked, step.crashed
        rewards, terminations, truncations, parked, crashed = (
            {agent: value.item() for agent, value in self._by_agent(values[0]).items()}
            for values in ends
        )
        infos = {
            agent: {"is_success": parked[agent], "crashed": crashed[agent]}
            for agent in self.agents
        }
        observations = self._by_agent(observation)
        self.agents = [
            agent
            for agent in self.agents
            if not (terminations[agent] or truncations[agent])
        ]
        self._show()
        return observations, rewards, terminations, truncations, infos

    def state(self) -> np.ndarray:
        """All agents' observations, one after the other; zeros of those who have left.

        Returns:
            (num_agents * observation_size,) float32.
        """
        if self._observation is None:
            EnvLogger.error_state_before_reset()
            raise AssertionError
        return self._observation.ravel()

    def render(self) -> np.ndarray | None:
        """Draws the lot: (height, width, 3) uint8 by `rgb_array`, or in the window."""
        if self._observation is None:
            EnvLogger.error_render_before_reset()
        if self.render_mode == "rgb_array":
            return self._screen.picture(self._lots.state)
        if self.render_mode == "human":
            self._screen.show(self._lots.state)
        else:
            EnvLogger.get_logger().warning("render() needs a render_mode")
        return None

    def close(self) -> None:
        """Closes the window, and what draws."""
        self._screen.close()

    def _show(self) -> None:
        if self.render_mode == "human":
            self.render()

    def _by_agent(self, values: np.ndarray) -> dict[str, Any]:
        """Values (num_agents, ...) of the agents that are driving, by name."""
        by_name = dict(zip(self.possible_agents, values, strict=True))
        return {agent: by_name[agent] for agent in self.agents}
