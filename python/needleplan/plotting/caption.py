"""Captions below figures."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["caption"]

# number of letters per inch of figure width after which a caption is wrapped
_LETTERS_PER_INCH = 18.0


def caption(figure: Figure, text: str) -> None:
    """Write `text` below all panels in lines that fit the figure, and increase the height of the figure for it."""
    lines = textwrap.wrap(text, int(figure.get_figwidth() * _LETTERS_PER_INCH))
    figure.set_figheight(figure.get_figheight() + 0.15 * len(lines))
    figure.supxlabel("\n".join(lines), x=0.01, ha="left", fontsize=8)
