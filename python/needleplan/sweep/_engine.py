"""Runs tasks on a Dask cluster: local processes, or any cluster with a scheduler address.

Dask distributes, retries and watches the workers. This module keeps a window of submitted tasks, sends tasks only to
workers of the same version, and submits what was lost again when the scheduler comes back. A task that runs twice is
harmless: it makes the same file.
"""

from __future__ import annotations

import logging
import math
import queue
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from needleplan.artifacts import version
from needleplan.config import Integer, Maybe, Number, Violation
from needleplan.errors import Mistake, SweepError
from needleplan.sweep._local import local_client
from needleplan.sweep._work import TableTask, TaskResult, solve_on_worker, solve_task

if TYPE_CHECKING:
    from distributed import Client, Future

__all__ = ["Cluster", "Engine", "run_tasks"]

# Submitted tasks per thread of the cluster: enough that no worker waits for the next one.
_WINDOW_PER_THREAD = 4
# Time (s) between looks at the cluster: for new workers and a lost scheduler.
_POLL_S = 0.5
# Number of times that a task is submitted again after an unexpected error.
_RETRIES = 3
# Failure of a table whose workers die each time.
_DIED = "its workers died, probably for lack of memory"


@dataclass(frozen=True)
class Engine:
    """Where tasks run.

    Parameters
    ----------
    scheduler : str, optional
        Address of a Dask scheduler, such as `tcp://10.0.0.5:8786`. Default: processes of this machine.
    workers : int, optional
        Number of processes of this machine; 0: this process alone, without Dask. Default: one per processor.
    wait_s : float, default 60
        Time to wait for a scheduler that does not answer, or has no worker, in s.

    Raises
    ------
    SweepError
        If a number breaks its rule, or both an address and a number of workers are given.
    """

    scheduler: str | None = None
    workers: int | None = None
    wait_s: float = 60.0

    def __post_init__(self) -> None:
        mistakes = []
        for name, rule in (("workers", Maybe(Integer(0, 1024))), ("wait_s", Number("s", at_least=0, at_most=1e6))):
            try:
                rule.read(getattr(self, name))
            except Violation as broken:
                mistakes += [Mistake(name, mistake.value, mistake.rule) for mistake in broken.mistakes]
        if self.scheduler is not None and self.workers is not None:
            mistakes.append(
                Mistake("workers", str(self.workers), "must be left out beside a scheduler, which has its own")
            )
        if mistakes:
            raise SweepError(mistakes)


class _Lost(Exception):
    """The scheduler does not answer any more."""


class _NoWorker(Exception):
    """The cluster has no worker that can be used."""

    def __init__(self, mistake: Mistake) -> None:
        self.mistake = mistake
        super().__init__(str(mistake))


@dataclass
class Cluster:
    """A connection to a Dask cluster, and the workers that may be used."""

    client: Client
    tell: Callable[[str], None]
    versions: dict[str, str] = field(default_factory=dict)
    threads: int = 0

    def look(self) -> None:
        """Update the list of workers; ask new workers for their version. Raises _Lost if nobody answers."""
        if self.client.status != "running":
            raise _Lost
        try:
            workers: dict[str, Any] = self.client.scheduler_info(n_workers=-1)["workers"]
            new = [address for address in workers if address not in self.versions]
            if new:
                # By this version a worker accepts a task. That of the installed package changes under a running worker.
                answers = self.client.run(version, workers=new, on_error="return")
                self._remember(answers)
        except (OSError, TimeoutError, ValueError) as error:
            raise _Lost from error
        self.versions = {
            address: worker_version for address, worker_version in self.versions.items() if address in workers
        }
        self.threads = sum(int(workers[address]["nthreads"]) for address in self.usable)

    def ask_again(self) -> None:
        """Read the versions of all workers again, after a worker has refused a task."""
        self.versions.clear()
        self.look()

    @property
    def usable(self) -> list[str]:
        """Addresses of the workers that have the version of this process."""
        return [address for address, worker_version in self.versions.items() if worker_version == version()]

    @property
    def allowed(self) -> list[str] | None:
        """The workers that tasks may be sent to; None: all of them."""
        return None if len(self.usable) == len(self.versions) else self.usable

    def _remember(self, answers: dict[str, Any]) -> None:
        for address, answer in answers.items():
            self.versions[address] = answer if isinstance(answer, str) else ""
            if answer != version():
                has = f"needleplan {answer}" if isinstance(answer, str) else "no needleplan"
                self.tell(f"worker {address} is not used: it has {has}, and this is needleplan {version()}")


