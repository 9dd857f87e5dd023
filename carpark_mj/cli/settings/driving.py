"""Settings of the commands in which somebody drives, and of `export`."""

import dataclasses
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from carpark_mj import config
from carpark_mj.cli.process import MAX_EPISODES, MAX_SECONDS
from carpark_mj.config.checks import (
    Bounds,
    CheckedConfig,
    Count,
    NonNegative,
    Positive,
    Seed,
    require_unset,
)
from carpark_mj.files import require_suffix
from carpark_mj.rendering.gl import has_display
from carpark_mj.rendering.local_pages import PORT, Port
from carpark_mj.scene.camera_flags import (
    OFFSCREEN_HEIGHT,
    OFFSCREEN_WIDTH,
    camera_names,
)

if TYPE_CHECKING:
    from carpark_mj.cameras import Rig

LOT = ("layout", "policy", "num_agents", "num_parked_cars", "vehicle", "seed", "out")


@dataclasses.dataclass(frozen=True, kw_only=True)
class LotSettings(CheckedConfig):
    """Overrides of an environment that several commands have.

    Attributes:
        layout: the lot, a name or a layout file, or a comma-separated list of them;
            default: that of the run.
        num_agents: number of agents; default: that of the run.
        num_parked_cars: number of parked cars; default: that of the run.
        vehicle: preset or file of all cars; default: that of the run, or its fleet.
        seed: seed of the held-out lots; training never uses these keys.
    """

    layout: str | None = None
    num_agents: int | None = None
    num_parked_cars: int | None = None
    vehicle: str | None = None
    seed: Seed = 0


@dataclasses.dataclass(frozen=True)
class DriveSettings(LotSettings):
    """A policy, and overrides of its environment.

    Attributes:
        run: pretrained policy, run folder, checkpoint file, `zero`, `random` or
            `planner`, or one of another library: `onnx:FILE`, `torch:FILE`, `sb3:FILE`
            or `sb3:FILE,VECNORMALIZE`, `function:MODULE:NAME`.
        environment: name of an environment, see `carpark_mj.registry`; default: that of
            the run. A policy keeps the observation of its training.
        movers: moving obstacles, `pedestrians:number=20`; default: those of the run.
        physics: back end; default: the run's. Crashes of `scene` are MuJoCo's contacts.
        set: any other settings of the environment, as in
            `sim.steering_delay=0.24 sensors.delay_max=2`.
    """

    run: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
    _: dataclasses.KW_ONLY
    environment: str = ""
    movers: tuple[str, ...] | None = None
    physics: str | None = None
    set: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class EvaluateConfig(DriveSettings):
    """Evaluates a policy on held-out seeds.

    Writes `evaluation.csv` and `evaluation.json`, and prints the table. The
    documentation's page on metrics defines every number.

    carpark_mj evaluate runs/cpu-0
    carpark_mj evaluate runs/cpu-mixture-0
    carpark_mj evaluate random --episodes 500
    carpark_mj evaluate zero --environment square

    Attributes:
        episodes: least number of episodes, rounded up to an equal number for every
            agent of every lot; 1,024 become 1,792 for seven agents in 128 lots.
        horizon: simulated time [s]; all episodes that begin within it count, instead of
            an equal number per agent, so that short episodes weigh more. `episodes`
            then sets the number of lots.
        num_lots: lots simulated side by side, each with its own share of the episodes;
            no more than these fill.
        rule: parked rule of the evaluation: tanner, strict, precise, exact, metadrive,
            or a registered one; default: that of the run.
        min_agents: lots have `min_agents` to `num_agents` agents, each number equally
            often. Default: that of the run, or `num_agents` if that is given.
        nominal: switch off noise and delay of sensors and randomization of the cars.
        stochastic: sample actions instead of taking the distribution's mode.
        out: folder for the CSV and JSON files; default: the run folder, or `runs/NAME`
            for a baseline or a pretrained policy. Flags for another task or other
            episodes, and checkpoint files of a run, get a subfolder of `evaluations/`.
    """

    episodes: Annotated[int, Bounds(ge=1, le=MAX_EPISODES)] = 1024
    horizon: Annotated[float | None, Bounds(gt=0.0, le=MAX_SECONDS, unit="s")] = None
    num_lots: Count = 128
    rule: str | None = None
    min_agents: int | None = None
    nominal: bool = False
    stochastic: bool = False
    out: str = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.rule is not None:
            config.find_rules(self.rule)


