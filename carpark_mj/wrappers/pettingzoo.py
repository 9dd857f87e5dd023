"""A lot as a PettingZoo environment, `carpark_mj.parallel_env(...)`."""

import copy
from typing import Any, Unpack

import jax
import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv
from pettingzoo.utils.env_logger import EnvLogger

from carpark_mj.compilation import compile_for_one_lot
from carpark_mj.config.checks import require_kind
from carpark_mj.mdp.goals import possible_choices
from carpark_mj.spawning.reset_options import ResetOptions
from carpark_mj.tasks.environment import AgentsEnvironment, JointEnv
from carpark_mj.wrappers import batch
from carpark_mj.wrappers.options import (
    Options,
    action_mask,
    action_space,
    as_reset_options,
    configure,
    discrete_table,
    flat_action,
    observation_space,
    share,
)

Results = tuple[
    dict[str, Any],
    dict[str, float],
    dict[str, bool],
    dict[str, bool],
    dict[str, dict[str, Any]],
]


def parallel_env(
    render_mode: str | None = None,
    camera: str = "topdown",
    width: int = batch.WIDTH,
    height: int = batch.HEIGHT,
    **options: Unpack[Options],
) -> "AgentsParallelEnv":
    """A lot with several agents, each with one episode.

    Examples:
        >>> env = carpark_mj.parallel_env(layout="square_compact", agents=4)
        >>> observations, infos = env.reset(seed=0)

    Pictures are those of `carpark_mj.wrappers.gymnasium_env.ParkEnv`, options those of
    `carpark_mj.wrappers.options.Options`.
    """
    compile_for_one_lot()
    config = configure(options)
    env = share(JointEnv, config)
    fps = 1 / config.sim.ctrl_dt
    screen = batch.Screen(env, camera, None, width, height)
    space = observation_space(config)
    return AgentsParallelEnv(env, space, screen, render_mode, fps, options)


