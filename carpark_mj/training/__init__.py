"""Training from Python, and what trainers share.

    from carpark_mj.training import PPOConfig, evaluate, render, train

    run = train(PPOConfig(num_steps=1_000_000), callback=lambda metrics: None)
    print(evaluate(run).summary["parked"])
    render(run, "drive.mp4")

What they need loads on first use, so that registering presets costs no import.
"""

import contextlib
import dataclasses
import importlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from carpark_mj.cli.process import configure_jax
from carpark_mj.extensions import naming_extras
from carpark_mj.rendering.gl import choose_gl

choose_gl()  # before MuJoCo is imported, for `render`

if TYPE_CHECKING:
    from carpark_mj.evaluation.evaluator import Evaluation
    from carpark_mj.policy.loading import LoadedPolicy
    from carpark_mj.policy.named import Maker
    from carpark_mj.training.ppo.config import PPOConfig
    from carpark_mj.training.ppo.parts import PRESETS

_HOMES = {
    "PPOConfig": "carpark_mj.training.ppo.config",
    "PRESETS": "carpark_mj.training.ppo.parts",
}

__all__ = ["PRESETS", "PPOConfig", "Run", "evaluate", "render", "train"]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'carpark_mj.training' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), name)


# Receives the metrics of an update by name; True ends the training after it.
Callback = Callable[[Mapping[str, float]], bool | None]


@dataclasses.dataclass(frozen=True)
class Run:
    """A run of PPO.

    Attributes:
        folder: of its settings, checkpoints and metrics.
        outcome: `done`, `stopped` before its end, or `diverged`.
    """

    folder: Path
    outcome: str = "done"

    @property
    def metrics(self) -> list[dict[str, float]]:
        """Metrics of every update so far, by name."""
        with naming_extras():
            from carpark_mj.training.loop import read_metrics
        return read_metrics(self.folder)

    @property
    def policy(self) -> "LoadedPolicy":
        """The policy of the newest checkpoint, and its environment."""
        from carpark_mj.policy.loading import load_policy

        return load_policy(self.folder)


AnyRun: TypeAlias = "Run | LoadedPolicy | Maker | str | Path"


def train(config: "PPOConfig", callback: Callback | None = None) -> Run:
    """Trains a run, or continues `config.resume`.

    Unlike `carpark_mj train` it does not evaluate or render: call `evaluate` and
    `render`. If JAX has made no array yet, the lots are divided over all cores.

    Args:
        config: settings, for example one of `PRESETS` with other values.
        callback: called on the host after every update with its row of `metrics.csv`;
            True ends the training after this update, as Ctrl-C does.

    Raises:
        ValueError: impossible settings.
        CheckpointError: a checkpoint to resume from is damaged.
        ImportError: the packages of the extra `train` are missing.
    """
    with naming_extras():
        from carpark_mj.training.ppo.train import train_runs
    with contextlib.suppress(RuntimeError):  # JAX runs already, on the devices it has
        configure_jax()

    def called(_: int, metrics: Mapping[str, float]) -> bool:
        return callback is not None and callback(metrics) is True

    [(folder, outcome)] = train_runs([config], finish_run=None, callback=called)
    return Run(folder, outcome)


def evaluate(run: AnyRun, **settings: Any) -> "Evaluation":
    """Evaluates a policy on held-out seeds; prints the table and writes the files.

    Args:
        run: a `Run`, a run's folder or checkpoint, a loaded policy, the name of a
            policy (a pretrained one, `zero`, `random`, `planner`, `onnx:FILE`), or what
            makes one for an environment, as `from_torch` and `from_function` give it.
        **settings: of `carpark_mj.cli.evaluate.EvaluateConfig`.

    Raises:
        CheckpointError: the run cannot be read.
        ValueError: impossible settings.
        ImportError: the packages of the extra `eval` are missing.
    """
    with naming_extras():
        from carpark_mj.cli.evaluate import EvaluateConfig, main
    return main(EvaluateConfig(_argument(run), **settings))


def render(run: AnyRun, out: str | Path, **settings: Any) -> Path:
    """Renders a policy's episodes to an `.mp4`, a `.gif`, or a `.png` of one moment.

    Args:
        run: what drives, as `evaluate` takes it.
        out: file to write.
        **settings: of `carpark_mj.cli.render.RenderConfig`.

    Raises:
        CheckpointError: the run cannot be read.
        RenderingError: OpenGL does not work here.
        ValueError: impossible settings.
        ImportError: the packages of the extra `eval` are missing.
    """
    with naming_extras():
        from carpark_mj.cli.render import RenderConfig, main
    return main(RenderConfig(_argument(run), out=str(out), **settings))


def _argument(run: AnyRun) -> str:
    """What drives, as an argument of a command."""
    if isinstance(run, str):
        return run
    from carpark_mj.policy.loading import load_policy
    from carpark_mj.policy.named import name_of
    from carpark_mj.training.run_folder import argument

    if callable(run):
        return name_of(run)
    if isinstance(run, Run | Path):
        return argument(run.folder if isinstance(run, Run) else run)
    if load_policy(run.path).env != run.env:
        raise ValueError(
            f"{run.path} was loaded with another environment: pass the path, and what "
            "differs as settings"
        )
    return argument(run.path)
