"""Chooses MuJoCo's OpenGL before MuJoCo is imported; imports nothing heavy itself."""

import ctypes
import os
import sys

MISSING_GL = (
    "off-screen OpenGL is not available: install the system package libegl1 with a "
    "driver (Debian, Ubuntu: apt install libegl1 libgl1-mesa-dri)"
)
_MISSING = {
    "egl": MISSING_GL,
    "osmesa": "off-screen OpenGL through OSMesa is not available: install the system "
    "package libosmesa6, or unset MUJOCO_GL",
}
# Values of `MUJOCO_GL`, and the libraries that they need.
_LIBRARIES = {"egl": "libEGL.so.1", "osmesa": "libOSMesa.so.8"}
# Other values that MuJoCo takes: GLFW, which needs a display, and no OpenGL at all.
_GLFW = ("glfw", "glx", "enable", "enabled", "on", "true", "1")
_OFF = ("disable", "disabled", "off", "false", "0")


def wanted_gl() -> str:
    """The value of `MUJOCO_GL`, as MuJoCo reads it.

    Raises:
        ValueError: MuJoCo knows no such value.
    """
    wanted = os.environ.get("MUJOCO_GL", "").lower().strip()
    if sys.platform == "linux" and wanted not in ("", *_LIBRARIES, *_GLFW, *_OFF):
        raise ValueError(f"MUJOCO_GL must be egl, osmesa or glfw, not {wanted!r}")
    return wanted


def check_gl() -> None:
    """Refuses a value of `MUJOCO_GL` with which MuJoCo cannot be imported.

    Raises:
        ValueError: MuJoCo knows no such value, or its library is missing.
    """
    wanted = wanted_gl()
    if sys.platform == "linux" and not _loads(_LIBRARIES.get(wanted)):
        raise ValueError(f"{_MISSING[wanted]} (MUJOCO_GL={wanted})")


def choose_gl() -> str | None:
    """Sets `MUJOCO_GL` to an off-screen back end this machine has.

    MuJoCo picks its back end when it is imported and fails to import if the library is
    missing, so this runs first. A value the user has set is kept if it can work.

    Returns:
        None on success, else a sentence that names the missing library; MuJoCo can then
        be imported but not render.

    Raises:
        ValueError: MuJoCo does not know the value the user has set.
    """
    if sys.platform != "linux":
        return None  # macOS and Windows have one OpenGL each
    wanted = wanted_gl()
    if wanted in (*_GLFW, *_OFF):
        return _windows_only(wanted)
    for name in [wanted] if wanted else list(_LIBRARIES):
        if _loads(_LIBRARIES[name]):
            os.environ["MUJOCO_GL"] = name
            return None
    os.environ.pop("MUJOCO_GL", None)
    return f"{_MISSING[wanted]} (MUJOCO_GL={wanted})" if wanted else MISSING_GL


def why_nothing_is_drawn(error: Exception) -> str:
    """A sentence on MuJoCo's failure to open OpenGL."""
    wanted = os.environ.get("MUJOCO_GL", "").lower().strip()
    advice = _MISSING.get(wanted) or _windows_only(wanted)
    return f"{advice or MISSING_GL}; the error was: {' '.join(str(error).split())}"


def _windows_only(wanted: str) -> str | None:
    """What is missing for a back end that draws with GLFW, or not at all."""
    from carpark_mj.rendering.window import missing_display

    if wanted in _OFF:
        return f"MUJOCO_GL={wanted} turns pictures off: unset it"
    if missing := missing_display():
        return (
            f"{missing}, and MuJoCo draws with GLFW where MUJOCO_GL is "
            f"{wanted or 'unset'}: set MUJOCO_GL=egl before anything imports MuJoCo"
        )
    return None


def _loads(library: str | None) -> bool:
    """Whether a library can be loaded; none can."""
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True
