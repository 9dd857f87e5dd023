"""What follows the updates of a training: `--logger`, `--callbacks`.

Loggers take the metrics besides `metrics.csv`, callbacks may change settings and end
the training. An extension registers its own, see `carpark_mj.extensions`:

    LOGGERS.register("mine", MyLogger)  # carpark_mj train --logger mine,tensorboard
    CALLBACKS.register("mine", MyCallback)  # carpark_mj train --callbacks mine
"""

import dataclasses
import hashlib
import importlib
import subprocess
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from carpark_mj.cli.process import USER_ERRORS, one_line
from carpark_mj.extensions import Registry, require_packages
from carpark_mj.files import naming

FLUSH_SECONDS = 20.0  # between looks of TensorBoard at what is new
PROJECT = "carpark_mj"  # of W&B and MLflow
# Columns of TensorBoard's table of hyperparameters.
OUTCOMES = ("episode/parked", "episode/crashed", "episode/timed_out")

Settings = Mapping[str, Any]


@dataclasses.dataclass(frozen=True)
class Logger:
    """Where one run logs; opened again when the run is resumed or finished.

    Attributes:
        write: takes the agent steps so far, and finite metrics by name.
        video: takes the agent steps so far, and the path of the video at the end.
        close: brings everything to its place.
    """

    write: Callable[[int, Mapping[str, float]], object]
    video: Callable[[int, Path], object]
    close: Callable[[], object]


# Called with the run's folder, the last step logged there and its settings by name. The
# result is a `Logger`, or has its methods.
LOGGERS: Registry[Callable[[Path, int, Settings], Any]] = Registry("logger")


class Callback:
    """Follows a run; a subclass overrides what it needs.

    Every host has one of its own, and they must act alike.

    Attributes:
        config: settings of the run, a `PPOConfig`.
        folder: of its files, with checkpoints up to `checkpoint_minutes` old.
    """

    def __init__(self, config: Any, folder: Path) -> None:
        """Called before the first update, also of a run that is resumed."""
        self.config, self.folder = config, folder

    def values(self, progress: float) -> Mapping[str, Any]:
        """Values of settings in the next update, by path: `env.sensors.speed_noise`.

        Always of the same settings, those of `carpark_mj.config.is_data`: numbers and
        ranges that are not off in `config`. They are not checked.

        Args:
            progress: share of the training that is done, in [0, 1].
        """
        del progress
        return {}

    def after(self, metrics: Mapping[str, float]) -> bool | None:
        """Takes the row of `metrics.csv` of an update; True ends the training."""
        del metrics


# Called with the settings and the folder of a run.
CALLBACKS: Registry[Callable[[Any, Path], Callback]] = Registry("callback")


def open_callbacks(names: str, config: Any, folder: Path) -> list[Callback]:
    """The callbacks in a setting `callbacks`, for a run."""
    return [CALLBACKS[name](config, folder) for name in split_names(names)]


def scheduled(callbacks: list[Callback], progress: float) -> dict[str, Any]:
    """The values that callbacks ask for; of several the last one's."""
    return {path: x for own in callbacks for path, x in own.values(progress).items()}


def split_names(text: str) -> list[str]:
    """The names in a text, separated by commas."""
    return [name.strip() for name in text.split(",") if name.strip()]


def logger_names(text: str) -> list[str]:
    """The names in a setting `logger`; refuses those that cannot log here."""
    names = split_names(text)
    require_packages(*(name for name in names if LOGGERS[name] in (_wandb, _mlflow)))
    return names


def open_loggers(names: str, folder: Path, step: int, settings: Settings) -> list[Any]:
    """The loggers in a setting `logger`, opened; a `ValueError` says what fails."""
    try:
        return [LOGGERS[name](folder, step, settings) for name in logger_names(names)]
    except (*USER_ERRORS, ModuleNotFoundError):
        raise
    except Exception as error:  # W&B without a login, MLflow without its server
        raise ValueError(f"logger {names}: {one_line(error)}") from error


