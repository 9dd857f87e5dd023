"""The scripts' flags: bad input ends each of them alike."""

import pytest

import inhabited
import physics_report
import referee
import soak


@pytest.mark.parametrize(
    ("script", "flags", "said"),
    [
        (physics_report, ["--preset", "tank"], "Unrecognized options: --preset"),
        (physics_report, ["--presets", "tank"], "unknown vehicle 'tank'; choose from"),
        (physics_report, ["--tyres", "square"], "square"),
        (physics_report, ["--tyres"], "tyres must name at least one"),
        (inhabited, ["--num-lots", "0"], "num_lots must be at least 1, not 0"),
        (inhabited, ["--movers", "ghosts"], "'ghosts'"),
        (inhabited, ["--environment", "moon"], "'moon'"),
        (referee, ["--output", "folder"], "Unrecognized options: --output, folder"),
        (referee, ["--out"], "--out"),
        (soak, ["--cars", "3"], "Unrecognized options: --cars, 3"),
        (soak, ["--num-cars", "0"], "num_cars must be at least 1, not 0"),
        (soak, ["--sim.sim-dt", "0"], "sim_dt"),
        (soak, ["--max-energy", "nan"], "max_energy must be at least 0, not nan"),
        (soak, ["--first-case", "2147483648"], "first_case must fit 32 bits"),
        (soak, ["--first-case", "2147483000"], "first_case is 2147483000, of"),
    ],
)
def test_bad_input_is_one_sentence_and_exit_code_2(script, flags, said, capsys):
    assert script.main(flags) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"{script.__name__}: ")
    assert said in error
    assert error.count("\n") == 1


@pytest.mark.parametrize("script", [physics_report, referee])
def test_an_unwritable_folder_is_refused_before_anything_drives(
    script, tmp_path, capsys, monkeypatch
):
    def drive(*_):
        raise AssertionError("it drove")

    monkeypatch.setattr(
        physics_report, "SUITES", {"brush": (drive,), "contact": (drive,)}
    )
    monkeypatch.setattr(referee, "trials", drive)
    (tmp_path / "file").write_text("no folder")
    for out in (tmp_path / "file", tmp_path / "file" / "below"):
        assert script.main(["--out", str(out)]) == 2
        error = capsys.readouterr().err
        assert error.startswith(f"{script.__name__}: cannot use {tmp_path}")
        assert error.count("\n") == 1
    taken = tmp_path / "taken"
    for name in ("report.md", "referee.md"):
        (taken / name).mkdir(parents=True)
    assert script.main(["--out", str(taken)]) == 2
    assert "Is a directory" in capsys.readouterr().err
