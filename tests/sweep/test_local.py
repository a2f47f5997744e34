"""Processes of this machine that a run starts by itself: they die, cannot be closed, are killed or interrupted."""

import gc
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import needleplan as npl
from needleplan.sweep import Engine, Sweep, TableSetReport, make_table_set
from needleplan.sweep._store import TableSetStore
from tests.pages import environment
from tests.sweep.cluster import kill
from tests.sweep.sweeps import FORTY, complete, write_sweep

pytest.importorskip("distributed")


@pytest.fixture
def sweep(tmp_path: Path) -> Sweep:
    return Sweep.read(write_sweep(tmp_path, radii=FORTY))


DEADLY = """
import os
import needleplan.sweep._work as work

solve = work.solve_on_worker

def deadly(task):
    if "curvature_radius_mm = 33.0" in task.scenario and "rotation = 8.0" in task.scenario:
        os._exit(1)
    if "curvature_radius_mm = 34.0" in task.scenario:
        raise RuntimeError("a bug")
    return solve(task)

work.solve_on_worker = deadly
deadly.__module__, deadly.__qualname__ = "needleplan.sweep._work", "solve_on_worker"
"""


@pytest.fixture
def deadly(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Workers that die of one table, and find a bug in two others."""
    (tmp_path / "deadly").mkdir()
    (tmp_path / "deadly" / "sitecustomize.py").write_text(DEADLY)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path / "deadly"), os.environ.get("PYTHONPATH", "")]))


def started(file: Path, store: Path) -> subprocess.Popen[str]:
    """Start the command with two processes, and return it when the first table has a record."""
    process = subprocess.Popen(
        [sys.executable, "-m", "needleplan", "sweep", str(file), "-o", str(store), "--workers", "2"],
        env=environment(), start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    while len(list((store / "records").glob("*.jsonl"))) == 0 and process.poll() is None:
        pass
    return process


@pytest.mark.study
@pytest.mark.usefixtures("deadly")
def test_tables_that_kill_their_workers_are_failures_and_the_rest_is_made(tmp_path: Path, sweep: Sweep) -> None:
    report = make_table_set(sweep, tmp_path / "store", Engine(workers=2))
    assert report.solved + report.read == 37
    why = {"radius_mm = 33, rotation = 8": "its workers died, probably for lack of memory"}
    why |= {f"radius_mm = 34, rotation = {cost}": "RuntimeError: a bug" for cost in (1, 8)}
    assert report.failures == why
    assert not report.missing


@pytest.mark.slow
def test_processes_that_dask_cannot_close_do_not_fail_a_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import psutil
    from distributed.nanny import WorkerProcess

    stop = WorkerProcess.kill
    stopped: list[WorkerProcess] = []

    async def fail(process: WorkerProcess, **options: Any) -> None:
        await stop(process, **options)
        stopped.append(process)
        raise AssertionError("can only join a started process")

    monkeypatch.setattr(WorkerProcess, "kill", fail)
    sweep = Sweep.read(write_sweep(tmp_path))
    before = psutil.Process().children(recursive=True)
    assert make_table_set(sweep, tmp_path / "store", Engine(workers=2)).complete
    assert len(stopped) == 2
    started = [each for each in psutil.Process().children(recursive=True) if each not in before]
    workers = [each for each in started if "spawn_main" in " ".join(each.cmdline())]
    assert not psutil.wait_procs(workers, timeout=30)[1]
    gc.collect()  # Dask warns of clusters that are not closed


@pytest.fixture
def unattended(monkeypatch: pytest.MonkeyPatch) -> None:
    """Processes that Dask does not start again, as one that dies before its start is complete."""
    from distributed import Nanny

    async def give_up(process: Nanny, _: int) -> None:
        await process.close()

    monkeypatch.setattr(Nanny, "_on_worker_exit", give_up)


@pytest.mark.study
@pytest.mark.usefixtures("deadly", "unattended")
def test_lost_processes_are_replaced_and_a_table_that_they_die_of_is_found(tmp_path: Path) -> None:
    sweep = Sweep.read(write_sweep(tmp_path, radii=[32.0, 33.0]))
    said: list[str] = []
    report = make_table_set(sweep, tmp_path / "store", Engine(workers=2, wait_s=2.0), tell=said.append)
    assert report.failures == {"radius_mm = 33, rotation = 8": "its workers died, probably for lack of memory"}
    assert (report.solved + report.read, report.missing) == (3, 0)
    assert "all processes of this machine have ended; starting others" in said


@pytest.mark.study
def test_the_command_is_killed_and_run_again(tmp_path: Path) -> None:
    file = write_sweep(tmp_path, radii=FORTY)
    store = tmp_path / "store"
    process = started(file, store)
    with process:
        kill(process)
    before = len(TableSetStore.open(store).there())
    assert before < 40
    report: TableSetReport = make_table_set(Sweep.read(file), store, Engine(workers=0))
    assert report.solved == 40 - before
    complete(store, Sweep.read(file))


@pytest.mark.study
def test_ctrl_c_ends_the_command_and_keeps_what_is_done(tmp_path: Path) -> None:
    file = write_sweep(tmp_path, radii=FORTY)
    store = tmp_path / "store"
    process = started(file, store)
    os.killpg(process.pid, signal.SIGINT)
    _, errors = process.communicate(timeout=30)
    assert process.returncode == 130, errors
    assert "Traceback" not in errors
    assert len(npl.TableSet.open(store)) == 40
