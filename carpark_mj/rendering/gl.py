"""Chooses MuJoCo's OpenGL before MuJoCo is imported; imports nothing heavy itself."""

import ctypes
import os
import sys

MISSING_GL = (
    "off-screen OpenGL is not available: install the system package libegl1 with a "
    "driver (Debian, Ubuntu: apt install libegl1 libgl1-mesa-dri)"
)
# What `MUJOCO_GL` names, and the library that must be there.
_LIBRARIES = {"egl": "libEGL.so.1", "osmesa": "libOSMesa.so.8"}


def choose_gl() -> str | None:
    """Sets `MUJOCO_GL` to an off-screen back end this machine has.

    MuJoCo picks its back end when it is imported and fails to import if the library is
    missing, so this runs first. A value the user has set is kept if it can work.

    Returns:
        None if all is well, else a sentence saying what is missing; MuJoCo can then
        be imported but not render.
    """
    if sys.platform != "linux":
        return None  # macOS and Windows have one OpenGL each
    wanted = os.environ.get("MUJOCO_GL", "")
    for name in [wanted] if wanted else list(_LIBRARIES):
        if name not in _LIBRARIES or _loads(_LIBRARIES[name]):
            os.environ["MUJOCO_GL"] = name
            return None
    os.environ.pop("MUJOCO_GL", None)
    return f"{MISSING_GL} (MUJOCO_GL={wanted})" if wanted else MISSING_GL


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True
