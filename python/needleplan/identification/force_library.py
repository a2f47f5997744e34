"""The library: identified combinations of needle, tissue and speed, for use where there is no force sensor."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np

from needleplan.artifacts import CallRepr, ShortRepr, write_whole
from needleplan.config import ConfigTable, TableList, Text, parse_toml, ruled, shipped_names, text_of, toml_text
from needleplan.errors import DataError, Mistake, ModelError
from needleplan.identification._identification import Identification
from needleplan.identification.combination import Combination, CombinationTable
from needleplan.models.force import DepthForce
from needleplan.signals import Record, Role

__all__ = ["ForceLibrary", "Match", "combination_of", "shipped_libraries"]

_FOLDER = Path(__file__).parent.parent / "force_libraries"

# Largest relative difference between the speed of a trial and the median speed of the trials of one combination.
_ONE_SPEED = 0.2


@dataclass(frozen=True)
class _LibraryTable(ConfigTable, error=ModelError, schema="needleplan.force-library/1"):
    title: str = ruled(Text(), "")
    combination: tuple[CombinationTable, ...] = ruled(TableList(CombinationTable), ())


@dataclass(frozen=True)
class Match(CallRepr):
    """A combination of a library that matches a search.

    `velocity_ratio` is the speed of the combination divided by the requested speed, or 1 if no speed was requested.
    Force-depth models hold for one speed: the farther the ratio is from 1, the less reliable is the prediction.
    """

    combination: Combination
    velocity_ratio: float


@dataclass(frozen=True)
class ForceLibrary(ShortRepr):
    """Identified combinations of needle, tissue and speed.

    Raises ModelError if two combinations have the same needle, tissue and speed. Case and repeated spaces of the names
    do not matter.
    """

    combinations: tuple[Combination, ...] = ()
    title: str = ""

    def __post_init__(self) -> None:
        first: dict[tuple[str, str, float], int] = {}
        mistakes = []
        for number, combination in enumerate(self.combinations, start=1):
            known = first.setdefault((*_pair(combination), combination.velocity_mm_s), number)
            if known != number:
                mistakes.append(
                    Mistake(f"combination {number}", combination.title, f"is there already, as number {known}")
                )
        if mistakes:
            raise ModelError(mistakes, self.title)

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Self:
        """Read a library file, or a shipped library by its name, such as `published` (chapter 2 of the thesis).

        Raises ModelError if the file cannot be read, or with every mistake of the file: key, value and rule.
        """
        source = os.fspath(path)
        read = parse_toml(text_of(path, ModelError, _FOLDER, "library"), _LibraryTable, source)
        try:
            return cls(tuple(map(Combination.of, read.combination)), read.title)
        except ModelError as error:
            raise ModelError(error.mistakes, source) from None

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the library file atomically. Raises OutputError if it cannot be written."""
        combinations = [combination.raw(commented=True) for combination in self.combinations]
        document = {"schema": _LibraryTable.schema, "title": self.title, "combination": combinations}
        write_whole(path, toml_text(document).encode())

    def with_combination(self, combination: Combination) -> ForceLibrary:
        """Return a copy of the library with `combination` added; it replaces those that `like` finds."""
        kept = [member for member in self.combinations if member not in self.like(combination)]
        return ForceLibrary((*kept, combination), self.title)

    def like(self, combination: Combination) -> tuple[Combination, ...]:
        """Return the combinations with the same needle, the same tissue and the same speed (relative 1e-6)."""
        alike = self.search(needle=combination.needle, tissue=combination.tissue)
        return tuple(
            member for member in alike if math.isclose(member.velocity_mm_s, combination.velocity_mm_s, rel_tol=1e-6)
            and _pair(member) == _pair(combination)
        )  # fmt: skip

    def search(self, *, needle: str | None = None, tissue: str | None = None) -> tuple[Combination, ...]:
        """Return the combinations whose needle and tissue contain the given texts. None and an empty text match all.

        Case and repeated spaces do not matter.
        """
        wanted = (_folded(needle or ""), _folded(tissue or ""))
        return tuple(
            combination for combination in self.combinations
            if all(part in name for part, name in zip(wanted, _pair(combination), strict=True))
        )  # fmt: skip

    def matches(
        self, *, needle: str | None = None, tissue: str | None = None, velocity_mm_s: float | None = None
    ) -> tuple[Match, ...]:
        """Return the combinations that fit the names, with the ratio of their speed to a given speed.

        If a speed is given, only the combination with the nearest speed is returned for each pair of needle and tissue.
        Raises ModelError if the speed is not positive.
        """
        combinations = self.search(needle=needle, tissue=tissue)
        if velocity_mm_s is None:
            return tuple(Match(combination, 1.0) for combination in combinations)
        pairs = dict.fromkeys((combination.needle, combination.tissue) for combination in combinations)
        nearest = (self.nearest(*pair, velocity_mm_s) for pair in pairs)
        return tuple(match for match in nearest if match)

    def nearest(self, needle: str, tissue: str, velocity_mm_s: float) -> Match | None:
        """Return the combination of this needle and tissue with the nearest speed, by ratio of the speeds.

        Returns None if there is no combination of this needle and tissue. Parameters are not interpolated, because
        those of neighbouring speeds may belong to different local optima. Raises ModelError if the speed is not
        positive.
        """
        if not (math.isfinite(velocity_mm_s) and velocity_mm_s > 0):
            raise ModelError(Mistake("velocity_mm_s", f"{velocity_mm_s}", "must be a positive number"))
        matches = [
            Match(combination, combination.velocity_mm_s / velocity_mm_s)
            for combination in self.combinations
            if _pair(combination) == (_folded(needle), _folded(tissue))
        ]
        return min(matches, key=lambda match: abs(math.log(match.velocity_ratio)), default=None)


