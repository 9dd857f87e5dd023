"""A planner of another package as a policy by name."""

import json

import pytest
from helpers.packages import run

pytestmark = pytest.mark.slow

NAMES = ("pure_pursuit",)
LOT = {
    "format": "carpark_mj layout 1",
    "bays": [{"pose": [0.0, 0.0, 0.0], "size": [5.5, 2.8]}],
    "spawns": [{"pose": [-9.0, 0.5, 0.0], "size": [1.0, 1.0], "spread": 0.1}],
    "extent": [15.0, 6.0],
}


@pytest.fixture
def lot(tmp_path):
    path = tmp_path / "lot.json"
    path.write_text(json.dumps(LOT))
    flags = ("--num-agents", "1", "--num-parked-cars", "0")
    return ("--layout", str(path), *flags)


def test_it_parks_where_the_way_is_free(lot, tmp_path):
    out = tmp_path / "found"
    flags = ("--episodes", "64", *lot, "--out", str(out))
    done = run("evaluate", "pure_pursuit", *flags, extensions=NAMES)
    assert done.returncode == 0, done.stderr
    found = json.loads((out / "evaluation.json").read_text())
    assert found["summary"]["parked"]["rate"] > 0.9


def test_a_picture_shows_it(lot, tmp_path):
    out = tmp_path / "still.png"
    done = run(
        "render",
        "pure_pursuit",
        "--frame",
        "10",
        *lot,
        "--out",
        str(out),
        extensions=NAMES,
    )
    assert done.returncode == 0, done.stderr
    assert out.stat().st_size > 10_000


def test_without_the_package_its_name_is_that_of_no_run():
    done = run("evaluate", "pure_pursuit", "--episodes", "8", extensions=())
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "pure_pursuit" in done.stderr
