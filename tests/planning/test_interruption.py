"""Ctrl-C and limits during long work of every kind; the work neither takes the GIL nor waits for it."""

import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import needleplan as npl
from needleplan import _ppvi
from needleplan.scenario import Method, Scenario

# Longest processor time (s) from a signal to its exception: 0.05 s on an idle machine; the work would take 5 s or more.
LONGEST_S = 1.0

# Work that takes 5 s or more, by name, and the loop that interrupts one kind of it. The signal is sent 0.2 s after the
# work has begun.
INTERRUPTED = """
import os, signal, sys, threading, time
import numpy as np
from needleplan import _ppvi

signal.signal(signal.SIGINT, signal.default_int_handler)
kind, threads = sys.argv[1], int(sys.argv[2]) or None
SCENE = dict(
    width_mm=120.0, height_mm=100.0, spacing_mm=(1.0, 1.0), obstacles=[], target_center_mm=(100.0, 50.0),
    target_radius_mm=1.0, curvature_radius_mm=10.0, headings=60, tip_noise=[0.5, 0.25], arc_samples=1,
    interpolated=True, insertion_per_mm=1.0, rotation=1.0, collision=1e4, exit=1e4, discount=1.0,
)
lattice = _ppvi.Lattice(**SCENE)
straight = _ppvi.Lattice(**SCENE | dict(tip_noise=[1.0]))
insert = np.zeros(lattice.shape, np.uint8)
values = np.zeros(lattice.shape, np.float32)
LIMITS = dict(partitions=(4, 4), priority="H2", tolerance=1e-12, threads=threads)
n = 3_000_000
chain = dict(
    action_offsets=np.arange(n + 1), row_offsets=2 * np.arange(n + 1), probabilities=np.full(2 * n, 0.5),
    successors=np.random.default_rng(1).integers(n, size=2 * n, dtype=np.uint32), stage_costs=np.ones(n),
)
# Steps of cost zero in one direction only.
source = np.repeat(np.arange(n - 1, dtype=np.uint32), 2)
free = dict(
    action_offsets=np.minimum(np.arange(n + 1), n - 1), row_offsets=2 * np.arange(n), stage_costs=np.zeros(n - 1),
    probabilities=np.full(2 * n - 2, 0.5), discount=1.0,
    successors=np.maximum(chain["successors"][:-2], source + 1),
)

def of_rows(method):
    mdp = _ppvi.Tabular(**chain, discount=0.99999)
    started.set()
    mdp.solve(method=method, tolerance=1e-9, threads=threads)

def repeated(call):
    while True:
        call()

WORK = {
    "sweep": lambda: repeated(lambda: lattice.solve(method="sweep", **LIMITS)),
    "vi": lambda: repeated(lambda: lattice.solve(method="vi", **LIMITS)),
    "ppvi": lambda: repeated(lambda: lattice.solve(method="ppvi", **LIMITS)),
    "ppvi, bound": lambda: repeated(lambda: lattice.solve(method="ppvi", **LIMITS | dict(priority="bound"))),
    "success": lambda: repeated(lambda: lattice.success(insert, threads=threads)),
    "expectations": lambda: straight.expectations(insert, threads=threads),
    "rollout": lambda: lattice.rollout(
        insert, values, np.array([[60.0, 50.0, 0.0, 1.0]]), runs=30_000_000, seed=1, max_steps=10_000, threads=threads
    ),
    "path": lambda: straight.path(insert, values, [60.0, 50.0, 0.0, 1.0], max_steps=10_000_000, arc_samples=10_000),
    "geometry": lambda: _ppvi.Lattice(**SCENE | dict(arc_samples=1000, headings=1200)),
    "tabular": lambda: repeated(lattice.tabular),
    "rows, sweep": lambda: of_rows("sweep"),
    "rows, vi": lambda: of_rows("vi"),
    "rows, ppvi": lambda: of_rows("ppvi"),
    "free steps": lambda: repeated(lambda: _ppvi.Tabular(**free)),
}
started = threading.Event()
sent = []

def interrupt():
    started.wait()
    time.sleep(0.2)
    sent.append(time.process_time())
    os.kill(os.getpid(), signal.SIGINT)

threading.Thread(target=interrupt).start()
if not kind.startswith("rows"):
    started.set()
try:
    WORK[kind]()
    print("was not interrupted")
except KeyboardInterrupt:
    print(time.process_time() - sent[0])
"""

KINDS = [
    "sweep", "vi", "ppvi", "ppvi, bound", "success", "expectations", "rollout", "path", "geometry", "tabular",
    "rows, sweep", "rows, vi", "rows, ppvi", "free steps",
]  # fmt: skip


def seconds_to_interrupt(kind: str, threads: int) -> float:
    """Return the processor time (s) of all threads from an interrupt to its effect; other programs do not count."""
    done = subprocess.run(
        [sys.executable, "-c", INTERRUPTED, kind, str(threads)],
        capture_output=True, text=True, check=False, timeout=120,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return float(done.stdout)


# All work runs in pools that are made alike: every kind with more threads than there are processors, two with one, and
# one with the default.
@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "threads"),
    [
        *((kind, 8) for kind in KINDS),
        *((kind, 1) for kind in ("sweep", "rows, vi")),
        ("sweep", 0),
    ],
)
def test_ctrl_c_ends_work_soon_with_any_number_of_threads(kind: str, threads: int) -> None:
    # Processors that only this work uses spend so much together in this time.
    processors = os.cpu_count() or 1
    assert seconds_to_interrupt(kind, threads) < LONGEST_S * min(threads or processors, processors)


