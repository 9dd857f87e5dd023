import dataclasses

import pytest

import scaling
from carpark_mj.benchmarking.scaling import (
    AGENTS,
    AISLES,
    Point,
    draw,
    environments,
    measure,
    read_points,
    write_points,
)
from carpark_mj.config import EnvConfig
from carpark_mj.env import ParkingEnv

POINTS = [
    Point("agents", 1, 100, 4, 2.5),
    Point("agents", 4, 100, 1, 2.0),
    Point("size", 8, 50, 2, 1.0),
    Point("size", 8, 200, 2, 1.5),
]


def test_series_vary_one_thing_only():
    agents, sizes = environments("agents"), environments("size")
    assert [env.num_agents for env in agents] == list(AGENTS)
    assert len({env.config.layout for env in agents}) == 1
    assert len({env.config.num_parked_cars for env in agents}) == 1
    assert len({env.num_agents for env in sizes}) == 1
    bays = [env.layout_config.min_bays for env in sizes]
    assert len(bays) == len(AISLES)
    assert bays == sorted(set(bays))
    assert bays[-1] > 10 * bays[0]


def test_a_measurement_notes_what_it_measured():
    env = ParkingEnv(EnvConfig(num_agents=2, physics="bicycle"))
    point = measure(env, "agents", total=6, steps=1, repeats=1)
    assert (point.series, point.agents, point.lots) == ("agents", 2, 3)
    assert point.bays >= env.layout_config.min_bays
    assert point.microseconds > 0


def test_points_are_read_as_they_were_written(tmp_path):
    write_points(tmp_path / "a.csv", POINTS)
    assert read_points(tmp_path / "a.csv") == POINTS


def test_another_table_is_refused_by_its_name(tmp_path, capsys):
    table = tmp_path / "other.csv"
    table.write_text("what,rate\nenv,3\n")
    picture = tmp_path / "cost.png"
    flags = ["--read", str(table), "--names", "a", "--plot", str(picture)]
    assert scaling.main(flags) == 2
    assert f"{table} lacks the columns" in capsys.readouterr().err
    assert not picture.exists()


def test_the_plot_shows_several_devices(tmp_path):
    slower = [dataclasses.replace(p, microseconds=9 * p.microseconds) for p in POINTS]
    write_points(tmp_path / "a.csv", POINTS)
    write_points(tmp_path / "b.csv", slower)
    picture = tmp_path / "cost.png"
    tables = [str(tmp_path / "a.csv"), str(tmp_path / "b.csv")]
    flags = ["--read", *tables, "--names", "a", "b", "--plot", str(picture)]
    assert scaling.main(flags) == 0
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_an_unwritable_picture_is_noticed_before_measuring(tmp_path, monkeypatch):
    monkeypatch.setattr(scaling, "measure", pytest.fail)
    assert scaling.main(["--plot", str(tmp_path / "no" / "cost.png")]) == 2


def test_a_picture_of_one_device_needs_no_name(tmp_path):
    draw(tmp_path / "cost.png", {"here": POINTS})
    assert (tmp_path / "cost.png").exists()
