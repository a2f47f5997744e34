"""The planner in the best plane through an anatomy beside the 3D planner: success, length, time.

python benches/python/best_plane.py > benches/results/best_plane.md
python benches/python/best_plane.py --seeds 1      # short test run

The anatomy is that of `needleplan new --anatomy liver --seed 5`. Both plans are carried out in the lab twin with the
same tip noise in 3D and perfect sensors; the loop of the plane brings the tip back to the plane. An insertion
succeeds if the true tip ends in the target, and its path is free in the voxels of the lattice.
"""

import argparse
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import machine
import numpy as np

from needleplan.anatomy import FREE, TARGET, Anatomy, SpaceScenario, write_phantom
from needleplan.control import Insertion, Listener, Options
from needleplan.control.safety import SafetyLimits
from needleplan.estimation.tip import TipEstimate, TipSettings
from needleplan.planning import AnatomyPlane, SpaceTable, best_plane, plan_space, wilson
from needleplan.signals import Array
from needleplan.simulation import Effects, Robot, SimulatedStation, Simulation, simulated_station

KIND, ANATOMY_SEED = "liver", 5
WIDE = SafetyLimits(out_of_plane_mm=100.0)


class TruePlace(Listener):
    """The true tip in the lattice, and whether its path was free."""

    def __init__(self, scenario: SpaceScenario, station: SimulatedStation, origin_mm: Array, axes: Array) -> None:
        self.scenario, self.station, self.free = scenario, station, True
        self.origin_mm, self.axes = origin_mm, axes

    @property
    def place_mm(self) -> Array:
        """True tip in the lattice."""
        return np.asarray(self.origin_mm + np.array(self.station.true_tip_mm) @ self.axes)

    def tip(self, time_ns: int, path_mm: float, tip: TipEstimate) -> None:  # noqa: ARG002
        """Note whether the true tip is free or in the target."""
        if path_mm > 0:
            self.free &= int(self.scenario.codes(self.place_mm)) in (FREE, TARGET)


def run(table: SpaceTable, plane: AnatomyPlane | None, seed: int) -> tuple[bool, float, int]:
    """Insert once; return whether the insertion succeeds, its length (mm) and the number of its rotations."""
    scenario = table.scenario
    simulation, noise = Simulation.read("steering"), scenario.noise_rad_sqrt_mm
    setup = replace(simulation.setup, effects=Effects(heading_noise_rad_sqrt_mm=noise), robot=Robot(servo_hz=400))
    lab = replace(simulation, setup=setup)
    if plane is None:
        station = simulated_station(lab, table, table.best_entry(exact=True), seed)
        origin, axes = np.zeros(3), np.eye(3)
    else:
        station = simulated_station(lab, plane.table, plane.entry, seed)
        origin, axes = plane.origin_mm, np.stack([*plane.axes, np.cross(*plane.axes)])
    path = TruePlace(scenario, station, origin, axes)
    with Insertion(
        plane.table if plane else table, station, Options(velocity_mm_s=10.0), registration=station.registration,
        tip_settings=TipSettings(heading_sd_rad_sqrt_mm=noise), limits=WIDE, accepted_limits="a bench",
        listeners=[path],
    ) as insertion:  # fmt: skip
        report = insertion.run()
    return bool(scenario.codes(path.place_mm) == TARGET) and path.free, report.inserted_mm, report.turns


def main() -> int:
    """Run all insertions and print the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=30, help="insertions by each plan (30)")
    options = parser.parse_args()
    of = machine.description()
    with tempfile.TemporaryDirectory() as folder:
        write_phantom(KIND, Path(folder) / KIND, ANATOMY_SEED)
        scenario = SpaceScenario.of(Anatomy.read(Path(folder) / KIND / "anatomy.toml"))
    began = time.perf_counter()
    table = plan_space(scenario)
    in_space_s = time.perf_counter() - began
    began = time.perf_counter()
    plane = best_plane(scenario)
    planes_s = time.perf_counter() - began
    print("# The best plane beside space\n")
    print(f"{of['processor']}, commit {of['commit']}, {of['date']}, load {of['load_before']}. Phantom {KIND}, seed")
    print(f"{ANATOMY_SEED}; {options.seeds} insertions by each plan in the lab twin, with tip noise in 3D and perfect")
    print("sensors. The time of the plane is that of 12 planes about the axis.\n")
    print("| plan | predicted | success in 3D | 95 % interval | mean length | rotations | time |")
    print("|---|--:|--:|--:|--:|--:|--:|")
    promise = table.lookup(table.best_entry(exact=True)).success
    for name, told, used, seconds in (
        ("space", promise, None, in_space_s),
        (f"best plane, {np.degrees(plane.angle_rad):.0f} degrees about the axis", plane.success, plane, planes_s),
    ):
        found = [run(table, used, seed) for seed in range(options.seeds)]
        hits = sum(success for success, _, _ in found)
        low, high = wilson(hits, len(found))
        lengths, turns = (np.mean([each[column] for each in found]) for column in (1, 2))
        print(f"| {name} | {told:.1%} | {hits / len(found):.0%} | {low:.0%} to {high:.0%} | {lengths:.0f} mm ", end="")
        print(f"| {turns:.1f} | {seconds:.1f} s |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
