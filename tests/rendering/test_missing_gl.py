"""Without OpenGL or a display a sentence says what is missing."""

import os

import pytest

from carpark_mj.rendering import gl

GL = {
    "": "apt install libegl1",
    "egl": "apt install libegl1",
    "junk": "must be egl, osmesa or glfw",
    "osmesa": "libosmesa6",
    "glfw": "no display",
    "GLX": "no display",
    "off": "turns pictures off",
}


@pytest.mark.parametrize("wanted", GL)
def test_an_opengl_that_cannot_work_is_told_what_it_lacks(wanted, monkeypatch):
    monkeypatch.setattr(gl, "_LIBRARIES", {"egl": "libnone.so", "osmesa": "libno.so"})
    monkeypatch.setattr(gl.sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("MUJOCO_GL", wanted)
    if wanted in ("junk", "osmesa", "egl"):  # MuJoCo cannot be imported
        with pytest.raises(ValueError, match=GL[wanted]):
            gl.check_gl()
    else:  # a command can do without pictures
        gl.check_gl()
    if wanted != "junk":
        assert GL[wanted] in gl.choose_gl()
    if wanted in ("", "egl"):  # MuJoCo must still import, for training without them
        assert "MUJOCO_GL" not in os.environ


def test_a_display_that_does_not_answer_is_named(monkeypatch):
    monkeypatch.setattr(gl.sys, "platform", "linux")
    monkeypatch.setenv("DISPLAY", ":987")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert "DISPLAY=:987" in gl.missing_display()
    monkeypatch.delenv("DISPLAY")
    assert "are unset" in gl.missing_display()
