"""Where the metrics of a training go besides `metrics.csv`: `--logger`.

An extension registers its own logger, see `carpark_mj.extensions`:

    LOGGERS.register("mine", MyLogger)  # carpark_mj train --logger mine,tensorboard
"""

import hashlib
import importlib
import subprocess
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol

from carpark_mj.cli.process import USER_ERRORS, one_line, require_packages
from carpark_mj.extensions import Registry
from carpark_mj.files import naming

FLUSH_SECONDS = 20.0  # between looks of TensorBoard at what is new
PROJECT = "carpark_mj"  # of W&B and MLflow
CHUNK = 100  # parameters that MLflow takes at once
# Columns of TensorBoard's table of hyperparameters.
OUTCOMES = ("episode/parked", "episode/crashed", "episode/timed_out")


class Logger(Protocol):
    """Receives what one run logs; opened again when the run is resumed or finished."""

    def write(self, step: int, values: Mapping[str, float]) -> None:
        """Takes finite metrics by name after `step` agent steps."""

    def video(self, step: int, path: Path) -> None:
        """Takes the video at the end."""

    def close(self) -> None:
        """Brings all to its place."""


# Called with the run's folder, the last step logged there and its settings by name.
LOGGERS: Registry[Callable[[Path, int, Mapping[str, Any]], Logger]] = Registry("logger")


def logger_names(text: str) -> list[str]:
    """The names in a setting `logger`, all of which can log here.

    Raises:
        ValueError: an unknown name.
        ModuleNotFoundError: its package is missing.
    """
    names = [name.strip() for name in text.split(",") if name.strip()]
    require_packages(*(name for name in names if LOGGERS[name] in (WandB, MLflow)))
    return names


def open_loggers(
    names: str, folder: Path, step: int, settings: Mapping[str, Any]
) -> list[Logger]:
    """The loggers in a setting `logger`, opened; a `ValueError` says what fails."""
    try:
        return [LOGGERS[name](folder, step, settings) for name in logger_names(names)]
    except (*USER_ERRORS, ModuleNotFoundError):
        raise
    except Exception as error:  # W&B without a login, MLflow without its server
        raise ValueError(f"logger {names}: {one_line(error)}") from error


class TensorBoard:
    """Event files in the run's `tensorboard/`."""

    def __init__(self, folder: Path, step: int, settings: Mapping[str, Any]) -> None:
        """Opens a file; what another one has after `step` is void."""
        from tensorboardX.event_file_writer import EventsWriter
        from tensorboardX.proto import event_pb2, summary_pb2
        from tensorboardX.summary import hparams

        self._event: Any = event_pb2
        self._summary: Any = summary_pb2.Summary  # pyright: ignore[reportAttributeAccessIssue]
        self._board = folder / "tensorboard"
        self._board.mkdir(exist_ok=True)
        # Not `SummaryWriter`, whose thread dies of a full disk and leaves us waiting.
        # The suffix is for a run that is resumed within a second.
        self._events = EventsWriter(str(self._board / "events"), f".{step}")
        self._flushed = time.monotonic()
        start = self._event.SessionLog(status=self._event.SessionLog.START)
        self._add(step + 1, session_log=start)
        plain = {
            name: value if isinstance(value, bool | int | float) else str(value)
            for name, value in settings.items()
        }
        if plain:
            for summary in hparams(plain, dict.fromkeys(OUTCOMES, 0.0)):
                self._add(step + 1, summary=summary)

    def _add(self, step: int, **content: Any) -> None:
        """Adds an event, and brings all to the disk now and then."""
        event = self._event.Event(wall_time=time.time(), step=step, **content)
        with naming(self._board):
            self._events.write_event(event)
            if time.monotonic() - self._flushed > FLUSH_SECONDS:
                self._events.flush()
                self._flushed = time.monotonic()

    def write(self, step: int, values: Mapping[str, float]) -> None:
        """See `Logger`; one event: with one for each scalar a row takes 3 ms."""
        value = self._summary.Value
        scalars = [value(tag=name, simple_value=x) for name, x in values.items()]
        self._add(step, summary=self._summary(value=scalars))

    def video(self, step: int, path: Path) -> None:
        """See `Logger`; a small GIF among the images."""
        from imageio_ffmpeg import get_ffmpeg_exe

        command = [get_ffmpeg_exe(), "-loglevel", "error", "-i", str(path)]
        command += ["-vf", "fps=5,scale=480:-1", "-f", "gif", "-"]
        gif = subprocess.run(command, capture_output=True, check=True).stdout
        width, height = (int.from_bytes(gif[k : k + 2], "little") for k in (6, 8))
        image = self._summary.Image(
            width=width, height=height, colorspace=3, encoded_image_string=gif
        )
        value = self._summary.Value(tag="video", image=image)
        self._add(step, summary=self._summary(value=[value]))

    def close(self) -> None:
        """See `Logger`."""
        with naming(self._board):
            self._events.close()


class WandB:
    """A run of Weights & Biases; its own settings come from `wandb`'s environment."""

    def __init__(self, folder: Path, step: int, settings: Mapping[str, Any]) -> None:
        """Opens the run, that of the folder if there is one."""
        del step
        self._wandb = wandb = importlib.import_module("wandb")
        digest = hashlib.sha256(str(folder.resolve()).encode()).hexdigest()[:8]
        run = {"name": folder.name, "id": f"{folder.name}-{digest}", "dir": str(folder)}
        run |= {"project": PROJECT, "config": dict(settings)}
        # `create_new` for runs side by side.
        self._run = wandb.init(**run, resume="allow", reinit="create_new")

    def write(self, step: int, values: Mapping[str, float]) -> None:
        """See `Logger`."""
        self._run.log(dict(values), step=step)

    def video(self, step: int, path: Path) -> None:
        """See `Logger`."""
        self._run.log({"video": self._wandb.Video(str(path), format="mp4")}, step=step)

    def close(self) -> None:
        """See `Logger`."""
        self._run.finish()


class MLflow:
    """A run of MLflow, where its environment says; its number is in `mlflow.txt`."""

    def __init__(self, folder: Path, step: int, settings: Mapping[str, Any]) -> None:
        """Opens the run, that of the folder if there is one."""
        del step
        self._entities = importlib.import_module("mlflow.entities")
        mlflow = importlib.import_module("mlflow")
        self._client = mlflow.MlflowClient()
        kept = folder / "mlflow.txt"
        if kept.exists():
            self._run = kept.read_text().strip()
            return
        place = mlflow.set_experiment(PROJECT).experiment_id
        run = self._client.create_run(place, run_name=folder.name)
        self._run: str = run.info.run_id
        kept.write_text(self._run)
        params = [self._entities.Param(n, str(value)) for n, value in settings.items()]
        for first in range(0, len(params), CHUNK):
            self._client.log_batch(self._run, params=params[first : first + CHUNK])

    def write(self, step: int, values: Mapping[str, float]) -> None:
        """See `Logger`."""
        now, metric = int(time.time() * 1000), self._entities.Metric
        metrics = [metric(n, x, now, step) for n, x in values.items()]
        self._client.log_batch(self._run, metrics=metrics)

    def video(self, step: int, path: Path) -> None:
        """See `Logger`."""
        del step
        self._client.log_artifact(self._run, str(path))

    def close(self) -> None:
        """See `Logger`."""
        self._client.set_terminated(self._run)


LOGGERS.register("tensorboard", TensorBoard)
LOGGERS.register("wandb", WandB)
LOGGERS.register("mlflow", MLflow)
