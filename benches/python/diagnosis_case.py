"""Diagnoses of single data sets of the blind campaign: hidden effects, verdict, estimates and computing time."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import diagnosis_peers
from diagnosis_subject import SUBJECTS, AnyCase, Subject, SubjectName

from needleplan.diagnosis import Diagnosis, Library, diagnose
from needleplan.models.effects import effects_of
from needleplan.signals import Record, Role
from tests.blind.campaign import Purpose, Stratum
from tests.blind.recording import DataSet


class Bench:
    """Diagnoses data sets one after the other; all share a library, which caches its computations for the motions."""

    def __init__(self, name: SubjectName = SubjectName.FORCE, *, peers: bool = False) -> None:
        self.subject = SUBJECTS[name]
        self.base = self.subject.base
        self.library = Library(effects_of(self.base.channel), self.base)
        self.peers = peers
        self.prepared_s = self._prepare()

    def _prepare(self) -> float:
        """Fill the cache: diagnose a data set without an effect for each set of motions. Return processor time (s)."""
        spent = 0.0
        seen = set()
        for case in self.subject.cases(Purpose.TUNING, True):
            motions = case.spec.training + case.spec.held_out
            if motions not in seen:
                seen.add(motions)
                data, _ = self.subject.generate(self.subject.empty(case))
                begin = process_time()
                diagnose(self.base, records(data), library=self.library)
                spent += process_time() - begin
        return spent

    def outcome(self, case: AnyCase) -> dict[str, Any]:
        """Generate and diagnose a data set; return its record. An exception becomes the record's `failure`."""
        data, truth = self.subject.generate(case.spec)
        names = [self.subject.called.get(each.name, str(each.name)) for each in truth.effects]
        line: dict[str, Any] = {
            "seed": case.spec.seed,
            "purpose": str(case.purpose),
            "stratum": str(case.stratum),
            "variety": str(case.variety),
            "heterogeneity": case.spec.heterogeneity,
            "never_tuned": case.never_tuned,
            "prepared_s": self.prepared_s,
            "noise_rms": truth.noise_rms,
            "truth": [
                {
                    "name": name,
                    "size": each.noise_multiple,
                    "rms": each.rms,
                    "noncentrality": each.noncentrality,
                    "parameters": _comparable(self.subject, name, each.parameters),
                }
                for name, each in zip(names, truth.effects, strict=True)
            ],
            "true_axis": self.subject.axes[case.spec.effects[0].name] if case.stratum is Stratum.OUTSIDE else None,
        }
        begin, wall = process_time(), perf_counter()
        try:
            found = diagnose(self.base, records(data), library=self.library)
        except Exception as error:  # a crash is a result; the other data sets still run
            return line | {"failure": repr(error), "cpu_s": process_time() - begin, "wall_s": perf_counter() - wall}
        line |= {"cpu_s": process_time() - begin, "wall_s": perf_counter() - wall} | said(found)
        if self.peers and case.stratum in (Stratum.NULL, Stratum.SINGLE, Stratum.PAIR):
            line["peers"] = diagnosis_peers.named(found, self.library, case.spec.seed)
        return line


def records(data: DataSet) -> list[Record]:
    """Return the trials of a data set as records."""
    return [
        Record(
            {name: values for name, values in each.columns.items() if values.dtype.kind == "f"},
            each.name,
            Role(each.role.value),
        )
        for each in data.trials
    ]


def said(found: Diagnosis) -> dict[str, Any]:
    """Return verdict, names, estimates and statistics of a diagnosis as plain values."""
    decision = found.decision
    return {
        "failure": "",
        "verdict": str(found.verdict),
        "because": decision.because,
        "probability": decision.probability,
        "names": list(found.names),
        "tied": [list(each) for each in decision.tied],
        "axis": str(decision.axis) if decision.axis else None,
        "level": found.heterogeneity,
        "effects": [
            {
                "name": each.effect.name,
                "rms": each.rms,
                "estimates": {name: [value.value, value.low, value.high] for name, value in each.estimates.items()},
            }
            for each in found.effects
        ],
        "shrink": found.shrink if math.isfinite(found.shrink) else None,
    }


def _comparable(subject: Subject, name: str, parameters: dict[str, Any]) -> dict[str, float]:
    return {ours: float(parameters[theirs]) for ours, theirs in subject.comparable.get(name, {}).items()}


_bench: Bench | None = None


def begin(name: SubjectName, peers: bool) -> None:
    """Lower the priority of this worker process and create its `Bench`."""
    global _bench
    os.nice(5)
    _bench = Bench(name, peers=peers)


def run(case: AnyCase) -> dict[str, Any]:
    """Return the record of one case; `begin` must have run in this process."""
    assert _bench is not None
    return _bench.outcome(case)


def read(path: Path, engine: str) -> dict[int, dict[str, Any]]:
    """Return the records of this engine in a file, by seed. A truncated last line is skipped."""
    kept: dict[int, dict[str, Any]] = {}
    for text in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
        try:
            line = json.loads(text)
        except json.JSONDecodeError:
            continue
        if line["engine"] == engine:
            kept[line["seed"]] = line
    return kept
