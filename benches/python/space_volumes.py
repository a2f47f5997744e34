"""Plans of random volumes on a coarse lattice, judged in the voxels of their files by a tracer that shares no code.

    python benches/python/space_volumes.py [--volumes 1000] [--seed 6000]

Stops at the first plan that is wrong: a closed way that is passed, an execution that counts and crosses an obstacle or
ends beside the target, an open way that is called impossible.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))

from tests.blind.obstacle_volumes import Kind
from tests.planning.judge import COARSE, judge_plan


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--volumes", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=6000)
    options = parser.parse_args()
    began, kinds = time.monotonic(), list(Kind)
    for number in range(options.volumes):
        with tempfile.TemporaryDirectory() as folder:
            judge_plan(options.seed + number // len(kinds), kinds[number % len(kinds)], Path(folder), COARSE, runs=25)
    print(f"{options.volumes} volumes: nothing wrong, {time.monotonic() - began:.0f} s")


if __name__ == "__main__":
    main()
