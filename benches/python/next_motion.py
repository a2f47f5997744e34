"""Measure how often the proposed next motion resolves an ambiguous diagnosis, compared with other motions.

PYTHONPATH=. python benches/python/next_motion.py --minutes 10                  # repeat to continue
PYTHONPATH=. python benches/python/next_motion.py --channel tip --minutes 10
PYTHONPATH=. python benches/python/next_motion.py --reporting --ambiguous 60    # the report, with the reporting seeds

Blind data: one hidden effect that looks like another effect in poor motions, a few trials of one motion, and a held-out
trial (`next_motion_case`). If the diagnosis is AMBIGUOUS and no data are missing, one more trial in the same tissue
is added to the training data, and all are diagnosed again. The added trial has the proposed motion, the last motion
(repeated), or a fixed motion. Resolved: the verdict is NAMED with the hidden effect. Wrong: an effect is named that was
not hidden. Outcomes are appended to build/next_motion_PURPOSE.jsonl; those of other engine sources are ignored. Writes
benches/results/next_motion.json and .md for both channels; with seeds for tuning, build/next_motion.json and .md.
"""

import argparse
import json
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from time import monotonic
from typing import Any

import machine
import numpy as np
from diagnosis_counts import engine_digest, rate
from diagnosis_subject import SubjectName
from next_motion_case import SOURCES, Source, Spec

from needleplan.diagnosis import (
    Diagnosis,
    Library,
    NextTrials,
    Verdict,
    diagnose,
    next_trials,
    programs,
    recorded_limits,
)
from needleplan.models.effects import effects_of
from tests.blind.campaign import HETEROGENEITY, Purpose

# Name of the fixed motion by channel, and kinds of added trials.
FIXED = {SubjectName.FORCE: "rich", SubjectName.TIP: "half_turns"}
WAYS = ("proposed", "repeated", "fixed")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--reporting", action="store_true", help="use the seeds for the report, not those for tuning")
    parser.add_argument("--channel", type=SubjectName, choices=list(SubjectName), action="append", help="both")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="time limit of each channel")
    parser.add_argument("--ambiguous", type=int, default=60, help="end a channel after so many ambiguous data sets")
    parser.add_argument("--part", type=int, nargs=2, default=(0, 1), metavar=("K", "N"), help="every Nth, from the Kth")
    options = parser.parse_args()
    purpose = Purpose.REPORTING if options.reporting else Purpose.TUNING
    outcomes = machine.ROOT / "build" / f"next_motion_{purpose}.jsonl"
    outcomes.parent.mkdir(parents=True, exist_ok=True)
    engine = engine_digest()
    with outcomes.open("a", encoding="utf-8") as file:
        for channel in options.channel or SubjectName:
            known = [each for each in read(outcomes, engine) if each["channel"] == channel]
            done, open_ = {line["seed"] for line in known}, sum("proposed" in line for line in known)
            bench, until = Bench(channel), monotonic() + 60 * options.minutes
            for number, spec in enumerate(bench.source.specs(purpose)):
                if monotonic() > until or open_ >= options.ambiguous:
                    break
                if spec.seed in done or number % options.part[1] != options.part[0]:
                    continue
                line = {"engine": engine, "channel": str(channel)} | bench.outcome(spec)
                open_ += "proposed" in line
                file.write(json.dumps(line) + "\n")
                file.flush()
    folder = machine.ROOT / ("benches/results" if options.reporting else "build")
    write(list(read(outcomes, engine)), purpose, engine, folder / "next_motion")


class Bench:
    """Diagnoses data sets of a channel; all share a library, which caches its computations for the motions."""

    def __init__(self, channel: SubjectName) -> None:
        self.source: Source = SOURCES[channel]
        self.base = self.source.subject.base
        self.library = Library(effects_of(self.base.channel), self.base)
        self.fixed = FIXED[channel]

    def outcome(self, spec: Spec) -> dict[str, Any]:
        """Diagnose a data set; if the verdict is ambiguous, repeat the diagnosis with each kind of added trial."""
        trials = self.source.generate(spec)
        first = diagnose(self.base, trials, library=self.library)
        name, size = self.source.hidden(spec)
        line: dict[str, Any] = {
            "seed": spec.seed, "hidden": name, "size": size, "level": spec.heterogeneity,
            "trials": len(spec.training), "held_out": str(spec.held_out[0]), **said(first),
        }  # fmt: skip
        if first.verdict is not Verdict.AMBIGUOUS or first.lacks_data:
            return line
        proposed, limits = next_trials(first), recorded_limits(first.calibration)
        if proposed is None or limits is None:
            return line
        rate_hz = 1 / float(np.median(first.calibration.training[0].motion.interval_s))
        (fixed,) = (each for each in programs(self.base.channel, limits) if each.name == self.fixed)
        extra = {
            "proposed": self.source.extra(spec, proposed.motions[0].motion),
            "repeated": self.source.again(spec),
            "fixed": self.source.extra(spec, fixed.motion(rate_hz)),
        }
        line |= promised(proposed)
        for way, record in extra.items():
            line[way] = said(diagnose(self.base, [record, *trials], library=self.library))
        return line


