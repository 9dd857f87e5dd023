"""Files that anybody may have written: values as they were meant, or one sentence."""

import contextlib
import json
import os
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest
from helpers.mutating import damaged

from carpark_mj import reading
from carpark_mj.files import write_atomically, write_text
from carpark_mj.reading import (
    TEXT,
    Archive,
    ArrayForm,
    parse_object,
    read_bytes,
    read_csv,
    read_object,
    read_text,
)

FLOATS = np.dtype(np.float32)
ARRAYS = {
    "speed": np.arange(12, dtype=np.float32).reshape(3, 4),
    "done": np.eye(3, 4, dtype=bool),
    "name": np.array(["first", "second", "third"]),
}
FORMS = {
    "speed": ArrayForm(FLOATS, ("drives", 4)),
    "done": ArrayForm(np.dtype(bool), ("drives", 4)),
    "name": ArrayForm(TEXT, ("drives",)),
}


def archive(tmp_path, **arrays):
    path = tmp_path / "a.npz"
    np.savez_compressed(path, **(ARRAYS | arrays))
    return path


def tried(read):
    """Reads; what is returned, or None after the error that the user is told."""
    with contextlib.suppress(ValueError):
        return read()
    return None


def test_arrays_are_read_as_written_in_any_order_of_memory(tmp_path):
    path = archive(tmp_path, speed=np.asfortranarray(ARRAYS["speed"]))
    found = Archive(path).read(FORMS)
    for name, array in ARRAYS.items():
        np.testing.assert_array_equal(found[name], array)


@pytest.mark.parametrize(
    ("name", "array"),
    [
        ("speed", np.zeros((3, 4, 1), np.float32)),
        ("speed", np.zeros((3, 4))),
        ("speed", np.zeros((2, 4), np.float32)),  # of fewer drives than the others
        ("done", np.full((3, 4), "x")),
        ("name", np.zeros(3)),
        ("name", np.array([{}, 1, 2], object)),
    ],
)
def test_an_array_of_another_form_is_refused_by_name(name, array, tmp_path):
    path = archive(tmp_path, **{name: array})
    with pytest.raises(ValueError, match=r"a\.npz (holds|is damaged at) "):
        Archive(path).read(FORMS)


def test_what_a_small_file_inflates_to_is_known_before(tmp_path, monkeypatch):
    path = tmp_path / "bomb.npz"
    np.savez_compressed(path, speed=np.zeros((2**24, 4), np.float32))
    assert path.stat().st_size < 2**20
    tracemalloc.start()
    with pytest.raises(ValueError, match=r"bomb\.npz"):
        Archive(path).read({"speed": ArrayForm(FLOATS, (3, 4))})
    monkeypatch.setattr(reading, "MOST_BYTES", 2**20)
    with pytest.raises(ValueError, match=r"bomb\.npz"):
        Archive(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 2**23


def test_members_that_are_no_arrays_or_missing_are_refused(tmp_path):
    path = tmp_path / "a.npz"
    for text in (b"", b"hello", b"\x93NUMPY\x01\x00\x05\x00((((("):
        with zipfile.ZipFile(path, "w") as file:
            file.writestr("speed.npy", text)
        with pytest.raises(ValueError, match=r"a\.npz is damaged|holds speed"):
            Archive(path).read({"speed": FORMS["speed"]})
    with pytest.raises(ValueError, match="lacks pose"):
        Archive(archive(tmp_path)).read({"pose": ArrayForm(FLOATS, (3,))})


def test_a_damaged_archive_has_its_values_or_is_refused(tmp_path):
    path = archive(tmp_path)
    data = path.read_bytes()
    read = 0
    for seed in range(400):
        path.write_bytes(damaged(data, seed))
        found = tried(lambda: Archive(path).read(FORMS))
        if found is not None:  # the checksums cover the values, not dates and the like
            read += 1
            for name, array in ARRAYS.items():
                np.testing.assert_array_equal(found[name], array)
    assert 0 < read < 200


def test_what_never_ends_is_not_read(tmp_path):
    pipe = tmp_path / "pipe.json"
    os.mkfifo(pipe)
    for path in (pipe, Path("/dev/zero")):
        with pytest.raises(ValueError, match="not a regular file"):
            read_bytes(path)


def test_text_may_begin_with_a_mark_and_is_utf_8(tmp_path):
    path = tmp_path / "a.txt"
    path.write_bytes("\ufeffä".encode())
    assert read_text(path) == "ä"
    path.write_bytes(b"\xff")
    with pytest.raises(ValueError, match=r"a\.txt: it is not text"):
        read_text(path)


def test_an_object_has_its_entries_and_no_endless_brackets():
    assert parse_object('{"seed": 1}', "x", seed=int) == {"seed": 1}
    for text in ("{}", '{"seed": true}', '{"seed": "1"}', '{"seed": null}'):
        with pytest.raises(ValueError, match=r"seed.*"):
            parse_object(text, "x", seed=int)
    with pytest.raises(ValueError, match="x is nested too deeply"):
        parse_object("[" * 10**6 + "]" * 10**6, "x")


TABLE = "name,step,value\r\na,1,0.5\r\nb,2,nan\r\n"


def test_a_table_is_read_by_its_columns(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(TABLE)
    first, second = read_csv(path, "step", "value")
    assert first.cells["name"] == "a"
    assert (first.whole("step"), first.number("value")) == (1, 0.5)
    assert np.isnan(second.number("value"))
    with pytest.raises(ValueError, match=r"a\.csv, line 3: name .*'b'"):
        second.number("name")
    path.write_text("")
    assert read_csv(path, "step") == []


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name,step\na,1\n", "lacks the columns value"),
        ("name,step,value,step\na,1,2,3\n", "a column twice"),
        (TABLE + "c,3\r\n", "line 4: not as many values as columns"),
        (TABLE + "c,3,4,5\r\n", "line 4: not as many values as columns"),
        (TABLE + f"c,3,{'0' * 200_000}\r\n", "line 4: field larger"),
        (TABLE + '"c,3,4\r\n', "line 4"),
    ],
)
def test_a_table_that_is_none_is_told_where(text, message, tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=message):
        read_csv(path, "step", "value")


def test_half_a_line_at_the_end_of_a_growing_table_is_left_out(tmp_path):
    path = tmp_path / "a.csv"
    for end in range(len(TABLE)):
        path.write_bytes(TABLE[:end].encode())
        whole = max(0, TABLE[:end].count("\n") - 1)
        assert len(read_csv(path, "step", growing=True)) == whole


def test_damaged_tables_and_objects_have_their_values_or_are_refused(tmp_path):
    table, path = tmp_path / "a.csv", tmp_path / "a.json"
    data = json.dumps({"config": {"name": "x", "sizes": [1, 2.5]}, "seed": 3}).encode()
    for seed in range(400):
        table.write_bytes(damaged(TABLE.encode(), seed))
        rows = tried(lambda: read_csv(table, "step", "value"))
        found = tried(lambda rows=rows: [row.number("value") for row in rows or ()])
        assert found is None or all(type(value) is float for value in found)
        path.write_bytes(damaged(data, seed))
        found = tried(lambda: read_object(path, config=dict, seed=int))
        assert found is None or type(found["seed"]) is int


def test_a_file_is_replaced_whole_or_not_at_all(tmp_path):
    path = tmp_path / "a.txt"
    write_text(path, "old")
    with path.open() as reader:
        write_text(path, "new")
        assert reader.read() == "old"

    def fail(temporary):
        temporary.write_text("half")
        raise OSError("no space")

    with pytest.raises(OSError, match="no space"):
        write_atomically(path, fail)
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]
