"""Measure how feedback and replanning improve success and error: seeded insertions in the lab twin, three scenarios.

python benches/python/closed_loop.py --json benches/results/closed_loop.json > benches/results/closed_loop.md
python benches/python/closed_loop.py --seeds 2       # short test run

The labs are those of the shipped simulation `steering` with little tip noise: the curvature of the needle scatters
by 5 % around the planned one, the heading has a random walk, the shaft twists, and the sensors have noise. With the
same seed, all kinds of
guidance get the same lab.
"""

import argparse
import json
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import machine

from needleplan.scenario import Scenario
from needleplan_thesis.steering import (
    Guidance,
    SteeringCase,
    SteeringTask,
    SteeringTrial,
    gap_closed,
    run_all,
    steering_simulation,
    summarized,
)

SCENARIOS = ("phantom", "four_obstacles", "layered")
# Relative errors of the true curvature in the second part of the page.
OFF = (-0.2, 0.2)
KIND = (
    "scenario", "curvature", "guidance", "runs", "predicted", "success", "error mean", "median", "95 %", "out of plane",
    "in 3D", "turns",
    "replans", "failures",
)  # fmt: skip
GAP = (
    "scenario", "curvature", "predicted", "one table", "replanned", "gap closed", "error, one table",
    "error, replanned", "curvature known", "replanned less known",
)  # fmt: skip


def kinds(courses: list[SteeringCase], errors: list[float]) -> Iterator[tuple[SteeringCase, Guidance, float]]:
    """Yield (case, guidance, relative curvature error) in the order of the page.

    Without a curvature error: all guidance that differs then. With a curvature error: the closed loops and OPEN.
    """
    known = (Guidance.ONE_TABLE, Guidance.KNOWN)
    off = (Guidance.ONE_TABLE, Guidance.REPLANNED, Guidance.KNOWN, Guidance.OPEN)
    for course in courses:
        yield from ((course, guidance, 0.0) for guidance in Guidance if guidance not in known)
    for course in courses:
        for error in errors:
            yield from ((course, guidance, error) for guidance in off)