def _tensorboard(folder: Path, step: int, settings: Settings) -> Logger:
    """Event files in `tensorboard/`; what older ones have after `step` is void."""
    from tensorboardX.event_file_writer import EventsWriter
    from tensorboardX.proto import event_pb2, summary_pb2
    from tensorboardX.summary import hparams

    event: Any = event_pb2
    summary: Any = summary_pb2.Summary  # pyright: ignore[reportAttributeAccessIssue]
    board = folder / "tensorboard"
    board.mkdir(exist_ok=True)
    # Not `SummaryWriter`, whose thread dies of a full disk and leaves us waiting.
    # The suffix is for a run that is resumed within a second.
    events, flushed = EventsWriter(str(board / "events"), f".{step}"), time.monotonic()

    def add(step: int, **content: Any) -> None:
        nonlocal flushed
        with naming(board):
            events.write_event(event.Event(wall_time=time.time(), step=step, **content))
            if time.monotonic() - flushed > FLUSH_SECONDS:
                events.flush()
                flushed = time.monotonic()

    def write(step: int, values: Mapping[str, float]) -> None:
        # One event: with one for each scalar a row takes 3 ms.
        scalars = [summary.Value(tag=n, simple_value=x) for n, x in values.items()]
        add(step, summary=summary(value=scalars))

    def video(step: int, path: Path) -> None:
        """Adds a small GIF to the images."""
        from imageio_ffmpeg import get_ffmpeg_exe

        command = [get_ffmpeg_exe(), "-loglevel", "error", "-i", str(path)]
        command += ["-vf", "fps=5,scale=480:-1", "-f", "gif", "-"]
        gif = subprocess.run(command, capture_output=True, check=True).stdout
        width, height = (int.from_bytes(gif[k : k + 2], "little") for k in (6, 8))
        shown = {"width": width, "height": height, "encoded_image_string": gif}
        image = summary.Image(**shown, colorspace=3)
        add(step, summary=summary(value=[summary.Value(tag="video", image=image)]))

    def close() -> None:
        with naming(board):
            events.close()

    add(step + 1, session_log=event.SessionLog(status=event.SessionLog.START))
    plain = (int, float, str)
    shown = {n: x if isinstance(x, plain) else str(x) for n, x in settings.items()}
    for part in hparams(shown, dict.fromkeys(OUTCOMES, 0.0)):
        add(step + 1, summary=part)
    return Logger(write, video, close)


def _wandb(folder: Path, step: int, settings: Settings) -> Logger:
    """A run of Weights & Biases, the folder's; `wandb` has its own settings."""
    del step
    wandb = importlib.import_module("wandb")
    digest = hashlib.sha256(str(folder.resolve()).encode()).hexdigest()[:8]
    run = wandb.init(
        **{"name": folder.name, "id": f"{folder.name}-{digest}", "dir": str(folder)},
        **{"project": PROJECT, "config": {**settings}, "resume": "allow"},
        reinit="create_new",  # for runs side by side
    )

    def video(step: int, path: Path) -> None:
        run.log({"video": wandb.Video(str(path), format="mp4")}, step=step)

    return Logger(lambda step, x: run.log({**x}, step=step), video, run.finish)


def _mlflow(folder: Path, step: int, settings: Settings) -> Logger:
    """A run of MLflow, where its environment says; its number is in `mlflow.txt`."""
    del step
    mlflow = importlib.import_module("mlflow")
    kept = folder / "mlflow.txt"
    if not kept.exists():
        place = mlflow.set_experiment(PROJECT).experiment_id
        run = mlflow.MlflowClient().create_run(place, run_name=folder.name)
        mlflow.log_params(settings, run_id=run.info.run_id)
        kept.write_text(run.info.run_id)
    number = kept.read_text()
    return Logger(
        lambda step, values: mlflow.log_metrics(values, step, run_id=number),
        lambda step, path: mlflow.log_artifact(str(path), run_id=number),
        lambda: mlflow.MlflowClient().set_terminated(number),
    )


LOGGERS.register("tensorboard", _tensorboard)
LOGGERS.register("wandb", _wandb)
LOGGERS.register("mlflow", _mlflow)
