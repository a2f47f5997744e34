"""Data sets of all generators in one form, and the outcome of the diagnosis of one of them."""

import math
import random
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from time import process_time
from types import MappingProxyType
from typing import Any

import second_generator
import second_generator_sets as second
import third_generator as third
from diagnosis_subject import SUBJECTS, SubjectName, records

from needleplan.diagnosis import Diagnosis, Library, default_library, diagnose
from needleplan.diagnosis.catalogue import CatalogueEntry
from needleplan.models import Model, ShaftAndTip
from needleplan.models.effects import SIZE
from needleplan.signals import Array, Motion, Record, Role
from tests.blind.campaign import Case, Purpose, campaign
from tests.blind.outside import AXES
from tests.blind.truth import Truth

GENERATORS = ("first", "second", "third")
# Share of each stratum in a draw from the first generator.
_SHARES = {"null": 0.2, "single": 0.35, "pair": 0.25, "outside": 0.2}
_KINDS = {"none": "null"}
# Effects that the second generator has outside of the documented library, and the library has under another name.
_SAME = {"rate_cutting": "cutting_speed"}
# Effects that the base model absorbs: no engine can name them.
_ABSORBED = ("gain_error", "ageing")
# Parameters that mean the same in the library and in the second generator, beside those of SUBJECTS.
_ALSO_COMPARABLE = {"respiration": ("frequency_hz",)}
# Words of the second generator for an axis, and the value of `GapAxis`.
_AXES = {"position wave": "position_periodic"}

Line = dict[str, Any]


@dataclass(frozen=True)
class EngineCase:
    """One data set: its key, what is known about it, and the functions that make recordings, model and truth."""

    key: str
    facts: Line
    make: Callable[[], tuple[ShaftAndTip, list[Record], list[Line], list[str]]]
    """Returns base model, recordings, hidden effects, and the axes that are right."""


def draw(
    generator: str, runs: int, seed: int, strata: Sequence[str] | None, motion: str | None, least: float = 0.0
) -> Iterator[EngineCase]:
    """Yield `runs` cases of a generator; skip those with a hidden effect of a noncentrality below `least`."""
    source = {"first": _mixed, "second": _second, "third": _third}[generator]
    for case in source(runs, seed, strata, motion):
        if not least or min((each["noncentrality"] for each in case.make()[2]), default=least) >= least:
            yield case


def _mixed(runs: int, seed: int, strata: Sequence[str] | None, motion: str | None) -> Iterator[EngineCase]:
    rnd = random.Random(seed)
    rows: dict[str, list[Case]] = {}
    for case in campaign(Purpose.TUNING):
        if motion is None or str(case.variety) == motion:
            rows.setdefault(str(case.stratum), []).append(case)
    for row in rows.values():
        rnd.shuffle(row)
    wanted = {name: share for name, share in _SHARES.items() if not strata or name in strata}
    wanted |= {name: 1.0 for name in strata or () if name not in wanted}
    total, taken = sum(wanted.values()), dict.fromkeys(wanted, 0)
    for number in range(runs):
        # the stratum that lags most behind its share
        name = max(wanted, key=lambda each: wanted[each] / total * (number + 1) - taken[each])
        if taken[name] < len(rows[name]):
            yield _first(rows[name][taken[name]])
        taken[name] += 1


def _hidden(truth: Truth) -> list[Line]:
    """Return what is known about each hidden effect, in the names of the library."""
    subject, found = SUBJECTS[SubjectName.FORCE], []
    for each in truth.effects:
        name = subject.called.get(each.name, str(each.name))
        same = subject.comparable.get(name, {})
        found.append({
            "name": name, "noncentrality": each.noncentrality, "multiple": each.noise_multiple,
            "parameters": {ours: float(each.parameters[theirs]) for ours, theirs in same.items()},
        })  # fmt: skip
    return found


