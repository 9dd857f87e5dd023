"""Gymnasium environments of one agent in a lot, and of batches of lots."""

import dataclasses
import inspect
from collections.abc import Callable
from types import FrameType
from typing import Any, Unpack

import gymnasium
import jax
import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from carpark_mj.compilation import compile_for_one_lot
from carpark_mj.config import EnvConfig
from carpark_mj.config.checks import require_count
from carpark_mj.env import ParkingEnv
from carpark_mj.spawning.reset_options import ResetOptions
from carpark_mj.wrappers import batch
from carpark_mj.wrappers.options import (
    OPTIONS,
    Options,
    array_action_space,
    as_reset_options,
    configure,
    discrete_table,
    look_up,
    observation_space,
    share,
)

ONE_AGENT = tuple(name for name in OPTIONS if name != "agents")
Given = dict[str, Any] | None  # options of `reset` for one agent


class Parking:
    """What single environments and batches share."""

    _batch: batch.NumpyBatch
    _by_env: Callable[[Any], Any]  # values of the environment from those of its batch
    _table: np.ndarray | None  # of discrete actions
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

    def _make(self, options: Options) -> ParkingEnv:
        return share(ParkingEnv, one_agent(configure(options, ONE_AGENT)))

    def _space(self, env: ParkingEnv) -> spaces.Space[Any]:
        """Space of an agent's observations."""
        return observation_space(env.config)

    def _acts(self, env: ParkingEnv, options: Options) -> spaces.Space[Any]:
        """Space of an agent's actions; reads what else options say of elements."""
        self._details = options.get("details", False)
        self._table = discrete_table(env.action_spec, options)
        return array_action_space(env.action_spec, self._table)

    def _rows(self, actions: np.ndarray) -> np.ndarray:
        """Actions (lots, agents, size) of elements of the space."""
        if self._table is not None:
            actions = look_up(self._table, actions)
        return actions.reshape(self._batch.action_shape)

    def _told(self, of_step: bool = False) -> dict[str, Any]:
        """The details that infos have, none unless asked for."""
        return self._by_env(self._batch.details(of_step)) if self._details else {}

    def _open(
        self, env: ParkingEnv, render_mode: str | None, camera: str, *size: int
    ) -> dict[str, Any]:
        """Sets what draws; returns the metadata."""
        self.render_mode = render_mode
        self._screen = batch.Screen(share(ParkingEnv, env.config), camera, None, *size)
        metadata: Any = type(self).metadata  # pyright: ignore[reportAttributeAccessIssue]
        return {**metadata, "render_fps": round(1.0 / env.config.sim.ctrl_dt)}


