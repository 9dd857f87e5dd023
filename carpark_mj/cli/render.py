"""`carpark_mj render`: records episodes and renders them off-screen."""

import contextlib
import dataclasses
import functools
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from PIL import Image
from rich.progress import track

from carpark_mj.cameras import RIGS, Rig
from carpark_mj.cameras.see import Channel
from carpark_mj.cli.clock import COMPILING, doing
from carpark_mj.cli.driver import DriveSettings, find_driver
from carpark_mj.cli.process import MAX_SECONDS
from carpark_mj.config import EnvConfig
from carpark_mj.config.checks import Bounds, Positive, require_unset
from carpark_mj.env import ParkingEnv
from carpark_mj.files import require_writable, write_atomically
from carpark_mj.observations.fields import Tracked
from carpark_mj.rendering.gallery import FAMILIES, cell_size, contact_sheet, draw_lots
from carpark_mj.rendering.gl import choose_gl
from carpark_mj.rendering.recording import (
    Recording,
    num_frames,
    record,
    recording_stage,
)
from carpark_mj.rendering.renderer import (
    LotRenderer,
    RenderingError,
    Show,
    camera_names,
)
from carpark_mj.rendering.video import (
    CarCameras,
    car_cameras,
    draw_frame,
    frame_indices,
    write_video,
)
from carpark_mj.scene.build import OFFSCREEN_HEIGHT, OFFSCREEN_WIDTH


@dataclasses.dataclass(frozen=True)
class RenderConfig(DriveSettings):
    """Renders a policy's evaluation episodes off-screen to an mp4, a GIF or a still.

    carpark_mj render runs/cpu-0
    carpark_mj render runs/cpu-0 --camera split:1 --show tracked,rings
    carpark_mj render runs/cpu-0 --physics scene --respawn false
    carpark_mj render runs/cpu-0 --camera chase:0 --seconds 30
    carpark_mj render runs/cpu-0 --camera driver:0 --layout lot --seed 3
    carpark_mj render runs/cpu-0 --frame 12 --out frame.png
    carpark_mj render --gallery --out gallery.png

    Attributes:
        out: file to write: .mp4, .gif, or .png for a still; default `video.mp4` or
            `frame.png` in the run folder, `gallery.png` here for the gallery.
        camera: `topdown`, `overview`, `chase:K` behind agent K, `driver:K` at its
            wheel, or `split:K`: topdown and chase:K side by side. Or what the first
            agent's cameras see: a rig, as `surround`, or one of its cameras, as
            `surround:0`.
        channel: what a rig's pictures show: `colour`, `depth` or `seen`.
        show: comma-separated extras: `tracked` links every agent to the cars and bays
            it tracks, `rings` draws the circles in which it counts walls; of agent K
            alone with `chase:K`, `driver:K` and `split:K`.
        seconds: length of the video [s].
        fps: frames per second; the nearest the recording allows (20, 10, 5 ...).
        frame: write a still at this time [s] instead of a video.
        gallery: write a contact sheet instead, `width` wide: two lots of the square and
            of six families, from `overview`, with seeds from `seed` on. It needs no
            run.
        width: width of a frame [pixels], even.
        height: height of a frame [pixels], even.
        respawn: whether finished agents respawn; `false` = one episode per agent.
    """

    out: str = ""
    camera: str = "topdown"
    channel: Channel = "colour"
    show: str = ""
    seconds: Annotated[float, Bounds(gt=0.0, le=MAX_SECONDS)] = 20.0
    fps: Positive = 10.0
    frame: Annotated[float | None, Bounds(ge=0.0, le=MAX_SECONDS, unit="s")] = None
    gallery: bool = False
    width: Annotated[int, Bounds(ge=2, le=OFFSCREEN_WIDTH)] = 1280
    height: Annotated[int, Bounds(ge=2, le=OFFSCREEN_HEIGHT)] = 720
    respawn: Literal["true", "false"] = "true"

    def __post_init__(self) -> None:
        super().__post_init__()
        if bool(self.run) == self.gallery:
            raise ValueError(
                "give a pretrained policy, a run folder, zero, random or planner, "
                "or --gallery" + (", not both" if self.run else "")
            )
        if self.gallery:
            shown = ("run", "out", "gallery", "width", "seed")
            others = [f.name for f in dataclasses.fields(self) if f.name not in shown]
            require_unset(self, "with --gallery", *others)
        if self.frame is not None:
            require_unset(self, "with --frame", "seconds", "fps")
        idle = "show" if self.rig() else "channel"
        require_unset(self, f"with --camera {self.camera}", idle)
        unknown = set(self.extras) - {"tracked", "rings"}
        if unknown:
            raise ValueError(
                f"show takes tracked and rings, with a comma between, not "
                f"{', '.join(sorted(unknown))!r}"
            )
        for name in ("width", "height"):
            if (value := getattr(self, name)) % 2:
                raise ValueError(f"{name} must be even, not {value}")

    def rig(self, num_agents: int | None = None) -> Rig | None:
        """The cameras of a car that `camera` names; None if it is one of the lot's."""
        rig = car_cameras(self.camera, (self.width, self.height))
        if rig is None:
            try:
                camera_names(self.camera, num_agents)
            except ValueError as error:
                rigs = ", ".join(sorted(RIGS))
                raise ValueError(
                    f"{error}, or what cars see: {rigs}, or one camera, as surround:0"
                ) from None
        return rig

    @property
    def extras(self) -> list[str]:
        """The names in `show`."""
        return [name.strip() for name in self.show.split(",") if name.strip()]


