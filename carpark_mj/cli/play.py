"""`carpark_mj play`: driving by hand, in a window or on a page for a browser."""

import contextlib
import dataclasses
import functools
import itertools
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from carpark_mj.cli.settings.driving import PlayConfig
from carpark_mj.config import EnvConfig, insert
from carpark_mj.config.checks import counted
from carpark_mj.rendering.gl import Window, choose_gl, has_display

if not has_display():
    choose_gl()  # before MuJoCo is imported; windows have an OpenGL of their own

from carpark_mj.cli.clock import COMPILING, PLACING, doing, wait_for_user
from carpark_mj.cli.driver import adapted, find_driver
from carpark_mj.cli.process import one_line, patient_interrupts
from carpark_mj.cli.scene import default_env, run_live
from carpark_mj.env import ParkingEnv
from carpark_mj.files import require_writable
from carpark_mj.play.demonstration import Demonstration, load_demonstration
from carpark_mj.play.driving import (
    KEYS,
    SIZE,
    Controls,
    DrivenLot,
    from_gamepad,
    from_keys,
    pictures,
    record_video,
    stop,
)
from carpark_mj.policy.acting import StatePolicy
from carpark_mj.policy.named import zero_policy
from carpark_mj.policy.networks import Policy
from carpark_mj.registry import environment
from carpark_mj.rendering.web import add_key, make_live_viewer

COMMANDS = ("R", "N", "Q")  # keys: restart, next lot, quit
# Keys of the page, each of which moves a slider by a step.
STEPS = (
    (("arrowleft", "A"), "Left", "steer", 0.2),
    (("arrowright", "D"), "Right", "steer", -0.2),
    (("arrowup", "W"), "Ahead", "pedal", 0.2),
    (("arrowdown", "S"), "Back", "pedal", -0.2),
)


def make_env(config: PlayConfig) -> tuple[ParkingEnv, Policy]:
    """The environment to drive in, and the policy of the other cars."""
    if config.policy:
        driver = find_driver(config.policy, config.environment)
        env = drivable(config, driver.env)
        policy = driver.policy(env)
        if isinstance(policy, StatePolicy):
            raise ValueError(
                f"policy must be one that acts on observations, not {config.policy}"
            )
        return env, policy
    if config.num_agents is None:
        config = dataclasses.replace(config, num_agents=1)
    named = config.environment
    env = drivable(config, environment(named) if named else default_env(config))
    return env, zero_policy(env.action_spec)


def drivable(config: PlayConfig, env: EnvConfig) -> ParkingEnv:
    """The environment that a command asks for, with what episodes end with."""
    env = adapted(config, env)
    return ParkingEnv(insert(env, {"episode.final_observation": env.episode.respawn}))


def replay(demonstration: Demonstration) -> DrivenLot:
    """The lot of a recorded drive, which repeats all actions."""
    env, last = ParkingEnv(demonstration.config), len(demonstration) - 1

    def read(lot: DrivenLot) -> np.ndarray:
        step = round(lot.seconds / env.config.sim.ctrl_dt)
        return demonstration.actions[min(step, last)]

    return DrivenLot(env, zero_policy(env.action_spec), demonstration.seed, read)


def open_folder(config: PlayConfig) -> Path:
    """The folder of the drives, made now: at the end of a drive it would be lost."""
    folder = Path(config.out)
    folder.mkdir(parents=True, exist_ok=True)
    require_writable(folder / "drive.npz")
    return folder


def save(lot: DrivenLot, folder: Path) -> None:
    """Saves what has been driven, if anything, under the next free number."""
    if (demonstration := lot.demonstration) is None:
        return
    paths = (folder / f"drive-{number}.npz" for number in itertools.count())
    path = next(path for path in paths if not path.exists())
    demonstration.save(path)
    driven = f"{lot.seconds:.0f} s, score {lot.score:.1f}"
    print(f"saved {path}: {driven}", flush=True)


def pad(action: np.ndarray, size: int) -> np.ndarray:
    """Actions (1, size) of agent 0, its goal choice that of tracking the first bay."""
    return np.concatenate([action, np.ones(size - 2, np.float32)])[None]


