"""One agent in one lot as a Gymnasium environment: `carpark_mj/Park-v0`."""

import dataclasses
import inspect
from types import FrameType
from typing import Any, Unpack

import gymnasium
import jax
import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import ResetNeeded

from carpark_mj.config import EnvConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.wrappers.batch import NumpyBatch, require_shape
from carpark_mj.wrappers.gymnasium_spaces import (
    action_space,
    observation_space,
)
from carpark_mj.wrappers.options import OPTIONS, Options, configure, shared_env
from carpark_mj.wrappers.reset_options import as_reset_options
from carpark_mj.wrappers.screen import RENDER_MODES, Screen

ONE_AGENT = tuple(name for name in OPTIONS if name != "agents")


class TimeLimited:
    """A spec that says after how many steps episodes are truncated."""

    _batch: NumpyBatch
    _spec: EnvSpec | None = None

    @property
    def spec(self) -> EnvSpec | None:
        """How to make the environment; Gymnasium sets it without the time limit."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        if spec is not None:
            spec.max_episode_steps = self._batch.env.config.episode.max_steps
        self._spec = spec


class ParkEnv(TimeLimited, gymnasium.Env[Any, np.ndarray]):  # pyright: ignore[reportIncompatibleVariableOverride]
    """One agent parks.

    - observation: (size,) float32, the fields of `docs/mdp.md`; with cameras a
      dictionary, see `carpark_mj.observations.unpack`.
    - action: (2,) float32, steer and pedal in [-1, 1]; numbers out of range are
      clipped. On the grid: indices of an acceleration and a turn.
    - reward: the sum of the terms of `docs/mdp.md`.
    - end: terminated when parked or crashed, truncated when out of time; then `reset`
      draws the next lot.
    - info: `is_success` (parked) and `crashed`.
    """

    metadata: dict[str, Any] = {"render_modes": RENDER_MODES}  # noqa: RUF012

    def __init__(
        self,
        render_mode: str | None = None,
        camera: str = "topdown",
        **options: Unpack[Options],
    ) -> None:
        """Makes the environment; it is compiled by the first reset and step.

        Args:
            render_mode: None, `human` or `rgb_array`.
            camera: of pictures, see `carpark_mj.rendering.renderer.camera_names`.
            **options: see `Options`; there is always one agent.

        Raises:
            TypeError: an unknown option.
            ValueError: an impossible one.
        """
        if render_mode not in (None, *RENDER_MODES):
            raise ValueError(
                f"unknown render_mode {render_mode!r}; choose from {RENDER_MODES}, or "
                "'rgb_array_list' in gymnasium.make"
            )
        if (steps := _asked_steps(inspect.currentframe())) is not None:
            options["max_episode_steps"] = steps
        self._batch = NumpyBatch(self._make(options), 1, restart=False)
        env = self._batch.env
        self.render_mode = render_mode
        frames_per_second = round(1.0 / env.config.sim.ctrl_dt)
        self.metadata = {**self.metadata, "render_fps": frames_per_second}
        self.observation_space = observation_space(env)
        self.action_space = action_space(env.action_spec)
        self._screen = Screen(shared_env(env.config), camera)
        self._running = False

    def _make(self, options: Options) -> ParkingEnv:
        return shared_env(one_agent(configure(options, ONE_AGENT)))

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begins an episode in another lot.

        Args:
            seed: in [0, 2**32); None = continue with the lot's own random numbers.
            options: `pose`, `speed` and `goal` of the start, drawn where left out;
                see `carpark_mj.wrappers.reset_options`.

        Returns:
            What the agent observes, and the info.

        Raises:
            ValueError: a seed out of range, an unknown option, or an impossible start,
                such as an unknown bay or a pose on a wall.
        """
        super().reset(seed=seed)
        given = as_reset_options([options], (1, 1))
        observation = self._batch.reset_numpy(seed, given)
        self._running = True
        self._show()
        return _alone(observation), {"is_success": False, "crashed": False}

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Advances by a control step; see the class.

        Raises:
            ResetNeeded: before the first `reset`, or after the end of an episode.
            ValueError: an action of another shape, or NaN.
        """
        if not self._running:
            raise ResetNeeded("call reset before the first step of an episode")
        action = np.asarray(action)
        require_shape("an action", action, self.action_space.shape)
        step = self._batch.step_numpy(action[None, None])
        terminated, truncated = bool(step.terminated[0, 0]), bool(step.truncated[0, 0])
        self._running = not (terminated or truncated)
        crashed = bool(step.crashed[0, 0])
        info = {"is_success": terminated and not crashed, "crashed": crashed}
        self._show()
        reward = float(step.reward[0, 0])
        return _alone(step.observation), reward, terminated, truncated, info

    def render(self) -> Any:
        """A picture (height, width, 3) uint8 in mode `rgb_array`, else None."""
        if self.render_mode == "rgb_array":
            return self._screen.picture(self._batch.state)
        return None

    def close(self) -> None:
        """Closes windows and renderers."""
        self._screen.close()

    def _show(self) -> None:
        if self.render_mode == "human":
            self._screen.show(self._batch.state)


def _alone(observation: Any) -> Any:
    """The observation of the only agent of the only lot."""
    return jax.tree.map(lambda x: x[0, 0], observation)


def _asked_steps(frame: FrameType | None) -> int | None:
    """`max_episode_steps` of `gymnasium.make`, if that called the frame.

    Gymnasium gives it to `TimeLimit` alone, which cannot make episodes longer and does
    not know of rewards that are shares of the time limit.
    """
    caller = frame and frame.f_back
    if caller is None or caller.f_code is not gymnasium.make.__code__:
        return None
    steps = caller.f_locals["max_episode_steps"]
    if steps is None:
        steps = caller.f_locals["env_spec"].max_episode_steps
    return None if steps == -1 else steps  # -1 is no `TimeLimit`


def one_agent(config: EnvConfig) -> EnvConfig:
    """The config for one agent without respawn."""
    episode = dataclasses.replace(
        config.episode, respawn=False, final_observation=False
    )
    return dataclasses.replace(config, num_agents=1, min_agents=None, episode=episode)
