"""A window that shows pictures and tells which keys and gamepad controls are held."""

import os
import sys
import warnings
from typing import Any

import numpy as np

NO_DISPLAY = "no display to open a window on (DISPLAY and WAYLAND_DISPLAY are unset)"
_DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY")


def has_display() -> bool:
    """Whether the user has a display, one that can be reached or not."""
    return sys.platform != "linux" or any(map(os.environ.get, _DISPLAYS))


def missing_display() -> str | None:
    """Why no window can be opened; None if one can."""
    if not has_display():
        return NO_DISPLAY
    import glfw

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what the sentence says
        if glfw.init():
            return None
    names = (name for name in _DISPLAYS if os.environ.get(name))
    shown = ", ".join(f"{name}={os.environ[name]}" for name in names)
    return f"no window can be opened on the display{shown and f' ({shown})'}"


class Window:
    """A window of GLFW's, in which MuJoCo draws the pixels."""

    def __init__(self, size: tuple[int, int]) -> None:
        """Opens it.

        Args:
            size: width and height of the pictures [pixels].

        Raises:
            OSError: there is no display.
        """
        if missing := missing_display():
            raise OSError(missing)
        import glfw
        import mujoco

        glfw.window_hint(glfw.RESIZABLE, False)
        self._glfw, self._draw = glfw, mujoco.mjr_drawPixels
        self._window: Any = glfw.create_window(*size, "carpark_mj", None, None)
        glfw.make_context_current(self._window)
        empty = mujoco.MjModel.from_xml_string("<mujoco/>")
        self._context = mujoco.MjrContext(empty, mujoco.mjtFontScale.mjFONTSCALE_100)
        self._viewport = mujoco.MjrRect(0, 0, *size)

    def show(self, picture: np.ndarray) -> None:
        """Shows a picture (height, width, 3) uint8 and reads the keys."""
        self._glfw.make_context_current(self._window)
        flipped = np.ascontiguousarray(picture[::-1]).ravel()
        self._draw(flipped, None, self._viewport, self._context)
        self._glfw.swap_buffers(self._window)
        self._glfw.poll_events()

    @property
    def closed(self) -> bool:
        """Whether the user has closed it."""
        return bool(self._glfw.window_should_close(self._window))

    def held(self, names: tuple[str, ...]) -> set[str]:
        """Which of some keys are held, by GLFW's names without `KEY_`."""
        glfw = self._glfw
        return {
            name
            for name in names
            if glfw.get_key(self._window, getattr(glfw, f"KEY_{name}")) == glfw.PRESS
        }

    def gamepad(self) -> tuple[list[float], list[int]] | None:
        """Axes and buttons of the first gamepad in GLFW's order; None without one."""
        glfw = self._glfw
        if not glfw.joystick_is_gamepad(glfw.JOYSTICK_1):
            return None
        state = glfw.get_gamepad_state(glfw.JOYSTICK_1)
        return (list(state.axes), list(state.buttons)) if state else None

    def close(self) -> None:
        """Closes it."""
        self._glfw.make_context_current(self._window)
        self._context.free()
        self._glfw.destroy_window(self._window)
