"""The notebooks run from end to end, and lie in the repository without outputs."""

from pathlib import Path

import pytest

from carpark_mj.rendering.gl import choose_gl

nbclient = pytest.importorskip("nbclient", reason="pip install nbclient ipykernel")
pytest.importorskip("ipykernel", reason="pip install nbclient ipykernel")
nbformat = pytest.importorskip("nbformat")

pytestmark = pytest.mark.slow
NOTEBOOKS = sorted((Path(__file__).parents[1] / "examples/notebooks").glob("*.ipynb"))
books = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def code(notebook):
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def is_install(cell):
    return "install" in cell.metadata.get("tags", [])


@books
def test_a_notebook_installs_in_one_line_and_has_no_outputs(path):
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    [install] = filter(is_install, code(notebook))
    assert install is code(notebook)[0]
    assert install.source.count("%pip install") == 1
    for cell in code(notebook):
        assert cell.outputs == []
        assert cell.execution_count is None


@books
@pytest.mark.filterwarnings("ignore")  # of Jupyter's packages
def test_a_notebook_runs_and_shows_pictures_and_a_video(path, tmp_path, monkeypatch):
    assert choose_gl() is None, "this machine cannot render"
    monkeypatch.setenv("CARPARK_MJ_TINY", "1")
    monkeypatch.delenv("MUJOCO_GL", raising=False)  # as where a notebook begins
    notebook = nbformat.read(path, as_version=4)
    notebook.cells = [cell for cell in notebook.cells if not is_install(cell)]
    resources = {"metadata": {"path": str(tmp_path)}}
    nbclient.NotebookClient(notebook, timeout=600, resources=resources).execute()
    shown = [
        output.get("data", {}) for cell in code(notebook) for output in cell.outputs
    ]
    assert any("image/png" in data for data in shown)
    assert any("<video" in data.get("text/html", "") for data in shown)
