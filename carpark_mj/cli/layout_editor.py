"""Draws a lot in the browser and saves it as a layout file.

carpark_mj layouts edit --out my_lot.json
carpark_mj layouts edit my_lot.json
carpark_mj layouts edit --out my_lot.json --background plan.png --width 60
"""

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro

from carpark_mj.cli.common import run_command
from carpark_mj.cli.flags import read_flags
from carpark_mj.config.checks import require_unset
from carpark_mj.editor.document import EXTENT, Draft, Picture, read_picture
from carpark_mj.editor.server import EditorServer
from carpark_mj.files import require_writable
from carpark_mj.layouts.files import FARTHEST
from carpark_mj.rendering.local_pages import HOST, PORT, check_port

PROGRAM = "carpark_mj layouts edit"


@dataclasses.dataclass(frozen=True)
class EditConfig:
    """Settings of `carpark_mj layouts edit`.

    Attributes:
        file: layout file (`.json`) to edit; an empty lot if not given.
        out: layout file to save to; by default the edited one. Another one must be new.
        background: picture under the drawing (`.png`, `.jpg`, `.webp`), its middle at
            the origin.
        scale: metres per pixel of the picture.
        width: of the picture in metres, instead of `scale`.
        port: of the page on localhost.
    """

    file: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")] = ""
    out: str = ""
    background: str = ""
    scale: float = 0.0
    width: float = 0.0
    port: int = PORT

    def __post_init__(self) -> None:
        if not self.target:
            raise ValueError("nothing to edit: give FILE.json, or --out for a new lot")
        for name in filter(None, (self.file, self.target)):
            if not name.endswith(".json"):
                raise ValueError(f"layouts are edited in .json files, not {name}")
        if not self.background:
            require_unset(self, "without --background", "scale", "width")
        elif bool(self.scale) == bool(self.width):
            raise ValueError(
                "--background takes either --scale in metres per pixel or --width in "
                f"metres, not --scale {self.scale:g} and --width {self.width:g}"
            )
        for name in ("scale", "width"):
            value = getattr(self, name)
            if not 0 <= value <= FARTHEST:
                raise ValueError(
                    f"--{name} must lie in (0, {FARTHEST:g}] m, not {value:g}"
                )
        check_port(self.port)

    @property
    def target(self) -> str:
        """The file to save to."""
        return self.out or self.file


def serve(config: EditConfig) -> None:
    """Serves the page until it is interrupted.

    Raises:
        ValueError: a file is no layout or no picture, or would be lost.
        OSError: a file cannot be read or written, or the port is taken.
    """
    out, source = Path(config.target), Path(config.file) if config.file else None
    if out.exists() and (source is None or not out.samefile(source)):
        raise ValueError(f"{out} exists: edit it by `{PROGRAM} {out}`")
    picture: Picture | None = None
    if config.background:
        picture = read_picture(Path(config.background), config.scale, config.width)
    require_writable(out)
    extent = EXTENT
    if picture:
        extent = tuple(math.ceil(side) / 2 for side in picture.size)
    draft = Draft(out, source, extent)
    with EditorServer(draft, config.port, picture) as server:
        if draft.kept.exists():
            print(f"opened unsaved changes: {draft.kept}")
        print(f"open http://{HOST}:{server.server_port} (Ctrl-C ends)", flush=True)
        server.serve_forever()


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit code."""

    def command() -> None:
        serve(read_flags(EditConfig, arguments, description=__doc__, prog=PROGRAM))

    return run_command("layouts edit", command)
