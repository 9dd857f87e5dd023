"""Errors of the user's making are one line that names the culprit."""

import re

import pytest

from carpark_mj.cli import render
from carpark_mj.cli.common import USER_ERRORS, one_line
from carpark_mj.cli.render import RenderConfig
from carpark_mj.policy.checkpoints import require_writable, write_atomically


def test_a_file_error_names_the_file_asked_for(tmp_path):
    wanted = tmp_path / "missing" / "a.csv"
    with pytest.raises(USER_ERRORS) as caught:
        write_atomically(wanted, lambda temporary: temporary.write_text("x"))
    line = one_line(caught.value)
    assert line == f"cannot use {wanted}: No such file or directory"


def test_every_error_is_one_line():
    assert one_line(ValueError("a\n  b")) == "a b"
    assert "seed" in one_line(OverflowError("too large"))


UNWRITABLE = {
    "folder": "{tmp}/folder.png",
    "longest name": f"{{tmp}}/{'x' * 251}.png",
    "no such place": "/proc/g.png",
}


@pytest.mark.parametrize("gallery", [True, False])
@pytest.mark.parametrize("case", sorted(UNWRITABLE))
def test_an_unwritable_picture_is_refused_before_the_work(
    case, gallery, tmp_path, monkeypatch
):
    (tmp_path / "folder.png").mkdir()
    out = UNWRITABLE[case].format(tmp=tmp_path)

    def work(*_):
        pytest.fail("the work has begun")

    monkeypatch.setattr(render, "choose_gl", lambda: "")
    monkeypatch.setattr(render, "draw_lots", work)
    monkeypatch.setattr(render, "record", work)
    run, frame = ("", None) if gallery else ("zero", 0.0)
    config = RenderConfig(run, out=out, gallery=gallery, frame=frame)
    with pytest.raises(OSError, match=re.escape(out)) as caught:
        render.main(config)
    assert one_line(caught.value).startswith(f"cannot use {out}: ")
    assert [path.name for path in tmp_path.iterdir()] == ["folder.png"]


def test_a_check_for_writability_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "a.png"
    require_writable(path)
    assert not list(tmp_path.iterdir())
    path.write_text("old")
    require_writable(path)
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"]
    assert path.read_text() == "old"
