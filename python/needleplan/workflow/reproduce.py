"""The published results, chapter by chapter."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from needleplan.errors import InputError, Mistake, OutputError
from needleplan.workflow import reproduce_ch6
from needleplan.workflow.comparison import Comparison

__all__ = ["CHAPTERS", "reproduce"]

Chapter = Callable[[Path | None, Callable[[str], None]], list[Comparison]]
"""Runs a chapter: draws into a folder where there is one, says what it does, returns the comparisons."""

CHAPTERS: dict[str, Chapter] = {"ch6": reproduce_ch6.run}


def reproduce(chapters: Sequence[str], figures: str | None, note: Callable[[str], None]) -> list[Comparison]:
    """Run the chapters and return all comparisons. Raises InputError for an unknown chapter."""
    for chapter in chapters:
        if chapter not in CHAPTERS:
            raise InputError(Mistake("CHAPTER", f'"{chapter}"', f"must be one of {', '.join(CHAPTERS)}"))
    folder = Path(figures) if figures else None
    if folder:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"cannot be made: {error.strerror}", str(folder)) from error
    return [comparison for chapter in chapters for comparison in CHAPTERS[chapter](folder, note)]