class ParkEnv(Parking, gymnasium.Env[Any, np.ndarray]):  # pyright: ignore[reportIncompatibleVariableOverride]
    """One agent parks: `carpark_mj/Park-v0`.

    - observation: (size,) float32, the fields of `carpark_mj.observations.make_fields`;
      with cameras a dictionary, see `carpark_mj.observations.unpack`.
    - action: (2,) float32, steer and pedal in [-1, 1]; numbers out of range are
      clipped. On the grid: indices of an acceleration and a turn. With `discrete` the
      number of a row of a table.
    - reward: the sum of the terms of `RewardConfig`.
    - end: terminated when parked or crashed, truncated when out of time; then `reset`
      draws the next lot.
    - info: `is_success` (parked) and `crashed`, with `details` where the car and its
      goal are and the reward by term.
    """

    metadata: dict[str, Any] = {"render_modes": batch.RENDER_MODES}  # noqa: RUF012

    def __init__(
        self,
        render_mode: str | None = None,
        camera: str = "topdown",
        width: int = batch.WIDTH,
        height: int = batch.HEIGHT,
        **options: Unpack[Options],
    ) -> None:
        """Makes the environment; it is compiled by the first reset and step.

        Args:
            render_mode: None, `human` or `rgb_array`.
            camera: of pictures, see `carpark_mj.scene.camera_flags.camera_names`.
            width: of pictures [pixels].
            height: of pictures [pixels].
            **options: see `Options`; there is always one agent.
        """
        batch.require_render_mode(render_mode, batch.RENDER_MODES)
        if (steps := _asked_steps(inspect.currentframe())) is not None:
            options["max_episode_steps"] = steps
        compile_for_one_lot()
        env = self._make(options)
        self._batch = batch.NumpyBatch(env, 1, restart=False)
        self.metadata = self._open(env, render_mode, camera, width, height)
        self.observation_space = self._space(env)
        self.action_space = self._acts(env, options)
        self._running = False

    def reset(
        self, *, seed: int | None = None, options: Given = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begins an episode in another lot; returns observation and info.

        Args:
            seed: in [0, 2**32); None = continue with the lot's own random numbers.
            options: `pose`, `speed` and `goal` of the start, drawn where left out; see
                `carpark_mj.wrappers.options.as_reset_options`. A `ValueError` refuses
                impossible starts, such as an unknown bay or a pose on a wall.
        """
        super().reset(seed=seed)
        given = as_reset_options([options], (1, 1))
        observation = self._batch.reset_numpy(seed, given)
        self._running = True
        self._show()
        info = {"is_success": False, "crashed": False}
        return self._by_env(observation), info | self._told()

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Advances by a control step; see the class.

        `ResetNeeded` before the first `reset`, or after the end of an episode;
        `ValueError` for an action of another shape, or NaN.
        """
        if not self._running:
            raise ResetNeeded("call reset before the first step of an episode")
        action = np.asarray(action)
        batch.require_shape("an action", action, self.action_space.shape)
        step = self._batch.step_numpy(self._rows(action))
        terminated, truncated = bool(step.terminated[0, 0]), bool(step.truncated[0, 0])
        self._running = not (terminated or truncated)
        crashed = bool(step.crashed[0, 0])
        info = {"is_success": terminated and not crashed, "crashed": crashed}
        info |= self._told(of_step=True)
        self._show()
        reward = float(step.reward[0, 0])
        return self._by_env(step.observation), reward, terminated, truncated, info

    def render(self) -> Any:
        """A picture (height, width, 3) uint8 in mode `rgb_array`, else None."""
        if self.render_mode == "rgb_array":
            return self._screen.picture(self._batch.state)
        return None

    def close(self) -> None:
        """Closes windows and renderers."""
        self._screen.close()

    def _by_env(self, values: Any) -> Any:
        """Those of the only agent of the only lot."""
        return jax.tree.map(lambda x: x[0, 0], values)

    def _show(self) -> None:
        if self.render_mode == "human":
            self._screen.show(self._batch.state)


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
    changes = {"respawn": False, "final_observation": False}
    episode = dataclasses.replace(config.episode, **changes)
    return dataclasses.replace(config, num_agents=1, min_agents=None, episode=episode)


class ParkVectorEnv(Parking, VectorEnv[Any, np.ndarray, np.ndarray]):  # pyright: ignore[reportIncompatibleVariableOverride]
    """`carpark_mj/Park-v0` many times; every environment is a lot with one agent.

    Environment i reset with a seed gives the episodes of `ParkEnv` reset with seed + i.
    Environments auto-reset as in Gymnasium's `SyncVectorEnv`, by default in the same
    step: `final_obs` and `final_info` of the infos hold the end of the episode.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"]}  # noqa: RUF012
    _modes = tuple(AutoresetMode)

    def __init__(
        self,
        num_envs: int = 1,
        render_mode: str | None = None,
        camera: str = "topdown",
        width: int = batch.WIDTH,
        height: int = batch.HEIGHT,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        **options: Unpack[Options],
    ) -> None:
        """Makes environments; see `ParkEnv`. The render mode is None or `rgb_array`.

        Modes by name are `SameStep`, `NextStep` and `Disabled`; in the last one
        environments whose episode has ended stand still until they are reset.
        """
        batch.require_render_mode(render_mode, self.metadata["render_modes"])
        mode = self.autoreset_mode = AutoresetMode(autoreset_mode)  # TorchRL reads it
        if mode not in self._modes:
            raise ValueError(
                f"agents that share lots reset in the same step, not {mode}"
            )
        env = self._make(options)
        require_count("num_envs", num_envs, 1)
        if num_envs % env.num_agents:
            raise ValueError(
                "num_envs must be a multiple of the number of agents, "
                f"{env.num_agents}, not {num_envs}"
            )
        same = mode is AutoresetMode.SAME_STEP
        self._batch = batch.NumpyBatch(env, num_envs // env.num_agents, restart=same)
        self.num_envs = num_envs
        self.metadata = self._open(env, render_mode, camera, width, height)
        self.metadata["autoreset_mode"] = mode
        self._ended = np.zeros(num_envs, bool)  # those due in the next step
        self.single_observation_space = self._space(env)
        self.single_action_space = self._acts(env, options)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    @property
    def num_lots(self) -> int:
        """Lots, of `num_envs` / `num_lots` agents each."""
        return self._batch.num_lots

    def reset(
        self, *, seed: batch.Seeds = None, options: Given | list[dict[str, Any]] = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begins an episode in every environment.

        Lot i gets seed + i, or the i-th of a sequence; see `Batch.reset`. Options are
        one dictionary for all environments, or one for each, see `ParkEnv.reset`, and
        apply to the episodes that begin now only. Instead, `{"reset_mask": mask}`
        resets some environments, (num_envs,) bool. Returns observations (num_envs, ...)
        and infos as `step` does.
        """
        super().reset(seed=seed if isinstance(seed, int) else None)
        no = np.zeros(self.num_envs, bool)
        if isinstance(options, dict) and {*options} == {"reset_mask"}:
            due = np.asarray(options["reset_mask"], bool)
            batch.require_shape("reset_mask", due, no.shape)
            lots = due.reshape(self.num_lots, -1)
            if (lots != lots[:, :1]).any():
                raise ValueError("reset_mask must have all agents of a lot, or none")
            observation = self._restarted(due, seed)
        else:
            due, given = ~no, self.read_options(options)
            observation = self._by_env(self._batch.reset_numpy(seed, given))
        self._ended, self._seen = self._ended & ~due, observation
        told = {"is_success": no, "crashed": no, **self._told()}
        return jax.tree.map(np.copy, observation), _infos(due, told)

    def _restarted(self, due: np.ndarray, seed: batch.Seeds, key: Any = None) -> Any:
        """Resets the environments that are due; observations of all of them."""
        lots = due.reshape(self.num_lots, -1)[:, 0]
        fresh = self._by_env(self._batch.restart(lots, seed, key))
        return _put(due, fresh, self._seen)

    def read_options(
        self, options: Given | list[dict[str, Any]]
    ) -> ResetOptions | None:
        """Options of `reset` as arrays; None if all are empty."""
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
        """Advances all environments by a control step; `actions` (num_envs, size)."""
        actions = np.asarray(actions)
        batch.require_shape("actions", actions, self.action_space.shape)
        mode, begins = self.autoreset_mode, self._ended
        key = self._batch.state.key.copy() if begins.any() else None
        step = self._batch.step_numpy(self._rows(actions))
        terminated, truncated = step.terminated.ravel(), step.truncated.ravel()
        crashed = step.crashed.ravel()
        success, done = terminated & ~crashed, terminated | truncated
        self._seen = self._by_env(step.observation)
        if begins.any():  # they stood in this step, and were paid nothing
            self._seen = self._restarted(begins, None, key)
        if mode is AutoresetMode.NEXT_STEP:
            self._ended = done
        fresh = done & (mode is AutoresetMode.SAME_STEP)
        told = self._told(of_step=True)
        ends = {"is_success": success, "crashed": crashed, **told}
        now = {"is_success": success & ~fresh, "crashed": crashed & ~fresh}
        now |= _put(fresh | begins, self._told(), told)
        infos = _infos(np.ones_like(done), now)
        if fresh.any():
            infos["final_info"] = _infos(done, ends)
            final = np.full(self.num_envs, None)
            each = self._by_env(step.final_observation)
            for index in np.flatnonzero(done):
                final[index] = jax.tree.map(lambda x: x[index], each)  # noqa: B023
            infos["final_obs"] = final
            infos["_final_info"] = infos["_final_obs"] = done
        observation = jax.tree.map(np.copy, self._seen)
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

    def _by_env(self, values: Any) -> Any:
        """Values (num_envs, ...) from those of agents in lots."""
        return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), values)


