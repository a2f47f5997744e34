"""Real clusters whose parts fail: nothing is lost, nothing is stored twice, the folder stays readable."""

import resource
import signal
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, cast

import pytest

import needleplan as npl
from needleplan.artifacts import version
from needleplan.errors import OutputError, SweepError
from needleplan.sweep import Engine, Sweep, make_table_set
from needleplan.sweep._engine import Cluster, _Lost, _Run
from needleplan.sweep._store import TableSetStore
from needleplan.sweep._work import TableTask, solve_task
from tests.pages import environment
from tests.sweep.cluster import DaskProcesses, kill
from tests.sweep.sweeps import FORTY, complete, write_sweep

ClosedClientError: type[Exception] = getattr(
    pytest.importorskip("distributed.client"), "ClosedClientError", RuntimeError
)


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[DaskProcesses]:
    (tmp_path / "logs").mkdir()
    with DaskProcesses(tmp_path / "logs") as processes:
        yield processes


@pytest.fixture
def sweep(tmp_path: Path) -> Sweep:
    return Sweep.read(write_sweep(tmp_path, radii=FORTY))


def at(count: int, act: Callable[[], object]) -> Callable[[int, int], None]:
    """Return a progress function that acts once, when so many tables have ended."""
    acted = threading.Event()

    def progress(done: int, _: int) -> None:
        if done >= count and not acted.is_set():
            acted.set()
            act()

    return progress


@pytest.mark.study
def test_local_processes(tmp_path: Path, sweep: Sweep) -> None:
    report = make_table_set(sweep, tmp_path / "store", Engine(workers=2))
    assert (report.solved + report.read, report.complete) == (40, True)
    complete(tmp_path / "store", sweep)


@pytest.mark.study
def test_the_scheduler_is_lost_and_comes_back(tmp_path: Path, sweep: Sweep, cluster: DaskProcesses) -> None:
    scheduler, worker = cluster.scheduler(), cluster.worker()

    def act() -> None:
        kill(scheduler)
        kill(worker)
        cluster.scheduler()
        cluster.worker()

    told: list[str] = []
    report = make_table_set(sweep, tmp_path / "store", Engine(cluster.address), progress=at(5, act), tell=told.append)
    assert (report.solved + report.read, report.complete) == (40, True)
    complete(tmp_path / "store", sweep)


@pytest.mark.study
def test_the_scheduler_is_lost_for_good(tmp_path: Path, sweep: Sweep, cluster: DaskProcesses) -> None:
    scheduler, worker = cluster.scheduler(), cluster.worker()

    def act() -> None:
        kill(scheduler)
        kill(worker)

    engine = Engine(cluster.address, wait_s=10.0)
    report = make_table_set(sweep, tmp_path / "store", engine, progress=at(5, act))
    assert 5 <= report.solved + report.read < 40
    assert report.missing == 40 - report.solved - report.read
    rest = make_table_set(sweep, tmp_path / "store", Engine(workers=0))
    assert rest.solved + rest.read + rest.present == 40
    complete(tmp_path / "store", sweep)


@pytest.mark.study  # Dask leaves connections to killed workers to the garbage collector
@pytest.mark.filterwarnings("ignore:.*<socket.socket:pytest.PytestUnraisableExceptionWarning")
def test_many_tables_while_workers_come_and_go(tmp_path: Path, cluster: DaskProcesses) -> None:
    radii = [30.0 + number / 50 for number in range(15)]  # 30 tables; at most 4 for each thread are under way
    file = write_sweep(tmp_path, radii=radii)
    file.write_text(file.read_text() + '[[parameter]]\nkey = "grid.spacing_mm"\nvalues = [[5.0, 5.0]]\n')
    sweep = Sweep.read(file)
    cluster.scheduler()
    workers, steps = [cluster.worker(), cluster.worker()], iter(range(8, 25, 10))
    following = [next(steps)]

    def progress(done: int, _: int) -> None:
        if done >= following[0]:
            following[0] = next(steps, 10_000)
            kill(workers.pop(0))
            workers.append(cluster.worker())

    report = make_table_set(sweep, tmp_path / "store", Engine(cluster.address), progress=progress)
    assert (report.solved + report.read, report.complete) == (30, True)
    complete(tmp_path / "store", sweep)


def other_version(folder: Path) -> Path:
    """Write the metadata of another version of needleplan, and return the folder to put in front."""
    info = folder / "needleplan-0.0.9.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: needleplan\nVersion: 0.0.9\n")
    return folder


