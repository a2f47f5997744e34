"""Measure the error at the target by the true tip: with curvature sensors, images, and a target that the needle pushes.

python benches/python/targeting.py --json benches/results/targeting.json > benches/results/targeting.md
python benches/python/targeting.py --seeds 1          # short test run

Closed-loop insertions of `four_obstacles` (R = 40 mm, target of 2 mm), and with a stiff needle of `phantom` (647 mm,
0.3 mm), in the lab twin `steering` with the tip noise of the steering study; a seed gives the same needle and the same
noise of the tracker in all rows of a table. Curvature sensors: 10, 30, 65 and 100 mm behind the tip, 2e-4 1/mm of white
noise, constant errors of 1e-4 1/mm. Images in the plane of the plan: 1 mm of white noise along each axis, 30 % missed,
5 % outliers, 0.15 s late. Pushing: the tissue has a shear modulus of 20 kPa and gives way to the tip, which pushes with
0.3 N. Unexpected layer: from 70 mm on the needle bends 30 % less than planned. An error is that to the moved target,
and a success is a tip within the given radius of it.
"""

import argparse
import json
import math
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import machine
import numpy as np
from scipy import stats

from needleplan.models.deflection import FibreSensors
from needleplan.models.path import ImagePlane
from needleplan.models.tissue import NeedlePush, TargetPush
from needleplan.planning import wilson
from needleplan.scenario import Scenario
from needleplan.simulation import SimulatedLayer
from needleplan_thesis.steering import (
    Guidance,
    SteeringCase,
    SteeringTask,
    SteeringTrial,
    run_trial,
    steering_simulation,
)

SENSORS, PLANE = FibreSensors((10.0, 30.0, 65.0, 100.0)), ImagePlane()
ERRORS = {
    "fibre_noise_per_mm": 2e-4, "fibre_bias_per_mm": 1e-4, "ultrasound_noise_mm": 1.0, "ultrasound_missed": 0.3,
    "ultrasound_outliers": 0.05, "ultrasound_delay_s": 0.15,
}  # fmt: skip
MODULUS_N_MM2 = 0.02
# Depth (mm) from which the layer reaches, and its curvature (1/mm): the needle bends 30 % less than planned.
LAYER_MM, LAYER_PER_MM = 70.0, 0.7 / 40.0
NEAR, FAR = "coil 3 mm behind the tip", "coil 30 mm behind the tip"
LAYER = "coil 30 mm behind the tip, unexpected layer"
PUSHED = "target that the needle pushes"
STIFF = "stiff needle, coil 30 mm behind the tip"


@dataclass(frozen=True)
class Kind:
    """A row of a table: title of the table, name, and what differs from the lab twin `steering` and its plan."""

    table: str
    name: str
    coil_mm: float = 3.0
    fibre: bool = False
    images: bool = False
    modulus_n_mm2: float | None = None
    margin: bool = False
    goes_on: bool = False
    layer: bool = False
    scenario: str = "four_obstacles"

    def case(self) -> SteeringCase:
        """Return scenario and lab of the insertions."""
        found, scenario = steering_simulation(), Scenario.read(self.scenario)
        effects = replace(found.setup.effects, coil_offset_mm=self.coil_mm, **ERRORS)
        setup = replace(
            found.setup, effects=effects, fibre=SENSORS if self.fibre else None,
            ultrasound=PLANE if self.images else None,
            tissue=replace(found.setup.tissue, shear_modulus_n_mm2=self.modulus_n_mm2),
            layers=(SimulatedLayer(LAYER_MM, curvature_per_mm=LAYER_PER_MM),) if self.layer else (),
        )  # fmt: skip
        push, target = NeedlePush(MODULUS_N_MM2, setup.shaft.radius_mm), scenario.target
        force = setup.tissue.cutting_n
        if self.margin:
            less = target.radius_mm - push.at_tip_mm(force)
            scenario = replace(scenario, target=replace(target, radius_mm=less))
        goes_on = TargetPush(push, force) if self.goes_on else None
        return SteeringCase(self.name, scenario, replace(found, setup=setup), push=goes_on)


KINDS = (
    *(
        Kind(table, name, coil, fibre, images, scenario=scenario, layer=table == LAYER)
        for table, coil, scenario in (
            (NEAR, 3.0, "four_obstacles"), (FAR, 30.0, "four_obstacles"),
            (LAYER, 30.0, "four_obstacles"), (STIFF, 30.0, "phantom"),
        )
        for name, fibre, images in (
            ("tracker", False, False), ("and curvature sensors", True, False), ("and images", False, True),
            ("and both", True, True),
        )
    ),
    Kind(PUSHED, "without `--push`", modulus_n_mm2=MODULUS_N_MM2),
    Kind(PUSHED, "`plan --push`", modulus_n_mm2=MODULUS_N_MM2, margin=True),
    Kind(PUSHED, "`insert --push`", modulus_n_mm2=MODULUS_N_MM2, goes_on=True),
)  # fmt: skip


