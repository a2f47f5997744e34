"""Captions below figures."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["caption"]

# Largest number of letters of a caption's line per inch of figure width; longer lines are wrapped.
_LETTERS_PER_INCH = 18.0


def caption(figure: Figure, text: str) -> None:
    """Write a caption below all panels, and make the figure higher by its lines.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        Figure.
    text : str
        Caption. It is wrapped to the width of the figure.
    """
    lines = textwrap.wrap(text, int(figure.get_figwidth() * _LETTERS_PER_INCH))
    figure.set_figheight(figure.get_figheight() + 0.15 * len(lines))
    figure.supxlabel("\n".join(lines), x=0.01, ha="left", fontsize=8)
