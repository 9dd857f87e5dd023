"""Writes a car park as MJCF that drives in the MuJoCo viewer, or opens it there.

python -m carpark_mj.scene --layout square --out scene.xml
python -m mujoco.viewer --mjcf=scene.xml
python -m carpark_mj.scene --layout square --suspension --view
"""

import dataclasses
import os
import sys
from pathlib import Path

import jax
import mujoco
import numpy as np

from carpark_mj.command_line import USER_ERRORS, one_line
from carpark_mj.config import EnvConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.policy.checkpoints import write_atomically
from carpark_mj.scene.export import drivable_scene, scene_xml
from carpark_mj.vehicle import preset

PROGRAM = "python -m carpark_mj.scene"
NO_DISPLAY = (
    "no display to open a window on (DISPLAY and WAYLAND_DISPLAY are unset): use a "
    "desktop session or `ssh -X`, or write a file with --out and open it elsewhere "
    "with `python -m mujoco.viewer --mjcf=FILE`, or render off-screen with "
    "`python eval/render.py zero --frame 0`"
)


@dataclasses.dataclass(frozen=True)
class SceneConfig:
    """Settings of `python -m carpark_mj.scene`.

    Attributes:
        layout: name of a lot or a family (`square`, `street`, `lot`...), or a layout
            file, as in `EnvConfig`.
        out: MJCF file to write; it needs no other file and no carpark_mj.
        view: open the scene in the MuJoCo viewer.
        num_agents: cars to drive.
        num_parked_cars: cars standing in bays.
        vehicle: preset of all cars.
        suspension: springs between the wheels and the cars to drive.
        seed: of what stands where.
    """

    layout: str = "square"
    out: str = ""
    view: bool = False
    num_agents: int = 2
    num_parked_cars: int = 16
    vehicle: str = "compact"
    suspension: bool = False
    seed: int = 0

    def __post_init__(self) -> None:
        if not self.out and not self.view:
            raise ValueError("give --out FILE.xml to write the scene, --view, or both")
        if self.out and Path(self.out).suffix != ".xml":
            raise ValueError(f"out must end in .xml, not {self.out!r}")


def make_scene(config: SceneConfig) -> mujoco.MjSpec:
    """Draws a lot as an episode would start and builds its drivable scene.

    Raises:
        ValueError: unknown vehicle, or more cars than the lot holds.
    """
    env = ParkingEnv(
        EnvConfig(
            layout=config.layout,
            vehicle=config.vehicle,
            num_agents=config.num_agents,
            num_parked_cars=config.num_parked_cars,
        )
    )
    state, _ = jax.jit(env.reset)(jax.random.key(config.seed))
    return drivable_scene(
        state.layout,
        preset(config.vehicle),
        np.asarray(state.vehicle.pose_w),
        np.asarray(state.layout.bay_pose[state.occupancy.parked_bay]),
        config.suspension,
    )


def main(config: SceneConfig) -> None:
    """Writes and shows.

    Raises:
        ValueError: impossible settings.
        OSError: the file cannot be written, or there is no display.
    """
    display = sys.platform != "linux" or any(
        os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")
    )
    if config.view and not display and not config.out:
        raise OSError(NO_DISPLAY)
    spec = make_scene(config)
    if config.out:
        path = Path(config.out)
        path.parent.mkdir(parents=True, exist_ok=True)
        text = scene_xml(spec, preset(config.vehicle), config.out)
        write_atomically(path, lambda temporary: temporary.write_text(text))
        print(f"wrote {path}; open it: python -m mujoco.viewer --mjcf={path}")
    if config.view:
        if not display:
            raise OSError(NO_DISPLAY)
        import mujoco.viewer

        mujoco.viewer.launch(spec.compile())


if __name__ == "__main__":
    try:
        import tyro
    except ImportError:
        print("scene: flags need tyro: pip install 'carpark_mj[eval]'", file=sys.stderr)
        sys.exit(2)
    try:
        main(tyro.cli(SceneConfig, prog=PROGRAM, description=__doc__))
    except USER_ERRORS as error:
        print(f"scene: {one_line(error)}", file=sys.stderr)
        sys.exit(2)
