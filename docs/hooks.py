"""Hooks of mkdocs: the demo, formulas as MathML, and a repository button."""

import html
import logging
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert

# What the extension arithmatex makes of $...$ and $$...$$.
_FORMULA = re.compile(
    r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL
)
_REPOSITORY = "<!-- repository -->"  # where a page links to the configured one
_BUILDER = Path(__file__).parent / "demo" / "build.py"
_BUILT = _BUILDER.parent / "built" / "demo.json"  # which the builder writes last
_PAGE = re.compile(r"<!-- demo -->.*?<!-- end of demo -->", re.DOTALL)
_NO_PAGE = "This site was built without the demo; [build it](#build)."


def on_startup(command: str, **_: object) -> None:
    """Builds the demo for a site, where npm is there and it is wanted."""
    wanted = command == "build" and os.environ.get("CARPARK_MJ_DEMO") != "0"
    if not wanted or _BUILT.is_file() or shutil.which("npm") is None:
        return
    log = logging.getLogger("mkdocs.hooks")
    log.info("Building the demo, which takes some minutes")
    done = subprocess.run(
        [sys.executable, _BUILDER], stderr=subprocess.PIPE, text=True, check=False
    )
    if done.returncode:
        reason = done.stderr.strip().rpartition("\n")[2]
        log.info("The site is built without the demo: %s", reason)


def on_page_markdown(markdown: str, config: Any, **_: object) -> str:
    """Links to the repository where mkdocs.yml has its address, and to a built demo."""
    link = f"**[Repository]({config.repo_url})**" if config.repo_url else ""
    if not _BUILT.is_file():
        markdown = _PAGE.sub(_NO_PAGE, markdown)
    return markdown.replace(_REPOSITORY, link)


def on_page_content(content: str, **_: object) -> str:
    """Replaces the formulas of a rendered page."""

    def mathml(found: re.Match[str]) -> str:
        display = "inline" if found[1] == "span" else "block"
        # The converter knows `split`, an equivalent within a formula.
        formula = html.unescape(found[2]).replace("{aligned}", "{split}")
        return convert(formula, display=display)

    return _FORMULA.sub(mathml, content)
