"""The queue of plans: of each tab, the newest request wins."""

import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import pytest

import needleplan as npl
from needleplan.page import _queue
from needleplan.page._queue import PlanQueue, Superseded


class Gate:
    """Stands in for the solver: it reports progress until it is opened, and then returns the table."""

    def __init__(self, table: npl.PolicyTable) -> None:
        self.table = table
        self.entered = threading.Semaphore(0)
        self.opened = threading.Event()
        self.solved: list[str] = []

    def __call__(self, scenario: npl.Scenario, progress: Callable[..., Any]) -> npl.PolicyTable:
        self.solved.append(scenario.title)
        self.entered.release()
        while not self.opened.wait(0.001):
            progress(0.0, 0.0, 0.0)
        table = self.table
        return npl.PolicyTable(table.values, table.policy, table.success, table.stats, scenario)


@pytest.fixture
def gate(table: npl.PolicyTable, monkeypatch: pytest.MonkeyPatch) -> Gate:
    found = Gate(table)
    monkeypatch.setattr(_queue, "plan", found)
    return found


@pytest.fixture
def queue(gate: Gate) -> Iterator[PlanQueue]:
    found = PlanQueue()
    yield found
    gate.opened.set()
    found.close()


def test_the_newest_request_of_a_tab_wins(queue: PlanQueue, gate: Gate, small: npl.Scenario) -> None:
    first = queue.submit("a", replace(small, title="1"))
    assert gate.entered.acquire(timeout=10)
    second = queue.submit("a", replace(small, title="2"))  # interrupts the first
    assert isinstance(first.exception(10), Superseded)
    assert gate.entered.acquire(timeout=10)
    other = queue.submit("b", replace(small, title="other tab"))
    third = queue.submit("b", replace(small, title="3"))  # replaces a request that waits
    assert isinstance(other.exception(10), Superseded)
    gate.opened.set()
    assert second.result(10).scenario.title == "2"
    assert third.result(10).scenario.title == "3"
    assert gate.solved == ["1", "2", "3"]


def test_a_solved_scenario_is_not_solved_again(queue: PlanQueue, gate: Gate, small: npl.Scenario) -> None:
    gate.opened.set()
    table = queue.submit("a", small).result(10)
    assert queue.submit("b", small).result(10) is table
    assert queue.find(small.digest) is table
    assert gate.solved == ["Small"]


def test_the_thread_goes_on_after_a_failure(
    queue: PlanQueue, gate: Gate, small: npl.Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr(_queue, "plan", fail)
    assert isinstance(queue.submit("a", small).exception(10), MemoryError)
    monkeypatch.setattr(_queue, "plan", gate)
    gate.opened.set()
    assert queue.submit("a", small).result(10).scenario == small


def test_old_tables_make_room(queue: PlanQueue, small: npl.Scenario, table: npl.PolicyTable,
                              monkeypatch: pytest.MonkeyPatch) -> None:  # fmt: skip
    monkeypatch.setattr(_queue, "_MOST_KEPT_STATES", 2 * table.values.size)
    scenarios = [replace(small, title=str(number)) for number in range(3)]
    for each in scenarios:
        queue.keep(npl.PolicyTable(table.values, table.policy, table.success, table.stats, each))
    assert queue.find(scenarios[0].digest) is None
    assert queue.find(scenarios[2].digest) is not None


def test_a_closed_queue_ends_what_runs(queue: PlanQueue, gate: Gate, small: npl.Scenario) -> None:
    running = queue.submit("a", small)
    assert gate.entered.acquire(timeout=10)
    waiting = queue.submit("b", replace(small, title="waits"))
    queue.close()
    assert isinstance(running.exception(10), Superseded)
    assert isinstance(waiting.exception(10), Superseded)
