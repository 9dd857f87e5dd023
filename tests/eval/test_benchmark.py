"""The benchmark's table; rates themselves are the machine's."""

import jax
import pytest

import benchmark
from carpark_mj.config import CONTACT_SIM_DT


def test_the_table_is_markdown_and_names_device_and_step(monkeypatch, capsys):
    rates = {"brush": (200_000.0, 12.0), "contact": (25_000.0, 20.0)}
    monkeypatch.setattr(benchmark, "measure", lambda config, tyres, _: rates[tyres])
    rows = benchmark.main(benchmark.BenchmarkConfig(batches=(128, 8192)))
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2 + len(rows) == 6
    assert len({line.count("|") for line in lines}) == 1
    cells = [cell.strip() for cell in lines[-1].strip("|").split("|")]
    assert cells == rows[-1]
    # 25,000 steps of 4 ms in a second are 100 times real time.
    assert cells[2:] == ["contact", "8,192", "4 ms", "25,000", "100", "20 s"]
    assert rows[0][4:7] == ["10 ms", "200,000", "2,000"]
    assert cells[0] == benchmark.device_name()


def test_a_gpu_is_named_as_it_names_itself(monkeypatch):
    class Device:
        platform, device_kind = "gpu", "NVIDIA H100 80GB HBM3"

    monkeypatch.setattr(jax, "devices", lambda: [Device()])
    assert benchmark.device_name() == "NVIDIA H100 80GB HBM3"


def test_each_model_runs_at_the_step_of_its_physics_report():
    steps = {name: sim.sim_dt for name, sim in benchmark.SIMS.items()}
    assert steps == {"brush": 0.01, "contact": CONTACT_SIM_DT}


@pytest.mark.parametrize("change", [{"steps": 0}, {"repeats": 0}, {"batches": ()}])
def test_impossible_settings_are_refused(change):
    with pytest.raises(ValueError, match=f"{next(iter(change))} must be"):
        benchmark.BenchmarkConfig(**change)
