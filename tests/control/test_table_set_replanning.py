"""Replanning with a table set: the nearest table first, the exact one when it is there, and again in a replay."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from queue import Queue
from threading import Semaphore
from typing import Any

import pytest

import needleplan as npl
from needleplan.control import (
    RunEventName,
    RunRecorder,
    RunSetup,
    TableSetReplanner,
    ThreadReplanner,
    _table_set_replanning,
    replay,
)
from needleplan.control._replanning import rescaled
from needleplan.errors import DataError, ScenarioError
from needleplan.recording import Recording
from needleplan.sweep import CurvatureLookup, Engine, Sweep, SweptParameter, TableSetEntry, make_table_set
from tests.control.scenes import FAST, NOISY, WIDE, a_lab, coil_of, insertion_in, small_table

RADII = [28.0, 33.0, 37.0, 44.0]


@pytest.fixture(scope="module")
def table_set(tmp_path_factory: pytest.TempPathFactory) -> npl.TableSet:
    folder = tmp_path_factory.mktemp("table set")
    small_table().scenario.write(folder / "small.toml")
    sweep = Sweep(str(folder / "small.toml"), [SweptParameter("needle.curvature_radius_mm", values=RADII)])
    make_table_set(sweep, folder / "store", Engine(workers=0))
    return npl.TableSet.open(folder / "store")


def radius_mm(table: object) -> float:
    assert isinstance(table, npl.PolicyTable)
    return table.scenario.needle.curvature_radius_mm


@pytest.mark.slow
def test_the_nearest_in_curvature_is_found(table_set: npl.TableSet) -> None:
    lookup = CurvatureLookup(table_set)
    for wanted in (20.0, 29.0, 30.2, 30.4, 35.0, 60.0):
        entry = lookup.nearest(rescaled(small_table().scenario, 40 / wanted))
        assert entry is not None
        best = min(RADII, key=lambda radius: abs(1 / radius - 1 / wanted))
        assert entry.values["curvature_radius_mm"] == best


@pytest.mark.slow
def test_a_table_for_another_task_is_not_taken(table_set: npl.TableSet) -> None:
    scenario = small_table().scenario
    lookup = CurvatureLookup(table_set)
    moved = replace(scenario, target=replace(scenario.target, center_mm=(50.0, 25.5)))
    assert lookup.nearest(moved) is None
    assert lookup.nearest(replace(scenario, title="other", solver=replace(scenario.solver, tolerance=0.5))) is not None


def test_layers_must_scale_alike(tmp_path: Path) -> None:
    layered = npl.Scenario.read("layered")
    coarse = replace(layered, grid=replace(layered.grid, spacing_mm=(4.0, 4.0)))
    rescaled(coarse, 1.1).write(tmp_path / "layered.toml")
    sweep = Sweep(str(tmp_path / "layered.toml"), [SweptParameter("objective.rotation", values=[4.0])])
    make_table_set(sweep, tmp_path / "store", Engine(workers=0))
    lookup = CurvatureLookup(npl.TableSet.open(tmp_path / "store"))
    assert lookup.nearest(coarse) is not None
    first = coarse.needle.curvature_radius_mm
    assert lookup.nearest(replace(coarse, needle=replace(coarse.needle, curvature_radius_mm=1.2 * first))) is None


@pytest.mark.slow
def test_on_simulated_time_the_stored_table_comes_first_and_the_new_one_next(table_set: npl.TableSet) -> None:
    with TableSetReplanner(
        CurvatureLookup(table_set), small_table(), ThreadReplanner(wait=True), wait=True
    ) as replanner:
        assert replanner.take(0) is None
        replanner.ask(rescaled(small_table().scenario, 40 / 34.0))
        assert (radius_mm(replanner.take(1)), replanner.source, replanner.busy) == (33.0, "table set", True)
        assert replanner.take(1) is None  # decision 1 is by the stored table, also if the needle comes to rest before
        assert (radius_mm(replanner.take(2)), replanner.source) == (pytest.approx(34.0), "replan")
        assert not replanner.busy
        replanner.ask(rescaled(small_table().scenario, 40 / 34.5))
        assert (radius_mm(replanner.take(3)), replanner.source) == (pytest.approx(34.5), "replan")


class Never(ThreadReplanner):
    """A replanner whose table is never ready."""

    def take(self, step: int) -> None:  # noqa: ARG002
        return None


def test_without_waiting_the_stored_table_comes_while_the_new_one_is_computed(table_set: npl.TableSet) -> None:
    with TableSetReplanner(CurvatureLookup(table_set), small_table(), Never(wait=False), wait=False) as replanner:
        replanner.ask(rescaled(small_table().scenario, 40 / 34.0))
        found = None
        while found is None:
            found = replanner.take(1)
        assert (radius_mm(found), replanner.source) == (33.0, "table set")
        assert replanner.take(2) is None


class SlowReading:
    """Reads tables one at a time, each after a permit, and keeps the order of their radii."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.begun: Queue[float] = Queue()
        self.permits = Semaphore(0)
        read = TableSetEntry.table

        def table(entry: TableSetEntry) -> npl.Table:
            self.begun.put(entry.values["curvature_radius_mm"])
            assert self.permits.acquire(timeout=30)
            return read(entry)

        monkeypatch.setattr(TableSetEntry, "table", table)

    def next(self) -> float:
        return self.begun.get(timeout=30)


