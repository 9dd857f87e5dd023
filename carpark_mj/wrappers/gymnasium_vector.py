"""Batches of lots as Gymnasium's vector environments: one compiled call a step."""

import dataclasses
from typing import Any, Unpack

import jax
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from carpark_mj.config.checks import require_count
from carpark_mj.env import ParkingEnv
from carpark_mj.spawning.reset_options import ResetOptions
from carpark_mj.wrappers.batch import NumpyBatch, Seeds, require_shape
from carpark_mj.wrappers.gymnasium_env import ONE_AGENT, TimeLimited, one_agent
from carpark_mj.wrappers.gymnasium_spaces import (
    action_space,
    observation_space,
)
from carpark_mj.wrappers.options import Options, configure, shared_env
from carpark_mj.wrappers.reset_options import as_reset_options
from carpark_mj.wrappers.screen import Screen


class ParkVectorEnv(TimeLimited, VectorEnv[Any, np.ndarray, np.ndarray]):  # pyright: ignore[reportIncompatibleVariableOverride]
    """`carpark_mj/Park-v0` many times; every environment is a lot with one agent.

    Environment i reset with a seed gives the episodes of `ParkEnv` reset with seed + i.
    Environments auto-reset in the same step: `final_obs` and `final_info` of the infos
    hold the end of the episode, as in Gymnasium's `SyncVectorEnv`.
    """

    autoreset_mode = AutoresetMode.SAME_STEP  # TorchRL reads it, Gymnasium the next
    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": ["rgb_array"],
        "autoreset_mode": autoreset_mode,
    }

    def __init__(
        self,
        num_envs: int = 1,
        render_mode: str | None = None,
        camera: str = "topdown",
        **options: Unpack[Options],
    ) -> None:
        """Makes the environments; they are compiled by the first reset and step.

        Args:
            num_envs: number of environments.
            render_mode: None or `rgb_array`.
            camera: see `ParkEnv`.
            **options: see `Options`.

        Raises:
            TypeError: an unknown option.
            ValueError: an impossible one.
        """
        modes = self.metadata["render_modes"]
        if render_mode not in (None, *modes):
            raise ValueError(
                f"unknown render_mode {render_mode!r}; choose from {modes}"
            )
        env = self._make(options)
        require_count("num_envs", num_envs, 1)
        if num_envs % env.num_agents:
            raise ValueError(
                "num_envs must be a multiple of the number of agents, "
                f"{env.num_agents}, not {num_envs}"
            )
        self._batch = NumpyBatch(env, num_envs // env.num_agents)
        self.num_envs, self.render_mode = num_envs, render_mode
        frames_per_second = round(1.0 / env.config.sim.ctrl_dt)
        self.metadata = {**self.metadata, "render_fps": frames_per_second}
        self.single_observation_space = observation_space(env)
        self.single_action_space = action_space(env.action_spec)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._screen = Screen(shared_env(env.config), camera)

    def _make(self, options: Options) -> ParkingEnv:
        return shared_env(one_agent(configure(options, ONE_AGENT)))

    @property
    def num_lots(self) -> int:
        """Lots, of `num_envs` / `num_lots` agents each."""
        return self._batch.num_lots

    def reset(
        self,
        *,
        seed: Seeds = None,
        options: dict[str, Any] | list[dict[str, Any]] | None = None,
    ) -> tuple[Any, dict[str, Any]]:
        """Begins an episode in every environment.

        Args:
            seed: lot i gets seed + i, or the i-th of a sequence; see `Batch.reset`.
            options: see `ParkEnv.reset`; one dictionary for all environments, or one
                for each. They apply to the episodes that begin now only.

        Returns:
            Observations (num_envs, ...), and infos as `step` returns them.

        Raises:
            ValueError: see `ParkEnv.reset`, or a wrong number of dictionaries.
        """
        super().reset(seed=seed if isinstance(seed, int) else None)
        given = self.read_options(options)
        no = np.zeros(self.num_envs, bool)
        return self._by_env(self._batch.reset_numpy(seed, given)), _infos(no, no, ~no)

    def read_options(
        self, options: dict[str, Any] | list[dict[str, Any]] | None
    ) -> ResetOptions | None:
        """Options of `reset` as arrays; None if all are empty.

        Raises:
            TypeError: not dictionaries.
            ValueError: a wrong number of dictionaries, an unknown key or an impossible
                value.
        """
        each = options if isinstance(options, list) else [options] * self.num_envs
        if len(each) != self.num_envs:
            raise ValueError(
                "options must be a dictionary, or one for each of the "
                f"{self.num_envs} environments, not {len(each)}"
            )
        return as_reset_options(each, self._batch.action_shape[:2])

    def step(
        self, actions: np.ndarray
    ) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Advances all environments by a control step; `actions` (num_envs, size).

        Raises:
            ResetNeeded: before the first `reset`.
            ValueError: actions of another shape, or NaN.
        """
        actions = np.asarray(actions)
        require_shape("actions", actions, self.action_space.shape)
        step = self._batch.step_numpy(actions.reshape(self._batch.action_shape))
        terminated, truncated = step.terminated.ravel(), step.truncated.ravel()
        crashed = step.crashed.ravel()
        success, done = terminated & ~crashed, terminated | truncated
        infos = _infos(success & ~done, crashed & ~done, np.ones_like(done))
        if done.any():
            infos["final_info"] = _infos(success, crashed, done)
            infos["final_obs"] = self._final_observations(step.final_observation, done)
            infos["_final_info"] = infos["_final_obs"] = done
        observation = self._by_env(step.observation)
        return observation, step.reward.ravel(), terminated, truncated, infos

    def render(self) -> tuple[np.ndarray, ...] | None:
        """A picture (height, width, 3) uint8 of every lot, or None."""
        if self.render_mode is None:
            return None
        state, lots = self._batch.state, range(self.num_lots)
        return tuple(self._screen.picture(state, lot) for lot in lots)

    def close_extras(self, **kwargs: Any) -> None:
        """Closes the renderer."""
        self._screen.close()

    def _by_env(self, observation: Any) -> Any:
        """Observations (num_envs, ...) from those of agents in lots."""
        return jax.tree.map(
            lambda x: x.reshape(self.num_envs, *x.shape[2:]), observation
        )

    def _final_observations(self, seen: Any, done: np.ndarray) -> np.ndarray:
        """Observations (num_envs,) of the environments that are done; else None."""
        each = self._by_env(seen)
        final = np.full(self.num_envs, None, dtype=object)
        for index in np.flatnonzero(done):
            final[index] = jax.tree.map(lambda x: x[index], each)  # noqa: B023
        return final


def _infos(
    success: np.ndarray, crashed: np.ndarray, known: np.ndarray
) -> dict[str, Any]:
    """Infos (num_envs,), and for which environments they are known."""
    infos = {"is_success": success, "crashed": crashed}
    infos |= {f"_{name}": known for name in infos}
    return {name: values.copy() for name, values in infos.items()}


class ParkManyVectorEnv(ParkVectorEnv):
    """`carpark_mj/ParkMany-v0`: every environment is an agent, several share a lot.

    Environments k n to k n + n - 1 are the n agents of lot k. Each agent auto-resets in
    the same lot and step while the others drive on, so lots keep their layouts until
    `reset`.
    """

    def _make(self, options: Options) -> ParkingEnv:
        config = configure(options)
        if config.min_agents not in (None, config.num_agents):
            raise ValueError(
                "min_agents must be None, as every environment is an agent, not "
                f"{config.min_agents}"
            )
        episode = dataclasses.replace(
            config.episode, respawn=True, final_observation=True
        )
        # None and not that number: lots without room for all are refused.
        config = dataclasses.replace(config, episode=episode, min_agents=None)
        return shared_env(config)
