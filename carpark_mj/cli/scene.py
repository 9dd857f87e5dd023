"""`carpark_mj scene`: a car park as MJCF, in a file or in a viewer."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import jax
import mujoco
import numpy as np

from carpark_mj.cli.clock import COMPILING, doing, wait_for_user
from carpark_mj.cli.driver import LotSettings, find_driver
from carpark_mj.config import EnvConfig
from carpark_mj.config.checks import CheckedConfig, require_unset
from carpark_mj.env import ParkingEnv
from carpark_mj.files import require_suffix, require_writable, write_text
from carpark_mj.layouts import layout_config
from carpark_mj.registry import environment
from carpark_mj.rendering.gl import missing_display
from carpark_mj.rendering.local_pages import HOST, PORT, Port
from carpark_mj.rendering.web import LiveLot, make_live_viewer, make_viewer, require_web
from carpark_mj.scene.build import drivable_scene, scene_xml
from carpark_mj.spawning.checks import has_exits
from carpark_mj.vehicle import preset

WITHOUT_DISPLAY = (
    "use a desktop session or `ssh -X`, or look at it in a browser with --view web, or "
    "write a file with --out and open it elsewhere with `python -m mujoco.viewer "
    "--mjcf=FILE`, or render off-screen with `carpark_mj render zero --frame 0`"
)


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


def make_scene(config: SceneConfig) -> tuple[mujoco.MjSpec, np.ndarray]:
    """The drivable scene of a lot at its start, and the lot's half widths (2,) [m]."""
    env = ParkingEnv(config.adapted(default_env(config)))
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


def show_policy(config: SceneConfig) -> None:
    """Serves a lot in which a policy drives, until Ctrl-C."""
    require_web()  # before the work
    driver = find_driver(config.policy)
    env = ParkingEnv(config.adapted(driver.env))
    doing(COMPILING)
    viewer, server = make_live_viewer(
        LiveLot(env, driver.policy(env), config.seed), config.port
    )
    serve(viewer, server)


def serve(viewer: Any, server: Any) -> None:
    """Says where a page is, and shows it until Ctrl-C."""
    print(f"open http://{HOST}:{server.get_port()} (Ctrl-C ends)", flush=True)
    wait_for_user()
    viewer.run()


def main(config: SceneConfig) -> None:
    """Writes and shows."""
    if config.policy:
        show_policy(config)
        return
    require_view(config)
    spec, extent = make_scene(config)
    vehicle = preset(config.adapted(default_env(config)).vehicle)
    show_scene(config, spec, extent, scene_xml(spec, vehicle))


def require_view(output: SceneOutput) -> None:
    """Refuses, before the work, what cannot be shown or written."""
    if output.out:
        require_writable(Path(output.out), new_folders=True)
    else:
        _require_display(output)
    if output.view == "web":
        require_web()


def _require_display(output: SceneOutput) -> None:
    if output.view == "window" and (missing := missing_display()):
        raise OSError(f"{missing}: {WITHOUT_DISPLAY}")


def show_scene(
    output: SceneOutput, spec: mujoco.MjSpec, extent: np.ndarray, text: str
) -> None:
    """Writes a scene and shows it.

    Args:
        output: where it goes.
        spec: the scene.
        extent: (2,) half widths that the browser shows [m].
        text: the scene as MJCF.
    """
    if output.out:
        path = Path(output.out)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, text)
        print(f"wrote {path}; open it: python -m mujoco.viewer --mjcf={path}")
    _require_display(output)
    if output.view == "web":
        model = spec.compile()
        viewer, server = make_viewer(model, mujoco.MjData(model), extent, output.port)
        serve(viewer, server)
    elif output.view:
        from mujoco import viewer as window

        wait_for_user()
        window.launch(spec.compile())


def complete(words: Sequence[str]) -> list[str]:
    """The command line with `--view` alone written out as `--view window`."""
    found: list[str] = []
    for word, after in zip(words, [*words[1:], "--"], strict=True):
        found.append(word)
        if word == "--view" and after.startswith("--"):
            found.append("window")
    return found
