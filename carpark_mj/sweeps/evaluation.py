"""The evaluation of runs that were trained side by side, in one program as well."""

from collections.abc import Sequence
from pathlib import Path

import jax

from carpark_mj.cli.evaluate import EvaluateConfig, prepare, report
from carpark_mj.evaluation.evaluator import Evaluator
from carpark_mj.policy.acting import AnyPolicy
from carpark_mj.training.ppo.config import PPOConfig
from carpark_mj.training.ppo.group import differing, of_env
from carpark_mj.training.settings import list_settings


class GroupEvaluation:
    """Evaluates the runs of a group one after the other; compiles for the first only.

    On a GPU compiling takes longer than the evaluation of a run.
    """

    def __init__(self, configs: Sequence[PPOConfig], stochastic: bool) -> None:
        """Takes the settings of all runs, and whether to sample actions."""
        self._differing = differing(configs)
        self._stochastic = stochastic
        self._first: tuple[Evaluator, AnyPolicy] | None = None

    def __call__(self, config: PPOConfig, folder: Path) -> None:
        """Evaluates a run as `carpark_mj evaluate FOLDER --out FOLDER` does."""
        if not config.eval_episodes:
            return
        settings = EvaluateConfig(
            str(folder),
            episodes=config.eval_episodes,
            stochastic=self._stochastic,
            out=str(folder),
        )
        task = prepare(settings)
        if self._first is None:
            self._first = Evaluator(task.env), task.policy
        evaluator, first = self._first
        own = dict(list_settings(config))
        result = evaluator.evaluate(
            # With the function of the first, or JAX would trace and compile again.
            jax.tree.unflatten(jax.tree.structure(first), jax.tree.leaves(task.policy)),
            settings.episodes,
            settings.seed,
            values=of_env({path: own[path] for path in self._differing}),
        )
        report(settings, task, result)
