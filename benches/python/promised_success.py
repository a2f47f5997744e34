"""The success that is left under entry scatter, registration error and an interval of the curvature.

    python benches/python/promised_success.py > benches/results/promised_success.md

The best entries of shipped scenarios, and of a phantom of an anatomy in 3D, by executions.
"""

import tempfile
import time

import needleplan as npl
from needleplan.anatomy import write_phantom
from needleplan.planning import Uncertainty

SCENARIOS = ("four_obstacles", "layered", "prostate", "brain", "phantom")
ANATOMIES = ("prostate",)  # invented, seed 1
UNCERTAINTY = Uncertainty(entry_sd_mm=1.0, heading_sd_deg=2.0, tre_mm=1.5, curvature_ratio=(0.9, 1.1))
HEAD = ("exact", "entry", "registration", "curvature", "together")


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


def main() -> None:
    given, (low, high) = UNCERTAINTY, UNCERTAINTY.curvature_ratio
    print("# Success under what is not known exactly\n")
    print(
        f"Entry point {given.entry_sd_mm:g} mm and direction {given.heading_sd_deg:g} degrees (standard deviations), "
        f"TRE {given.tre_mm:g} mm, curvature {low:g} to {high:g} of that of the "
        "plan (95 %). From the best entry, in percent with 95 % intervals, by 2,000 executions each.\n"
    )
    print(f"| scenario | target (mm) | {' | '.join(HEAD)} | s |")
    print("|---|--:|--:|--:|--:|--:|--:|--:|")
    for name in SCENARIOS:
        print(row(f"`{name}`", npl.plan(name)), flush=True)
    for kind in ANATOMIES:
        with tempfile.TemporaryDirectory() as folder:
            print(row(f"{kind} phantom, seed 1, 3D", npl.plan(write_phantom(kind, folder, seed=1))), flush=True)


if __name__ == "__main__":
    main()
