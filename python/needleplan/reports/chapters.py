"""Chapters that `needleplan reproduce` can compute, found in the installed packages.

A chapter is an entry point of the group `needleplan.reproduce`: its name is the name of the chapter, its value a module
with the two functions of `Chapter`. needleplan itself has no chapter; the package `needleplan_thesis` has them.
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

_MOST_RUNS = 10_000  # insertions for each hidden effect; more would take days


class Effort(StrEnum):
    """How much is computed."""

    QUICK = "quick"
    """Coarse grids and few executions, half a minute: shows that everything runs."""

    DEFAULT = "default"
    """The published sizes; minutes."""

    FULL = "full"
    """Finer grids too; hours."""


@dataclass(frozen=True)
class Request:
    """What a chapter computes and where it writes."""

    folder: Path | None
    """Folder for figures and results; None writes nothing."""

    effort: Effort
    note: Callable[[str], None]
    """Receives one line about the current step."""

    experiments: bool = False
    """Repeats the experiments of section 6.5 in the lab twin instead of computing chapter 6."""

    runs: int | None = None
    """Insertions for each hidden effect of the diagnosis study; None takes the number of the effort."""


class Chapter(Protocol):
    """Functions of a chapter's module."""

    def run(self, request: Request) -> list[Comparison]:
        """Compute the chapter and compare with the published results."""

    def files(self, request: Request) -> Sequence[str]:
        """Return the names of the files that `run` writes into the folder."""


def chapters() -> Mapping[str, metadata.EntryPoint]:
    """Return the installed chapters by name, sorted by name."""
    return {each.name: each for each in sorted(metadata.entry_points(group=GROUP), key=lambda each: each.name)}


def reproduce(
    names: Sequence[str],
    request: Request,
    *,
    require_new: Callable[[Sequence[Path]], None] | None = None,
) -> list[Comparison]:
    """Compute chapters and return their comparisons.

    Parameters
    ----------
    names
        Names of the chapters; none means all installed chapters.
    request
        What to compute. Its folder is created if necessary.
    require_new
        Receives all files that will be written, before anything is computed.

    Raises
    ------
    InputError
        If no chapter is installed, a name is unknown or an option does not belong to the chapters.
    OutputError
        If the folder cannot be created or a file of it cannot be written.

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
    """Raise InputError for unknown chapters and for options of other chapters."""
    if not found:
        rule = "no chapter is installed: install the package needleplan_thesis, which is part of needleplan's wheel"
        raise InputError(Mistake("CHAPTER", "", rule))
    mistakes = [
        Mistake("CHAPTER", f'"{name}"', f"must be one of {', '.join(found)}") for name in names if name not in found
    ]
    if request.experiments and list(names) != ["ch6"]:
        mistakes.append(Mistake("--experiments", " ".join(names), "goes with the chapter ch6 and with no other"))
    if request.runs is not None and "diagnosis" not in names:
        mistakes.append(Mistake("--runs", " ".join(names), "goes with the chapter diagnosis and with no other"))
    if request.runs is not None and not 1 <= request.runs <= _MOST_RUNS:
        mistakes.append(Mistake("--runs", f"{request.runs}", f"must be a whole number from 1 to {_MOST_RUNS}"))
    if mistakes:
        raise InputError(mistakes)
