"""`carpark_mj render`: records episodes and renders them off-screen."""

import contextlib
import functools
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

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
from carpark_mj.rendering.gallery import FAMILIES, cell_size, contact_sheet, draw_lots
from carpark_mj.rendering.gl import choose_gl
from carpark_mj.rendering.recording import num_frames, record, recording_stage
from carpark_mj.rendering.renderer import LotRenderer, RenderingError, Show
from carpark_mj.rendering.video import (
    CarCameras,
    draw_frame,
    frame_indices,
    write_video,
)


def main(config: RenderConfig) -> Path:
    """Drives, draws and writes; returns the file."""
    if config.gallery:
        return _gallery(config)
    driver = find_driver(config.run, config.environment)
    env_config = adapted(config, driver.env, respawn=config.respawn == "true")
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
        out.parent.mkdir(parents=True, exist_ok=True)
        if config.frame is not None:
            _write_png(out, Image.fromarray(draw(num_frames(recording) - 1)))
            drawn = ""
        else:
            indices, shown = frame_indices(recording, config.fps)
            start = time.monotonic()
            count = write_video(out, map(draw, _shown(indices)), shown)
            rate = count / (time.monotonic() - start)
            drawn = f"{counted(count, 'frame')}, {rate:.1f} rendered per second, "
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
    seen = env.observation
    tracked = seen.tracked if "tracked" in config.extras else None
    if tracked == Tracked():
        raise ValueError(
            "show 'tracked' needs an observation that tracks cars, and the "
            f"encoding {seen.encoding!r} tracks none here"
        )
    return Show(tracked, seen.circles if "rings" in config.extras else ())


def _shown(things: Iterable[Any]) -> Iterable[Any]:
    """Things under a progress bar, for which notebooks would need another package."""
    hidden = get_console().is_jupyter
    return track(things, "rendering", transient=True, disable=hidden)


def _gallery(config: RenderConfig) -> Path:
    out = _open_output(config, Path())
    more = cell_size(config.width), config.seed
    cells = [cell for name in _shown(FAMILIES) for cell in draw_lots(name, *more)]
    out.parent.mkdir(parents=True, exist_ok=True)
    _write_png(out, contact_sheet(cells))
    print(f"wrote {out}: {len(cells)} lots")
    return out


def _write_png(path: Path, picture: Image.Image) -> None:
    write_atomically(path, lambda temporary: picture.save(temporary, optimize=True))
