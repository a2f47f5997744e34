"""Measure success when the true curvature differs from the plan: replanned, with one table, and with a plan that knew.

python benches/python/adaptation.py --json benches/results/adaptation.json > benches/results/adaptation.md
python benches/python/adaptation.py --seeds 5 --scenarios four_obstacles      # short test run

Insertions are simulated at the level of tip poses, not in the full lab twin, which takes ten times as long: the tip
moves along arcs with a random walk of the heading (2 mrad per root mm, in and out of the plane); a pose of the tip
arrives every `FRAME_MM` of path, with the noise of the simulation `steering` (0.1 mm, 10 mrad); robot and torsion are
perfect. Tip filter, rule for replanning, decisions and last step are those of `needleplan insert`; a table that was
asked for is there at the next decision, and its factor is rounded to 2 %, so that tables can be shared. All guidances
start at the best entry of the nominal plan with the same seed; the last columns have the success that the tables
predict there, and at the best entry of the plan that knew. Success: the tip ends within the radius of the target, in
the plane, and neither touches an obstacle nor leaves the workspace.
"""

import argparse
import json
import math
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from pathlib import Path

import machine
import numpy as np

from needleplan.control import Approach, Options, ScenarioGeometry, curvature_mismatch, rescaled
from needleplan.devices import PoseSample, StageSample, Stamp
from needleplan.errors import InputError
from needleplan.estimation import Registration, TipFilter, TipSettings
from needleplan.models import TipFrame
from needleplan.planning import Action, PolicyTable, Pose, plan, wilson
from needleplan.scenario import Scenario

SCENARIOS = ("four_obstacles", "layered", "phantom")
RATIOS = (0.7, 0.85, 1.0, 1.15, 1.3)
# Distance between two poses, and length of one arc with its own random curvature (mm).
FRAME_MM, ARC_MM = 2.0, 0.5
HEADING_SD, POSITION_SD_MM, ANGLE_SD = 0.002, 0.1, 0.01
SETTINGS = TipSettings(position_sd_mm=POSITION_SD_MM, angle_sd_rad=ANGLE_SD)
# Ratio to which the factors of tables are rounded.
ROUNDED = 1.02
# Longest path (mm), as in `needleplan insert`.
LONGEST_MM = 180.0


class Guide(StrEnum):
    """What the guidance knows of the curvature."""

    ADAPTS = "replanned"
    ONE = "one table"
    KNEW = "knew"


@dataclass
class Result:
    """The end of one insertion (mm), the number of replans, and what ended it."""

    error_mm: float
    replans: int
    outcome: str

    def success(self, radius_mm: float) -> bool:
        """Return whether the tip is in the target and nothing else ended the insertion."""
        return not self.outcome and self.error_mm <= radius_mm


@cache
def nominal(name: str) -> Scenario:
    return Scenario.read(name)


@cache
def table_of(name: str, power: int) -> PolicyTable:
    """Return the table of a scenario whose curvatures are multiplied by `ROUNDED` to a power."""
    return plan(rescaled(nominal(name), ROUNDED**power) if power else nominal(name))


def power_of(ratio: float) -> int:
    return round(math.log(ratio) / math.log(ROUNDED))


