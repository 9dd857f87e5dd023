"""Formulas as MathML: a hook of mkdocs, so that no page needs a script for them."""

import html
import re

from latex2mathml.converter import convert

# What the extension arithmatex makes of $...$ and $$...$$.
_FORMULA = re.compile(
    r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL
)


def on_page_content(content: str, **_: object) -> str:
    """Replaces the formulas of a rendered page."""

    def mathml(found: re.Match[str]) -> str:
        display = "inline" if found[1] == "span" else "block"
        # The converter knows `split`, which is the same within a formula.
        formula = html.unescape(found[2]).replace("{aligned}", "{split}")
        return convert(formula, display=display)

    return _FORMULA.sub(mathml, content)
