"""Hooks of mkdocs: formulas as MathML, without a script, and a repository button."""

import html
import re
from typing import Any

from latex2mathml.converter import convert

# What the extension arithmatex makes of $...$ and $$...$$.
_FORMULA = re.compile(
    r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL
)


_REPOSITORY = "<!-- repository -->"  # where a page links to the configured one


def on_page_markdown(markdown: str, config: Any, **_: object) -> str:
    """Links to the repository where mkdocs.yml has its address."""
    link = f"**[Repository]({config.repo_url})**" if config.repo_url else ""
    return markdown.replace(_REPOSITORY, link)


def on_page_content(content: str, **_: object) -> str:
    """Replaces the formulas of a rendered page."""

    def mathml(found: re.Match[str]) -> str:
        display = "inline" if found[1] == "span" else "block"
        # The converter knows `split`, which is the same within a formula.
        formula = html.unescape(found[2]).replace("{aligned}", "{split}")
        return convert(formula, display=display)

    return _FORMULA.sub(mathml, content)
