"""The documentation site builds without a warning, and asks nobody for anything."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
pytest.importorskip("mkdocs", reason='pip install ".[docs]"')

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site, built."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-d", folder]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return folder


def test_every_page_is_built(site):
    for page in (ROOT / "docs").rglob("*.md"):
        name = page.relative_to(ROOT / "docs").with_suffix(".html")
        assert (site / name).is_file(), name


def test_no_page_loads_anything_from_elsewhere(site):
    loads = r'<(?:script|img|iframe|source)\b[^>]*\bsrc="(https?:)?//'
    styles = r'<link\b(?=[^>]*\brel="(?:stylesheet|preconnect)")[^>]*href="(https?:)?//'
    for page in site.rglob("*.html"):
        text = page.read_text()
        assert not re.search(f"{loads}|{styles}", text), page


def test_search_needs_no_server(site):
    assert (site / "search" / "search_index.js").read_text().startswith("var __index")
    pages = {*site.rglob("*.html")} - {site / "demo" / "index.html"}  # which has none
    for page in pages:
        [script] = re.findall(r'src="([^"]*iframe-worker[^"]*)"', page.read_text())
        assert page.name == "404.html" or (page.parent / script).is_file()


def test_tables_and_lists_are_none_of_them_left_as_text(site):
    for page in site.rglob("*.html"):
        text = re.sub(r"<(pre|code)\b.*?</\1>", "", page.read_text(), flags=re.S)
        assert not re.search(r"^(<p>)?(- |\|)", text, re.MULTILINE), page


def test_formulas_are_mathml(site):
    text = (site / "vehicle.html").read_text()
    assert text.count("<math ") > 30
    assert "arithmatex" not in text


def test_the_reference_documents_what_it_names(site):
    api = (site / "api" / "env.html").read_text()
    for name in ("carpark_mj.env.ParkingEnv.step", "carpark_mj.types.Motion"):
        assert f'id="{name}"' in api, name