def _put(due: np.ndarray, new: Any, old: Any) -> Any:
    """Arrays (num_envs, ...) that are new where due (num_envs,)."""

    def put(new: Any, old: np.ndarray) -> np.ndarray:
        return np.where(due.reshape(-1, *[1] * (old.ndim - 1)), new, old)

    return jax.tree.map(put, new, old)


def _infos(known: np.ndarray, values: dict[str, np.ndarray]) -> dict[str, Any]:
    """Infos (num_envs, ...), and for which environments they are known."""
    infos = values | {f"_{name}": known for name in values}
    return {name: array.copy() for name, array in infos.items()}


class ParkManyVectorEnv(ParkVectorEnv):
    """`carpark_mj/ParkMany-v0`: every environment is an agent, several share a lot.

    Environments k n to k n + n - 1 are the n agents of lot k. Each agent auto-resets in
    the same lot and step while others drive on: lots keep their layouts until `reset`.
    """

    _modes = (AutoresetMode.SAME_STEP,)

    def _make(self, options: Options) -> ParkingEnv:
        config = configure(options)
        if config.min_agents not in (None, config.num_agents):
            raise ValueError(
                "min_agents must be None, as every environment is an agent, not "
                f"{config.min_agents}"
            )
        changes = {"respawn": True, "final_observation": True}
        episode = dataclasses.replace(config.episode, **changes)
        # None and not that number: lots without room for all are refused.
        config = dataclasses.replace(config, episode=episode, min_agents=None)
        return share(ParkingEnv, config)