def play_in_window(config: PlayConfig) -> None:
    """Drives in a window until it is closed; every drive is saved."""
    env, others = make_env(config)
    controls, seed = Controls(), config.seed

    def read(lot: DrivenLot) -> np.ndarray:
        nonlocal controls
        gamepad, held = window.gamepad(), window.held(KEYS)
        if gamepad is not None and not held:
            controls = from_gamepad(gamepad[0])
        else:
            controls = from_keys(held, controls, lot.speed, env.config.sim.ctrl_dt)
        return pad(controls.action, env.action_spec.size)

    wanted = "N"
    with contextlib.closing(Window(SIZE)) as window:
        folder = open_folder(config)
        while wanted == "N":
            lot = DrivenLot(env, others, seed, read, lambda lot: save(lot, folder))
            wanted, seed = "R", seed + 1
            with pictures(lot, config.camera) as draw:
                window.show(draw())
                doing(COMPILING)
                lot.compile_step()
                try:
                    while wanted == "R":
                        wanted = _drive(lot, draw, window)
                        lot.reset()
                except BaseException:
                    save(lot, folder)
                    raise


def _drive(lot: DrivenLot, draw: Callable[[], np.ndarray], window: Window) -> str:
    """Drives in real time until a key of `COMMANDS` is pressed; returns that."""
    while window.held(COMMANDS):  # until the last one is released
        window.show(draw())
    due = time.monotonic()
    while not window.closed:
        lot.step()
        wait_for_user()
        window.show(draw())
        pressed = window.held(COMMANDS)
        if pressed:
            return min(pressed)
        due = max(due + lot.stage.model.opt.timestep, time.monotonic() - 1.0)
        time.sleep(max(0.0, due - time.monotonic()))
    return "Q"


def make_wheel(config: PlayConfig, page: Any) -> tuple[Any, DrivenLot, dict[str, Any]]:
    """Shows a lot on a page; gives viewer, lot, and sliders `steer` and `pedal`."""
    env, others = make_env(config)
    held: dict[str, Any] = {}
    folder = open_folder(config)

    def read(lot: DrivenLot) -> np.ndarray:
        steer, pedal = (held[k].value if held else 0.0 for k in ("steer", "pedal"))
        return pad(Controls(steer, pedal).action, env.action_spec.size)

    lot = DrivenLot(env, others, config.seed, read, lambda lot: save(lot, folder))
    viewer = make_live_viewer(page, lot)
    gui = page.gui
    with gui.add_folder("Drive"):
        gui.add_markdown("Arrows or WASD: steer, drive. Space: brake. R: restart.")
        held["steer"] = gui.add_slider("Steering, left > 0", -1.0, 1.0, 0.05, 0.0)
        held["pedal"] = gui.add_slider("Pedal, ahead > 0", -1.0, 1.0, 0.05, 0.0)
        straight, brake = gui.add_button("Straight"), gui.add_button("Brake")
        saving = gui.add_button("Save drive")

    def press(name: str, by: float) -> None:
        held[name].value = float(np.clip(held[name].value + by, -1.0, 1.0))

    def halt() -> None:
        held["pedal"].value = stop(lot.speed)

    for keys, label, name, by in STEPS:
        for key in keys:
            add_key(page, label, key, functools.partial(press, name, by))
    add_key(page, "Brake", "space", halt)
    brake.on_click(lambda _: halt())
    straight.on_click(lambda _: setattr(held["steer"], "value", 0.0))

    @saving.on_click
    def _(_: Any) -> None:
        try:
            save(lot, folder)
        except OSError as error:  # not the end of the drive
            print(one_line(error), file=sys.stderr)

    return viewer, lot, held


def show_replay(config: PlayConfig, page: Any) -> None:
    """Shows a recorded drive: as a video, in a window or in a browser."""
    demonstration = load_demonstration(Path(config.replay))
    lot = replay(demonstration)
    if config.video:
        count = record_video(lot, config.camera, len(demonstration), Path(config.video))
        print(f"wrote {config.video}: {counted(count, 'frame')}")
    elif config.shown_in == "web":
        run_live(make_live_viewer(page, lot), lot)
    else:
        window = Window(SIZE)
        with pictures(lot, config.camera) as draw:
            while _drive(lot, draw, window) == "R":
                lot.reset()


def main(config: PlayConfig, page: Any = None) -> None:
    """Plays, or replays; `page` is an open one for the browser, see `cli.pages`."""
    doing(PLACING)
    if config.replay:
        show_replay(config, page)
    elif config.shown_in == "window":
        with patient_interrupts():  # to save the drive
            play_in_window(config)
    else:
        viewer, lot, _ = make_wheel(config, page)
        try:
            run_live(viewer, lot)
        finally:
            save(lot, Path(config.out))