@dataclasses.dataclass(frozen=True)
class RecordConfig(DriveSettings):
    """Records episodes of a policy as data: a Minari data set and arrays of NumPy.

    carpark_mj record planner --environment first --episodes 1000 --out data
    carpark_mj record anywhere --layout street --noise 0.1 --out data/street
    carpark_mj record runs/play --out data/people

    One car drives. Episode i is that of `carpark_mj/Park-v0` with the recorded config
    after `reset(seed=SEED + i)`. Drives that `play` has saved in a folder give whole
    episodes without seeds. Writes `episodes.npz`, `recording.json` with settings and a
    hash, and a data set that `MINARI_DATASETS_PATH=OUT` makes loadable.

    Attributes:
        seed: of the first episode.
        episodes: number of episodes.
        num_lots: lots simulated side by side.
        rule: parked rule; default: that of the run.
        noise: standard deviation of normal noise on steer and pedal.
        minari: write the data set of Minari: `pip install "carpark_mj[minari]"`.
        out: folder.
    """

    episodes: Annotated[int, Bounds(ge=1, le=MAX_EPISODES)] = 100
    num_lots: Count = 64
    rule: str | None = None
    noise: NonNegative = 0.0
    minari: bool = True
    out: str = "runs/data"

    def __post_init__(self) -> None:
        super().__post_init__()
        require_unset(self, "as one car drives", "num_agents")


@dataclasses.dataclass(frozen=True)
class RenderConfig(DriveSettings):
    """Renders a policy's evaluation episodes off-screen to an mp4, a GIF or a still.

    carpark_mj render runs/cpu-0
    carpark_mj render runs/cpu-0 --camera split:1 --show tracked,rings
    carpark_mj render runs/cpu-0 --physics scene --set episode.respawn=false
    carpark_mj render runs/cpu-0 --camera chase:0 --seconds 30
    carpark_mj render runs/cpu-0 --camera driver:0 --layout lot --seed 3
    carpark_mj render runs/cpu-0 --frame 12 --out frame.png

    Attributes:
        out: file to write: .mp4, .gif, or .png for a still; default `video.mp4` or
            `frame.png` in the run folder.
        camera: `topdown`, `overview`, `chase:K` behind agent K, `driver:K` at its
            wheel, or `split:K`: topdown and chase:K side by side. Or what the first
            agent's cameras see: a rig (`surround`) or a camera of it (`surround:0`).
        channel: what a rig's pictures show: `colour`, `depth` or `seen`.
        show: comma-separated extras: `tracked` links every agent to the cars and bays
            it tracks, `rings` draws the circles in which it counts walls; of agent K
            alone with `chase:K`, `driver:K` and `split:K`.
        seconds: length of the video [s].
        fps: frames per second; the nearest the recording allows (20, 10, 5 ...).
        frame: write a still at this time [s] instead of a video.
        width: width of a frame [pixels], even.
        height: height of a frame [pixels], even.
    """

    out: str = ""
    camera: str = "topdown"
    channel: Literal["colour", "depth", "seen"] = "colour"
    show: str = ""
    seconds: Annotated[float, Bounds(gt=0.0, le=MAX_SECONDS)] = 20.0
    fps: Positive = 10.0
    frame: Annotated[float | None, Bounds(ge=0.0, le=MAX_SECONDS, unit="s")] = None
    width: Annotated[int, Bounds(ge=2, le=OFFSCREEN_WIDTH)] = 1280
    height: Annotated[int, Bounds(ge=2, le=OFFSCREEN_HEIGHT)] = 720

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.frame is not None:
            require_unset(self, "with --frame", "seconds", "fps")
            require_suffix("out with --frame", self.out, ".png")
        else:
            require_suffix("out without --frame", self.out, ".mp4", ".gif")
        unknown = set(self.extras) - {"tracked", "rings"}
        if unknown:
            raise ValueError(
                f"show takes tracked and rings, with a comma between, not "
                f"{', '.join(sorted(unknown))!r}"
            )
        for name in ("width", "height"):
            if (value := getattr(self, name)) % 2:
                raise ValueError(f"{name} must be even, not {value}")
        idle = "show" if self.rig() else "channel"
        require_unset(self, f"with --camera {self.camera}", idle)

    def rig(self, num_agents: int | None = None) -> "Rig | None":
        """The cameras of a car that `camera` names; None if it is one of the lot's."""
        try:
            camera_names(self.camera, num_agents)
        except ValueError as error:
            from carpark_mj.cameras.rig import RIGS, car_cameras

            rig = car_cameras(self.camera, (self.width, self.height))
            if rig is None:
                rigs = ", ".join(sorted(RIGS))
                raise ValueError(
                    f"{error}, or what cars see: {rigs}, or one camera, as surround:0"
                ) from None
            return rig
        return None

    @property
    def extras(self) -> list[str]:
        """The names in `show`."""
        return [name.strip() for name in self.show.split(",") if name.strip()]


