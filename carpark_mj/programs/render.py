"""Renders a policy's evaluation episodes off-screen to an mp4, a GIF or a still.

carpark_mj render runs/cpu-0
carpark_mj render runs/cpu-0 --camera split:1 --show tracked,rings
carpark_mj render runs/cpu-0 --physics scene --respawn false
carpark_mj render runs/cpu-0 --camera chase:0 --seconds 30
carpark_mj render runs/cpu-0 --camera driver:0 --layout lot --seed 3
carpark_mj render runs/cpu-0 --frame 12 --out frame.png
carpark_mj render --gallery --out gallery.png
"""

from collections.abc import Sequence

from carpark_mj.cli.common import (
    dispatch_synchronously,
    enable_output_fusion,
    keep_compiled_programs,
)
from carpark_mj.rendering.gl import choose_gl


def run(arguments: Sequence[str] | None = None) -> None:
    """Renders."""
    choose_gl()  # before MuJoCo is imported
    dispatch_synchronously()
    enable_output_fusion()
    keep_compiled_programs()
    from carpark_mj.cli.driver import command_help
    from carpark_mj.cli.flags import read_flags
    from carpark_mj.cli.render import RenderConfig, main

    main(read_flags(RenderConfig, arguments, description=command_help(__doc__)))
