"""Score the diagnosis on the blind campaign: confusion, power, calibration, false names, time; compare with peers.

PYTHONPATH=. python benches/python/diagnosis_benchmark.py --peers              # the report, with the reporting seeds
PYTHONPATH=. python benches/python/diagnosis_benchmark.py --channel tip        # the path of the tip
PYTHONPATH=. python benches/python/diagnosis_benchmark.py --tuning --small     # for development: 165 data sets
PYTHONPATH=. python benches/python/diagnosis_benchmark.py --peers --minutes 30 # repeat the command to continue

Every outcome is appended to a file at once, and a repeated command continues from that file. The file also stores a
digest of the engine's sources; outcomes with another digest are ignored. Data sets are ordered so that an incomplete
run covers all strata, with wider bounds. Writes PREFIX.json, PREFIX.md, PREFIX_power.png and PREFIX_confusion.png.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import sys
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from time import monotonic

import diagnosis_case
import diagnosis_goals
import diagnosis_page
import diagnosis_score
import machine
from diagnosis_subject import SUBJECTS, AnyCase, SubjectName

import needleplan
from needleplan.artifacts import digest
from tests.blind.campaign import Purpose

RESULTS = machine.ROOT / "benches" / "results"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tuning", action="store_true", help="use the seeds for tuning, not those for the report")
    parser.add_argument("--small", action="store_true", help="run the small campaign, a subset")
    parser.add_argument("--peers", action="store_true", help="also apply PySINDy and LASSO to the same data")
    parser.add_argument("--processes", type=int, default=2, choices=(1, 2))
    parser.add_argument("--minutes", type=float, help="stop after this time and summarise the outcomes so far")
    parser.add_argument("--stratum", action="append", help="only this stratum (null, single, pair, outside, absorbed)")
    parser.add_argument("--outcomes", type=Path, help="file for outcomes (build/diagnosis_PURPOSE.jsonl)")
    parser.add_argument(
        "--prefix", type=Path, help="prefix of the written files (benches/results/diagnosis; with --tuning, in build/)"
    )
    parser.add_argument("--channel", type=SubjectName, choices=list(SubjectName), default=SubjectName.FORCE)
    options = parser.parse_args()
    subject, kind = SUBJECTS[options.channel], "" if options.channel is SubjectName.FORCE else f"_{options.channel}"
    peers = options.peers and not kind  # the peers have candidates for the axial force only
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"  # inherited by the worker processes, which share the cores: one thread each
    purpose = Purpose.TUNING if options.tuning else Purpose.REPORTING
    build = machine.ROOT / "build"
    outcomes = options.outcomes or build / f"diagnosis{kind}_{purpose}.jsonl"
    prefix = options.prefix or (build / f"diagnosis{kind}_tuning" if options.tuning else RESULTS / f"diagnosis{kind}")
    for path in (outcomes, prefix):
        path.parent.mkdir(parents=True, exist_ok=True)

    engine = engine_digest()
    cases = mixed(
        case for case in subject.cases(purpose, options.small)
        if not options.stratum or str(case.stratum) in options.stratum
    )  # fmt: skip
    known = diagnosis_case.read(outcomes, engine)
    to_do = [case for case in cases if not _is_done(known.get(case.spec.seed), peers)]
    end = monotonic() + 60 * options.minutes if options.minutes is not None else float("inf")
    if to_do and monotonic() < end:
        with outcomes.open("a", encoding="utf-8") as file:
            context = multiprocessing.get_context("spawn")
            with context.Pool(options.processes, diagnosis_case.begin, (options.channel, peers)) as pool:
                for count, line in enumerate(pool.imap_unordered(diagnosis_case.run, to_do), start=1):
                    line["engine"] = engine
                    known[line["seed"]] = line
                    file.write(json.dumps(line) + "\n")
                    file.flush()
                    if count % 20 == 0:
                        print(f"{count} of {len(to_do)}", file=sys.stderr)
                    if monotonic() > end:
                        pool.terminate()
                        break
    lines = [known[case.spec.seed] for case in cases if case.spec.seed in known]
    if not lines:
        sys.exit("no data set was diagnosed: nothing to report")
    found = diagnosis_score.summary(lines, large=subject.large)
    preparation = [line["prepared_s"] for line in lines if line.get("prepared_s") is not None]
    judge = diagnosis_goals.tip_goals if kind else diagnosis_goals.goals
    judged = judge(found, max(preparation, default=None))
    run = {
        "channel": str(options.channel),
        "large": subject.large,
        "purpose": str(purpose),
        "small": options.small,
        "engine": engine,
        "done": len(lines),
        "wanted": len(cases),
    }
    report = {
        "machine": machine.description(),
        "run": run,
        "goals": [asdict(each) for each in judged],
        "summary": found,
    }
    prefix.with_suffix(".json").write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    diagnosis_page.draw(found, prefix)
    text = diagnosis_page.page(report, judged, prefix.name)
    prefix.with_suffix(".md").write_text(text, encoding="utf-8")
    print(text)


def mixed(cases: Iterable[AnyCase]) -> list[AnyCase]:
    """Return the cases in an order in which all rows of the campaign progress at the same relative rate."""
    rows: dict[tuple[object, ...], list[AnyCase]] = defaultdict(list)
    for case in cases:
        names = tuple(each.name for each in case.spec.effects) if len(case.spec.effects) == 1 else ()
        rows[case.stratum, case.variety, case.spec.heterogeneity, names].append(case)
    placed = [
        ((index + 0.618 * number % 1) / len(row), case)
        for number, row in enumerate(rows.values()) for index, case in enumerate(row)
    ]  # fmt: skip
    return [case for _, case in sorted(placed, key=lambda pair: pair[0])]


def engine_digest() -> str:
    """Return a digest of all sources that affect an outcome."""
    package = Path(needleplan.__file__).parent
    files = sorted(file for part in ("diagnosis", "models", "signals") for file in (package / part).rglob("*.py"))
    files += sorted((machine.ROOT / "tests" / "blind").glob("*.py"))
    return digest(b"".join(file.read_bytes() for file in files))[:19]


def _is_done(line: dict[str, object] | None, peers: bool) -> bool:
    return line is not None and (not peers or "peers" in line or line["stratum"] in ("outside", "absorbed"))


if __name__ == "__main__":
    main()
