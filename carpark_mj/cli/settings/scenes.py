"""Settings of `carpark_mj scene` and `play`."""

import dataclasses
from collections.abc import Sequence
from typing import Literal

from carpark_mj.cli.settings.driving import LotSettings
from carpark_mj.config.checks import CheckedConfig, require_unset
from carpark_mj.files import require_suffix
from carpark_mj.rendering.gl import has_display
from carpark_mj.rendering.local_pages import PORT, Port
from carpark_mj.scene.camera_flags import camera_names

LOT = ("layout", "policy", "num_agents", "num_parked_cars", "vehicle", "seed", "out")


@dataclasses.dataclass(frozen=True)
class SceneOutput(CheckedConfig):
    """Where a scene goes.

    Attributes:
        out: MJCF file to write; it needs no other file and no carpark_mj.
        view: open the scene: `window` is the MuJoCo viewer (`--view` alone, too), `web`
            a page on this machine for a browser.
        port: port of the browser page.
    """

    out: str = ""
    view: Literal["", "window", "web"] = ""
    port: Port = PORT

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.out and not self.view:
            raise ValueError("give --out FILE.xml to write the scene, --view, or both")
        if self.view != "web":
            require_unset(self, "without --view web", "port")
        require_suffix("out", self.out, ".xml")


@dataclasses.dataclass(frozen=True, kw_only=True)
class ShownLot(LotSettings):
    """A lot to look at, or to drive in.

    Attributes:
        layout: name of a lot or a family (`square`, `street`, `lot`...), or a layout
            file, as in `EnvConfig`; default `square`, or the policy's.
        policy: pretrained policy, run folder or checkpoint file that drives.
        num_parked_cars: number of parked cars; default 16, or as many as fit into a
            smaller lot, or as in the policy's training.
        vehicle: preset or file of all cars; default `compact`, or the policy's.
    """

    policy: str = ""


@dataclasses.dataclass(frozen=True)
class SceneConfig(SceneOutput, ShownLot):
    """Writes a car park as MJCF that drives in the MuJoCo viewer, or opens it there.

    carpark_mj scene --layout square --out scene.xml
    python -m mujoco.viewer --mjcf=scene.xml
    carpark_mj scene --layout lot --seed 3 --view
    carpark_mj scene --layout lot --seed 3 --view web
    carpark_mj scene --policy runs/cpu-0 --view web
    carpark_mj scene --layout square --suspension --view

    Attributes:
        policy: pretrained policy, run folder or checkpoint file that drives, or `zero`
            or `random`; in the browser only.
        num_agents: number of cars to drive; default 2, or 1 in a lot with one goal, or
            as in the policy's training.
        suspension: springs between the wheels and the cars to drive.
        seed: random seed of the lot and its cars.
    """

    suspension: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.policy and (self.view != "web" or self.out):
            raise ValueError(
                "a policy drives in the browser only: give --view web alone"
            )
        if self.policy:
            require_unset(self, "with --policy", "suspension")


@dataclasses.dataclass(frozen=True)
class PlayConfig(ShownLot):
    """Drive a car yourself: keyboard or gamepad in a window, or a page for a browser.

    carpark_mj play --layout street
    carpark_mj play --policy square --view window --camera chase:0
    carpark_mj play --replay runs/play/drive-0.npz --video drive.mp4

    Keys: arrows or WASD steer and drive, space brakes, R restarts the lot, N takes the
    next one, Q ends. Gamepad: left stick, right trigger ahead, left trigger back.
    Without a display a page is served instead, with a steering wheel and a pedal.

    Attributes:
        policy: pretrained policy, run folder or checkpoint file that drives the other
            cars; without a policy they stand.
        num_agents: number of cars, yours included; default 1, or as in the policy's
            training.
        seed: seed of the lot; the next lot has the next seed.
        view: `window`, or `web` for a page on this machine; default: a window if there
            is a display.
        camera: camera of the window or the video: `topdown`, `overview`, `chase:0`,
            `driver:0` or `split`.
        out: folder in which every drive is saved as drive-K.npz.
        replay: a saved drive to look at instead.
        video: `.mp4` or `.gif` to write the replay to.
        port: port of the page.
    """

    view: Literal["", "window", "web"] = ""
    camera: str = "split"
    out: str = "runs/play"
    replay: str = ""
    video: str = ""
    port: Port = PORT

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.video and not self.replay:
            raise ValueError("video needs a drive to show: give --replay FILE.npz")
        if self.replay:
            require_unset(self, "with --replay", *LOT)
        if self.video:
            require_unset(self, "with --video", "view", "port")
        elif self.shown_in == "web":
            require_unset(self, "in the browser, which has its own", "camera")
        else:
            require_unset(self, "in a window", "port")
        camera_names(self.camera)

    @property
    def shown_in(self) -> str:
        """`window` or `web`."""
        return self.view or ("window" if has_display() else "web")


def complete(words: Sequence[str]) -> list[str]:
    """The command line with `--view` alone written out as `--view window`."""
    found: list[str] = []
    for word, after in zip(words, [*words[1:], "--"], strict=True):
        found.append(word)
        if word == "--view" and after.startswith("--"):
            found.append("window")
    return found
