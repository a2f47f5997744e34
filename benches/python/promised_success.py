"""The success under entry scatter, registration error, an interval of the curvature and a coil behind the tip.

    python benches/python/promised_success.py > benches/results/promised_success.md

The best entries of shipped scenarios, and of a phantom of an anatomy in 3D, by executions. The success with a coil
behind the tip is judged by insertions in the lab twin `steering`, which has the tip noise of the plan.
"""

import tempfile
import time

import needleplan as npl
from needleplan.anatomy import write_phantom
from needleplan.planning import Uncertainty, wilson
from needleplan.simulation import Simulation
from needleplan_thesis.steering import Guidance, SteeringCase, SteeringTask, run_trial

SCENARIOS = ("four_obstacles", "layered", "prostate", "brain", "phantom")
ANATOMIES = ("prostate",)  # invented, seed 1
UNCERTAINTY = Uncertainty(entry_sd_mm=1.0, heading_sd_deg=2.0, tre_mm=1.5, curvature_ratio=(0.9, 1.1), coil_mm=3.0)
HEAD = ("exact", "entry", "registration", "curvature", "tip", "together")
LABS = ("four_obstacles", "layered", "prostate", "brain", "phantom")
SEEDS = 40


def row(name: str, table: npl.Table) -> str:
    """Return a row of the table."""
    entry, began = table.best_entry(), time.monotonic()
    parts = table.success_under(UNCERTAINTY, entry).parts()
    seconds = time.monotonic() - began
    cells = []
    for part in (parts[each] for each in HEAD):
        low, high = (100 * end for end in part.interval or (0.0, 1.0))
        cells.append(f"{100 * part.value:.1f} ({low:.1f} to {high:.1f})")
    radius = table.scenario.target_radius_mm
    return f"| {name} | {radius:.3g} | {' | '.join(cells)} | {seconds:.1f} |"


def lab_row(name: str) -> str:
    """Return a row of promise and insertions."""
    table = npl.plan(name)
    case = SteeringCase(name, table.scenario, Simulation.read("steering"), planned_noise=True)
    trials = [run_trial(SteeringTask(case, Guidance.REPLANNED, 200 + seed)) for seed in range(SEEDS)]
    reached = sum(trial.success for trial in trials)
    low, high = wilson(reached, SEEDS)
    promise = table.success_under(Uncertainty(coil_mm=UNCERTAINTY.coil_mm), case.pose).together
    return f"| `{name}` | {100 * promise.value:.1f} | {reached} of {SEEDS} | {100 * low:.0f} to {100 * high:.0f} |"


def main() -> None:
    given, (low, high) = UNCERTAINTY, UNCERTAINTY.curvature_ratio
    print("# Success under what is not known exactly\n")
    print(
        f"Entry point {given.entry_sd_mm:g} mm and direction {given.heading_sd_deg:g} degrees (standard deviations), "
        f"TRE {given.tre_mm:g} mm, curvature {low:g} to {high:g} of that of the "
        f"plan (95 %), coil {given.coil_mm:g} mm behind the tip. "
        "From the best entry, in percent with 95 % intervals, by 2,000 executions each.\n"
    )
    print(f"| scenario | target (mm) | {' | '.join(HEAD)} | s |")
    print("|---|--:|--:|--:|--:|--:|--:|--:|--:|")
    for name in SCENARIOS:
        print(row(f"`{name}`", npl.plan(name)), flush=True)
    for kind in ANATOMIES:
        with tempfile.TemporaryDirectory() as folder:
            print(row(f"{kind} phantom, seed 1, 3D", npl.plan(write_phantom(kind, folder, seed=1))), flush=True)
    print("\n## Judged by insertions\n")
    print("Lab twin `steering` with the tip noise of the plan; true success, 95 % intervals.\n")
    print("| scenario | promise, coil alone (%) | insertions in the target | % |\n|---|--:|--:|--:|")
    for name in LABS:
        print(lab_row(name), flush=True)


if __name__ == "__main__":
    main()