class Needle:
    """The true needle, and the tip filter that follows it."""

    def __init__(self, name: str, ratio: float, start: Pose, seed: int, told: float) -> None:
        self._scene, self._ratio = ScenarioGeometry(nominal(name)), ratio
        self._random = np.random.default_rng(seed)
        self.frame = TipFrame.planar(start.x_mm, start.y_mm, start.heading_rad)
        self.path_mm, self.bevel, self._now = 0.0, start.bevel, 0
        self.crossed = ""
        planned = ScenarioGeometry(rescaled(nominal(name), told) if told != 1 else nominal(name))
        self.filter = TipFilter(
            Registration(), tuple(start[:3]), lambda x, y, _z: 1 / planned.radius_mm(x, y), SETTINGS
        )  # fmt: skip
        self._stage()

    def insert(self, length_mm: float) -> None:
        """Insert; the filter gets a pose after every `FRAME_MM` and at the end."""
        end = self.path_mm + length_mm
        while self.path_mm < end - 1e-9:
            until = min(end, (math.floor(self.path_mm / FRAME_MM + 1e-6) + 1) * FRAME_MM)
            while self.path_mm < until - 1e-9:
                self._arc(min(ARC_MM, until - self.path_mm))
            self._stage()
            self._pose()

    def settle(self) -> None:
        """Observe the tip at rest, in as many frames as the loop waits for."""
        for _ in range(Options().settling_frames):
            self._stage()
            self._pose()

    def _arc(self, length_mm: float) -> None:
        x, y, _ = self.frame.position_mm
        n, b = (HEADING_SD / math.sqrt(length_mm) * self._random.standard_normal(2)).tolist()
        bend = self._ratio / self._scene.radius_mm(x, y)
        self.frame = self.frame.arc(self.bevel * bend + n, b, length_mm)
        self.path_mm += length_mm
        x, y, _ = self.frame.position_mm
        self.crossed = self.crossed or self._scene.touches(x, y) or "workspace" * self._scene.outside(x, y)

    def _stage(self) -> None:
        self._now += 10_000_000
        roll = 0.0 if self.bevel > 0 else math.pi
        self.filter.predict(StageSample(Stamp(self._now, self._now), self.path_mm, 0.0, roll, moving=True))

    def _pose(self) -> None:
        at = np.array(self.frame.position_mm) + POSITION_SD_MM * self._random.standard_normal(3)
        off = ANGLE_SD * self._random.standard_normal(2)
        axis = (
            np.array(self.frame.tangent) + off[0] * np.array(self.frame.normal) + off[1] * np.array(self.frame.binormal)
        )
        self._now += 1_000
        self.filter.update(PoseSample(Stamp(self._now, self._now), tuple(at.tolist()), turning_z_to(axis), math.nan))


def turning_z_to(axis: np.ndarray) -> tuple[float, float, float, float]:
    """Return the quaternion (w, x, y, z) that turns the axis of the coil, +z, to a direction."""
    x, y, z = axis / np.linalg.norm(axis)
    w = math.sqrt(max((1 + z) / 2, 1e-12))
    return w, float(-y / (2 * w)), float(x / (2 * w)), 0.0


def insertion(name: str, ratio: float, guide: Guide, seed: int) -> Result:
    """Carry out one insertion with the rules of the control loop."""
    knows = guide is Guide.KNEW
    options, power = Options(), power_of(ratio) if knows else 0
    table = table_of(name, power)
    start = table.start(tuple(table_of(name, 0).best_entry().pose[:3]))
    needle = Needle(name, ratio, start, seed, ratio if knows else 1.0)
    needle.settle()
    scene, replans = ScenarioGeometry(table.scenario), 0
    outcome = ""
    while not outcome and not needle.crossed:
        tip = needle.filter.tip
        pose = Pose(*scene.clamped(tip.x_mm, tip.y_mm), tip.heading_rad, needle.bevel)
        approach = Approach(scene, tip.curvature_per_mm)
        if approach.done(pose):
            break
        if scene.outside(pose.x_mm, pose.y_mm):
            outcome = "outside"
            break
        decision = None if approach.inside(pose) else table.lookup(*pose)
        if decision is not None and decision.success < options.least_success:
            beside = approach.beside(pose)
            if beside is None:
                outcome = "given up"
                break
            turned, length, last = beside[0], beside[1], True
        else:
            rotates = decision is not None and decision.action is Action.ROTATE
            turned = pose._replace(bevel=-pose.bevel) if rotates else pose
            length, last = approach.length_mm(turned, LONGEST_MM - needle.path_mm)
        if guide is Guide.ADAPTS:
            planned = 1 / scene.radius_mm(pose.x_mm, pose.y_mm)
            expected, sd = needle.filter.mean_curvature(scene.target_distance_mm(pose.x_mm, pose.y_mm))
            if planned and curvature_mismatch(expected, sd, planned, options):
                wanted = power_of(ROUNDED**power * expected / planned) if expected > 0 else power
                if wanted != power:
                    power, replans = wanted, replans + 1
        needle.bevel = turned.bevel
        needle.insert(length)
        if last:
            needle.settle()
        try:
            table = table_of(name, power)
        except InputError:
            continue
        scene = ScenarioGeometry(table.scenario)
        if needle.path_mm >= LONGEST_MM - 0.1:
            outcome = "too long"
    x, y, _ = needle.frame.position_mm
    return Result(scene.target_distance_mm(x, y), replans, needle.crossed or outcome)