def _first(case: Case) -> EngineCase:
    subject = SUBJECTS[SubjectName.FORCE]

    def make() -> tuple[ShaftAndTip, list[Record], list[Line], list[str]]:
        data, truth = subject.generate(case.spec)
        hidden = _hidden(truth)
        outside = str(case.stratum) == "outside"
        axes = [str(AXES[case.spec.effects[0].name])] if outside else []
        assert isinstance(subject.base, ShaftAndTip)
        return subject.base, records(data), hidden, axes

    facts = {"generator": "first", "stratum": str(case.stratum), "motion": str(case.variety), "rate_hz": 50,
             "heterogeneity": case.spec.heterogeneity}  # fmt: skip
    return EngineCase(f"first {case.spec.seed}", facts, make)


def _second(runs: int, seed: int, strata: Sequence[str] | None, motion: str | None) -> Iterator[EngineCase]:
    own = motion if motion in second.MOTIONS else None
    for wish in second.wishes(seed, runs, None, None, None, own, "noise"):
        stratum = _KINDS.get(wish.kind, wish.kind)
        if not strata or stratum in strata:
            yield second_case(wish, stratum, f"second {wish.seed} {wish.index} {wish.kind} {own}")


def second_case(
    wish: second.Wish, stratum: str, key: str, changes: Mapping[str, float] = MappingProxyType({}), references: int = 0
) -> EngineCase:
    """Return a data set of the second generator.

    The parameters of the given model are the true ones times `changes`, by name. `references` is the number of further
    trials without the effects.
    """

    def make() -> tuple[ShaftAndTip, list[Record], list[Line], list[str]]:
        data = second.make(wish)
        found = [Record(columns, name, Role(role)) for name, role, columns in second_generator.trials_of(data)]
        found += [
            Record(columns, name, Role(role))
            for name, role, columns in second_generator.references_of(data, references)
        ]
        hidden, axes = [], []
        same = SUBJECTS[SubjectName.FORCE].comparable
        for each in data.truth["hidden"]:  # type: ignore[attr-defined]
            numbers = {**each["numbers"], SIZE: each["size"]}
            names = (*same.get(each["name"], ()), *_ALSO_COMPARABLE.get(each["name"], ()))
            hidden.append({
                "name": each["name"], "noncentrality": each["noncentrality"],
                "multiple": each["noise_multiple"], "library": each["library"],
                "parameters": {key: float(numbers[key]) for key in names if key in numbers},
            })  # fmt: skip
            axes += [_AXES.get(axis, axis) for axis in (each["axis"], *each["axes_also_right"])]
        given = {name: float(f"{value * changes.get(name, 1.0):.3g}") for name, value in data.nominal.items()}
        return ShaftAndTip(**given), found, hidden, axes if wish.kind == "outside" else []

    facts = {"generator": "second", "stratum": stratum, "motion": wish.motion, "rate_hz": wish.rate_hz,
             "heterogeneity": wish.heterogeneity}  # fmt: skip
    return EngineCase(key, facts | ({"changes": dict(changes)} if changes else {}), make)


def _third(runs: int, seed: int, strata: Sequence[str] | None, motion: str | None) -> Iterator[EngineCase]:
    """Yield data sets of the third generator. Noncentralities are those that heterogeneous tissue leaves.

    An effect of the further library is of the stratum `further`.
    """
    own = motion if motion in third.MOTIONS else None
    same = SUBJECTS[SubjectName.FORCE].comparable
    for index in range(runs):
        kind = _KINDS.get(third.kind_of(seed, index), third.kind_of(seed, index))
        if strata and kind not in strata:
            continue

        @lru_cache(1)
        def data_set(index: int = index) -> third.DataSet:
            return third.make(seed, index, motion=own, counted="tissue")

        def make(
            given: Callable[[], third.DataSet] = data_set,
        ) -> tuple[ShaftAndTip, list[Record], list[Line], list[str]]:
            data, hidden, axes = given(), [], []
            for each in data.truth["hidden"]:
                numbers = {**each["numbers"], SIZE: each["size"]}
                hidden.append({
                    "name": each["name"], "noncentrality": each["noncentrality_with_tissue"],
                    "noise_only": each["noncentrality"], "multiple": each["noise_multiple"],
                    "library": each["library"], "tier": each["tier"],
                    "parameters": {key: float(numbers[key]) for key in same.get(each["name"], ()) if key in numbers},
                })  # fmt: skip
                axes += [_AXES.get(axis, axis) for axis in (each["axis"], *each["axes_also_right"])]
            found = [Record(columns, name, Role(role)) for name, role, columns in data.records]
            return ShaftAndTip(**data.nominal), found, hidden, axes if data.truth["kind"] == "outside" else []

        truth = data_set().truth
        if kind in ("single", "pair") and any(each["tier"] == "further" for each in truth["hidden"]):
            kind = "further"
        facts = {"generator": "third", "stratum": kind, "motion": truth["motion"], "rate_hz": truth["rate_hz"],
                 "heterogeneity": truth["heterogeneity"], "base": truth["base"]}  # fmt: skip
        yield EngineCase(f"third {seed} {index} {own}", facts, make)