def run_tasks(
    tasks: Sequence[TableTask],
    engine: Engine,
    deliver: Callable[[TableTask, TaskResult], None],
    tell: Callable[[str], None] = lambda _: None,
) -> list[TableTask]:
    """Run tasks, and call `deliver` in this thread with each task and its result, in the order in which they end.

    Returns the tasks that were not run because the scheduler, or all of its workers, did not come back within
    `engine.wait_s`. If all processes of this machine are lost, others are started. If they are lost before a task ends,
    each task runs alone until the one is found that they die of. An exception of `deliver` ends the run. `tell`
    receives remarks.

    Raises SweepError if no scheduler answers at first, or no worker has the version of this process.
    """
    if engine.workers == 0:
        for task in tasks:
            deliver(task, solve_task(task))
        return []
    pending = deque(tasks)
    connected, alone, before = False, False, len(pending) + 1
    while pending:
        now = deque([pending.popleft()]) if alone else pending
        try:
            with _cluster(engine, tell) as cluster:
                _require_worker(cluster, engine)
                connected = True
                _Run(cluster, engine, now, deliver).drive()
        except _NoWorker as none:
            if not connected:
                raise SweepError(none.mistake) from None
            pending = now if now is pending else now + pending
            break
        except _Lost:
            if not connected:
                raise SweepError(_no_answer(engine)) from None
            if engine.scheduler is None:  # Dask gives a process up that dies before its start is complete
                for task in now if alone else ():
                    deliver(task, TaskResult(failed=_DIED))
                alone, before = not alone and len(pending) == before, len(pending)
                tell("all processes of this machine have ended; starting others")
                continue
            tell("the scheduler does not answer; waiting for it")
            if not _comes_back(engine):
                break
    return list(pending)


class _Run:
    """One connection's worth of a run: takes tasks from `pending`, and puts back what was lost."""

    def __init__(
        self,
        cluster: Cluster,
        engine: Engine,
        pending: deque[TableTask],
        deliver: Callable[[TableTask, TaskResult], None],
    ) -> None:
        self._cluster, self._engine, self._pending, self._deliver = cluster, engine, pending, deliver
        self._outstanding: dict[str, tuple[Future[TaskResult], TableTask]] = {}
        self._ended: queue.SimpleQueue[Future[TaskResult]] = queue.SimpleQueue()
        self._failures: dict[str, int] = {}
        # Tasks whose workers died. Dask counts every task of a dead worker, so each is tried again alone.
        self._suspects: deque[TableTask] = deque()
        self._alone = ""
        self._submitted = 0
        self._allowed = cluster.allowed

    def drive(self) -> None:
        """Run until all tasks have ended. Raises _Lost if the scheduler is lost or has no usable worker."""
        looked = progressed = time.monotonic()
        try:
            while self._pending or self._outstanding or self._suspects:
                if not (self._pending or self._outstanding):
                    self._pending.append(self._suspects.popleft())
                    self._alone = self._pending[0].address
                self._submit()
                try:
                    self._end(self._ended.get(timeout=_POLL_S))
                    progressed = time.monotonic()
                except queue.Empty:
                    pass
                if time.monotonic() - looked > _POLL_S:
                    self._look()
                    looked = time.monotonic()
                if self._cluster.usable:
                    progressed = max(progressed, looked)
                elif looked - progressed > self._engine.wait_s:
                    raise _Lost
        except BaseException:
            self._take_back(list(self._outstanding))
            self._pending.extend(self._suspects)
            raise

    def _submit(self) -> None:
        window = max(_WINDOW_PER_THREAD * self._cluster.threads, 1)
        while self._pending and len(self._outstanding) < window and self._cluster.usable:
            task = self._pending.popleft()
            # Dask knows a task by its key, and may still hold a task of this address that was cancelled or lost.
            self._submitted += 1
            key = f"needleplan-{task.address}-{self._submitted}"
            client = self._cluster.client
            try:
                future = client.submit(solve_on_worker, task, key=key, pure=False, workers=self._allowed)
            except Exception as error:
                self._pending.appendleft(task)
                if client.status == "running":
                    raise
                raise _Lost from error  # the client was closed since the last look, because the scheduler is gone
            self._outstanding[key] = future, task
            future.add_done_callback(self._ended.put)

    def _end(self, future: Future[TaskResult]) -> None:
        """Deliver the result of a future, or put its task back."""
        if future.key not in self._outstanding:
            return
        _, task = self._outstanding.pop(future.key)
        try:
            result: TaskResult = future.result(timeout=self._engine.wait_s)
        except Exception as error:  # what a worker raises, or Dask when a worker or the scheduler is lost
            if future.status != "error":  # lost or cancelled: no fault of the task
                self._pending.appendleft(task)
                return
            result = self._failed(task, error)
            if not result.failed:
                return
        if result.refused:  # the task came before the look at the versions of new workers
            self._pending.appendleft(task)
            self._cluster.ask_again()
            self._look()
            return
        self._deliver(task, result)

    def _failed(self, task: TableTask, error: Exception) -> TaskResult:
        """Return the result of a task that raised an error; an empty one if it will be tried again."""
        from distributed import KilledWorker

        if isinstance(error, KilledWorker):  # Dask has tried it on several workers
            if task.address == self._alone:
                return TaskResult(failed=_DIED)
            self._suspects.append(task)
            return TaskResult()
        tries = self._failures[task.address] = self._failures.get(task.address, 0) + 1
        if tries > _RETRIES:
            return TaskResult(failed=f"{type(error).__name__}: {error}")
        self._pending.append(task)
        return TaskResult()

    def _look(self) -> None:
        """Look for new workers and lost futures; if other workers are allowed now, submit everything again."""
        self._cluster.look()
        lost = [key for key, (future, _) in self._outstanding.items() if future.status in ("lost", "cancelled")]
        if self._cluster.allowed != self._allowed:
            self._allowed = self._cluster.allowed
            lost = list(self._outstanding)
        self._take_back(lost)

    def _take_back(self, keys: Sequence[str]) -> None:
        """Cancel submitted tasks, and put them in front of the pending ones."""
        taken = [self._outstanding.pop(key) for key in keys]
        self._pending.extendleft(task for _, task in reversed(taken))
        if taken:
            with suppress(Exception):  # a lost scheduler cannot cancel, and need not
                self._cluster.client.cancel([future for future, _ in taken], force=True)


