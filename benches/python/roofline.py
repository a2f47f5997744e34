"""Compare the backups of the lattice with what the machine can do: bytes and operations a backup, copy and fma rates.

python benches/python/roofline.py > benches/results/roofline.md

A backup in single precision makes the operations of `rust/ppvi/src/lattice/kernel.rs`: the five taps of the noise (3
products, 4 sums), the bilinear mean (4 products, 3 sums; not with nearest transitions), the cost of the step (a
product, a sum), and the better of two actions (a sum, a comparison). It writes 4 bytes of W and reads them, and reads
a byte of events; W stays in the cache. All rates are of one thread and of processor time, measured in one process:
copies of 128 kB (second cache) and of 64 MB (memory), and products of 1024 x 1024 matrices in single precision. Set
OPENBLAS_NUM_THREADS=1.
"""

from collections.abc import Callable
from dataclasses import replace
from time import process_time

import machine
import numpy as np

import needleplan as npl
from needleplan.planning import lattice_of

# Repetitions, of which the fastest counts.
REPETITIONS = 7
NOISE, MEAN, COST, CHOICE = 7, 7, 2, 2  # operations a backup
W_BYTES, EVENT_BYTES = 8, 1  # bytes a backup: W written and read, the event


def main() -> None:
    """Measure the machine and the solves, and print the page."""
    about = machine.description()
    cache, memory, products = copy_rate(128 << 10), copy_rate(64 << 20), product_rate()
    print(f"{about['processor']}, load {about['load_before']}, {str(about['date'])[:10]}, commit {about['commit']}.\n")
    print("| the machine, one thread | rate |\n|---|--:|")
    print(f"| copy of 128 kB, read and written | {cache / 1e9:.1f} GB/s |")
    print(f"| copy of 64 MB, read and written | {memory / 1e9:.1f} GB/s |")
    print(f"| product of matrices | {products / 1e9:.1f} Gflop/s |\n")
    print("| solve | 1e6 backups / s | flop | Gflop/s | share | bytes | GB/s | share of the cache's copies |")
    print("|---|--:|--:|--:|--:|--:|--:|--:|")
    for transition in ("nearest", "interpolated"):
        rate = backup_rate(transition)
        flops = NOISE + COST + CHOICE + (MEAN if transition == "interpolated" else 0)
        moved = W_BYTES + EVENT_BYTES
        print(
            f"| {transition} | {rate / 1e6:.0f} | {flops} | {rate * flops / 1e9:.1f} | {rate * flops / products:.0%} "
            f"| {moved} | {rate * moved / 1e9:.1f} | {rate * moved / cache:.0%} |"
        )


def backup_rate(transition: str) -> float:
    """Return the backups a second of processor time of the thesis' problem, solved with one thread."""
    scenario = npl.Scenario.read("four_obstacles_thesis")
    grid = replace(scenario.grid, transition=transition, success_refinement=1)
    lattice = lattice_of(replace(scenario, grid=grid))
    backups = 0.0

    def solve() -> None:
        nonlocal backups
        solved = lattice.solve(
            method="sweep", partitions=(1, 1), priority="H2", tolerance=scenario.solver.tolerance, threads=1
        )
        backups = solved["backups"]

    seconds = fastest(solve)
    return backups / seconds


def copy_rate(size: int) -> float:
    """Return the bytes a second that copies of an array of this many bytes read and write."""
    source = np.ones(size, np.uint8)
    target = np.empty_like(source)
    times = max(1, (64 << 20) // size)

    def copy() -> None:
        for _ in range(times):
            np.copyto(target, source)

    return 2.0 * size * times / fastest(copy)


def product_rate() -> float:
    """Return the operations a second of a matrix product in single precision."""
    n = 1024
    matrix = np.ones((n, n), np.float32)
    return 2.0 * n**3 / fastest(lambda: matrix @ matrix)


def fastest(run: Callable[[], object]) -> float:
    """Return the least processor time of some runs, in seconds."""
    times = []
    for _ in range(REPETITIONS):
        begin = process_time()
        run()
        times.append(process_time() - begin)
    return min(times)


if __name__ == "__main__":
    main()
