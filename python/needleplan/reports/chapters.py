"""Chapters that `needleplan reproduce` can compute, found in the installed packages.

A chapter is an entry point of the group `needleplan.reproduce`. The name of the entry point is the name of the chapter;
its value is a module with the two functions of `Chapter`. needleplan itself has no chapters; they are in the package
`needleplan_thesis`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from importlib import metadata
from pathlib import Path
from typing import Protocol

from needleplan.errors import InputError, Mistake, OutputError
from needleplan.reports.comparison import Comparison

__all__ = ["GROUP", "Chapter", "Effort", "Request", "chapters", "reproduce"]

GROUP = "needleplan.reproduce"
"""Entry point group of the chapters."""

# Largest number of insertions for each hidden effect of the diagnosis study; more would take days.
_MOST_RUNS = 10_000


class Effort(StrEnum):
    """Amount of computation: grids and numbers of executions of a chapter."""

    QUICK = "quick"
    """Coarse grids and few executions (about half a minute), to check that everything runs."""

    DEFAULT = "default"
    """Grids and numbers of executions as published (minutes)."""

    FULL = "full"
    """The published grids and finer ones (hours)."""


@dataclass(frozen=True)
class Request:
    """What a chapter computes, and the folder for its files."""

    folder: Path | None
    """Folder for figures and results; if None, nothing is written."""

    effort: Effort
    note: Callable[[str], None]
    """Called with one line of text about each step, to show progress."""

    experiments: bool = False
    """Whether to repeat the experiments of section 6.5 in the lab twin instead of computing chapter 6."""

    runs: int | None = None
    """Number of insertions for each hidden effect in the chapter `diagnosis`; if None, `effort` determines it."""


class Chapter(Protocol):
    """Protocol: the functions that the module of a chapter must have."""

    def run(self, request: Request) -> list[Comparison]:
        """Compute the chapter and return the comparisons with the published results.

        Writes the files of the chapter if `request.folder` is given.
        """

    def files(self, request: Request) -> Sequence[str]:
        """Return the names of the files that `run` writes into the folder."""


def chapters() -> Mapping[str, metadata.EntryPoint]:
    """Return the entry points of the installed chapters by name, sorted by name."""
    return {
        entry_point.name: entry_point
        for entry_point in sorted(metadata.entry_points(group=GROUP), key=lambda each: each.name)
    }


def reproduce(
    names: Sequence[str],
    request: Request,
    *,
    require_new: Callable[[Sequence[Path]], None] | None = None,
) -> list[Comparison]:
    """Compute chapters, write their files if a folder is given, and return the comparisons of all chapters.

    Parameters
    ----------
    names
        Names of the chapters; if empty, all installed chapters are computed.
    request
        What to compute, and the folder for the files. The folder is created if it does not exist.
    require_new
        Called before the computation with the paths of all files that will be written; may raise an exception if one
        of them exists. None: existing files are overwritten. Not called without a folder.

    Raises
    ------
    InputError
        If no chapter is installed, a name is unknown, `experiments` or `runs` does not apply to the chapters, or `runs`
        is not from 1 to 10,000.
    OutputError
        If the folder cannot be created or a file in it cannot be written.

    """
    found = chapters()
    _require(names, request, found)
    loaded: list[Chapter] = [found[name].load() for name in names or found]
    if request.folder:
        if require_new:
            require_new([request.folder / file for chapter in loaded for file in chapter.files(request)])
        try:
            request.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"cannot be made: {error.strerror}", str(request.folder)) from error
    return [comparison for chapter in loaded for comparison in chapter.run(request)]


def _require(names: Sequence[str], request: Request, found: Mapping[str, object]) -> None:
    """Raise InputError if no chapter is installed, a chapter is unknown, or an option is wrong or does not apply."""
    if not found:
        rule = "no chapter is installed: install the package needleplan_thesis, which is part of needleplan's wheel"
        raise InputError(Mistake("CHAPTER", "", rule))
    mistakes = [
        Mistake("CHAPTER", f'"{name}"', f"must be one of {', '.join(found)}") for name in names if name not in found
    ]
    if request.experiments and list(names) != ["ch6"]:
        mistakes.append(Mistake("--experiments", " ".join(names), "applies to the chapter ch6 only"))
    if request.runs is not None and "diagnosis" not in names:
        mistakes.append(Mistake("--runs", " ".join(names), "applies to the chapter diagnosis only"))
    if request.runs is not None and not 1 <= request.runs <= _MOST_RUNS:
        mistakes.append(Mistake("--runs", f"{request.runs}", f"must be a whole number from 1 to {_MOST_RUNS}"))
    if mistakes:
        raise InputError(mistakes)