def nulls_of_other_laws(seed: int, count: int) -> Iterator[EngineCase]:
    """Yield data sets of the third generator without an effect, whose bases have other laws than the model."""
    for index in range(count):

        def make(index: int = index) -> tuple[ShaftAndTip, list[Record], list[Line], list[str]]:
            data = third.make(seed, index, kind="none", base="other")
            found = [Record(columns, name, Role(role)) for name, role, columns in data.records]
            return ShaftAndTip(**data.nominal), found, [], []

        facts = {"generator": "third", "stratum": "law", "motion": "", "rate_hz": 0, "heterogeneity": math.nan}
        yield EngineCase(f"third {seed} {index} other laws", facts, make)


class EngineBench:
    """Diagnoses data sets; those with the same base model share a library, which caches its computations by motion."""

    def __init__(self) -> None:
        self._library: TimedLibrary | None = None

    def outcome(self, case: EngineCase) -> Line:
        """Return the outcome of one data set. An exception becomes the `failure` of the outcome."""
        base, recordings, hidden, axes = case.make()
        if self._library is None or self._library.nominal != base:
            self._library = TimedLibrary(default_library(base).effects, base)
        for each in hidden:
            each["name"] = _SAME.get(each["name"], each["name"])
        if case.facts["stratum"] == "outside" and {each["name"] for each in hidden} <= {*_SAME.values()}:
            case.facts["stratum"] = "single"
        if len(hidden) == 1 and hidden[0]["name"] in _ABSORBED and case.facts["stratum"] == "single":
            case.facts["stratum"] = "absorbed"
        line: Line = {"key": case.key, **case.facts, "truth": hidden, "axes": axes}
        begin, before_s = process_time(), self._library.spent_s
        try:
            found = said(diagnose(base, recordings, library=self._library))
        except Exception as error:  # a crash is a result; the other data sets still run
            found = {"failure": repr(error)}
        return line | {"failure": ""} | found | {
            "cpu_s": process_time() - begin, "library_s": self._library.spent_s - before_s
        }  # fmt: skip


class TimedLibrary(Library):
    """A library that counts the processor time of its sensitivities, which a second call with its motions saves."""

    spent_s = 0.0

    def sensitivities(self, model: Model, motion: Motion, entries: Sequence[CatalogueEntry]) -> Array:
        """Return the sensitivities of the library."""
        begin = process_time()
        found = super().sensitivities(model, motion, entries)
        self.spent_s += process_time() - begin
        return found


def said(found: Diagnosis) -> Line:
    """Return answer, names, axis, probability, intervals and held-out shrink as plain values."""
    decision = found.decision
    return {
        "verdict": str(decision.verdict),
        "names": list(decision.names),
        "axis": str(decision.axis) if decision.axis else None,
        "probability": decision.probability,
        "family": list(decision.family),
        "estimates": {
            each.name: {name: [value.value, value.low, value.high] for name, value in each.estimates.items()}
            for each in found.likely
        },
        "shrink": found.shrink if math.isfinite(found.shrink) else None,
        "findings": [f"{each.kind} {each.name}" for each in found.findings],
    }
