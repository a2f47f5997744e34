"""A collection of combinations: reading, writing, searching."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from needleplan.artifacts import write_whole
from needleplan.errors import Mistake, ModelError
from needleplan.estimation.atlas.combination import Combination
from needleplan.estimation.atlas.toml import parse, text
from needleplan.models.force import PUBLISHED_FORCES

__all__ = ["Atlas", "Match", "published_atlas"]


@dataclass(frozen=True)
class Match:
    """A combination of the atlas for a needle, a tissue and a speed that were asked for.

    `velocity_ratio` is its speed over the one asked for. Force-depth models hold for one speed: with a ratio far from 1
    the prediction is that of another experiment.
    """

    combination: Combination
    velocity_ratio: float


@dataclass(frozen=True)
class Atlas:
    """Identified combinations; no two of the same needle, tissue and speed. Raises ModelError where there are."""

    combinations: tuple[Combination, ...] = ()
    title: str = ""

    def __post_init__(self) -> None:
        seen: dict[tuple[str, str, float], int] = {}
        mistakes = []
        for number, each in enumerate(self.combinations, start=1):
            first = seen.setdefault((_folded(each.needle), _folded(each.tissue), each.velocity_mm_s), number)
            if first != number:
                mistakes.append(Mistake(f"combination {number}", each.title, f"is there already, as number {first}"))
        if mistakes:
            raise ModelError(mistakes, self.title)

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Self:
        """Read an atlas file. Raises ModelError with every mistake of the file: key, value and rule."""
        source = os.fspath(path)
        try:
            content = Path(path).read_text(encoding="utf-8")
        except (OSError, ValueError) as error:
            reason = error.strerror if isinstance(error, OSError) and error.strerror else "is not UTF-8 text"
            raise ModelError(Mistake("", "", f"cannot be read: {reason}"), source) from error
        title, combinations, mistakes = parse(content)
        if not mistakes:
            try:
                return cls(combinations, title)
            except ModelError as error:
                mistakes = list(error.mistakes)
        raise ModelError(mistakes, source)

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the atlas, whole or not at all. Raises OutputError."""
        write_whole(path, text(self.title, self.combinations).encode())

    def with_combination(self, combination: Combination) -> Atlas:
        """Return the atlas with one more, which takes the place of one of the same needle, tissue and speed."""
        found = (combination.needle, combination.tissue, combination.velocity_mm_s)
        kept = [each for each in self.combinations if not _is(each, *found)]
        return Atlas((*kept, combination), self.title)

    def search(
        self, *, needle: str | None = None, tissue: str | None = None, velocity_mm_s: float | None = None
    ) -> tuple[Combination, ...]:
        """Return the combinations that fit all that is asked for; names are compared without case and outer spaces."""
        return tuple(each for each in self.combinations if _is(each, needle, tissue, velocity_mm_s))

    def nearest(self, needle: str, tissue: str, velocity_mm_s: float) -> Match | None:
        """Return the combination of this needle and tissue whose speed is nearest, by its ratio; None if there is none.

        Nothing is interpolated: parameters of neighbouring speeds need not lie on the same branch of the optimum.
        Raises ModelError for a speed that is not positive.
        """
        if not (math.isfinite(velocity_mm_s) and velocity_mm_s > 0):
            raise ModelError(Mistake("velocity_mm_s", f"{velocity_mm_s}", "must be a positive number"))
        matches = [
            Match(each, each.velocity_mm_s / velocity_mm_s) for each in self.search(needle=needle, tissue=tissue)
        ]
        return min(matches, key=lambda match: abs(math.log(match.velocity_ratio)), default=None)


def published_atlas() -> Atlas:
    """Return what the thesis identified: section 2.5.2 and Table 2.3, without intervals, which it does not print."""
    needles = {"A": "18 GA, 1.270/0.838 mm", "B": "22 GA, 0.718/0.413 mm"}
    tissues = {"A": "gellan gum 4.5 %", "B": "gellan gum 6 %"}
    return Atlas(
        tuple(
            Combination(
                needles[each.needle], tissues[each.tissue], each.velocity_mm_s, each.depth_mm, each.model,
                f"IEEE Trans. Instrum. Meas. 61(2), 2012, 429-438; {each.source}", mae_n=each.mae_n,
            )
            for each in PUBLISHED_FORCES
        ),
        "Chapter 2 of the thesis",
    )  # fmt: skip


def _folded(name: str) -> str:
    return " ".join(name.casefold().split())


def _is(each: Combination, needle: str | None, tissue: str | None, velocity_mm_s: float | None) -> bool:
    return (
        (needle is None or _folded(each.needle) == _folded(needle))
        and (tissue is None or _folded(each.tissue) == _folded(tissue))
        and (velocity_mm_s is None or math.isclose(each.velocity_mm_s, velocity_mm_s, rel_tol=1e-6))
    )
