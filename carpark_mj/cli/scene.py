"""`carpark_mj scene`: a car park as MJCF, in a file or in a viewer."""

import dataclasses
from pathlib import Path
from typing import Any

import jax
import mujoco
import numpy as np

from carpark_mj.cli.clock import COMPILING, PLACING, doing, wait_for_user
from carpark_mj.cli.driver import adapted, find_driver
from carpark_mj.cli.settings.driving import LotSettings, SceneConfig, SceneOutput
from carpark_mj.config import EnvConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.files import require_writable, write_text
from carpark_mj.layouts import layout_config
from carpark_mj.registry import environment
from carpark_mj.rendering.gl import missing_display
from carpark_mj.rendering.web import LiveLot, make_live_viewer, make_viewer
from carpark_mj.scene.build import drivable_scene, scene_xml
from carpark_mj.spawning.checks import has_exits
from carpark_mj.vehicle import preset

WITHOUT_DISPLAY = (
    "use a desktop session or `ssh -X`, or look at it in a browser with --view web, or "
    "write a file with --out and open it elsewhere with `python -m mujoco.viewer "
    "--mjcf=FILE`, or render off-screen with `carpark_mj render zero --frame 0`"
)


def make_scene(config: SceneConfig) -> tuple[mujoco.MjSpec, np.ndarray]:
    """The drivable scene of a lot at its start, and the lot's half widths (2,) [m]."""
    env = ParkingEnv(adapted(config, default_env(config)))
    state, _ = jax.jit(env.reset)(jax.random.key(config.seed))
    spec = drivable_scene(
        state.layout,
        env.vehicle,
        np.asarray(state.motion.pose_w),
        np.asarray(state.parked_cars.pose_w),
        config.suspension,
        state.movers.groups,
    )
    return spec, np.asarray(state.layout.extent)


def default_env(config: LotSettings) -> EnvConfig:
    """Two agents and sixteen parked cars, or as many as fit into the lot."""
    name = config.layout or "square"
    lot = layout_config(name)
    agents = config.num_agents or min(EnvConfig.num_agents, lot.min_goals)
    if has_exits(lot):
        drive_out = environment("metadrive")
        return dataclasses.replace(drive_out, layout=name, num_agents=agents)
    room = lot.min_bays - agents
    parked = max(0, min(EnvConfig.num_parked_cars, room))
    return EnvConfig(layout=name, num_agents=agents, num_parked_cars=parked)


def run_live(viewer: Any, lot: LiveLot) -> None:
    """Moves a lot on its page until Ctrl-C; until it can, the page shows its start."""
    doing(COMPILING)
    lot.compile_step()
    wait_for_user()
    viewer.run()


def main(config: SceneConfig, page: Any = None) -> None:
    """Writes and shows; `page` is an open one for the browser, see `cli.pages`."""
    if config.policy:
        driver = find_driver(config.policy)
        env = ParkingEnv(adapted(config, driver.env))
        doing(PLACING)
        lot = LiveLot(env, driver.policy(env), config.seed)
        return run_live(make_live_viewer(page, lot), lot)
    require_view(config)
    if page is not None:
        doing(PLACING)
    spec, extent = make_scene(config)
    vehicle = preset(adapted(config, default_env(config)).vehicle)
    show_scene(config, spec, extent, scene_xml(spec, vehicle), page)


def require_view(output: SceneOutput) -> None:
    """Refuses, before the work, what cannot be shown or written."""
    if output.out:
        require_writable(Path(output.out), new_folders=True)
    else:
        _require_display(output)


def _require_display(output: SceneOutput) -> None:
    if output.view == "window" and (missing := missing_display()):
        raise OSError(f"{missing}: {WITHOUT_DISPLAY}")


def show_scene(
    output: SceneOutput,
    spec: mujoco.MjSpec,
    extent: np.ndarray,
    text: str,
    page: Any = None,
) -> None:
    """Writes a scene, `text` as MJCF, and shows it; a browser needs its `page`.

    `extent` (2,) are the half widths that the browser shows [m].
    """
    if output.out:
        path = Path(output.out)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, text)
        print(f"wrote {path}; open it: python -m mujoco.viewer --mjcf={path}")
    _require_display(output)
    if output.view == "web":
        model = spec.compile()
        viewer = make_viewer(page, model, mujoco.MjData(model), extent)
        wait_for_user()
        viewer.run()
    elif output.view:
        from mujoco import viewer as window

        wait_for_user()
        window.launch(spec.compile())