@contextmanager
def _cluster(engine: Engine, tell: Callable[[str], None]) -> Iterator[Cluster]:
    """Connect to the cluster of an engine, or start processes of this machine. Raises _Lost if nobody answers."""
    try:
        from distributed import Client
        from distributed.comm.addressing import get_address_host_port, normalize_address
    except ImportError:
        rule = "needs Dask: install it with `pip install needleplan[sweep]`"
        raise SweepError(Mistake("workers", "", rule)) from None
    _silence()
    if engine.scheduler is None:
        with local_client(engine.workers) as client:
            yield Cluster(client, tell)
        return
    try:
        get_address_host_port(normalize_address(engine.scheduler))
    except (ValueError, TypeError) as error:
        raise SweepError(Mistake("scheduler", engine.scheduler, f"is no scheduler address: {error}")) from None
    try:
        client = Client(engine.scheduler, timeout=max(engine.wait_s, 1.0), set_as_default=False)
    except (OSError, TimeoutError):
        raise _Lost from None
    try:
        yield Cluster(client, tell)
    finally:
        with suppress(Exception):
            client.close(timeout=2)


def _silence() -> None:
    """Keep Dask's own messages off the terminal; each of its loggers has a level of its own."""
    for name in list(logging.root.manager.loggerDict):
        if name.partition(".")[0] in ("distributed", "tornado", "asyncio"):
            logging.getLogger(name).setLevel(logging.CRITICAL)


def _require_worker(cluster: Cluster, engine: Engine) -> None:
    """Wait for a usable worker. Raises _NoWorker if there is none after `engine.wait_s`, or only other versions."""
    until = time.monotonic() + engine.wait_s
    cluster.look()
    while not cluster.usable:
        if time.monotonic() > until or cluster.versions:
            found = sorted({each or "none" for each in cluster.versions.values()})
            rule = (
                f"its workers have other versions of needleplan ({', '.join(found)}; this is {version()}): install the "
                "same version on all"
                if found
                else f"has had no worker for {engine.wait_s:g} s"
            )
            raise _NoWorker(Mistake("scheduler", engine.scheduler or "local", rule))
        time.sleep(_POLL_S / 5)
        cluster.look()


def _comes_back(engine: Engine) -> bool:
    """Return whether the scheduler answers again within `engine.wait_s`."""
    if engine.scheduler is None:
        return False
    until = time.monotonic() + engine.wait_s
    while True:
        left = until - time.monotonic()
        try:
            from distributed import Client

            Client(engine.scheduler, timeout=max(min(left, 5.0), 0.5), set_as_default=False).close()
        except (OSError, TimeoutError):
            if not math.isfinite(left) or left <= 0:
                return False
            time.sleep(min(_POLL_S, max(left, 0)))
        else:
            return True


def _no_answer(engine: Engine) -> Mistake:
    return Mistake("scheduler", engine.scheduler or "local", f"no scheduler answers within {engine.wait_s:g} s")