def main() -> int:
    """Run all insertions and print a table; with --json, write the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--first-seed", type=int, default=5000, help="first seed (5000)")
    parser.add_argument("--scenarios", nargs="+", default=SCENARIOS)
    parser.add_argument("--ratios", nargs="+", type=float, default=RATIOS)
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    began, record = time.time(), []
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    print(
        f"{machine.description()['processor']}; {len(seeds)} insertions each, seeds from {seeds[0]} on. Success in %,"
    )
    print("with its 95 % interval for the difference of equal seeds; errors in mm, in the plane.\n")
    names = ["scenario", "true curvature", "knew", "replanned", "replanned - knew", "one table"]
    names += ["error, knew", "error, replanned", "replans", "table, same entry", "table, own entry"]
    print(f"| {' | '.join(names)} |\n|---|{'--:|' * (len(names) - 1)}")
    for name in options.scenarios:
        for ratio in options.ratios:
            found = {guide: [insertion(name, ratio, guide, seed) for seed in seeds] for guide in Guide}
            row = summary(name, ratio, found, nominal(name).target.radius_mm)
            record.append(row)
            print(line(row), flush=True)
            print(f"{name} {ratio}: {time.time() - began:.0f} s", file=sys.stderr)
            if options.json:
                options.json.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    return 0


def summary(name: str, ratio: float, found: dict[Guide, Sequence[Result]], radius_mm: float) -> dict[str, object]:
    """Return the statistics of one scenario and curvature."""
    good = {guide: np.array([each.success(radius_mm) for each in some], float) for guide, some in found.items()}
    gap = good[Guide.ADAPTS] - good[Guide.KNEW]
    return {
        "scenario": name, "ratio": ratio, "runs": len(gap),
        "success": {str(guide): float(each.mean()) for guide, each in good.items()},
        "interval": {str(guide): wilson(int(each.sum()), len(each)) for guide, each in good.items()},
        "gap": float(gap.mean()), "gap_reach": float(1.96 * gap.std(ddof=1) / math.sqrt(len(gap))),
        "error_mm": {str(guide): float(np.mean([each.error_mm for each in some])) for guide, some in found.items()},
        "replans": float(np.mean([each.replans for each in found[Guide.ADAPTS]])),
        "predicted": _predicted(name, ratio),
        "outcomes": {str(guide): sorted({each.outcome for each in some}) for guide, some in found.items()},
    }  # fmt: skip


def _predicted(name: str, ratio: float) -> tuple[float, float]:
    """Return the success that the plan that knew predicts at the entry of the nominal plan, and at its own best."""
    known = table_of(name, power_of(ratio))
    start = known.start(tuple(table_of(name, 0).best_entry().pose[:3]))
    return float(known.lookup(*start).success), float(known.best_entry().success)


def line(row: dict[str, object]) -> str:
    """Return a row of the table."""
    good, error = row["success"], row["error_mm"]
    assert isinstance(good, dict)
    assert isinstance(error, dict)
    shown = [f"{100 * good[each]:.1f}" for each in (Guide.KNEW, Guide.ADAPTS)]
    gap = f"{100 * float(str(row['gap'])):+.1f} +- {100 * float(str(row['gap_reach'])):.1f}"
    off = [f"{error[each]:.2f}" for each in (Guide.KNEW, Guide.ADAPTS)]
    predicted = row["predicted"]
    assert isinstance(predicted, tuple)
    cells = [str(row["scenario"]), f"{row['ratio']:g}", *shown, gap, f"{100 * good[Guide.ONE]:.1f}", *off]
    cells += [f"{row['replans']:.1f}", *(f"{100 * each:.1f}" for each in predicted)]
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    raise SystemExit(main())
