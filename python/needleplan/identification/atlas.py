"""The atlas: identified combinations of needle, tissue and speed, for use where there is no force sensor."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np

from needleplan.artifacts import write_whole
from needleplan.config import ConfigTable, TableList, Text, parse_toml, ruled, shipped_names, text_of, toml_text
from needleplan.errors import DataError, Mistake, ModelError
from needleplan.identification._identification import Identification
from needleplan.identification.combination import Combination, CombinationTable
from needleplan.models.force import DepthForce
from needleplan.signals import Record, Role

__all__ = ["Atlas", "Match", "combination_of", "shipped_atlases"]

_FOLDER = Path(__file__).parent.parent / "atlases"

# Largest relative difference of the speeds of trials that are one combination.
_ONE_SPEED = 0.2


@dataclass(frozen=True)
class _AtlasTable(ConfigTable, error=ModelError, schema="needleplan.atlas/1"):
    title: str = ruled(Text(), "")
    combination: tuple[CombinationTable, ...] = ruled(TableList(CombinationTable), ())


@dataclass(frozen=True)
class Match:
    """The combination of an atlas that is nearest to a needle, a tissue and a speed.

    `velocity_ratio` is its speed over the requested speed. Force-depth models hold for one speed: the farther the ratio
    is from 1, the less the prediction says about the requested speed.
    """

    combination: Combination
    velocity_ratio: float


@dataclass(frozen=True)
class Atlas:
    """Identified combinations. Raises ModelError if two have the same needle, tissue and speed."""

    combinations: tuple[Combination, ...] = ()
    title: str = ""

    def __post_init__(self) -> None:
        first: dict[tuple[str, str, float], int] = {}
        mistakes = []
        for number, each in enumerate(self.combinations, start=1):
            known = first.setdefault((*_pair(each), each.velocity_mm_s), number)
            if known != number:
                mistakes.append(Mistake(f"combination {number}", each.title, f"is there already, as number {known}"))
        if mistakes:
            raise ModelError(mistakes, self.title)

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Self:
        """Read an atlas file, or the shipped atlas by its name, `published`: chapter 2 of the thesis.

        Raises ModelError with every mistake of the file: key, value and rule.
        """
        source = os.fspath(path)
        read = parse_toml(text_of(path, ModelError, _FOLDER, "atlas"), _AtlasTable, source)
        try:
            return cls(tuple(map(Combination.of, read.combination)), read.title)
        except ModelError as error:
            raise ModelError(error.mistakes, source) from None

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the atlas, whole or not at all. Raises OutputError."""
        combinations = [each.raw(commented=True) for each in self.combinations]
        document = {"schema": _AtlasTable.schema, "title": self.title, "combination": combinations}
        write_whole(path, toml_text(document).encode())

    def with_combination(self, combination: Combination) -> Atlas:
        """Return the atlas with a combination, which replaces one of the same needle, tissue and speed."""
        kept = [each for each in self.combinations if each not in self.like(combination)]
        return Atlas((*kept, combination), self.title)

    def like(self, combination: Combination) -> tuple[Combination, ...]:
        """Return the combinations of the same needle, tissue and speed: one or none."""
        alike = self.search(needle=combination.needle, tissue=combination.tissue)
        return tuple(
            each for each in alike if math.isclose(each.velocity_mm_s, combination.velocity_mm_s, rel_tol=1e-6)
            and _pair(each) == _pair(combination)
        )  # fmt: skip

    def search(self, *, needle: str | None = None, tissue: str | None = None) -> tuple[Combination, ...]:
        """Return the combinations whose names contain the given texts; case and repeated spaces do not matter."""
        wanted = (_folded(needle or ""), _folded(tissue or ""))
        return tuple(
            each for each in self.combinations
            if all(part in name for part, name in zip(wanted, _pair(each), strict=True))
        )  # fmt: skip

    def matches(
        self, *, needle: str | None = None, tissue: str | None = None, velocity_mm_s: float | None = None
    ) -> tuple[Match, ...]:
        """Return the combinations that `search` finds; with a speed, the nearest one of each needle and tissue."""
        found = self.search(needle=needle, tissue=tissue)
        if velocity_mm_s is None:
            return tuple(Match(each, 1.0) for each in found)
        pairs = dict.fromkeys((each.needle, each.tissue) for each in found)
        nearest = (self.nearest(*pair, velocity_mm_s) for pair in pairs)
        return tuple(each for each in nearest if each)

    def nearest(self, needle: str, tissue: str, velocity_mm_s: float) -> Match | None:
        """Return the combination of this needle and tissue with the nearest speed, by ratio; None if there is none.

        Nothing is interpolated: parameters of neighbouring speeds need not lie on the same branch of the optimum.
        Raises ModelError for a speed that is not positive.
        """
        if not (math.isfinite(velocity_mm_s) and velocity_mm_s > 0):
            raise ModelError(Mistake("velocity_mm_s", f"{velocity_mm_s}", "must be a positive number"))
        matches = [
            Match(each, each.velocity_mm_s / velocity_mm_s)
            for each in self.combinations
            if _pair(each) == (_folded(needle), _folded(tissue))
        ]
        return min(matches, key=lambda match: abs(math.log(match.velocity_ratio)), default=None)


def shipped_atlases() -> list[str]:
    """Return the names of the atlases that come with the package; `Atlas.read` accepts them."""
    return shipped_names(_FOLDER)


def combination_of(found: Identification, records: Sequence[Record], needle: str, tissue: str) -> Combination:
    """Return an identified axial force as a combination for an atlas.

    The speed is the median speed of the insertions, the depth their largest. Raises DataError for records without an
    insertion or with different speeds, ModelError if nothing was identified and for an empty name.
    """
    model = found.model
    if not isinstance(model, DepthForce):
        raise ModelError(Mistake("model", "", "is missing: nothing was identified that an atlas could hold"))
    used = [each for each in records if each.role is Role.TRAIN]
    speeds = list(_speeds(used))
    speed = float(np.median(speeds))
    if max(speeds) > (1 + _ONE_SPEED) * speed or min(speeds) < (1 - _ONE_SPEED) * speed:
        value = f"{min(speeds):.3g} to {max(speeds):.3g}"
        raise DataError(Mistake("velocity_mm_s", value, "must be one speed: identify each speed by itself"))
    errors = {name: value for name, value, _ in found.scores}
    intervals = {
        name: (each.low, each.high)
        for name, each in found.estimates.items()
        if each.identified and name in model.values() and math.isfinite(each.low) and math.isfinite(each.high)
    }
    trials = ", ".join(each.trial for each in used if each.trial)
    return Combination(
        needle, tissue, float(f"{speed:.4g}"), max(float(np.max(each["depth_mm"])) for each in used), model,
        f"needleplan identify force: {trials or f'{len(used)} trials'}"[:1000], intervals,
        errors.get("MAE of the open loop"), tuple(dict.fromkeys(each.digest for each in used if each.digest)),
    )  # fmt: skip


def _speeds(records: Sequence[Record]) -> Iterator[float]:
    """Yield the median speed (mm/s) of the insertion of each trial."""
    for record in records:
        velocity = record.motion().velocity_mm_s
        inward = velocity[velocity > 0]
        if not inward.size:
            raise DataError(Mistake("velocity_mm_s", "", "is never above 0: there is no insertion"), record.trial)
        yield float(np.median(inward))


def _folded(name: str) -> str:
    return " ".join(name.casefold().split())


def _pair(each: Combination) -> tuple[str, str]:
    return _folded(each.needle), _folded(each.tissue)
