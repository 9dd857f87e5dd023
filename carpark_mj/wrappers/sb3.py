"""The Gymnasium vector environments as a Stable-Baselines3 `VecEnv`."""

# An extra that the type checker does without.
# pyright: reportMissingImports=false, reportUntypedBaseClass=false

from typing import Any, cast

import gymnasium
import numpy as np
from stable_baselines3.common.vec_env.base_vec_env import (
    VecEnv,
    VecEnvIndices,
    VecEnvObs,
    VecEnvStepReturn,
)

from carpark_mj.wrappers.gymnasium_env import ParkVectorEnv


class ParkVecEnv(VecEnv):
    """All environments stepped by one compiled call.

    Infos hold those of the id and `TimeLimit.truncated`, at the end of an
    episode also `terminal_observation`. Wrap it in `VecMonitor` for returns.

    Examples:
        >>> vec_env = ParkVecEnv("carpark_mj/Park-v0", 64, layout="square_compact")
        >>> model = PPO("MlpPolicy", VecMonitor(vec_env))
    """

    def __init__(self, name: str, num_envs: int = 1, **options: Any) -> None:
        """Makes environments by a Gymnasium id of this package, with its options."""
        env = gymnasium.make_vec(name, num_envs, **options)
        if not isinstance(env, ParkVectorEnv):
            raise ValueError(f"{name!r} is not an environment of carpark_mj")
        self._env = env
        self._actions: np.ndarray | None = None
        super().__init__(
            env.num_envs, env.single_observation_space, env.single_action_space
        )
        self.metadata = env.metadata  # with the frames per second of videos

    def reset(self) -> VecEnvObs:
        """Begins an episode in every environment.

        The seeds of `seed` and the options of `set_options` apply, if any.
        """
        every = self._env.num_envs // self._env.num_lots
        seeds = [None if s is None else s % 2**32 for s in self._seeds[::every]]
        given = [seed for seed in seeds if seed is not None]
        observation, _ = self._env.reset(seed=given or None, options=self._options)
        self._reset_seeds()
        self._reset_options()
        return observation

    def set_options(
        self, options: list[dict[str, Any]] | dict[str, Any] | None = None
    ) -> None:
        """Sets the options of the next `reset`, see `ParkVectorEnv.read_options`."""
        self._env.read_options(options)
        super().set_options(options)

    def step_async(self, actions: np.ndarray) -> None:
        """Takes the actions (num_envs, size) of the next step."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Advances all environments by a control step."""
        actions = cast(np.ndarray, self._actions)
        observation, reward, terminated, truncated, infos = self._env.step(actions)
        done = terminated | truncated
        final = infos.get("final_info", infos)
        columns = {"TimeLimit.truncated": truncated}
        for name in (name for name in infos if f"_{name}" in infos and name in final):
            ended = done.reshape(-1, *[1] * (infos[name].ndim - 1))
            columns[name] = np.where(ended, final[name], infos[name])
        values = zip(*(column.tolist() for column in columns.values()), strict=True)
        rows: list[dict[str, Any]] = [
            dict(zip(columns, row, strict=True)) for row in values
        ]
        for index in np.flatnonzero(done):
            rows[index]["terminal_observation"] = infos["final_obs"][index]
        return observation, reward, done, rows

    def close(self) -> None:
        """Closes the renderer."""
        self._env.close()

    def get_images(self) -> list[np.ndarray | None]:
        """A picture of every lot."""
        return list(self._env.render() or ())

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """An attribute of the environments, equal in all."""
        return [getattr(self._env, attr_name) for _ in self._get_indices(indices)]

    def set_attr(
        self, attr_name: str, value: Any, indices: VecEnvIndices = None
    ) -> None:
        """Raises `AttributeError`: the environments are one."""
        raise AttributeError(f"{attr_name!r} of single environments cannot be set")

    def env_method(
        self,
        method_name: str,
        *method_args: Any,
        indices: VecEnvIndices = None,
        **method_kwargs: Any,
    ) -> list[Any]:
        """Result of a method of the environments, once for each of `indices`."""
        result = getattr(self._env, method_name)(*method_args, **method_kwargs)
        return [result for _ in self._get_indices(indices)]

    def env_is_wrapped(
        self, wrapper_class: type[gymnasium.Wrapper], indices: VecEnvIndices = None
    ) -> list[bool]:
        """False for each: nothing is wrapped."""
        return [False for _ in self._get_indices(indices)]
