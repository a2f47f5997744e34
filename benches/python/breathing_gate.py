"""Insertions in the lab twin while the patient breathes: gated, ungated, and with tissue at rest.

PYTHONPATH=. python benches/python/breathing_gate.py > benches/results/breathing_gate.md
PYTHONPATH=. python benches/python/breathing_gate.py --runs 1      # short test run

The anatomy is the box of the tests of insertions. Breathing moves all tissue, needle and target in it, across the
entry, and dwells at exhalation. An insertion has the same tip noise in every row; its breath has its own phase.
"""

import argparse
import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import machine
import numpy as np

from needleplan.anatomy import TARGET, Breathing
from needleplan.control import BreathGate, RunEventName
from needleplan.estimation.tip import TipSettings
from needleplan.models import TipFrame
from needleplan.planning import SpaceTable, wilson
from needleplan.simulation import Effects
from tests.control.space_scenes import FAST, box_table, inserted, space_station

PERIOD_S = 4.0
# Rows of the table: motion of the tissue from exhalation to inspiration (mm), and gate (mm).
KINDS: tuple[tuple[float, float | None], ...] = ((0.0, None), (10.0, 3.0), (3.0, None), (10.0, None))


@dataclass(frozen=True)
class GatedEnd:
    """How an insertion ended: whether the loop says so and the true tip is in the target, and where in the tissue."""

    success: bool
    error_mm: float
    waits: int
    waited_s: float
    duration_s: float
    outcome: str


def run(table: SpaceTable, full_mm: float, within_mm: float | None, seed: int) -> GatedEnd:
    """Insert once with tissue that moves by `full_mm`; `within_mm` is the gate."""
    effects = Effects(
        coil_offset_mm=3.0, tracker_noise_mm=0.1, tracker_angle_noise_rad=0.01, tracker_wander_mm=0.05,
        respiration_across_mm=full_mm / 2, respiration_rest=1.0, respiration_period_s=PERIOD_S,
    )  # fmt: skip
    gate = None
    if within_mm is not None:
        breathing = Breathing(full_mm=full_mm, still=("bone",), period_s=PERIOD_S)
        gate = BreathGate(breathing, within_mm, space_station(table, effects, seed).exhaled_s)
    settings = TipSettings(heading_sd_rad_sqrt_mm=table.scenario.noise_rad_sqrt_mm)
    report, station = inserted(table, effects, seed, replace(FAST, gate=gate, replan=False), tip_settings=settings)
    start = table.best_entry()
    heading, elevation = start.pose.angles_rad
    line = TipFrame.planar(0.0, 0.0, heading).raised(elevation)
    along, across = station.lab.plant.breath_mm
    in_tissue = np.array(station.true_tip_mm) - along * np.array(line.tangent) - across * np.array(line.normal)
    waits = [float(event.text.split()[0]) for event in report.events if event.name is RunEventName.WAITING]
    return GatedEnd(
        bool(table.scenario.codes(in_tissue) == TARGET),
        float(np.linalg.norm(in_tissue - table.scenario.target_mm)),
        len(waits), sum(waits), report.duration_s, str(report.outcome),
    )  # fmt: skip


def row(name: str, ends: Sequence[GatedEnd]) -> str:
    """Return a row of the table."""
    hits = sum(end.success for end in ends)
    low, high = wilson(hits, len(ends))
    errors, waited = [end.error_mm for end in ends], [end.waited_s for end in ends]
    ended = Counter(end.outcome for end in ends if end.outcome not in ("target", "missed"))
    lost = ", ".join(f"{count} {outcome}" for outcome, count in ended.items()) or "0"
    return (
        f"| {name} | {len(ends)} | {hits / len(ends):.0%} | {low:.0%} to {high:.0%} | {np.median(errors):.1f} mm | "
        f"{np.quantile(errors, 0.9):.1f} mm | {lost} | {np.mean([end.waits for end in ends]):.1f} | "
        f"{np.mean(waited):.1f} s | {max(waited):.1f} s | {np.mean([end.duration_s for end in ends]):.1f} s |"
    )


def main() -> int:
    """Run all insertions and print the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=50, help="insertions for each row (50)")
    options = parser.parse_args()
    began, of = time.time(), machine.description()
    rows, table = [], box_table()
    promised = table.estimate(table.best_entry())
    for full_mm, gate in KINDS:
        name = "none" if not full_mm else f"{full_mm:g} mm, " + ("free" if gate is None else f"gate {gate:g} mm")
        rows.append(row(name, [run(table, full_mm, gate, seed) for seed in range(options.runs)]))
        print(rows[-1], file=sys.stderr)
    print("# Insertions while the patient breathes\n")
    print(f"{of['processor']}, commit {of['commit']}, {of['date']}; {time.time() - began:.0f} s.")
    print(f"Box with a lattice of 4 mm; success as planned {promised}.")
    print(f"Breathing: displacement from exhalation to inspiration, across the entry, in {PERIOD_S:g} s; 20 mm/s.")
    print("Success: the true tip ends in the target, both in the tissue. Error: distance of the true tip from the")
    print("centroid of the target, in the tissue. Ended early: before the depth of the target, by the outcome.\n")
    print(
        "| breathing | insertions | success | 95 % interval | median error | 90 % of errors below | ended early ",
        end="| waits ",
    )
    print("| mean wait | longest wait | duration |")
    print("|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|")
    print("\n".join(rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
