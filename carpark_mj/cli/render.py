"""`carpark_mj render`: records episodes and renders them off-screen."""

import contextlib
import functools
import time
from pathlib import Path

from PIL import Image
from rich import get_console
from rich.progress import track

from carpark_mj.cli.clock import COMPILING, doing
from carpark_mj.cli.driver import adapted, find_driver
from carpark_mj.cli.settings.driving import RenderConfig
from carpark_mj.config import EnvConfig
from carpark_mj.config.checks import counted
from carpark_mj.env import ParkingEnv
from carpark_mj.files import require_writable, write_atomically
from carpark_mj.observations.fields import Tracked
from carpark_mj.rendering.gl import choose_gl
from carpark_mj.rendering.recording import num_frames, record, recording_stage
from carpark_mj.rendering.renderer import LotRenderer, RenderingError
from carpark_mj.rendering.video import (
    CarCameras,
    draw_frame,
    frame_indices,
    write_video,
)


def main(config: RenderConfig) -> Path:
    """Drives, draws and writes; returns the file."""
    driver = find_driver(config.run, config.environment)
    env_config = adapted(config, driver.env)
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
            rings = env_config.observation.circles if "rings" in config.extras else ()
            shown = config.camera, size, _tracked(config, env_config), rings
            renderer = LotRenderer(recording_stage(env, recording), *shown)
            stack.enter_context(contextlib.closing(renderer))
            draw = functools.partial(draw_frame, recording, renderer)
        out.parent.mkdir(parents=True, exist_ok=True)
        if config.frame is not None:
            picture = Image.fromarray(draw(num_frames(recording) - 1))
            write_atomically(out, lambda file: picture.save(file, optimize=True))
            drawn = ""
        else:
            indices, shown = frame_indices(recording, config.fps)
            start = time.monotonic()
            # Notebooks would need another package for the bar.
            hidden = get_console().is_jupyter
            bar = track(indices, "rendering", transient=True, disable=hidden)
            count = write_video(out, map(draw, bar), shown)
            rate = count / (time.monotonic() - start)
            drawn = f"{counted(count, 'frame')}, {rate:.1f} rendered per second, "
    print(f"wrote {out}: {seconds:g} s, {drawn}camera {config.camera}")
    return out


def _open_output(config: RenderConfig, folder: Path) -> Path:
    """The file to write, checked before the work."""
    name = "video.mp4" if config.frame is None else "frame.png"
    out = Path(config.out) if config.out else folder / name
    if (missing_gl := choose_gl()) and config.rig() is None:
        raise RenderingError(missing_gl)
    require_writable(out, new_folders=True)
    return out


def _tracked(config: RenderConfig, env: EnvConfig) -> Tracked | None:
    seen = env.observation
    tracked = seen.tracked if "tracked" in config.extras else None
    if tracked == Tracked():
        raise ValueError(
            "show 'tracked' needs an observation that tracks cars, and the "
            f"encoding {seen.encoding!r} tracks none here"
        )
    return tracked