def main() -> int:
    """Run all insertions and print the page; with --json, write the results after every kind of insertion."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=200, help="insertions of each kind (200)")
    parser.add_argument("--off-seeds", type=int, help="insertions of each kind with a curvature error (as --seeds)")
    parser.add_argument("--scenarios", nargs="+", default=SCENARIOS)
    parser.add_argument("--off", nargs="*", type=float, default=OFF, help="relative errors of the curvature")
    parser.add_argument("--guidances", nargs="+", type=Guidance, default=list(Guidance), metavar="NAME")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--json", metavar="FILE")
    options = parser.parse_args()
    began, of = time.time(), machine.description()
    results: list[dict[str, Any]] = []
    courses = [SteeringCase(name, Scenario.read(name), steering_simulation()) for name in options.scenarios]
    for course, guidance, error in kinds(courses, options.off):
        if guidance not in options.guidances:
            continue
        seeds = (options.off_seeds or options.seeds) if error else options.seeds
        trials = list(
            run_all([SteeringTask(course, guidance, seed, error) for seed in range(seeds)], options.processes)
        )
        results.append(row(course.name, guidance, error, trials))
        print(f"{course.name}, {guidance}, {error:+.0%}: {results[-1]['success']:.1%}", file=sys.stderr)
        if options.json:
            written = json.dumps({"machine": of, "seconds": time.time() - began, "results": results}, indent=1)
            Path(options.json).write_text(written + "\n", encoding="utf-8")
    print("\n".join(lines(results, of, time.time() - began)))
    return 0


def row(name: str, guidance: Guidance, error: float, trials: list[SteeringTrial]) -> dict[str, Any]:
    """Return the record of one kind of insertions: the statistics, all errors, and the causes of failed insertions."""
    failed = [
        {"seed": each.task.seed, "ending": each.outcome, "cause": each.cause, "touched": each.touched,
         "error_mm": each.error_mm, "aside_mm": each.aside_mm, "in_space_mm": each.in_space_mm,
         "seen_error_mm": each.seen_error_mm, "out_of_plane_mm": each.out_of_plane_mm}
        for each in trials if not each.success
    ]  # fmt: skip
    errors = [round(each.error_mm, 4) for each in trials]
    summary: dict[str, Any] = asdict(summarized(trials))
    return {"scenario": name, "guidance": guidance, "curvature_error": error, **summary, "failed": failed,
            "errors_mm": errors, "beyond_rim_mm": sum(each.beyond_rim_mm for each in trials) / len(trials)}  # fmt: skip


def lines(results: list[dict[str, Any]], of: dict[str, object], seconds: float) -> Iterator[str]:
    """Yield the lines of the Markdown page."""
    yield "# Insertions in the lab twin: with feedback, without, and not steered"
    yield ""
    yield f"{of['processor']}, commit {of['commit']}, {of['date']}; {seconds:.0f} s. The simulation is `steering`, its"
    yield "servo at 400 Hz; 10 mm/s and 10 rad/s. Success: the true tip ends in the target, a ball, and its"
    yield "true path touches no obstacle and stays in the workspace. Errors (mm) are those of the true tip to the"
    yield "centre of the target over all insertions: mean, median and 95th percentile in the plane, and means of the"
    yield "distance from the plane and of the distance in 3D; intervals of 95 %."
    for title, chosen in (
        ("As planned", [0.0]),
        (
            "True curvature different from the plan",
            [e for e in sorted({each["curvature_error"] for each in results}) if e],
        ),
    ):
        yield from ("", f"## {title}", "")
        yield _row(KIND)
        yield "|---|--:|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|---|"
        for each in results:
            if each["curvature_error"] in chosen:
                yield _line(each)
    gaps = list(_gaps(results))
    if gaps:
        yield from ("", "## Gap of success that replanning closes", "")
        yield _row(GAP)
        yield "|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|"
        yield from gaps


def _row(names: tuple[str, ...]) -> str:
    return f"| {' | '.join(names)} |"


def _line(each: dict[str, Any]) -> str:
    low, high = each["success_interval"]
    less, more = each["error_interval_mm"]
    failures = ", ".join(f"{count} {what}" for what, count in each["failures"].items())
    return (
        f"| {each['scenario']} | {each['curvature_error']:+.0%} | {each['guidance']} | {each['runs']} | "
        f"{each['predicted']:.3f} | {each['success']:.3f} ({low:.3f} to {high:.3f}) | {each['error_mm']:.3f} "
        f"({less:.3f} to {more:.3f}) | {each['error_median_mm']:.3f} | {each['error_95_mm']:.3f} | "
        f"{each['aside_mm']:.3f} | {each['in_space_mm']:.3f} | "
        f"{each['turns']:.1f} | {each['replans']:.1f} | {failures} |"
    )


def _gaps(results: list[dict[str, Any]]) -> Iterator[str]:
    found = {(each["scenario"], each["curvature_error"], each["guidance"]): each for each in results}
    for (name, error, guidance), again in found.items():
        kept = found.get((name, error, Guidance.ONE_TABLE))
        if not error or guidance != Guidance.REPLANNED or kept is None:
            continue
        known = found.get((name, error, Guidance.KNOWN))
        best = f"{known['success']:.3f} | {_difference(again, known)}" if known else "not run | "
        closed = gap_closed(again["predicted"], kept["success"], again["success"])
        yield (
            f"| {name} | {error:+.0%} | {again['predicted']:.3f} | {kept['success']:.3f} | {again['success']:.3f} | "
            f"{'no gap' if closed is None else f'{closed:.0%}'} | {kept['error_mm']:.3f} | {again['error_mm']:.3f} | "
            f"{best} |"
        )


def _difference(one: dict[str, Any], other: dict[str, Any]) -> str:
    """Return the difference of the success of insertions with equal seeds, in points, with its 95 % interval."""
    runs = min(one["runs"], other["runs"])
    failed = [{each["seed"] for each in kind["failed"] if each["seed"] < runs} for kind in (one, other)]
    worse, better = len(failed[0] - failed[1]), len(failed[1] - failed[0])
    mean = (better - worse) / runs
    deviation = 1.96 * ((better + worse) / runs - mean**2) ** 0.5 / runs**0.5
    return f"{100 * mean:+.1f} +- {100 * deviation:.1f}"


if __name__ == "__main__":
    sys.exit(main())
