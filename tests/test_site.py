"""The documentation site builds without a warning, and asks nobody for anything."""

import re

import pytest
from helpers.programs import ROOT, python

pytestmark = pytest.mark.slow
# Scripts, pictures or styles of other servers; rows of tables and lists left as text.
LOADS = (
    r'<(?:script|img|iframe|source)\b[^>]*\bsrc="(https?:)?//',
    r'<link\b(?=[^>]*\brel="(?:stylesheet|preconnect)")[^>]*href="(https?:)?//',
)
LEFT_AS_TEXT = re.compile(r"^(<p>)?(- |\|)", re.MULTILINE)


def test_the_site_is_whole_and_asks_nobody(tmp_path):
    pytest.importorskip("mkdocs", reason='pip install -e ".[docs]"')
    command = ("-m", "mkdocs", "build", "--strict", "-d", tmp_path)
    done = python(*command, cwd=ROOT, CARPARK_MJ_DEMO="0")  # it takes minutes
    assert done.returncode == 0, done.stderr
    for page in (ROOT / "docs").rglob("*.md"):
        name = page.relative_to(ROOT / "docs").with_suffix(".html")
        assert (tmp_path / name).is_file(), name
    index = (tmp_path / "search" / "search_index.js").read_text()
    assert index.startswith("var __index")  # search without a server
    for page in tmp_path.rglob("*.html"):
        text = page.read_text()
        assert not re.search("|".join(LOADS), text), page
        prose = re.sub(r"<(pre|code)\b.*?</\1>", "", text, flags=re.S)
        assert not LEFT_AS_TEXT.search(prose), page
    built = (tmp_path / "demo" / "built" / "demo.json").is_file()
    assert ("<iframe" in (tmp_path / "demo.html").read_text()) == built
    formulas = (tmp_path / "physics" / "equations.html").read_text()
    assert formulas.count("<math ") > 30
    assert "arithmatex" not in formulas
    api = (tmp_path / "api" / "env.html").read_text()
    for name in ("carpark_mj.env.ParkingEnv.step", "carpark_mj.types.Motion"):
        assert f'id="{name}"' in api, name
