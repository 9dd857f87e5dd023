"""Writes the junction as MJCF that drives in the MuJoCo viewer, or opens it there.

carpark_mj study junction_scene --scenario 3av-hd --out junction.xml
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from carpark_mj.cli.flags import command_help
from carpark_mj.cli.pages import open_page
from carpark_mj.cli.process import run_command
from carpark_mj.cli.scene import require_view, show_scene
from carpark_mj.cli.settings.driving import SceneOutput
from carpark_mj.config.checks import Seed
from carpark_mj.scene.build import scene_xml
from carpark_mj.vehicle import preset
from carpark_papers.cederle.junction import JunctionConfig, JunctionEnv
from carpark_papers.cederle.junction.cars import road_car
from carpark_papers.cederle.junction.scene import HALF, drivable_junction


@dataclasses.dataclass(frozen=True)
class JunctionSceneConfig(SceneOutput):
    """Settings of `carpark_mj study junction_scene`.

    Attributes:
        out: MJCF file to write; it needs no other file and no carpark_mj.
        view: open the scene: `window` is the MuJoCo viewer, `web` a page for a browser.
        port: port of the browser page.
        scenario: `2av`, `2av-hd`, `3av` or `3av-hd`, all cars to drive.
        vehicle: preset or file of all cars.
        seed: random seed of the starts.
    """

    scenario: str = "2av"
    vehicle: str = JunctionConfig.vehicle
    seed: Seed = 0


def main(config: JunctionSceneConfig, page: Any = None) -> None:
    """Writes and shows, in the browser on a page."""
    require_view(config)
    env = JunctionEnv(JunctionConfig(config.scenario))
    state, _ = env.reset(jax.random.key(config.seed))
    car = road_car(preset(config.vehicle))
    spec = drivable_junction(car, np.asarray(state.motion.pose_w))
    text = scene_xml(spec, car, "road junction")
    show_scene(config, spec, np.array([HALF, HALF]), text, page)


def run(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit code."""
    return run_command("junction_scene", lambda: _run(arguments))


def _run(arguments: Sequence[str] | None) -> None:
    from carpark_mj.cli.flags import read_flags

    text = command_help(__doc__ or "")
    config = read_flags(JunctionSceneConfig, arguments, description=text)
    with open_page(config.port, config.view == "web") as page:
        main(config, page)