@pytest.mark.slow
def test_tables_are_read_ahead_from_the_nearest_curvature(
    table_set: npl.TableSet, monkeypatch: pytest.MonkeyPatch
) -> None:
    reading = SlowReading(monkeypatch)
    reading.permits.release(len(RADII))
    with TableSetReplanner(CurvatureLookup(table_set), small_table(), Never(wait=False), wait=True) as replanner:
        found = [reading.next() for _ in RADII]
        assert found == sorted(RADII, key=lambda radius: abs(1 / radius - 1 / radius_mm(small_table())))
        replanner.ask(rescaled(small_table().scenario, 40 / 29.0))
        assert radius_mm(replanner.take(1)) == 28.0
    assert reading.begun.empty()


def test_the_table_asked_for_is_read_before_those_that_wait(
    table_set: npl.TableSet, monkeypatch: pytest.MonkeyPatch
) -> None:
    reading = SlowReading(monkeypatch)
    with TableSetReplanner(CurvatureLookup(table_set), small_table(), Never(wait=False), wait=True) as replanner:
        first = reading.next()
        replanner.ask(rescaled(small_table().scenario, 40 / 27.0))
        reading.permits.release(len(RADII))
        assert radius_mm(replanner.take(1)) == 28.0
        rest = [reading.next() for _ in RADII[1:]]
    assert first != 28.0
    assert (rest[0], sorted([first, *rest])) == (28.0, sorted(RADII))


def test_no_more_is_read_ahead_than_memory_is_meant_for(
    table_set: npl.TableSet, monkeypatch: pytest.MonkeyPatch
) -> None:
    states = small_table().scenario.states
    monkeypatch.setattr(_table_set_replanning, "_STATES_AHEAD", 2 * states)
    reading = SlowReading(monkeypatch)
    reading.permits.release(len(RADII))
    with TableSetReplanner(CurvatureLookup(table_set), small_table(), Never(wait=False), wait=True) as replanner:
        ahead = {reading.next(), reading.next()}
        replanner.ask(rescaled(small_table().scenario, 40 / 27.0))
        assert radius_mm(replanner.take(1)) == 28.0
    assert (ahead, reading.next(), reading.begun.empty()) == ({37.0, 44.0}, 28.0, True)


@pytest.mark.slow
def test_a_damaged_table_is_no_reason_not_to_plan(tmp_path: Path) -> None:
    small_table().scenario.write(tmp_path / "small.toml")
    sweep = Sweep(str(tmp_path / "small.toml"), [SweptParameter("needle.curvature_radius_mm", values=[33.0])])
    make_table_set(sweep, tmp_path / "store", Engine(workers=0))
    (file,) = (tmp_path / "store").rglob("*.h5")
    file.write_bytes(file.read_bytes()[:-100])
    table_set = npl.TableSet.open(tmp_path / "store")
    told: list[str] = []
    with TableSetReplanner(
        CurvatureLookup(table_set), small_table(), ThreadReplanner(wait=True), wait=True, tell=told.append
    ) as replanner:
        replanner.ask(rescaled(small_table().scenario, 40 / 34.0))
        assert (radius_mm(replanner.take(1)), replanner.source) == (pytest.approx(34.0), "replan")
    assert len(told) == 1
    assert file.name in told[0]


def test_a_plan_that_fails_is_told_after_the_stored_table(table_set: npl.TableSet) -> None:
    scenario = small_table().scenario
    impossible = replace(scenario, grid=replace(scenario.grid, spacing_mm=(1e-3, 1e-3)))
    with TableSetReplanner(
        CurvatureLookup(table_set), small_table(), ThreadReplanner(wait=True), wait=True
    ) as replanner:
        replanner.ask(impossible)
        with pytest.raises(ScenarioError):
            replanner.take(1)
        assert not replanner.busy


@pytest.mark.study
def test_an_insertion_follows_both_tables_and_its_replay_too(
    table_set: npl.TableSet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lab = a_lab(replace(NOISY, curvature_error=0.25), 1)
    setup = RunSetup(FAST, WIDE, coil_of(lab), accepted="a fast lab")
    replanner = TableSetReplanner(CurvatureLookup(table_set), small_table(), ThreadReplanner(wait=True), wait=True)
    with RunRecorder(tmp_path / "run.mcap", small_table(), setup, lab.clock) as recorder:
        report = insertion_in(lab, listeners=[recorder], replanner=replanner).run()
    swapped = [event for event in report.events if event.name is RunEventName.TABLE_SWAPPED]
    assert [event.cause for event in swapped[:2]] == ["table set", "replan"]
    assert swapped[1].step == swapped[0].step + 1
    assert report.steps[swapped[0].step].table_digest == swapped[0].digest
    recording = Recording.read(tmp_path / "run.mcap")
    again = replay(recording, small_table(), table_set)
    assert again.differences == ()
    assert again.report.steps == report.steps
    with pytest.raises(DataError, match="table set: is missing: the insertion used its tables"):
        replay(recording, small_table())
    read = Recording.messages

    def as_once(self: Recording, *given: Any, **named: Any) -> Iterator[Any]:
        """Yield the messages with the former name of the source of stored tables."""
        for message in read(self, *given, **named):
            if message.values.get("cause") == "table set":
                message = replace(message, values=message.values | {"cause": "atlas"})
            yield message

    monkeypatch.setattr(Recording, "messages", as_once)
    assert replay(recording, small_table(), table_set).differences == ()