@pytest.mark.parametrize("method", Method)
@pytest.mark.parametrize("threads", [None, 1, 3])
def test_a_time_limit_ends_a_solve_soon(small: Scenario, method: Method, threads: int | None) -> None:
    solver = replace(small.solver, method=method, tolerance=1e-13, time_limit_s=0.05, threads=threads)
    table = npl.plan(replace(small, solver=solver))
    assert table.stats.seconds_solving < 0.05 + LONGEST_S


def beside_a_thread_that_keeps_the_gil(work: Callable[[], object]) -> None:
    """Call `work` while another thread takes the GIL whenever it can and then keeps it for 0.2 s."""
    done = threading.Event()

    def busy() -> None:
        while not done.is_set():
            sum(range(1000))

    before = sys.getswitchinterval()
    thread = threading.Thread(target=busy)
    sys.setswitchinterval(0.2)
    try:
        thread.start()
        work()
    finally:
        done.set()
        sys.setswitchinterval(before)
        thread.join()


@pytest.mark.slow
@pytest.mark.parametrize("progress", [None, lambda *_: None])
def test_a_solve_does_not_wait_for_the_gil(small: Scenario, progress: npl.planning.Progress | None) -> None:
    tables: list[npl.PolicyTable] = []
    solver = replace(small.solver, method=Method.VALUE_ITERATION, tolerance=1e-3)
    alone = npl.plan(replace(small, solver=solver)).stats
    beside_a_thread_that_keeps_the_gil(lambda: tables.append(npl.plan(replace(small, solver=solver), progress)))
    assert alone.sweeps > 15
    assert tables[0].stats.sweeps == alone.sweeps
    # If every sweep took the GIL, the solve would take 0.2 s for each.
    assert tables[0].stats.seconds_solving < alone.seconds_solving + 2.0


def test_progress_is_called_seldom_and_at_the_end(small: Scenario) -> None:
    calls: list[tuple[float, float, float, float]] = []
    solver = replace(small.solver, method=Method.VALUE_ITERATION, tolerance=1e-3)
    table = npl.plan(replace(small, solver=solver), lambda *state: calls.append((time.monotonic(), *state)))
    assert 1 <= len(calls) <= 2 + table.stats.seconds / 0.05
    assert table.stats.sweeps - 1 <= calls[-1][1] <= table.stats.sweeps


@pytest.mark.parametrize("method", Method)
def test_progress_may_end_a_solve_with_its_table(small: Scenario, method: Method) -> None:
    def enough(*_: float) -> None:
        raise StopIteration

    solver = replace(small.solver, method=method, tolerance=1e-13, max_sweeps=10**9)
    table = npl.plan(replace(small, solver=solver), enough)
    assert table.stats.status in ("interrupted", "converged", "precision_limit")
    assert np.isfinite(table.stats.residual)
    mdp = npl.mdp.TabularMdp.from_rows(**table.lattice.tabular())
    solution = npl.mdp.solve(mdp, method=method, tolerance=1e-13, max_sweeps=10**9, progress=enough)
    assert solution.stats.status in ("interrupted", "converged", "precision_limit")


def test_work_waits_for_nobody_when_its_pool_is_busy() -> None:
    """A callback that plans, on a pool of one thread that its own solve keeps busy, can be interrupted."""
    code = """if True:
        import os, signal, threading, time
        import numpy as np
        os.environ["RAYON_NUM_THREADS"] = "1"
        from needleplan import _ppvi
        signal.signal(signal.SIGINT, signal.default_int_handler)
        n = 1000
        rows = dict(action_offsets=np.arange(n + 1), row_offsets=np.arange(n + 1), probabilities=np.ones(n),
                    successors=np.arange(n, dtype=np.uint32), stage_costs=np.ones(n), discount=0.999999999)
        mdp = _ppvi.Tabular(**rows)
        sent = []
        def interrupt():
            sent.append(time.monotonic())
            os.kill(os.getpid(), signal.SIGINT)
        def progress(*_):
            threading.Timer(0.2, interrupt).start()
            mdp.solve(method="vi", tolerance=1e-6, max_sweeps=10**9)
        try:
            mdp.solve(method="vi", tolerance=1e-6, max_sweeps=10**9, progress=progress)
        except KeyboardInterrupt:
            print(time.monotonic() - sent[0])
    """
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 0, done.stderr
    assert float(done.stdout) < LONGEST_S


def test_arrays_that_change_during_a_solve_change_nothing() -> None:
    n = 20_000
    rng = np.random.default_rng(3)
    rows = {
        "action_offsets": np.arange(n + 1), "row_offsets": 2 * np.arange(n + 1),
        "successors": rng.integers(n, size=2 * n, dtype=np.uint32), "probabilities": np.full(2 * n, 0.5),
        "stage_costs": rng.random(n),
    }  # fmt: skip
    mdp = npl.mdp.TabularMdp.from_rows(**rows, discount=0.9)
    before = npl.mdp.solve(mdp, tolerance=1e-9).values
    rows["successors"][:] = 2**32 - 1
    rows["probabilities"][:] = np.nan
    rows["stage_costs"][:] = np.inf
    rows["row_offsets"][:] = -1
    rows["action_offsets"][:] = -1
    np.testing.assert_array_equal(npl.mdp.solve(mdp, tolerance=1e-9).values, before)


def test_a_fortran_ordered_table_is_refused() -> None:
    values = np.zeros((2, 3, 4, 2), np.float32, order="F")
    with pytest.raises(ValueError, match="values: must be contiguous in C order"):
        _ppvi.lookup_many(values, np.zeros(values.shape, np.uint8), values, (1.0, 1.0), (1.0, 2.0), np.zeros((1, 4)))
