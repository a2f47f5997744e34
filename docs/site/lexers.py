"""Colours for kinds of code in the pages that Pygments knows by another name, or not at all."""

from typing import Any

from pygments.lexers.html import XmlLexer
from pygments.lexers.special import TextLexer


def setup(app: Any) -> dict[str, bool]:
    """Register the lexers."""
    app.add_lexer("svg", XmlLexer)
    app.add_lexer("csv", TextLexer)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
