"""OpenGL: the off-screen back end, chosen before MuJoCo is imported, and windows.

Nothing heavy is imported here.
"""

from __future__ import annotations

import ctypes
import os
import sys
import warnings
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

_MISSING = {
    "egl": "off-screen OpenGL is not available: install the system package libegl1 "
    "with a driver (Debian, Ubuntu: apt install libegl1 libgl1-mesa-dri)",
    "osmesa": "off-screen OpenGL through OSMesa is not available: install the system "
    "package libosmesa6, or unset MUJOCO_GL",
}
# Values of `MUJOCO_GL`, and the libraries that they need.
_LIBRARIES = {"egl": "libEGL.so.1", "osmesa": "libOSMesa.so.8"}
# Other values that MuJoCo takes: GLFW, which needs a display, and no OpenGL at all.
_GLFW = ("glfw", "glx", "enable", "enabled", "on", "true", "1")
_OFF = ("disable", "disabled", "off", "false", "0")


def _wanted() -> str:
    """The value of `MUJOCO_GL`, as MuJoCo reads it."""
    return os.environ.get("MUJOCO_GL", "").lower().strip()


def check_gl() -> None:
    """Raises `ValueError` where MuJoCo cannot be imported with `MUJOCO_GL`."""
    wanted = _wanted()
    if sys.platform != "linux" or wanted in ("", *_GLFW, *_OFF):
        return
    if wanted not in _LIBRARIES:
        raise ValueError(f"MUJOCO_GL must be egl, osmesa or glfw, not {wanted!r}")
    if not _loads(wanted):
        raise ValueError(f"{_MISSING[wanted]} (MUJOCO_GL={wanted})")


def choose_gl() -> str | None:
    """Sets `MUJOCO_GL` to an off-screen back end this machine has.

    MuJoCo picks its back end when it is imported and fails to import if the library is
    missing, so this runs first. A value the user has set is kept if it can work.

    Returns None, or a sentence that names the missing library; MuJoCo can then be
    imported but not render.
    """
    wanted = _wanted()
    if sys.platform != "linux":
        return None  # macOS and Windows have one OpenGL each
    if wanted not in ("", *_LIBRARIES):
        return _without_off_screen(wanted)
    if name := next(filter(_loads, [wanted] if wanted else _LIBRARIES), None):
        os.environ["MUJOCO_GL"] = name
        return None
    os.environ.pop("MUJOCO_GL", None)
    return _MISSING[wanted or "egl"] + (wanted and f" (MUJOCO_GL={wanted})")


def why_nothing_is_drawn(error: Exception) -> str:
    """A sentence on MuJoCo's failure to open OpenGL."""
    wanted = _wanted()
    advice = _MISSING.get(wanted) or _without_off_screen(wanted) or _MISSING["egl"]
    return f"{advice}; the error was: {' '.join(str(error).split())}"


def _without_off_screen(wanted: str) -> str | None:
    """What is missing for a back end that draws with GLFW, or not at all."""
    if wanted in _OFF:
        return f"MUJOCO_GL={wanted} turns pictures off: unset it"
    if missing := missing_display():
        return (
            f"{missing}, and MuJoCo draws with GLFW where MUJOCO_GL is "
            f"{wanted or 'unset'}: set MUJOCO_GL=egl before anything imports MuJoCo"
        )
    return None


def _loads(back_end: str) -> bool:
    try:
        return bool(ctypes.CDLL(_LIBRARIES[back_end]))
    except OSError:
        return False


_DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY")


def has_display() -> bool:
    """Whether the user has a display, one that can be reached or not."""
    return sys.platform != "linux" or any(map(os.environ.get, _DISPLAYS))


def missing_display() -> str | None:
    """Why no window can be opened; None if one can."""
    if not has_display():
        return "no display to open a window on (DISPLAY and WAYLAND_DISPLAY are unset)"
    import glfw

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what the sentence says
        if glfw.init():
            return None
    shown = ", ".join(f"{x}={os.environ[x]}" for x in _DISPLAYS if os.environ.get(x))
    return f"no window can be opened on the display{shown and f' ({shown})'}"


class Window:
    """A window of GLFW's, in which MuJoCo draws the pixels."""

    def __init__(self, size: tuple[int, int]) -> None:
        """Opens it for pictures of a width and height [pixels]; it needs a display."""
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
        self._draw(picture[::-1].ravel(), None, self._viewport, self._context)
        self._glfw.swap_buffers(self._window)
        self._glfw.poll_events()

    @property
    def closed(self) -> bool:
        """Whether the user has closed it."""
        return bool(self._glfw.window_should_close(self._window))

    def held(self, names: tuple[str, ...]) -> set[str]:
        """Which of some keys are held, by GLFW's names without `KEY_`."""
        glfw, window = self._glfw, self._window
        keys = {name: getattr(glfw, f"KEY_{name}") for name in names}
        return {x for x, key in keys.items() if glfw.get_key(window, key) == glfw.PRESS}

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
