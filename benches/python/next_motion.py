"""Whether the motion that a diagnosis proposes decides between the effects that were left, against the last one again.

PYTHONPATH=. python benches/python/next_motion.py --minutes 10      # again, to go on

Blind data with seeds for tuning: one hidden effect that poor motions leave to be mistaken for another, one trial at
5 mm/s or two, and a held-out one at 2.5 mm/s. Where the diagnosis is AMBIGUOUS between two effects or more, one more
trial from the same tissue is added to the training data, and it is diagnosed again: of the motion that was proposed, of
the last motion again, and of a fixed one (`rich`). Resolved: NAMED, and the hidden effect. Wrong: a name that was not
hidden. Outcomes are appended to build/next_motion.jsonl; writes benches/results/next_motion.json and .md.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from time import monotonic
from typing import Any

import machine
import numpy as np
from diagnosis_case import records
from diagnosis_score import rate
from diagnosis_subject import SUBJECTS, SubjectName

from needleplan.diagnosis import Diagnosis, Library, Verdict, diagnose
from needleplan.diagnosis.next_motion import Separating, limits_of, next_motion
from needleplan.diagnosis.program import programs
from needleplan.models.effects import effects_of
from needleplan.signals import Motion, Record
from tests.blind.campaign import HETEROGENEITY, NAMEABLE, SEEDS, UNSEEN, Purpose, Variety
from tests.blind.effect import ForceName
from tests.blind.force import ForceSpec, Wanted, another, generate
from tests.blind.motions import MotionKind, Trajectory, from_depths, trajectory
from tests.blind.recording import DataSet

SUBJECT = SUBJECTS[SubjectName.FORCE]
BASE = SUBJECT.base
RESULTS = machine.ROOT / "benches" / "results" / "next_motion"
OUTCOMES = machine.ROOT / "build" / "next_motion.jsonl"
FIRST = SEEDS[Purpose.TUNING].start + 9_000_000
"""Behind the seeds of the campaign for tuning."""

FIXED = "rich"
CLEAR = (ForceName.PUNCTURE, ForceName.BUMPS, ForceName.LATENCY, ForceName.INERTIA, ForceName.RELAXATION)
"""Effects that look like no other, or that poor motions do not show."""

WAYS = ("proposed", "repeated", "fixed")
SIZES = (1.0, 6.0)
HIDDEN = tuple(each for each in NAMEABLE if each not in UNSEEN[Variety.POOR] and each not in CLEAR)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=5.0, help="begin no further data set after so long")
    parser.add_argument("--part", type=int, nargs=2, default=(0, 1), metavar=("K", "N"), help="every Nth from the Kth")
    options = parser.parse_args()
    OUTCOMES.parent.mkdir(parents=True, exist_ok=True)
    done = {line["seed"] for line in read()}
    library = Library(effects_of(BASE.channel), BASE)
    until = monotonic() + 60 * options.minutes
    with OUTCOMES.open("a", encoding="utf-8") as file:
        for number, spec in enumerate(specs()):
            if monotonic() > until:
                break
            if spec.seed in done or number % options.part[1] != options.part[0]:
                continue
            file.write(json.dumps(outcome(spec, library)) + "\n")
            file.flush()
    write(list(read()))


def specs() -> Iterator[ForceSpec]:
    """Yield data sets without end, the effects and levels one after the other."""
    number = 0
    while True:
        seed = FIRST + number
        name, level = HIDDEN[number % len(HIDDEN)], HETEROGENEITY[number // len(HIDDEN) % len(HETEROGENEITY)]
        generator = np.random.default_rng(seed)
        size = float(np.exp(generator.uniform(*np.log(SIZES))))
        count = 1 + number % 2
        yield ForceSpec(
            seed, (Wanted(name, size),), level, (MotionKind.CONSTANT,) * count, (MotionKind.CONSTANT_SLOW,)
        )  # fmt: skip
        number += 1


def outcome(spec: ForceSpec, library: Library) -> dict[str, Any]:
    """Diagnose a data set and, where the answer is ambiguous, what each of the ways makes of it."""
    data, _ = generate(spec)
    trials = records(data)
    first = diagnose(BASE, trials, library=library, seed=spec.seed)
    (wanted,) = spec.effects
    name = SUBJECT.called.get(wanted.name, str(wanted.name))
    line: dict[str, Any] = {
        "seed": spec.seed, "hidden": name, "size": wanted.noise_multiple, "level": spec.heterogeneity,
        "trials": len(spec.training), "verdict": str(first.verdict), "tied": list(first.decision.tied),
    }  # fmt: skip
    if first.verdict is not Verdict.AMBIGUOUS or len(first.decision.tied) < 2:
        return line
    proposed, limits = next_motion(first), limits_of(first)
    if not isinstance(proposed, Separating) or limits is None:
        return line
    rate_hz = 1 / float(np.median(first.calibration.training[0].motion.interval_s))
    (fixed,) = (each for each in programs(BASE.channel, limits) if each.name == FIXED)
    paths = {
        "proposed": as_trajectory(proposed.program.name, proposed.motion),
        "repeated": trajectory(MotionKind.CONSTANT),
        "fixed": as_trajectory(FIXED, fixed.motion(rate_hz)),
    }
    line |= promised(proposed)
    for way, path in paths.items():
        line[way] = said(diagnose(BASE, [extra(spec, path), *trials], library=library, seed=spec.seed))
    return line


def as_trajectory(name: str, motion: Motion) -> Trajectory:
    """Return a motion as one of the generator."""
    return from_depths(name, motion.time_s, motion.depth_mm)


def extra(spec: ForceSpec, path: Trajectory) -> Record:
    """Return one more training trial of the same tissue."""
    (record,) = records(DataSet((another(spec, path),)))
    return record


def promised(proposed: Separating) -> dict[str, Any]:
    """Return what was proposed, and what was expected of it."""
    return {
        "motion": proposed.program.name, "resolves": proposed.resolves, "least": proposed.least,
        "repeated_resolves": proposed.repeated_resolves, "duration_s": float(proposed.motion.time_s[-1]),
        "synonyms": [[each.first, each.second] for each in proposed.synonyms],
    }  # fmt: skip


def said(found: Diagnosis) -> dict[str, Any]:
    """Return what was said after the further trial."""
    return {"verdict": str(found.verdict), "names": list(found.names), "tied": list(found.decision.tied)}


def read() -> Iterator[dict[str, Any]]:
    """Yield the outcomes so far."""
    if OUTCOMES.exists():
        yield from map(json.loads, OUTCOMES.read_text(encoding="utf-8").splitlines())


def resolved(line: dict[str, Any], way: str) -> bool:
    """Whether it is named, and rightly."""
    return bool(line[way]["verdict"] == "named" and line[way]["names"] == [line["hidden"]])


def wrong(line: dict[str, Any], way: str) -> bool:
    """Whether a name was given that was not hidden."""
    return line[way]["verdict"] in ("named", "incomplete") and set(line[way]["names"]) != {line["hidden"]}


def write(lines: Sequence[dict[str, Any]]) -> None:
    """Write the summary, for all levels and each."""
    open_ = [line for line in lines if "proposed" in line]
    table: dict[str, Any] = {}
    for level in (None, *HETEROGENEITY):
        part = [line for line in open_ if level is None or line["level"] == level]
        # Where the hidden effect is not among those left, no motion that tells them apart can name it.
        inside = [line for line in part if line["hidden"] in line["tied"]]
        table["all" if level is None else f"{level:g}"] = {
            way: {
                "resolved": rate(sum(resolved(line, way) for line in part), len(part)),
                "resolved_where_tied": rate(sum(resolved(line, way) for line in inside), len(inside)),
                "wrong": rate(sum(wrong(line, way) for line in part), len(part)),
            }
            for way in WAYS
        }
    found = {
        "machine": machine.description(), "data_sets": len(lines), "ambiguous": len(open_), "levels": table,
        "motions": dict(Counter(line["motion"] for line in open_)),
        "promised": float(np.mean([line["resolves"] for line in open_])) if open_ else None,
    }  # fmt: skip
    Path(f"{RESULTS}.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    rows = [
        f"{len(lines)} data sets, {len(open_)} of them ambiguous. One more trial, of the motion",
        "", "| level | way | resolved | where it was tied | wrong |", "|---|---|---|---|---|",
        *("| " + " | ".join([level, way, *(shown(each[key]) for key in ("resolved", "resolved_where_tied", "wrong"))])
          + " |" for level, ways in table.items() for way, each in ways.items()),
        "", "Proposed: " + ", ".join(f"{name} {count}" for name, count in found["motions"].items()) + ".", "",
    ]  # fmt: skip
    Path(f"{RESULTS}.md").write_text("\n".join(rows), encoding="utf-8")
    print("\n".join(rows))


def shown(each: dict[str, float | int | None]) -> str:
    """Return a share with its bounds."""
    if not each["of"]:
        return "-"
    return f"{each['hits']}/{each['of']}, {each['rate']:.0%} ({each['low']:.0%} to {each['high']:.0%})"


if __name__ == "__main__":
    main()
