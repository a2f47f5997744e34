"""The published results, chapter by chapter."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from needleplan.errors import InputError, Mistake, OutputError
from needleplan.reports.comparison import Comparison

__all__ = ["Effort", "Request", "reproduce"]


_MOST_SEEDS = 10_000


class Effort(StrEnum):
    """How much is computed."""

    QUICK = "quick"
    """Coarse grids and few executions: whether everything runs, in half a minute."""

    DEFAULT = "default"
    """What was published, at its size; minutes."""

    FULL = "full"
    """Finer grids besides; much longer."""


@dataclass(frozen=True)
class Request:
    """What a chapter is asked to do: where to draw (None: nowhere), how much, and whom to tell what it is doing."""

    folder: Path | None
    effort: Effort
    note: Callable[[str], None]
    experiments: bool = False
    """Whether the experiments of section 6.5 are repeated in the lab twin, in place of the chapter's computations."""

    seeds: int = 0
    """How many insertions for each hidden effect of the diagnosis; 0: as many as the effort has."""


def _ch2(request: Request) -> list[Comparison]:
    from needleplan_thesis.chapter2 import chapter

    return chapter.run(request)


def _ch3(request: Request) -> list[Comparison]:
    from needleplan_thesis.chapter3 import chapter

    return chapter.run(request)


def _ch4(request: Request) -> list[Comparison]:
    from needleplan_thesis.chapter4 import chapter

    return chapter.run(request)


def _ch5(request: Request) -> list[Comparison]:
    from needleplan_thesis.chapter5 import chapter

    return chapter.run(request)


def _ch6(request: Request) -> list[Comparison]:
    from needleplan_thesis.chapter6 import chapter

    return chapter.run(request)


def _diagnosis(request: Request) -> list[Comparison]:
    from needleplan_thesis.closed_loop import chapter

    return chapter.run(request)


_AVAILABLE: dict[str, Callable[[Request], list[Comparison]]] = {
    "ch2": _ch2,
    "ch3": _ch3,
    "ch4": _ch4,
    "ch5": _ch5,
    "ch6": _ch6,
    "diagnosis": _diagnosis,
}


def reproduce(
    chapters: Sequence[str],
    figures: str | None,
    effort: Effort,
    note: Callable[[str], None],
    *,
    experiments: bool = False,
    seeds: int | None = None,
) -> list[Comparison]:
    """Run the chapters and return all comparisons; draw into the folder `figures` where one is given.

    No chapters means all. `experiments` is for chapter 6 alone, `seeds` for the diagnosis. Raises InputError for a
    chapter that there is not, OutputError for the folder.
    """
    mistakes = [
        Mistake("CHAPTER", f'"{chapter}"', f"must be one of {', '.join(_AVAILABLE)}")
        for chapter in chapters
        if chapter not in _AVAILABLE
    ]
    if experiments and list(chapters) != ["ch6"]:
        mistakes.append(Mistake("--experiments", " ".join(chapters), "goes with the chapter ch6, and with no other"))
    if seeds is not None and "diagnosis" not in chapters:
        mistakes.append(Mistake("--seeds", " ".join(chapters), "goes with the chapter diagnosis, and with no other"))
    if seeds is not None and not 1 <= seeds <= _MOST_SEEDS:
        mistakes.append(Mistake("--seeds", f"{seeds}", f"must be a whole number from 1 to {_MOST_SEEDS}"))
    if mistakes:
        raise InputError(mistakes)
    folder = Path(figures) if figures else None
    if folder:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"cannot be made: {error.strerror}", str(folder)) from error
    request = Request(folder, effort, note, experiments, seeds or 0)
    return [comparison for chapter in chapters or _AVAILABLE for comparison in _AVAILABLE[chapter](request)]
