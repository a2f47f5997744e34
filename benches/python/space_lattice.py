"""Which lattice serves a user in 3D: success realised from the same starts with other steps, directions and cones.

PYTHONPATH=. python benches/python/space_lattice.py --seed 3 > benches/results/space_lattice.md

The starts of each phantom are drawn by space_starts.py, with the table of the first lattice; starts of a predicted
success below 2 % are left out. Each lattice then has a table of its own, and the same starts are executed in the
continuous model.
"""

import argparse
import re
import tempfile
from pathlib import Path
from time import process_time

import machine
import numpy as np
from space_starts import drawn

from needleplan.anatomy import PHANTOMS, Anatomy, SpaceScenario, write_phantom
from needleplan.planning import SpaceTable, plan_space

# Step (mm), spacing of the directions and half angle of the cone (degrees) of each lattice.
LATTICES = ((4.0, 5.0, 40.0), (4.0, 3.29, 40.0), (4.0, 5.0, 32.0), (8.0, 5.0, 40.0), (2.0, 5.0, 40.0))
# Least predicted success of a start.
LEAST = 0.02


def table_of(kind: str, seed: int, lattice: tuple[float, float, float]) -> tuple[SpaceTable, float]:
    """Return the table of a phantom with a lattice, and the processor time of planning (s)."""
    with tempfile.TemporaryDirectory() as folder:
        file = write_phantom(kind, folder, seed)
        text = file.read_text(encoding="utf-8")
        for key, value in zip(("step_mm", "directions_deg", "cone_deg"), lattice, strict=True):
            text = re.sub(rf"(?m)^{key} = [\d.]+", f"{key} = {value}", text)
        file.write_text(text, encoding="utf-8")
        scenario = SpaceScenario.of(Anatomy.read(file))
        begin = process_time()
        return plan_space(scenario), process_time() - begin


def starts_of(table: SpaceTable, count: int) -> list[tuple[float, ...]]:
    """Return random starts that are not hopeless."""
    random, found = np.random.default_rng(5), []
    while len(found) < count:
        pose = drawn(table, random)
        if table.lookup(pose).success > LEAST:
            found.append(pose)
    return found


def main() -> None:
    """Print a table with one line for each phantom and lattice."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=3, help="seed of the phantoms (3)")
    parser.add_argument("--starts", type=int, default=16, help="starts of each phantom (16)")
    parser.add_argument("--runs", type=int, default=2000, help="executions from each start (2,000)")
    given = parser.parse_args()
    about = machine.description()
    print(f"# The 3D lattice\n\n{about['processor']}, commit {about['commit']}, {about['date']}.")
    print(f"Command: `{Path(__file__).name} --seed {given.seed} --starts {given.starts} --runs {given.runs}`.\n")
    print(
        "| anatomy | step, mm | directions, degrees | cone, degrees | realised success "
        "| table's success less realised: mean, largest | processor time of planning, s |\n"
        "|---|--:|--:|--:|--:|--:|--:|"
    )
    for kind in PHANTOMS:
        starts: list[tuple[float, ...]] = []
        for lattice in LATTICES:
            table, seconds = table_of(kind, given.seed, lattice)
            starts = starts or starts_of(table, given.starts)
            predicted = 100 * np.array([table.lookup(pose).success for pose in starts])
            realised = 100 * np.array([
                table.rollout(pose, runs=given.runs, seed=number).success
                for number, pose in enumerate(starts)
            ])  # fmt: skip
            apart = predicted - realised
            cells = [kind, *(f"{each:g}" for each in lattice), f"{realised.mean():.1f} %",
                     f"{apart.mean():+.1f}, {apart[abs(apart).argmax()]:+.1f}", f"{seconds:.1f}"]  # fmt: skip
            print("| " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
