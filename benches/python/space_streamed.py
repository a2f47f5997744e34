"""Time, memory and disk of 3D tables with billions of states, which are solved, read and used from the disk.

    python benches/python/space_streamed.py --spacings 2 1 0.8 0.5

The results are in `benches/results/space_memory.md`.

The anatomy is a box of 120 x 80 x 80 mm with an entry region, a target and an obstacle; cone 45 degrees, directions 6
degrees apart, steps of 8 mm, eight roll angles and straight steps. For each spacing, one process solves it with
`plan_space(file=..., streamed=True)`, and another one reads the table with `SpaceTable.read(mapped=True)`, looks up the
best entry, ranks the entries, and executes 1,000 times. Where the memory allows it, a third one solves in memory, and
the digests are compared. `memory` is the largest anonymous resident memory of the process, sampled every 20 ms (Linux):
mapped parts of files, which the system can drop at any time, are not counted.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

from needleplan.anatomy import Anatomy, AnatomyFile, LabelVolume, SpaceScenario
from needleplan.planning import SpaceTable, entry_map, plan_space

NAMES = {"air": 0, "body": 1, "entry": 2, "target": 3, "vessel": 4}
TEXT = """\
schema = "needleplan.anatomy/1"
title = "A box (invented)"
[anatomy]
file = "box.nii.gz"
labels = "labels.ctbl"
target = "target"
entry = "entry"
obstacles = ["vessel"]
outside = ["air"]
[needle]
curvature_radius_mm = 60.0
diameter_mm = 0.0
[lattice]
spacing_mm = {spacing}
step_mm = 8.0
cone_deg = 45.0
directions_deg = 6.0
"""
# Largest number of states that are also solved in memory, for the comparison.
_IN_MEMORY = 400_000_000


def scenario(spacing: float) -> SpaceScenario:
    """Return the box on a lattice of this spacing (mm)."""
    labels = np.full((42, 42, 63), NAMES["body"], np.uint16)
    labels[[0, -1]], labels[:, [0, -1]] = NAMES["air"], NAMES["air"]
    labels[11:31, 11:31, 1:3] = NAMES["entry"]
    labels[19:23, 19:23, 56:59] = NAMES["target"]
    labels[16:21, 20:26, 25:32] = NAMES["vessel"]
    file = AnatomyFile.from_toml(TEXT.format(spacing=spacing))
    return SpaceScenario.of(Anatomy(file, LabelVolume(labels, np.diag([2.0, 2.0, 2.0, 1.0])), NAMES))


class Memory:
    """Samples the anonymous memory of this process (bytes) in a thread."""

    def __init__(self) -> None:
        self.most = 0
        threading.Thread(target=self._watch, daemon=True).start()

    def _watch(self) -> None:
        while True:
            lines = Path("/proc/self/status").read_text().splitlines()
            now = next(line.split()[1] for line in lines if line.startswith("RssAnon"))
            self.most = max(self.most, 1024 * int(now))
            time.sleep(0.02)


def solve(spacing: float, file: str, streamed: bool) -> dict[str, Any]:
    """Solve, and return what it took."""
    problem, memory, began = scenario(spacing), Memory(), time.monotonic()
    table = plan_space(problem, file=file if streamed else None, streamed=streamed)
    seconds = time.monotonic() - began
    found = {"states": table.stats.states, "shape": table.shape, "pass_s": table.stats.seconds, "whole_s": seconds}
    return found | {"memory": memory.most, "digest": table.digest}


def use(file: str) -> dict[str, Any]:
    """Read a table and use it, and return what it took."""
    memory, began = Memory(), time.monotonic()
    table = SpaceTable.read(file, mapped=True)
    read_s, began = time.monotonic() - began, time.monotonic()
    best = table.best_entry(exact=True)
    entries = entry_map(table)
    ranked = entries.best(5)
    rank_s, began = time.monotonic() - began, time.monotonic()
    realised = table.rollout(best, 1000, seed=1).success
    run_s = time.monotonic() - began
    return {"read_s": read_s, "rank_s": rank_s, "run_s": run_s, "memory": memory.most, "digest": table.digest,
            "entries": len(entries.poses), "ranked": len(ranked), "predicted": table.lookup(best).success,
            "realised": float(realised)}  # fmt: skip


def _child(*arguments: object) -> dict[str, Any]:
    command = [sys.executable, __file__, *map(str, arguments)]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def main() -> None:
    """Print the table of results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--spacings", type=float, nargs="+", default=[2.0, 1.0, 0.5])
    parser.add_argument("--folder", help="where the tables are written; default: the folder for temporary files")
    parser.add_argument("--part", nargs=3, metavar=("PART", "SPACING", "FILE"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.part:
        part, spacing, file = options.part
        print(json.dumps(use(file) if part == "use" else solve(float(spacing), file, part == "stream")))
        return
    print("| spacing | states | pass | million states a second | with checksums | memory | file | read and verify "
          "| rank all entries | 1,000 executions | memory | solve in memory | memory |")  # fmt: skip
    print("|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|")
    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        file = Path(folder) / "table.h5"
        for spacing in options.spacings:
            made = _child("--part", "stream", spacing, file)
            used = _child("--part", "use", spacing, file)
            assert used["digest"] == made["digest"]
            held, states = None, made["states"]
            if states <= _IN_MEMORY:
                held = _child("--part", "hold", spacing, file)
                assert held["digest"] == made["digest"]
            columns = [
                f"{spacing:g} mm", f"{states:,}", f"{made['pass_s']:.1f} s", f"{states / made['pass_s'] / 1e6:.1f}",
                f"{made['whole_s']:.1f} s", f"{made['memory'] / 1e6:.0f} MB", f"{file.stat().st_size / 1e9:.2f} GB",
                f"{used['read_s']:.1f} s", f"{used['entries']:,}: {used['rank_s']:.1f} s", f"{used['run_s']:.1f} s",
                f"{used['memory'] / 1e6:.0f} MB", f"{held['whole_s']:.1f} s" if held else "",
                f"{held['memory'] / 1e6:.0f} MB" if held else "",
            ]  # fmt: skip
            print("| " + " | ".join(columns) + " |", flush=True)
            file.unlink()


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    main()
