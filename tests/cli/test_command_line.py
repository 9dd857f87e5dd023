"""Errors of the user's making are one line that names the culprit."""

import pytest

from carpark_mj.cli.common import USER_ERRORS, one_line
from carpark_mj.policy.checkpoints import write_atomically


def test_a_file_error_names_the_file_asked_for(tmp_path):
    wanted = tmp_path / "missing" / "a.csv"
    with pytest.raises(USER_ERRORS) as caught:
        write_atomically(wanted, lambda temporary: temporary.write_text("x"))
    line = one_line(caught.value)
    assert line == f"cannot use {wanted}: No such file or directory"


def test_every_error_is_one_line():
    assert one_line(ValueError("a\n  b")) == "a b"
    assert "seed" in one_line(OverflowError("too large"))