@pytest.mark.study
def test_a_worker_of_another_version_is_not_used(tmp_path: Path, sweep: Sweep, cluster: DaskProcesses) -> None:
    cluster.scheduler()
    cluster.worker()
    old = other_version(tmp_path / "old")
    told: list[str] = []
    report = make_table_set(
        sweep,
        tmp_path / "store",
        Engine(cluster.address),
        progress=at(2, lambda: cluster.worker(path=old)),
        tell=told.append,
    )
    assert (report.solved + report.read, report.complete) == (40, True)
    complete(tmp_path / "store", sweep)


@pytest.mark.slow
def test_only_workers_of_another_version_are_refused(tmp_path: Path, sweep: Sweep, cluster: DaskProcesses) -> None:
    cluster.scheduler()
    cluster.worker(path=other_version(tmp_path / "old"))
    told: list[str] = []
    with pytest.raises(SweepError, match=rf"have other versions of needleplan \(0\.0\.9; this is {version()}\)"):
        make_table_set(sweep, tmp_path / "store", Engine(cluster.address), tell=told.append)
    assert "it has needleplan 0.0.9" in told[0]


UPGRADED = """
import sys
from needleplan.artifacts import version

version()  # as the worker began; the metadata change afterwards
sys.path.remove({folder!r})
"""


@pytest.mark.slow
def test_a_worker_under_which_needleplan_was_upgraded_is_refused(
    tmp_path: Path, sweep: Sweep, cluster: DaskProcesses
) -> None:
    cluster.scheduler()
    old = other_version(tmp_path / "old")
    (old / "sitecustomize.py").write_text(UPGRADED.format(folder=str(old)))
    cluster.worker(path=old)
    with pytest.raises(SweepError, match=r"have other versions of needleplan \(0\.0\.9;"):
        make_table_set(sweep, tmp_path / "store", Engine(cluster.address))


@pytest.mark.slow
def test_a_scheduler_without_workers_is_refused(tmp_path: Path, sweep: Sweep, cluster: DaskProcesses) -> None:
    cluster.scheduler()
    with pytest.raises(SweepError, match="has had no worker for 3 s"):
        make_table_set(sweep, tmp_path / "store", Engine(cluster.address, wait_s=3.0))


SLOW = """
import needleplan.sweep._work as work

solve = work.solve_on_worker

def slowly(task):
    import time
    with open(LOG, "a") as log:
        print("solved", file=log)
    time.sleep(2)
    return solve(task)

work.solve_on_worker = slowly
slowly.__module__, slowly.__qualname__ = "needleplan.sweep._work", "solve_on_worker"
"""


@pytest.mark.study
def test_a_slow_worker_does_not_hold_the_others_up(tmp_path: Path, sweep: Sweep, cluster: DaskProcesses) -> None:
    (tmp_path / "slow").mkdir()
    log = tmp_path / "slow" / "solved.txt"
    (tmp_path / "slow" / "sitecustomize.py").write_text(f"LOG = {str(log)!r}\n{SLOW}")
    cluster.scheduler()
    cluster.worker(path=tmp_path / "slow")

    def others() -> None:
        cluster.worker()

    report = make_table_set(sweep, tmp_path / "store", Engine(cluster.address), progress=at(1, others))
    assert (report.solved + report.read, report.complete) == (40, True)
    assert 1 <= len(log.read_text().splitlines()) < sweep.tables / 2
    complete(tmp_path / "store", sweep)


@pytest.mark.study
def test_all_workers_are_lost_for_good(tmp_path: Path, sweep: Sweep, cluster: DaskProcesses) -> None:
    cluster.scheduler()
    worker = cluster.worker()
    engine = Engine(cluster.address, wait_s=8.0)
    report = make_table_set(sweep, tmp_path / "store", engine, progress=at(5, lambda: kill(worker)))
    assert report.missing == 40 - report.solved - report.read > 0


