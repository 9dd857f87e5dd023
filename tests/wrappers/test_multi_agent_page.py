"""The code of docs/multi_agent.md runs, as far as the libraries are installed."""

import re
from pathlib import Path

import pytest

from carpark_mj.wrappers.options import OPTIONS

PAGE = (Path(__file__).parents[2] / "docs" / "multi_agent.md").read_text()
SECTIONS = {
    section.split("\n", 1)[0]: section
    for section in re.split(r"^## ", PAGE, flags=re.M)
}
LIBRARIES = {
    "PettingZoo": "pettingzoo",
    "TorchRL": "torchrl",
    "BenchMARL": "benchmarl",
    "JaxMARL": "jaxmarl",
    "By hand": "numpy",
}
LESS = (
    ("1024", "2"),
    ("agents=4", 'agents=2, parked_cars=2, physics="bicycle"'),
    ('{"agents": 4}', '{"agents": 2, "parked_cars": 2, "physics": "bicycle"}'),
    # An update of BenchMARL's default size takes minutes.
    ("rates = ", "config.on_policy_n_minibatch_iters = 1\nrates = "),
    ("rates = ", "config.on_policy_collected_frames_per_batch = 400\nrates = "),
)


@pytest.mark.filterwarnings("ignore")  # of libraries
@pytest.mark.parametrize("name", LIBRARIES)
def test_the_code_of_a_section_runs(name, tmp_path, monkeypatch, capsys):
    pytest.importorskip(LIBRARIES[name])
    monkeypatch.chdir(tmp_path)
    [code] = re.findall(r"^```python\n(.*?)^```", SECTIONS[name], re.M | re.S)
    for old, new in LESS:
        code = code.replace(old, new)
    exec(code, {})


def test_the_page_lists_all_options():
    rows = re.findall(r"^\| `(\w+)` \|", PAGE, re.M)
    assert tuple(rows) == OPTIONS