def shipped_libraries() -> list[str]:
    """Return the names of the libraries that come with the package. `ForceLibrary.read` accepts such a name."""
    return shipped_names(_FOLDER)


def combination_of(found: Identification, records: Sequence[Record], needle: str, tissue: str) -> Combination:
    """Return an identified axial force as a combination for a library.

    Only the training records count: speed is the median of their insertion speeds, depth their largest depth. Raises
    DataError if a record has no insertion or its speed differs by more than 20 % from the median, and ModelError if no
    force-depth model was identified or a name is empty.
    """
    model = found.model
    if not isinstance(model, DepthForce):
        raise ModelError(Mistake("model", "", "is missing: nothing was identified that a library could hold"))
    used = [record for record in records if record.role in (Role.TRAIN, Role.REFERENCE)]
    speeds = list(_speeds(used))
    speed = float(np.median(speeds))
    if max(speeds) > (1 + _ONE_SPEED) * speed or min(speeds) < (1 - _ONE_SPEED) * speed:
        value = f"{min(speeds):.3g} to {max(speeds):.3g}"
        raise DataError(Mistake("velocity_mm_s", value, "must be one speed: identify each speed by itself"))
    errors = {name: value for name, value, _ in found.scores}
    intervals = {
        name: (estimate.low, estimate.high)
        for name, estimate in found.estimates.items()
        if estimate.identified
        and name in model.values()
        and math.isfinite(estimate.low)
        and math.isfinite(estimate.high)
    }
    trials = ", ".join(record.trial for record in used if record.trial)
    return Combination(
        needle, tissue, float(f"{speed:.4g}"), max(float(np.max(record["depth_mm"])) for record in used), model,
        f"needleplan identify force: {trials or f'{len(used)} trials'}"[:1000], intervals,
        errors.get("MAE of the open loop"), tuple(dict.fromkeys(record.digest for record in used if record.digest)),
    )  # fmt: skip


def _speeds(records: Sequence[Record]) -> Iterator[float]:
    """Yield the median speed (mm/s) of the insertion of each trial. Raises DataError if a trial has no insertion."""
    for record in records:
        velocity = record.motion().velocity_mm_s
        inward = velocity[velocity > 0]
        if not inward.size:
            raise DataError(Mistake("velocity_mm_s", "", "is never above 0: there is no insertion"), record.trial)
        yield float(np.median(inward))


def _folded(name: str) -> str:
    return " ".join(name.casefold().split())


def _pair(combination: Combination) -> tuple[str, str]:
    return _folded(combination.needle), _folded(combination.tissue)
