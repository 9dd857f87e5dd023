"""Runs side by side: several seeds, and settings that are data, in one program.

One small training leaves a GPU idle. The state of a group's runs has a leading
dimension, over which the update is vectorised, and the devices share the runs. The lots
of a run lie on one device, so that each is the run which that device alone would train.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec

from carpark_mj.config import insert, is_data
from carpark_mj.evaluation.keys import training_key
from carpark_mj.training.ppo.collect import TrainingState, state_specs
from carpark_mj.training.ppo.config import PPOConfig
from carpark_mj.training.ppo.learner import Learner, Values, without_input
from carpark_mj.training.ppo.variants import AXIS
from carpark_mj.training.run_folder import list_settings

RUNS = "runs"
# What the program does not read.
OUTSIDE = (
    *("warm_start", "preset", "name", "runs_dir", "resume", "seed"),
    *("eval_episodes", "video_seconds", "logger"),
)


def program(config: PPOConfig) -> PPOConfig:
    """What decides the program: runs for which it is equal can be a group.

    It is hashable, but no config of a run: settings that may differ in it are blank.
    """
    data = dict.fromkeys(_data(config), 0.0)
    return insert(config, data | dict.fromkeys(OUTSIDE))


def differing(configs: Sequence[PPOConfig]) -> dict[str, list[float]]:
    """The values, one for each run, of settings in which runs of a group differ.

    Equal ones stay constants of the program.
    """
    settings = [dict(list_settings(config)) for config in configs]
    values = {path: [run[path] for run in settings] for path in _data(configs[0])}
    return {path: found for path, found in values.items() if len(set(found)) > 1}


def make_learner(configs: Sequence[PPOConfig]) -> Learner:
    """The learner of one run, or of several side by side."""
    return Learner(configs[0]) if len(configs) == 1 else GroupLearner(configs)


class GroupLearner(Learner):
    """The learner of several runs, whose states have a leading dimension (runs,)."""

    def __init__(self, configs: Sequence[PPOConfig]) -> None:
        """Sets up what the runs share."""
        _require_one_program(configs)
        super().__init__(configs[0])
        self.configs, count = tuple(configs), len(configs)
        self.data = {
            k: jnp.array(x, jnp.float32) for k, x in differing(configs).items()
        }
        devices = max(n for n in range(1, jax.device_count() + 1) if count % n == 0)
        mesh = np.array(jax.devices()[:devices]).reshape(-1, 1)
        self.mesh = Mesh(mesh, (RUNS, AXIS))
        self.specs = jax.tree.map(
            lambda _: PartitionSpec(RUNS),
            state_specs(),
            is_leaf=lambda x: isinstance(x, PartitionSpec),
        )

    def build(self) -> TrainingState:
        """The states before the first update (pure)."""
        keys = [training_key(config.seed) for config in self.configs]
        begin = jax.vmap(lambda key, own: self.with_values(own).begin(key))
        return begin(jnp.stack(keys), self.data)

    def split(self, state: TrainingState) -> list[TrainingState]:
        """The state of every run."""
        runs = range(len(self.configs))
        return [jax.tree.map(lambda x, k=k: x[k], state) for k in runs]

    def join(self, states: Sequence[TrainingState]) -> TrainingState:
        """The states of all runs, from that of every one."""
        return jax.tree.map(lambda *parts: jnp.stack(parts), *states)

    def compile(self, scheduled: bool = False) -> Callable[..., Any]:
        """The jitted update of all runs; metrics and values are (runs, ...)."""

        def one(state: TrainingState, values: Values) -> Any:
            return self.with_values(values).update(state)

        def update(state: TrainingState, values: Values) -> Any:
            return jax.vmap(one)(jax.tree.map(without_input, state), values)

        runs = PartitionSpec(RUNS)
        jitted = self._jitted(update, (self.specs, runs), runs)
        return lambda state, *values: jitted(state, self.data | dict(*values))

    def as_arrays(self, values: Sequence[Values]) -> Values:
        """See `Learner.as_arrays`; all runs have values of the same settings."""
        if len({frozenset(own) for own in values}) > 1:
            raise ValueError("callbacks of all runs must set the same settings")
        first, *_ = values
        return {k: np.array([own[k] for own in values], np.float32) for k in first}


def _require_one_program(configs: Sequence[PPOConfig]) -> None:
    """Raises `ValueError` for configs that differ in a setting that a group shares."""
    if jax.process_count() > 1:
        raise ValueError(f"runs side by side need one host, not {jax.process_count()}")
    first = dict(list_settings(program(configs[0])))
    for config in configs[1:]:
        other = dict(list_settings(program(config)))
        for path in first | other:
            if (a := first.get(path)) != (b := other.get(path)):
                raise ValueError(
                    f"runs side by side must have the same {path}, not {a!r} and {b!r}"
                )


def _data(config: PPOConfig) -> list[str]:
    """Paths of the settings that may differ as data."""
    return [path for path, _ in list_settings(config) if is_data(config, path)]