def promised(proposed: NextTrials) -> dict[str, Any]:
    """Return the proposed motion and the information that it promises, in bits."""
    (motion,) = proposed.motions
    return {
        "motion": motion.name if motion.program else "repetition", "bits": proposed.bits,
        "repeated_bits": proposed.repeated_bits, "open_bits": proposed.open_bits,
        "duration_s": float(motion.motion.time_s[-1]),
    }  # fmt: skip


def said(found: Diagnosis) -> dict[str, Any]:
    """Return verdict, names, tied effects and reason of a diagnosis."""
    what = found.decision
    return {
        "verdict": str(found.verdict), "names": list(found.names), "because": what.because,
        "tied": sorted({name for names in what.tied for name in names}),
    }  # fmt: skip


def read(outcomes: Path, engine: str) -> Iterator[dict[str, Any]]:
    """Yield the outcomes in the file that belong to this digest of the engine."""
    for text in outcomes.read_text(encoding="utf-8").splitlines() if outcomes.exists() else ():
        line = json.loads(text)
        if line["engine"] == engine:
            yield line


def resolved(line: dict[str, Any], way: str) -> bool:
    """Whether the diagnosis with this kind of added trial names the hidden effect and nothing else."""
    return bool(line[way]["verdict"] == "named" and line[way]["names"] == [line["hidden"]])


def wrong(line: dict[str, Any], way: str) -> bool:
    """Whether the diagnosis with this kind of added trial names an effect that was not hidden."""
    return line[way]["verdict"] in ("named", "incomplete") and set(line[way]["names"]) != {line["hidden"]}


def write(lines: Sequence[dict[str, Any]], purpose: Purpose, engine: str, prefix: Path) -> None:
    """Write PREFIX.json and PREFIX.md, print the page: one row per channel, heterogeneity and kind of added trial."""
    open_ = [line for line in lines if "proposed" in line]
    table: dict[str, Any] = {}
    present = [channel for channel in SubjectName if any(line["channel"] == channel for line in open_)]
    for channel in present if len(present) == 1 else (None, *present):
        for level in (None, *HETEROGENEITY):
            part = [line for line in open_ if channel in (None, line["channel"]) and level in (None, line["level"])]
            # If the hidden effect is not among the tied effects, no motion that separates them can name it.
            inside = [line for line in part if line["hidden"] in line["tied"]]
            row = f"{channel or 'both'}, {'all' if level is None else f'{level:.0%}'}"
            table[row] = {
                way: {
                    "resolved": rate(sum(resolved(line, way) for line in part), len(part)),
                    "resolved_where_tied": rate(sum(resolved(line, way) for line in inside), len(inside)),
                    "wrong": rate(sum(wrong(line, way) for line in part), len(part)),
                }
                for way in WAYS
            }
    found = {
        "machine": machine.description(), "purpose": str(purpose), "engine": engine, "data_sets": len(lines),
        "ambiguous": len(open_), "rows": table,
        "motions": dict(Counter(line["motion"] for line in open_).most_common()),
        "ties": dict(Counter(", ".join(sorted(line["tied"])) for line in open_).most_common()),
        "promised_bits": float(np.mean([line["bits"] for line in open_])) if open_ else None,
    }  # fmt: skip
    prefix.with_suffix(".json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    rows = [
        f"{len(lines)} data sets ({purpose} seeds), {len(open_)} of them ambiguous. One more trial, of the motion",
        "", "| channel, heterogeneity | way | resolved | where it was tied | wrong |", "|---|---|---|---|---|",
        *("| " + " | ".join([name, way, *(shown(each[key]) for key in ("resolved", "resolved_where_tied", "wrong"))])
          + " |" for name, ways in table.items() for way, each in ways.items()),
        "", "Proposed: " + ", ".join(f"{name} {count}" for name, count in found["motions"].items()) + ".",
        "Tied: " + "; ".join(f"{name} {count}" for name, count in found["ties"].items()) + ".", "",
    ]  # fmt: skip
    prefix.with_suffix(".md").write_text("\n".join(rows), encoding="utf-8")
    print("\n".join(rows))


def shown(each: dict[str, float | int | None]) -> str:
    """Format a rate with its bounds; a dash if it has no data."""
    if not each["of"]:
        return "-"
    return f"{each['hits']}/{each['of']}, {each['rate']:.0%} ({each['low']:.0%} to {each['high']:.0%})"


if __name__ == "__main__":
    main()