def main(config: RenderConfig) -> Path:
    """Drives, draws and writes; returns the file."""
    if config.gallery:
        return _gallery(config)
    driver = find_driver(config.run, config.environment)
    env_config = config.adapted(driver.env)
    episode = dataclasses.replace(env_config.episode, respawn=config.respawn == "true")
    env_config = dataclasses.replace(env_config, episode=episode)
    rig = config.rig(env_config.num_agents)  # refuse before the work
    out = _open_output(config, driver.folder)

    env = ParkingEnv(env_config)
    seconds = config.seconds if config.frame is None else config.frame
    num_steps = max(1, round(seconds / env_config.sim.ctrl_dt))
    doing(COMPILING)
    recording = record(env, driver.policy(env), num_steps, config.seed)
    with contextlib.ExitStack() as stack:
        size = config.width, config.height
        if rig is not None:
            draw = CarCameras(env, recording, rig, config.channel, size).draw
        else:
            stage, show = recording_stage(env, recording), _show(config, env_config)
            renderer = LotRenderer(stage, config.camera, size, show)
            stack.enter_context(contextlib.closing(renderer))
            draw = functools.partial(draw_frame, recording, renderer)
        if config.frame is not None:
            _write_png(out, Image.fromarray(draw(num_frames(recording) - 1)))
            drawn = ""
        else:
            drawn = f"{_write_frames(out, config.fps, recording, draw)}, "
    print(f"wrote {out}: {seconds:g} s, {drawn}camera {config.camera}")
    return out


def _open_output(config: RenderConfig, folder: Path) -> Path:
    """The file to write, checked before the work."""
    still = config.gallery or config.frame is not None
    name = ("gallery.png" if config.gallery else "frame.png") if still else "video.mp4"
    out = Path(config.out) if config.out else folder / name
    if out.suffix not in ((".png",) if still else (".mp4", ".gif")):
        raise ValueError(
            "out must end in .mp4 or .gif, or in .png with --frame or --gallery, not "
            f"{out.name!r}"
        )
    missing_gl = choose_gl()
    if missing_gl and (config.gallery or config.rig() is None):
        raise RenderingError(missing_gl)
    require_writable(out, new_folders=True)
    return out


def _show(config: RenderConfig, env: EnvConfig) -> Show:
    seen, tracked = env.observation, None
    if "tracked" in config.extras:
        tracked = seen.tracked
        if tracked == Tracked():
            raise ValueError(
                "show 'tracked' needs an observation that tracks cars, and the "
                f"encoding {seen.encoding!r} tracks none here"
            )
    rings = seen.circles if "rings" in config.extras else ()
    return Show(tracked, rings)


def _write_frames(
    out: Path, fps: float, recording: Recording, draw: Callable[[int], np.ndarray]
) -> str:
    """Writes the video; returns how many frames were drawn, and how fast."""
    indices, rate = frame_indices(recording, fps)
    out.parent.mkdir(parents=True, exist_ok=True)
    start = time.monotonic()
    pictures = map(draw, track(indices, "rendering", transient=True))
    count = write_video(out, pictures, rate)
    return (
        f"{count} frames, {count / (time.monotonic() - start):.1f} rendered per second"
    )


def _gallery(config: RenderConfig) -> Path:
    out = _open_output(config, Path())
    size = cell_size(config.width)
    cells = [
        cell
        for family in track(FAMILIES, "rendering", transient=True)
        for cell in draw_lots(family, size, config.seed)
    ]
    _write_png(out, contact_sheet(cells))
    print(f"wrote {out}: {len(cells)} lots")
    return out


def _write_png(path: Path, picture: Image.Image) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, lambda temporary: picture.save(temporary, optimize=True))