@dataclasses.dataclass(frozen=True)
class ExportConfig(CheckedConfig):
    """Writes a policy as a checkpoint without training state.

    carpark_mj export runs/cpu-0 --out policy.npz     # as the pretrained policies are

    ONNX models come with carpark_formats: `pip install ./formats`.

    Attributes:
        run: pretrained policy, run folder or checkpoint file.
        out: file to write, .npz.
    """

    run: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
    out: str = ""


@dataclasses.dataclass(frozen=True)
class SceneOutput(CheckedConfig):
    """Output of a scene.

    Attributes:
        out: MJCF file to write; it needs no other file and no carpark_mj.
        view: open the scene: `window` is the MuJoCo viewer, `web` a page for a browser.
        port: port of the browser page.
    """

    out: str = ""
    view: Literal["", "window", "web"] = ""
    port: Port = PORT

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.out and not self.view:
            raise ValueError("give --out FILE.xml, --view window or --view web")
        if self.view != "web":
            require_unset(self, "without --view web", "port")
        require_suffix("out", self.out, ".xml")


@dataclasses.dataclass(frozen=True, kw_only=True)
class ShownLot(LotSettings):
    """A lot to view or to drive in.

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
    carpark_mj scene --layout lot --seed 3 --view window
    carpark_mj scene --layout lot --seed 3 --view web
    carpark_mj scene --policy runs/cpu-0 --view web
    carpark_mj scene --layout square --suspension --view window

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
    carpark_mj play --environment first --out runs/mine
    carpark_mj play --policy square --view window --camera chase:0
    carpark_mj play --replay runs/play/drive-0.npz --video drive.mp4

    Keys: arrows or WASD steer and drive, space brakes, R restarts the lot, N takes the
    next one, Q ends. Gamepad: left stick, right trigger ahead, left trigger back.
    Without a display a page is served instead, where arrows or WASD move the steering
    and the pedal step by step; left is positive.

    Attributes:
        environment: name of an environment, see `carpark_mj.registry`; default: one of
            the layout, or that of the policy.
        policy: pretrained policy, run folder or checkpoint file that drives the other
            cars; without a policy they stand.
        num_agents: number of cars, yours included; default 1, or the policy's.
        seed: seed of the lot; the next lot has the next seed.
        view: `window`, or `web` for a page; default: a window if there is a display.
        camera: camera of the window or the video: `topdown`, `overview`, `chase:0`,
            `driver:0` or `split`.
        out: folder in which every drive is saved as drive-K.npz.
        replay: a saved drive to replay instead.
        video: `.mp4` or `.gif` to write the replay to.
        port: port of the page.
    """

    environment: str = ""
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
            require_unset(self, "with --replay", "environment", *LOT)
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
