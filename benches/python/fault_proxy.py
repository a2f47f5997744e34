"""Provoke faults from outside, between `needleplan insert` and a lab in real time, and report what becomes of each.

chrt -f 20 python benches/python/fault_proxy.py --json benches/results/fault_proxy.json > benches/results/fault_proxy.md
python benches/python/fault_proxy.py --only "force: foreign"   # faults whose names begin so
python benches/python/fault_proxy.py --list

For each fault, a lab and an insertion are started with a proxy between them. At a depth of 3 mm the fault is injected:
in the relays of the proxy, by a foreign client, or at the processes and files. The report shows the state of the guard,
the cause, who stopped the needle and when, and what the recording contains. The exit code is 1 if a fault ends in
another state or with another cause than it should.
"""

import argparse
import math
import sys
import tempfile
from pathlib import Path

import machine
from fault_cases import CASES, STANDS, Case
from fault_run import Outcome, as_json, from_json, observed

ATTEMPTS = 3  # largest number of runs of a fault that does not end as expected


def measured(case: Case) -> Outcome:
    """Return the outcome of a fault; a fault that ends otherwise than expected is provoked again.

    On a busy machine a run may end for another reason, such as a loop that waited for a processor.
    """
    for number in range(1, ATTEMPTS + 1):
        with tempfile.TemporaryDirectory() as folder:
            found = observed(case.name, case.inject, Path(folder), case.before, case.observed_s)
        found.runs = number
        if STANDS in case.states and found.by == "robot":
            found.state = STANDS
        if as_expected(case, found):
            break
        print(found, file=sys.stderr, flush=True)
    return found


def as_expected(case: Case, found: Outcome) -> bool:
    """Return whether the state and the cause of an outcome are those that the fault should have."""
    named = any(each in found.cause for each in case.causes) if case.causes and found.state != "ENABLED" else True
    starting = case.name.startswith("start:")
    return found.state in case.states and named and (starting or not found.disturbed)


def report(rows: list[tuple[Case, Outcome]], about: dict[str, object]) -> str:
    """Return the report in Markdown."""
    lines = [
        "# Faults provoked from outside",
        "",
        f"{len(rows)} faults on {about['processor']}, {about['threads']} threads, load "
        f"{about['load_before']} before the run, priority {about['priority']}, commit {about['commit']}. Written by "
        "`benches/python/fault_proxy.py`.",
        "",
        "| fault | state | cause | stopped by | ms | mm further in | recording | runs | as expected |",
        "|---|---|---|---|--:|--:|---|--:|---|",
    ]
    for case, each in rows:
        stop = "" if math.isnan(each.stop_ms) else f"{each.stop_ms:.1f}"
        deeper = "" if math.isnan(each.inward_mm) else f"{each.inward_mm:.2f}"
        expected = "yes" if as_expected(case, each) else "**no**"
        state = f"{each.state} (disturbed)" if each.disturbed and not case.name.startswith("start:") else each.state
        cells = (each.name, state, each.cause, each.by, stop, deeper, each.recording, str(each.runs), expected)
        lines.append(f"| {' | '.join(cells)} |")
    times = [each.stop_ms for case, each in rows if not each.disturbed and each.by]
    good = sum(as_expected(case, each) for case, each in rows)
    lines += ["", f"As expected: {good} of {len(rows)}. Worst time to the stop: {max(times, default=math.nan):.1f} ms."]
    return "\n".join(lines)


def main() -> int:
    """Provoke the faults, print the report, and return 1 if one does not end as it should."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--only", action="append", metavar="TEXT", help="only faults whose names begin with this text; may be repeated"
    )
    parser.add_argument("--list", action="store_true", help="print the names of all faults")
    parser.add_argument(
        "--known", action="append", type=Path, default=[], metavar="FILE",
        help="take the outcomes in this file of --json instead of provoking their faults; later files replace earlier",
    )  # fmt: skip
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    if options.list:
        print("\n".join(case.name for case in CASES))
        return 0
    about = machine.description()
    known: dict[str, Outcome] = {}
    for file in options.known:
        known |= from_json(file.read_text(encoding="utf-8"))
    rows = []
    for case in CASES:
        if case.name.startswith(tuple(options.only or [""])):
            found = known.get(case.name) or measured(case)
            rows.append((case, found))
            print(found, file=sys.stderr, flush=True)
    print(report(rows, about))
    if options.json:
        options.json.write_text(as_json([each for _, each in rows]) + "\n", encoding="utf-8")
    return 0 if all(as_expected(*row) for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
