"""Seeded 3D insertions in the lab twin, beside the prediction of the table and the rollout.

python benches/python/space_insertions.py > benches/results/space_insertions.md
python benches/python/space_insertions.py --seeds 1      # short test run

The anatomies are those of `needleplan new --anatomy KIND --seed 5`, with the shipped settings; the needle begins at the
entry of the highest success without an error of it. In all labs, an insertion has the same tip noise; every anatomy has
its own.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import machine
import numpy as np

from needleplan.anatomy import FREE, PHANTOMS, TARGET, Anatomy, SpaceScenario, write_phantom
from needleplan.control import Insertion, Listener, Options
from needleplan.devices import ForceSample, PoseSample, Sample, StageSample
from needleplan.estimation.tip import TipEstimate, TipSettings
from needleplan.identification.space_curvature import SpaceInsertion, space_curvature
from needleplan.models.tissue import NeedlePush, TargetPush
from needleplan.planning import SpaceTable, plan_space, wilson
from needleplan.simulation import Effects, Robot, SimulatedStation, Simulation, simulated_station

ROLLOUTS = 10_000
# Shear modulus (N/mm^2) of soft tissue: the tip moves a target on its axis by 5 mm.
SOFT_N_MM2 = 0.005


@dataclass(frozen=True)
class LabKind:
    """A lab: name, effects, and from how many earlier insertions the plan takes its curvature (0: as shipped).

    With a shear modulus, the needle pushes the target; `goes_on`: the insertion has the option `--push`.
    """

    name: str
    effects: Effects
    learns_from: int = 0
    modulus_n_mm2: float | None = None
    goes_on: bool = False


class TruePath(Listener):
    """What the true tip has met, at every frame of the tracker, and the samples of the run."""

    def __init__(self, table: SpaceTable, station: SimulatedStation) -> None:
        self.scenario, self.station, self.free = table.scenario, station, True
        self.samples: list[StageSample | PoseSample] = []

    def sample(self, sample: Sample) -> None:
        """Keep a sample of stage or tracker."""
        if not isinstance(sample, ForceSample):
            self.samples.append(sample)

    def tip(self, time_ns: int, path_mm: float, tip: TipEstimate) -> None:  # noqa: ARG002
        """Note whether the true tip is neither in an obstacle nor outside."""
        if path_mm > 0:
            self.free &= int(self.scenario.codes(np.array(self.station.true_tip_mm))) in (FREE, TARGET)


@dataclass(frozen=True)
class TrueEnd:
    """How an insertion ended in truth."""

    success: bool
    error_mm: float
    rotations: int
    replans: int
    slowest_s: float
    run: SpaceInsertion


def run(table: SpaceTable, kind: LabKind, seed: int) -> TrueEnd:
    """Insert once."""
    simulation = Simulation.read("steering")
    tissue = replace(simulation.setup.tissue, shear_modulus_n_mm2=kind.modulus_n_mm2)
    robot = Robot(servo_hz=400, bandwidth_hz=10.0)
    setup = replace(simulation.setup, effects=kind.effects, robot=robot, tissue=tissue)
    station = simulated_station(replace(simulation, setup=setup), table, table.best_entry(exact=True), seed)
    path = TruePath(table, station)
    settings = TipSettings(heading_sd_rad_sqrt_mm=table.scenario.noise_rad_sqrt_mm)
    push = None
    if kind.modulus_n_mm2 and kind.goes_on:
        push = TargetPush(NeedlePush(kind.modulus_n_mm2, setup.shaft.radius_mm), tissue.cutting_n)
    options = Options(velocity_mm_s=10.0, torsion=station.torsion, push=push)
    with Insertion(table, station, options, registration=station.registration, tip_settings=settings,
                   listeners=[path]) as insertion:  # fmt: skip
        report = insertion.run()
    center = np.array(table.scenario.target_mm)
    apart = np.array(station.true_tip_mm) - station.true_target_mm(table.scenario.target_mm)
    return TrueEnd(
        bool(table.scenario.codes(center + apart) == TARGET) and path.free,
        float(np.linalg.norm(apart)),
        report.turns,
        report.replans,
        max((float(e.text.split(" in ")[1].split()[0]) for e in report.events if e.name == "table_swapped"), default=0),
        SpaceInsertion(f"{seed}", path.samples, station.registration, settings),
    )


def learned(table: SpaceTable, kind: LabKind, seeds: range) -> tuple[SpaceTable, LabKind, float]:
    """Return the plan with the curvature of earlier insertions, the same lab relative to it, and the ratio."""
    found = space_curvature(table.scenario, [run(table, kind, seed).run for seed in seeds])
    error = (1 + kind.effects.curvature_error) / found.ratio - 1
    again = replace(kind, effects=replace(kind.effects, curvature_error=error))
    return plan_space(table.scenario.rescaled(found.ratio)), again, found.ratio


def kinds() -> list[LabKind]:
    """Return the labs: with tip noise only, with all effects, and with another curvature."""
    shipped = Simulation.read("steering").setup.effects
    noise = Effects(heading_noise_rad_sqrt_mm=shipped.heading_noise_rad_sqrt_mm)
    off = replace(shipped, curvature_error=-0.3, curvature_scatter=0.0)
    return [
        LabKind("tip noise only", noise),
        LabKind("all effects", shipped),
        LabKind("curvature 0.7", off),
        LabKind("curvature 0.7, planned again after 4", off, learns_from=4),
        LabKind("soft tissue, which gives way", noise, modulus_n_mm2=SOFT_N_MM2),
        LabKind("soft tissue, `insert --push`", noise, modulus_n_mm2=SOFT_N_MM2, goes_on=True),
    ]


def main() -> int:
    """Run all insertions and print the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=15, help="insertions for each anatomy and lab (15)")
    parser.add_argument("--anatomy-seed", type=int, default=5, help="seed of the phantoms (5)")
    parser.add_argument("--labs", nargs="+", metavar="WORD", help="run only labs with one of these words")
    options = parser.parse_args()
    began, of = time.time(), machine.description()
    rows, means = [], []
    with tempfile.TemporaryDirectory() as folder:
        tables = {}
        for kind in PHANTOMS:
            write_phantom(kind, Path(folder) / kind, options.anatomy_seed)
            tables[kind] = plan_space(SpaceScenario.of(Anatomy.read(Path(folder) / kind / "anatomy.toml")))
    shipped = {kind: promises(table) for kind, table in tables.items()}
    for lab in kinds():
        if options.labs and not any(word in lab.name for word in options.labs):
            continue
        every, told = [], []
        for number, (kind, table) in enumerate(tables.items()):
            plan, same, of_plan = table, lab, shipped[kind]
            if lab.learns_from:
                earlier = range(1000 * number + 500, 1000 * number + 500 + lab.learns_from)
                plan, same, ratio = learned(table, lab, earlier)
                of_plan = promises(plan)
                print(f"{kind}: {ratio:.3f} times the planned curvature", file=sys.stderr)
            found = [run(plan, same, 1000 * number + seed) for seed in range(options.seeds)]
            every += found
            told.append(of_plan)
            rows.append(row(lab.name, kind, of_plan, found))
            print(rows[-1], file=sys.stderr)
        means.append(row(lab.name, "all", np.mean(told, axis=0), every))
    print("# 3D insertions in the lab twin\n")
    print(f"{of['processor']}, commit {of['commit']}, {of['date']}; {time.time() - began:.0f} s.")
    print(f"Phantoms with the seed {options.anatomy_seed}, shipped settings, entry of the highest success without an")
    print("error of it; servo at 400 Hz, 10 mm/s.")
    print("Predicted: by the table. Rollout: executions in the continuous model.")
    print("Success: the true tip ends in the target, and its path meets no obstacle. Error: distance of the true tip")
    print("from the centroid of the target. Longest solve: of a plan during the insertion.\n")
    print("| lab | anatomy | predicted | rollout | insertions | success | 95 % interval | median error ", end="")
    print("| rotations | replans | longest solve |")
    print("|---|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|")
    print("\n".join(means + rows))
    return 0


def promises(table: SpaceTable) -> tuple[float, float]:
    """Return predicted success and that of the rollout, at the entry."""
    start = table.best_entry(exact=True)
    return table.lookup(start).success, table.rollout(start, ROLLOUTS).success


def row(lab: str, kind: str, told: Sequence[float], found: list[TrueEnd]) -> str:
    """Return a row of the table; `told` holds predicted success and that of the rollout."""
    hits = sum(each.success for each in found)
    low, high = wilson(hits, len(found))
    return (
        f"| {lab} | {kind} | {told[0]:.1%} | {told[1]:.1%} | {len(found)} | {hits / len(found):.0%} | "
        f"{low:.0%} to {high:.0%} | "
        f"{np.median([each.error_mm for each in found]):.1f} mm | {np.mean([each.rotations for each in found]):.1f} | "
        f"{np.mean([each.replans for each in found]):.1f} | {max(each.slowest_s for each in found):.1f} s |"
    )


if __name__ == "__main__":
    sys.exit(main())
