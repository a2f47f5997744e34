"""The claims of `compare_peers.py`, checked with its measured values."""

from collections.abc import Mapping
from dataclasses import dataclass

from contest import Result
from contestants import PARTITIONS, PRIORITIES

LIBRARIES = ("mdpsolver", "quantecon", "mdptoolbox")


@dataclass(frozen=True)
class Verdict:
    """A claim, the measured value, and whether it holds (None if a measurement is missing)."""

    claim: str
    measured: str
    holds: bool | None


def fastest_library(results: Mapping[str, Result]) -> Result | None:
    """Return the result with the shortest solve time of all methods of the libraries; None if all failed."""
    done = [each for name, each in results.items() if name.startswith(LIBRARIES) and not each.failure]
    return min(done, key=lambda each: each.least, default=None)


def ratio(results: Mapping[str, Result], name: str, yardstick: Result | None) -> float | None:
    """Return the shortest time of `yardstick` divided by the median time of `name`; None if one of them is missing."""
    ours = results.get(name)
    if ours is None or ours.failure or yardstick is None or yardstick.failure:
        return None
    return yardstick.least / ours.median


def verdicts(results: Mapping[str, Result]) -> list[Verdict]:
    """Check all claims that the results allow."""
    peer, user = fastest_library(results), results.get("numba-gs")
    one, two = results.get("lattice-1"), results.get("lattice-2")
    listed = [
        _at_least(
            "lattice, 1 thread: 200 times faster than the fastest library", 200, ratio(results, "lattice-1", peer)
        ),
        _at_least(
            "scenario file to table: 40 times faster than its solve alone", 40, ratio(results, "whole-way", peer)
        ),
        _at_least("tabular, all threads: 8 times faster than the fastest library", 8, _tabular(results, peer)),
        _at_least("tabular, all threads: not slower than numba Gauss-Seidel", 1, ratio(results, "tabular-2", user)),
        _at_least("tabular, 1 thread: not slower than numba Gauss-Seidel", 1, ratio(results, "tabular-1", user)),
    ]
    if one and two and not one.failure and not two.failure:
        listed.insert(1, _at_least("lattice, 2 threads: faster than 1", 1, one.median / two.median))
    if one and not one.failure:
        sweeps = one.facts["sweeps"]
        listed.insert(1, Verdict("lattice: at most 8 n backups to the stop rule", f"{sweeps:.2f} n", sweeps <= 8))
    return listed


def _tabular(results: Mapping[str, Result], peer: Result | None) -> float | None:
    return ratio(results, "tabular-2", peer)


def _at_least(claim: str, wanted: float, measured: float | None) -> Verdict:
    if measured is None:
        return Verdict(claim, "not measured", None)
    return Verdict(claim, f"{measured:.3g} x", measured >= wanted)


def does_prioritization_pay(results: Mapping[str, Result]) -> str:
    """Return a few sentences on the benefit of priorities, with the measured values."""
    plain = results.get("plain")
    names = [f"ppvi-{px}x{py}-{priority}" for px, py in PARTITIONS for priority in PRIORITIES]
    runs = [results[name] for name in names if name in results and not results[name].failure]
    if plain is None or plain.failure or not runs:
        return "Not measured."
    sweeps = plain.facts["sweeps"]
    fewest = min(runs, key=lambda run: run.facts["sweeps"])
    quickest = min(runs, key=lambda run: run.median)
    fewer = [run for run in runs if run.facts["sweeps"] < sweeps]
    lines = [
        f"Against plain value iteration ({sweeps:.1f} n backups, {plain.median:.3g} s, the same code for a backup, one "
        f"thread): {len(fewer)} of {len(runs)} variants need fewer backups; fewest {fewest.facts['sweeps']:.1f} n "
        f"({fewest.label}); quickest {quickest.median:.3g} s ({quickest.label}), "
        f"{plain.median / quickest.median:.2f} times as fast."
    ]
    shares = [run.facts["seconds_priorities"] / run.median for run in runs]
    lines.append(f"Priorities take {100 * min(shares):.0f} to {100 * max(shares):.0f} % of the time.")
    sweep = results.get("lattice-1")
    if sweep is not None and not sweep.failure:
        verdict = "Order beats" if sweep.facts["sweeps"] < fewest.facts["sweeps"] else "Order does not beat"
        lines.append(f"{verdict} priority: the directional sweeps need {sweep.facts['sweeps']:.1f} n backups.")
    alternating = results.get("numba-gs")
    if alternating is not None and not alternating.failure:
        lines.append(f"Gauss-Seidel in alternating order needs {alternating.facts['sweeps']:.0f} n.")
    return " ".join(lines)
