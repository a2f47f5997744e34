"""Axes of the figures of studies: names and units of parameters, headings, and cells at the values of a parameter."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from needleplan.sweep._study_rules import levels_of, tables_text
from needleplan.sweep._swept_parameter import name_and_unit, words_and_unit
from needleplan.sweep._table_set import TableSet

__all__ = ["CellAxis", "axis_title", "cell_axis", "heading", "level_text"]

# Largest relative difference of gaps between values that count as equal gaps.
_EVEN = 1e-6
# Ratio of the largest to the smallest value from which an axis may be logarithmic: a decade.
_DECADE = 10.0


def axis_title(name: str, table_set: TableSet | None = None) -> str:
    """Return the title of an axis: the name of a parameter, with its unit in brackets.

    The key of the parameter in the sweep gives the unit. Without a table set, or if it has no such parameter, the
    ending of the name gives the unit.
    """
    for parameter in table_set.sweep.parameters if table_set else ():
        if parameter.title == name:
            text, unit = words_and_unit(parameter)
            return f"{text} ({unit})" if unit else text
    text, unit = name_and_unit(name)
    return f"{text} ({unit})" if unit else text


def heading(what: str, table_set: TableSet | None, used: int, rest: str = "left out") -> str:
    """Return the title of a figure: the title of the sweep, what is shown, selected values, number of tables.

    `used` and `rest` as for `tables_text`.
    """
    if table_set is None:
        return what
    fixed = [
        f"{axis_title(parameter.title, table_set)} = {level_text(levels[0])}"
        for parameter in table_set.sweep.parameters
        if len(levels := levels_of(table_set, parameter.title)) == 1 and parameter.size > 1
    ]
    named = f"{table_set.sweep.title}: {what[0].lower()}{what[1:]}" if table_set.sweep.title else what
    return "; ".join([named, *fixed, tables_text(table_set, used, rest)])


def level_text(value: Any) -> str:
    """Return a value of a parameter as a text."""
    if isinstance(value, tuple):
        return ", ".join(map(level_text, value))
    return f"{value:.4g}" if isinstance(value, float) else str(value)


@dataclass(frozen=True)
class CellAxis:
    """Cells along one axis: edges (n + 1), centres (n), their texts, and whether the axis is logarithmic."""

    edges: NDArray[np.float64]
    centres: NDArray[np.float64]
    texts: tuple[str, ...]
    logarithmic: bool

    @property
    def shares(self) -> NDArray[np.float64]:
        """Widths of the cells as shares of the axis (n)."""
        return np.asarray(np.diff(self._drawn(self.edges)) / np.ptp(self._drawn(self.edges)))

    def labelled(self, gaps: Sequence[float]) -> list[int]:
        """Return the cells that get a label, so that labels do not overlap.

        `gaps` are the lengths of the labels as shares of the axis.
        """
        drawn = self._drawn(self.edges)
        places = (self._drawn(self.centres) - drawn[0]) / np.ptp(drawn)
        chosen: list[int] = []
        for number, place in enumerate(places):
            if not chosen or place - places[chosen[-1]] >= (gaps[number] + gaps[chosen[-1]]) / 2:
                chosen.append(number)
        return chosen

    def _drawn(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.log(values) if self.logarithmic else values


def cell_axis(levels: Sequence[Any]) -> CellAxis:
    """Return the cells of the values of a parameter.

    Cells of numbers lie at the numbers and meet in the middle between them: on a logarithmic axis if the numbers are
    spread over a decade and more evenly there. Other values have cells of equal size.
    """
    count = len(levels)
    if all(isinstance(level, int | float) and not isinstance(level, bool) for level in levels):
        values = np.array(levels, float)
        logarithmic = bool(
            count > 2
            and values[0] > 0
            and values[-1] >= _DECADE * values[0]
            and _unevenness(np.log(values)) < _unevenness(values)
        )
        drawn = np.log(values) if logarithmic else values
        gaps = np.diff(drawn)
        first, last = (gaps[0], gaps[-1]) if count > 1 else (1.0, 1.0)
        edges: NDArray[np.float64] = np.array(
            [drawn[0] - first / 2, *(drawn[:-1] + gaps / 2), drawn[-1] + last / 2], np.float64
        )
        texts = tuple(level_text(float(level)) for level in levels)
        edges = np.asarray(np.exp(edges), np.float64) if logarithmic else edges
        return CellAxis(edges, values, texts, logarithmic)
    return CellAxis(
        np.arange(count + 1, dtype=np.float64) - np.float64(0.5),
        np.arange(count, dtype=float),
        _short_texts(levels),
        False,
    )


def _unevenness(values: NDArray[np.float64]) -> float:
    """Return the ratio of the largest to the smallest gap; nearly 1 counts as 1."""
    gaps = np.diff(values)
    ratio = float(gaps.max() / gaps.min())
    return 1.0 if ratio < 1 + _EVEN else ratio


def _short_texts(levels: Sequence[Any]) -> tuple[str, ...]:
    """Return the texts of values; files without the folder that they share."""
    texts = tuple(map(level_text, levels))
    if not all(os.path.isabs(text) for text in texts):  # noqa: PTH117  values of other systems stay
        return texts
    folder = os.path.commonpath([os.path.dirname(text) for text in texts])  # noqa: PTH120
    return tuple(os.path.relpath(text, folder) for text in texts)