def small_files_only() -> None:
    """Limit the size of files to 20 kB, less than a table, as on a full disk. Use -B: Python would cut .pyc files."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)


@pytest.mark.slow
@pytest.mark.study
@pytest.mark.parametrize("workers", ["0", pytest.param("2", marks=pytest.mark.slow)])
def test_a_table_that_cannot_be_written_ends_the_run(tmp_path: Path, workers: str) -> None:
    file = write_sweep(tmp_path)
    done = subprocess.run(
        [sys.executable, "-B", "-m", "needleplan", "sweep", file, "-o", tmp_path / "store", "--workers", workers],
        env=environment(), capture_output=True, text=True, timeout=60, preexec_fn=small_files_only,
    )  # fmt: skip
    assert done.returncode == 1, done.stderr
    assert "given up" in done.stderr
    assert "File too large" in done.stderr
    assert "Traceback" not in done.stderr
    assert not [each for each in (tmp_path / "store" / "tables").rglob("*") if each.is_file()]
    assert make_table_set(Sweep.read(file), tmp_path / "store", Engine(workers=0)).solved == 6


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 200 kB, with room for two or three tables. Mounting it needs the rights of root."""
    folder = tmp_path / "disk"
    folder.mkdir()
    made = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=200k", "tmpfs", str(folder)], capture_output=True, check=False
    )
    if made.returncode:
        pytest.skip("needs the rights to mount a file system")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


@pytest.mark.slow
@pytest.mark.parametrize("workers", [0, 2])
def test_a_full_disk_and_one_that_becomes_read_only(tmp_path: Path, small_disk: Path, workers: int) -> None:
    sweep = Sweep.read(write_sweep(tmp_path, radii=FORTY))
    report = make_table_set(sweep, small_disk / "store", Engine(workers=workers))
    assert "No space left on device" in report.stopped
    assert report.missing == 40 - report.solved > 30
    table_set = npl.TableSet.open(small_disk / "store")
    made = [each for each in table_set if each.record]
    assert len(made) == report.solved > 0
    assert all(each.table().digest == each.record["digest"] for each in made)
    subprocess.run(["mount", "-o", "remount,ro", str(small_disk)], check=True)
    with pytest.raises(OutputError, match=r"cannot be written \(a read-only disk"):
        make_table_set(sweep, small_disk / "store", Engine(workers=workers))
    assert len(npl.TableSet.open(small_disk / "store")) == 40


def task_of(sweep: Sweep, store: TableSetStore, **changes: str) -> TableTask:
    scenario = npl.Scenario.read(sweep.scenario)
    values = {"folder": str(store.folder), "identity": store.identity, "version": version()} | changes
    return TableTask("ab" * 32, scenario.to_toml(), "left", None, **values)  # type: ignore[arg-type]


@pytest.mark.slow
def test_a_worker_that_does_not_see_the_folder_returns_the_table(tmp_path: Path) -> None:
    sweep = Sweep.read(write_sweep(tmp_path))
    make_table_set(sweep, tmp_path / "store", Engine(workers=0))
    store = TableSetStore.open(tmp_path / "store")
    for changes in ({"folder": str(tmp_path / "elsewhere")}, {"identity": "of another folder of the same name"}):
        result = solve_task(task_of(sweep, store, **changes))
        (tmp_path / "table.h5").write_bytes(result.image)
        assert npl.PolicyTable.read(tmp_path / "table.h5").digest == result.record["digest"]
        assert not store.table_path("ab" * 32).exists()


def test_a_task_of_another_version_is_not_solved(tmp_path: Path) -> None:
    sweep = Sweep.read(write_sweep(tmp_path))
    make_table_set(sweep, tmp_path / "store", Engine(workers=0))
    result = solve_task(task_of(sweep, TableSetStore.open(tmp_path / "store"), version="0.0.9"))
    assert (result.record, result.refused) == (None, f"this worker has needleplan {version()}, not 0.0.9")


@pytest.mark.parametrize(("status", "expected"), [("closed", _Lost), ("running", ClosedClientError)])
def test_a_client_that_closes_between_two_looks_loses_no_task(status: str, expected: type[Exception]) -> None:
    """Dask closes a client whose scheduler is gone; what it is asked for then is refused with an error of its own."""

    class Closing:
        status = "running"

        def submit(self, *_: object, **__: object) -> None:
            self.status = status
            raise ClosedClientError(status)

    wanted = [TableTask(name, "", "left", None, "", "", version()) for name in ("one", "two")]
    pending, client = deque(wanted), cast(Any, Closing())
    cluster = Cluster(client, print, {"worker": version()}, threads=1)
    with pytest.raises(expected):
        _Run(cluster, Engine("tcp://127.0.0.1:1"), pending, lambda *_: pytest.fail("a result")).drive()
    assert list(pending) == wanted
