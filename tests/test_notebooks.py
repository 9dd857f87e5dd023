"""The notebooks run from end to end, and lie in the repository with their outputs."""

from pathlib import Path

import pytest

from carpark_mj.rendering.gl import choose_gl

nbclient = pytest.importorskip("nbclient", reason="pip install nbclient ipykernel")
pytest.importorskip("ipykernel", reason="pip install nbclient ipykernel")
nbformat = pytest.importorskip("nbformat")

pytestmark = pytest.mark.slow
NOTEBOOKS = sorted((Path(__file__).parents[1] / "examples/notebooks").glob("*.ipynb"))
books = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
MOST = 1_000_000  # bytes of a notebook

# What a test does less of.
TINY = """import dataclasses

from carpark_mj import EnvConfig
from carpark_mj.training import PPOConfig

config = PPOConfig(
    num_steps=64,
    num_lots=4,
    unroll_length=4,
    num_minibatches=2,
    env=EnvConfig(physics="bicycle", num_parked_cars=2),
)"""
SMALL = "seconds=1.0, width=160, height=120"
LESS = {
    "quickstart": {
        'render_mode="rgb_array"': 'render_mode="rgb_array", physics="bicycle"',
        "seconds=12.0, width=480, height=360": f'{SMALL}, physics="bicycle"',
        "episodes=1024": 'episodes=8, physics="bicycle"',
    },
    "train_and_watch": {
        'config = PRESETS["cpu"]': TINY,
        "episodes=1024": "episodes=4",
        "seconds=12.0, width=480, height=360": SMALL,
    },
}


def code(notebook):
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def is_install(cell):
    return "install" in cell.metadata.get("tags", [])


def assert_shown(notebook):
    """Asserts that pictures and a video are shown, and nothing is complained of."""
    outputs = [output for cell in code(notebook) for output in cell.outputs]
    shown = [output.get("data", {}) for output in outputs]
    assert any("image/png" in data for data in shown)
    assert any("<video" in data.get("text/html", "") for data in shown)
    assert not [o for o in outputs if o.get("name") == "stderr" or "Warning" in str(o)]


@books
def test_a_notebook_installs_in_its_first_cell_and_has_outputs(path):
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    [install] = filter(is_install, code(notebook))
    assert install is code(notebook)[0]
    assert "git clone" in install.source
    assert install.source.count("%pip install") == 1
    assert "cuda" not in install.source
    assert_shown(notebook)
    assert path.stat().st_size < MOST
    assert "/home/" not in path.read_text()


@books
@pytest.mark.filterwarnings("ignore")  # of Jupyter's packages
def test_a_notebook_runs_and_shows_pictures_and_a_video(path, tmp_path, monkeypatch):
    assert choose_gl() is None, "this machine cannot render"
    monkeypatch.delenv("MUJOCO_GL", raising=False)  # as where a notebook begins
    notebook = nbformat.read(path, as_version=4)
    notebook.cells = [cell for cell in notebook.cells if not is_install(cell)]
    for old, new in LESS[path.stem].items():
        assert any(old in cell.source for cell in notebook.cells), old
        for cell in code(notebook):
            cell.source, cell.outputs = cell.source.replace(old, new), []
    resources = {"metadata": {"path": str(tmp_path)}}
    nbclient.NotebookClient(notebook, timeout=600, resources=resources).execute()
    assert_shown(notebook)
