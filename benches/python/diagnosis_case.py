"""One data set of the blind campaign, diagnosed: what was hidden, what was said about it, and what it cost."""

from __future__ import annotations

import json
import os
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import diagnosis_peers

from needleplan.diagnosis import Diagnosis, Library, diagnose
from needleplan.errors import NeedleplanError
from needleplan.models import ShaftAndTip
from needleplan.models.effects import SIZE, effects_of
from needleplan.signals import Record, Role
from tests.blind.campaign import Case, Purpose, Stratum, campaign
from tests.blind.effect import ForceName
from tests.blind.force import ForceSpec, generate
from tests.blind.outside import AXES
from tests.blind.recording import DataSet

BASE = ShaftAndTip(friction=0.012, cutting=0.4, onset_mm=4.0, presliding_mm=0.05)
"""The nominal values that an analyst is told."""

CALLED = {ForceName.CUTTING_DEPTH: "cutting_with_depth", ForceName.GAIN: "gain_error", ForceName.BUMPS: "bump"}
"""What the library calls effects that the blind data call otherwise."""

COMPARABLE = {
    "viscous": {SIZE: SIZE},
    "bias": {SIZE: SIZE},
    "drift": {SIZE: SIZE},
    "latency": {SIZE: SIZE},
    "inertia": {SIZE: SIZE},
    "cutting_with_depth": {SIZE: SIZE},
    "friction_layer": {SIZE: SIZE, "depth_mm": "depth_mm"},
    "cutting_layer": {SIZE: SIZE, "depth_mm": "depth_mm"},
    "puncture": {"depth_mm": "depth_mm"},
    "thermal_drift": {SIZE: SIZE, "time_s": "settling_s"},
    "respiration": {SIZE: SIZE},
}
"""Parameters that mean the same on both sides, by effect: ours, and the truth's."""


def called(name: str) -> str:
    """Return what the library calls a hidden effect."""
    each = ForceName(name)
    return CALLED.get(each, str(each))


class Bench:
    """Diagnoses data sets one after the other; what the library computes for motions is kept."""

    def __init__(self, *, peers: bool) -> None:
        self.library = Library(effects_of(BASE.channel), BASE)
        self.peers = peers
        self.prepared_s = self._prepare()

    def _prepare(self) -> float:
        """Diagnose one data set without an effect for each kind of motions; return seconds, generation left out."""
        spent = 0.0
        seen = set()
        for case in campaign(Purpose.TUNING):
            motions = case.spec.training + case.spec.held_out
            if motions not in seen:
                seen.add(motions)
                data, _ = generate(ForceSpec(7, (), 0.0, case.spec.training, case.spec.held_out))
                begin = process_time()
                diagnose(BASE, records(data), library=self.library)
                spent += process_time() - begin
        return spent

    def outcome(self, case: Case) -> dict[str, Any]:
        """Return one line of results."""
        data, truth = generate(case.spec)
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
                    "name": called(each.name),
                    "size": each.noise_multiple,
                    "rms": each.rms,
                    "noncentrality": each.noncentrality,
                    "parameters": _comparable(called(each.name), each.parameters),
                }
                for each in truth.effects
            ],
            "true_axis": str(AXES[case.spec.effects[0].name]) if case.stratum is Stratum.OUTSIDE else None,
        }
        begin, wall = process_time(), perf_counter()
        try:
            found = diagnose(BASE, records(data), library=self.library, seed=case.spec.seed)
        except NeedleplanError as error:
            return line | {"failure": str(error), "cpu_s": process_time() - begin, "wall_s": perf_counter() - wall}
        line |= {"cpu_s": process_time() - begin, "wall_s": perf_counter() - wall} | said(found)
        if self.peers and case.stratum in (Stratum.NULL, Stratum.SINGLE, Stratum.PAIR):
            line["peers"] = diagnosis_peers.named(found, self.library, case.spec.seed)
        return line


def records(data: DataSet) -> list[Record]:
    """Return a data set as the diagnosis takes it."""
    return [
        Record(
            {name: values for name, values in each.columns.items() if values.dtype.kind == "f"},
            each.name,
            Role(each.role.value),
        )
        for each in data.trials
    ]


def said(found: Diagnosis) -> dict[str, Any]:
    """Return what a diagnosis said, as plain values."""
    first = found.selection.steps[0]
    after = found.verified
    return {
        "failure": "",
        "verdict": str(found.verdict),
        "because": found.decision.because,
        "names": list(found.names),
        "tied": list(found.decision.tied),
        "axis": str(found.decision.axis) if found.decision.axis else None,
        "level": found.selection.base.level,
        "p_value": first.p_value,
        "stop": str(first.stop),
        "best": first.ranked[0].name if first.ranked else first.screened[0].effect.name,
        "balance": first.ranked[0].balance if first.ranked else first.screened[0].balance,
        "rival": {"name": first.rivals[0].name, "balance": first.rivals[0].balance},
        "effects": [
            {
                "name": each.effect.name,
                "rms": each.rms,
                "estimates": {
                    name: [value.value, value.low, value.high] for name, value in each.added.estimates.items()
                },
            }
            for each in found.effects
        ],
        "shrink": after.shrink if after else None,
        "transfer": after.transfer if after else None,
        "whiteness_after": after.whiteness_after if after else None,
    }


def _comparable(name: str, parameters: dict[str, Any]) -> dict[str, float]:
    return {ours: float(parameters[theirs]) for ours, theirs in COMPARABLE.get(name, {}).items()}


_bench: Bench | None = None


def begin(peers: bool) -> None:
    """Prepare a process."""
    global _bench
    os.nice(5)
    _bench = Bench(peers=peers)


def run(case: Case) -> dict[str, Any]:
    """Diagnose one data set in a process that was prepared."""
    assert _bench is not None
    return _bench.outcome(case)


def read(path: Path, engine: str) -> dict[int, dict[str, Any]]:
    """Return the results of this engine that a file has, by seed; a last line that was cut off is left out."""
    kept: dict[int, dict[str, Any]] = {}
    for text in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
        try:
            line = json.loads(text)
        except json.JSONDecodeError:
            continue
        if line["engine"] == engine:
            kept[line["seed"]] = line
    return kept