class AgentsParallelEnv(ParallelEnv[str, Any, Any]):
    """Agents `agent_0`... have one episode each and leave when it ends.

    Actions out of range are clipped. In infos `is_success` is true in the step in which
    the agent parks or arrives, `crashed` in the step in which it crashes. Where agents
    choose bays, `action_mask` is for `sample` of the next action. With
    `EnvConfig.min_agents` a lot may have fewer than `possible_agents`.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "name": "carpark_mj_v0",
        "render_modes": batch.RENDER_MODES,
        "is_parallelizable": True,
    }

    def __init__(
        self,
        env: AgentsEnvironment,
        space: spaces.Box | spaces.Dict,
        screen: batch.Screen,
        render_mode: str | None,
        fps: float,
        options: Options | None = None,
    ) -> None:
        """Wraps an environment in which finished agents wait; see `parallel_env`.

        Of the options it reads `discrete` and `details`.
        """
        batch.require_render_mode(render_mode, batch.RENDER_MODES)
        self._screen = screen
        self._lots = batch.NumpyBatch(env, 1, restart=False)
        self._observation: np.ndarray | None = None
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": fps}
        self.possible_agents = env.agents
        self.agents: list[str] = []
        options = options or {}
        self._table = discrete_table(env.action_spec, options)
        self._details = options.get("details", False)
        acts = action_space(env.action_spec)
        if self._table is not None:
            acts = spaces.Discrete(len(self._table))
        # Of each agent its own, so that they can be seeded apart.
        self._spaces = {
            agent: (copy.deepcopy(space), copy.deepcopy(acts))
            for agent in self.possible_agents
        }
        box: Any = spaces.flatten_space(space)
        low, high = (np.tile(bound, env.num_agents) for bound in (box.low, box.high))
        self.state_space = spaces.Box(low, high, dtype=box.dtype)

    def observation_space(self, agent: str) -> spaces.Box | spaces.Dict:
        """The vector (observation_size,) float32, or with pictures a dictionary."""
        return self._spaces[agent][0]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """Steer and pedal (2,) in [-1, 1], or the number of a row of a table."""
        return self._spaces[agent][1]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """Resets the lot.

        The seed is that of this and all later lots; None continues the random numbers
        of the last one, or of one from the operating system. Options are by the names
        of agents, see `carpark_mj.wrappers.options.as_reset_options`.
        """
        given = self._read_options(options)
        observation = self._lots.reset_numpy(seed, given)
        self._observation = _in_a_row(observation)  # callers may change what they get
        active = np.asarray(self._lots.state.active[0])
        self.agents = [
            a for a, x in zip(self.possible_agents, active, strict=True) if x
        ]
        self._show()
        no = np.zeros_like(active[None])
        return self._by_agent(observation), self._infos(no, no)

    def step(self, actions: dict[str, Any]) -> Results:
        """Steps all agents that are still driving.

        There is an element of `action_space` for each of `agents`; those of agents that
        have left are ignored, because TorchRL sends them. `AssertionError` before
        `reset`, or for a missing agent, a wrong shape or numbers that are not finite.
        """
        if self._observation is None:
            EnvLogger.error_step_before_reset()
        if not self.agents:
            EnvLogger.warn_step_after_terminated_truncated()
            return {}, {}, {}, {}, {}
        if not {*self.agents} <= actions.keys() <= {*self.possible_agents}:
            raise AssertionError(
                f"actions must be those of {self.agents}, not of {[*actions]}"
            )
        spec = self._lots.env.action_spec
        action = np.zeros(self._lots.action_shape, spec.dtype)
        for agent in self.agents:
            row = self.possible_agents.index(agent)
            if self._table is None:
                action[0, row] = flat_action(actions[agent], spec)
            elif self.action_space(agent).contains(actions[agent]):
                action[0, row] = self._table[int(actions[agent])]
            else:
                raise AssertionError(
                    f"an action must be of {self.action_space(agent)}, not "
                    f"{actions[agent]!r}"
                )
        step = self._lots.step_numpy(action)
        self._observation = _in_a_row(step.observation)
        rewards, terminations, truncations = (
            {agent: value.item() for agent, value in self._by_agent(values).items()}
            for values in (step.reward, step.terminated, step.truncated)
        )
        infos = self._infos(step.success, step.crashed, of_step=True)
        observations = self._by_agent(step.observation)
        ended = {a for a in self.agents if terminations[a] or truncations[a]}
        self.agents = [agent for agent in self.agents if agent not in ended]
        self._show()
        return observations, rewards, terminations, truncations, infos

    def state(self) -> np.ndarray:
        """Observations of all agents in a row (n,); zeros for agents that have left."""
        if self._observation is None:
            EnvLogger.error_state_before_reset()
            raise AssertionError
        return self._observation.copy()

    def render(self) -> np.ndarray | None:
        """Draws the lot: (height, width, 3) uint8 in mode `rgb_array`, or a window."""
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
        """Closes the window and the renderer."""
        self._screen.close()

    def _read_options(self, options: dict[str, Any] | None) -> ResetOptions | None:
        require_kind("options", options, dict | None)
        by_agent = options or {}
        if by_agent == {"options": 1}:  # PettingZoo's tests pass it
            by_agent = {}
        for agent in by_agent:
            if agent not in self.possible_agents:
                raise ValueError(
                    f"unknown agent {agent!r} in the options of reset; choose from "
                    f"{self.possible_agents}"
                )
        rows = [by_agent.get(agent) for agent in self.possible_agents]
        return as_reset_options(rows, (1, len(rows)))

    def _infos(
        self, success: np.ndarray, crashed: np.ndarray, of_step: bool = False
    ) -> dict[str, dict[str, Any]]:
        told = self._lots.details(of_step) if self._details else {}
        infos = self._by_agent({"is_success": success, "crashed": crashed} | told)
        for info in infos.values():
            info.update({k: info[k].item() for k in info if not info[k].ndim})
        choices = possible_choices(self._lots.state)
        if choices is not None:
            spec = self._lots.env.action_spec
            for agent, own in self._by_agent(np.asarray(choices)).items():
                infos[agent]["action_mask"] = action_mask(spec, self._table, own)
        return infos

    def _show(self) -> None:
        if self.render_mode == "human":
            self.render()

    def _by_agent(self, values: Any) -> dict[str, Any]:
        """Values (1, num_agents, ...) of the agents that are driving, by name."""
        rows = {agent: self.possible_agents.index(agent) for agent in self.agents}
        return {a: jax.tree.map(lambda x: x[0, k], values) for a, k in rows.items()}  # noqa: B023


def _in_a_row(observation: Any) -> np.ndarray:
    """All numbers of a lot's observations (1, num_agents, ...), agent by agent."""
    rows = [x.reshape(x.shape[1], -1) for x in jax.tree.leaves(observation)]
    return np.concatenate(rows, axis=1).flatten()
