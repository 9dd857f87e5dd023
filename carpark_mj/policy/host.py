"""Policies of other libraries: functions, torch modules, Stable-Baselines3.

They are computed on the host, from NumPy observations of all agents of all lots at
once, and drive wherever a policy does: in `carpark_mj.evaluate` and `render`, the
suite, recordings, and by name on the command line (`carpark_mj.policy.named`).
"""

# torch and Stable-Baselines3 are extras that the type checker does without.
# pyright: reportMissingImports=false

import contextlib
import dataclasses
import pickle
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental import io_callback

from carpark_mj.config import EnvConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.extensions import require_packages
from carpark_mj.mdp.actions import action_table
from carpark_mj.policy.networks import Policy

# Actions (n, size) of the observations of n agents, as `ParkingEnv.unpack` gives them:
# an array (n, observation_size), or a dictionary of arrays if there are pictures. Or
# integers (n,), numbers of rows of `action_table`.
Act = Callable[[Any], Any]
Env = EnvConfig | str | None


@dataclasses.dataclass(frozen=True)
class HostPolicy:
    """Makes the policy for an environment, as the functions of `POLICIES` do.

    Attributes:
        name: of its output folder.
        bind: the function of observations, for an environment.
        env: the environment of its training or its name, whose observation and reward
            it keeps elsewhere; None = it drives in any.
    """

    name: str
    bind: Callable[[ParkingEnv], Act]
    env: Env = None

    def __call__(self, env: ParkingEnv) -> Policy:
        """Binds the policy; it is called once, with zeros of one agent.

        Raises:
            ValueError: it does not take the observations, or gives other actions.
        """
        spec, act = env.action_spec, self.bind(env)

        def on_host(observation: Any) -> np.ndarray:
            action = np.asarray(act(jax.tree.map(np.asarray, observation)))
            if action.ndim == 1 and np.issubdtype(action.dtype, np.integer):
                action = action_table(spec)[action]  # numbers of its rows
            return action.astype(spec.dtype)

        def policy(observation: jax.Array, key: jax.Array) -> Any:
            del key
            shape = jax.ShapeDtypeStruct((len(observation), spec.size), spec.dtype)
            return io_callback(on_host, shape, env.unpack(observation)), {}

        zeros = jnp.zeros((1, env.observation_size))
        try:
            found = on_host(env.unpack(zeros)).shape
        except Exception as error:  # of whatever library
            raise ValueError(
                f"{self.name} fails on an observation here, {zeros.shape}: {error}"
            ) from error
        if found != (1, spec.size):
            raise ValueError(
                f"{self.name} must give actions (1, {spec.size}) of one, not {found}"
            )
        return policy


def from_function(act: Act, env: Env = None) -> HostPolicy:
    """A policy from a function of NumPy observations, see `Act` and `HostPolicy`."""
    name = getattr(act, "__name__", type(act).__name__)
    return HostPolicy(name, lambda env: act, env)


def from_torch(module: Any, env: Env = None) -> HostPolicy:
    """A policy from a torch module on the CPU, or a file that `torch.export` saved.

    It maps observations (n, size), of any number n, to actions.
    """
    require_packages("torch")
    import torch

    name = type(module).__name__
    if isinstance(module, str | Path):
        with reading_file(module) as file:
            name, module = Path(file).stem, torch.export.load(file).module()

    def act(observation: Any) -> np.ndarray:
        with torch.no_grad():
            return module(jax.tree.map(torch.tensor, observation)).numpy()

    return HostPolicy(name, lambda env: act, env)


def from_sb3(model: Any, normalize: str | Path = "", env: Env = None) -> HostPolicy:
    """A policy from a model of Stable-Baselines3; it acts deterministically.

    Args:
        model: a model with `predict`, also one of sb3-contrib or sbx, or the file of
            a PPO, A2C, DQN, SAC or TD3.
        normalize: file of the statistics of its observations, which
            `VecNormalize.save` has written. It is a pickle: open none of strangers.
        env: see `HostPolicy`.
    """
    name, normalizer = type(model).__name__, None
    if isinstance(model, str | Path):
        require_packages("stable_baselines3")
        with reading_file(model) as file:
            name, model = Path(file).stem, _load_sb3(file)
    if normalize:
        with reading_file(normalize) as file:
            normalizer = pickle.loads(Path(file).read_bytes())

    def act(observation: Any) -> np.ndarray:
        if normalizer is not None:
            observation = normalizer.normalize_obs(observation)
        return model.predict(observation, deterministic=True)[0]

    return HostPolicy(name, lambda env: act, env)


def _load_sb3(file: str) -> Any:
    from stable_baselines3 import A2C, DQN, PPO, SAC, TD3
    from stable_baselines3.common.save_util import load_from_zip_file

    data = load_from_zip_file(file, device="cpu")[0] or {}
    # The policies of the first two are of the same classes.
    for kind in (PPO if "clip_range" in data else A2C, DQN, SAC, TD3):
        if data.get("policy_class") in kind.policy_aliases.values():
            return kind.load(file, device="cpu")
    raise ValueError("it is no PPO, A2C, DQN, SAC or TD3: load it and pass the model")


@contextlib.contextmanager
def reading_file(path: str | Path) -> Generator[str]:
    """Gives the name of a file; what a library says of it becomes a `ValueError`."""
    Path(path).open("rb").close()
    try:
        yield str(path)
    except Exception as error:
        raise ValueError(f"{path} cannot be loaded: {error}") from error