def row(kind: Kind, trials: list[SteeringTrial]) -> dict[str, Any]:
    """Return the statistics of the insertions of one kind; distances (mm) are those of the true tip in 3D."""
    distances = np.array([trial.in_space_mm for trial in trials])
    radius = Scenario.read(kind.scenario).target.radius_mm
    failed = [t for t in trials if t.touched or t.left or t.in_space_mm > radius]
    mean = stats.bootstrap((distances,), np.mean, method="percentile", rng=1) if len(trials) > 1 else None
    interval = mean.confidence_interval if mean else (distances[0], distances[0])
    ends = Counter("an obstacle" if trial.touched else f"ended as {trial.outcome}" for trial in failed)
    return {
        "kind": asdict(kind), "runs": len(trials), "predicted": trials[0].predicted,
        "error_mm": float(distances.mean()), "interval_mm": [float(each) for each in interval],
        "median_mm": float(np.median(distances)), "successes": len(trials) - len(failed),
        "success_interval": wilson(len(trials) - len(failed), len(trials)), "failures": dict(ends),
        "errors_mm": [round(each, 4) for each in distances.tolist()],
    }  # fmt: skip


def lines(rows: list[dict[str, Any]]) -> Iterator[str]:
    """Yield the lines of the tables."""
    table, first = "", rows[0]
    for each in rows:
        if each["kind"]["table"] != table:
            table = each["kind"]["table"]
            yield from ("", f"## {table.capitalize()}", "")
            first = each
            yield (
                "| | mean error (95 % interval) | less the first row, at equal seeds | median | predicted | "
                "successes (95 % interval) | failures |"
            )
            yield "|---|--:|--:|--:|--:|--:|---|"
        low, high = each["interval_mm"]
        least, most = each["success_interval"]
        failures = ", ".join(f"{count} {end}" for end, count in each["failures"].items())
        yield (
            f"| {each['kind']['name']} | {each['error_mm']:.2f} mm ({low:.2f} to {high:.2f}) | "
            f"{_difference(each, first)} | {each['median_mm']:.2f} mm | {each['predicted']:.2f} | "
            f"{each['successes']} of {each['runs']} ({least:.2f} to {most:.2f}) | {failures} |"
        )


def _difference(one: dict[str, Any], first: dict[str, Any]) -> str:
    """Return the mean difference (mm) of the errors at equal seeds with half of its 95 % interval (Student's t)."""
    apart = np.array(one["errors_mm"]) - np.array(first["errors_mm"])
    if one is first or len(apart) < 2:
        return ""
    half = stats.t.ppf(0.975, len(apart) - 1) * apart.std(ddof=1) / math.sqrt(len(apart))
    return f"{apart.mean():+.2f} +- {half:.2f} mm"


def main() -> int:
    """Run the insertions and print the tables; with --json, write the results after every seed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=30, help="insertions of each kind (30)")
    parser.add_argument("--tables", nargs="+", default=(NEAR, FAR, LAYER, STIFF, PUSHED), help="run only these")
    parser.add_argument("--names", nargs="+", help="run only the rows of these names; keep others of the file")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    about, known = machine.description(), []
    chosen = [k for k in KINDS if k.table in options.tables and (not options.names or k.name in options.names)]
    if options.json and options.json.exists() and len(chosen) < len(KINDS):
        known = json.loads(options.json.read_text(encoding="utf-8"))["rows"]
    rows = known = [each for each in known if each["kind"] not in map(asdict, chosen)]
    trials: dict[Kind, list[SteeringTrial]] = {kind: [] for kind in chosen}
    for seed in range(options.seeds):
        for kind, done in trials.items():
            done.append(run_trial(SteeringTask(kind.case(), Guidance.REPLANNED, seed)))
            print(f"{seed}: {kind.table}, {kind.name}: {done[-1].in_space_mm:.2f} mm", file=sys.stderr, flush=True)
        rows = [*known, *(row(kind, done) for kind, done in trials.items())]
        if options.json:
            options.json.write_text(json.dumps({"machine": about, "rows": rows}, indent=1) + "\n", encoding="utf-8")
    order = [(kind.table, kind.name) for kind in KINDS]
    print("Error at the target by the true tip, in 3D: insertions in the lab twin with equal seeds in each table.")
    print(f"{about['processor']}, {about['date'][:10]}, commit {about['commit']}, Python {about['python']}.")
    rows.sort(key=lambda each: order.index((each["kind"]["table"], each["kind"]["name"])))
    print("\n".join(lines(rows)))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
