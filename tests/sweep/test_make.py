"""Making a table set in this process: what is solved, what is kept, and what a damaged or foreign folder does."""

import json
import os
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import needleplan as npl
from needleplan.errors import OutputError, SweepError
from needleplan.planning import Path as PlannedPath
from needleplan.sweep import Engine, Sweep, SweptParameter, TableSetReport, make_table_set
from needleplan.sweep._store import TableSetStore
from needleplan.sweep._swept_parameter import record_unit
from tests.cli.commands import needleplan, refused
from tests.sweep.sweeps import write_sweep

HERE = Engine(workers=0)


def counts(report: TableSetReport) -> tuple[int, int, int]:
    return report.solved, report.read, report.present


@pytest.mark.slow
def test_tables_are_those_of_plan(sweep: Sweep, store: Path) -> None:
    tables = npl.TableSet.open(store)
    assert [tuple(each.values.values()) for each in tables] == [(r, c) for r in (30.0, 40.0, 50.0) for c in (1.0, 8.0)]
    base = npl.Scenario.read(sweep.scenario)
    for entry in tables:
        scenario = base.with_curvature(1 / entry.values["radius_mm"])
        scenario = replace(scenario, objective=replace(scenario.objective, rotation=entry.values["rotation"]))
        wanted = npl.plan(scenario)
        best = wanted.best_entry()
        assert entry.table().digest == wanted.digest == entry.record["digest"]
        assert (entry.record["success"], entry.record["entry_y_mm"]) == (best.success, best.pose.y_mm)
        assert entry.record["length_mm"] == wanted.path(best).length_mm


@pytest.mark.slow
def test_a_second_run_does_nothing_and_a_changed_sweep_does_what_is_new(tmp_path: Path, sweep: Sweep) -> None:
    store = tmp_path / "store"
    make_table_set(sweep, store, HERE)
    before = {file: file.stat().st_mtime_ns for file in store.rglob("*") if file.is_file()}
    assert counts(make_table_set(sweep, store, HERE)) == (0, 0, 6)
    assert {file: file.stat().st_mtime_ns for file in store.rglob("*") if file.is_file()} == before
    changed = Sweep.read(write_sweep(tmp_path, radii=[40.0, 45.0]))
    assert counts(make_table_set(changed, store, HERE)) == (2, 0, 2)
    assert len(npl.TableSet.open(store)) == 4
    assert counts(make_table_set(sweep, store, HERE)) == (0, 0, 6)


@pytest.mark.slow
def test_parts_do_not_overlap_and_make_the_whole(tmp_path: Path, sweep: Sweep) -> None:
    reports = [make_table_set(sweep, tmp_path / "parts", HERE, part=(number, 4)) for number in (1, 2, 3, 4)]
    assert [report.solved for report in reports] == [2, 2, 1, 1]
    assert counts(make_table_set(sweep, tmp_path / "parts", HERE)) == (0, 0, 6)


def test_the_parts_of_a_job_array_may_begin_at_the_same_time(tmp_path: Path, sweep: Sweep) -> None:
    together = threading.Barrier(4)

    def part(number: int) -> int:
        together.wait(20)
        return make_table_set(sweep, tmp_path / "store", HERE, part=(number, 4)).solved

    with ThreadPoolExecutor(4) as pool:
        assert sum(pool.map(part, (1, 2, 3, 4))) == 6
    assert counts(make_table_set(sweep, tmp_path / "store", HERE)) == (0, 0, 6)
    assert not list((tmp_path / "store").glob(".*"))


@pytest.mark.slow
def test_runs_at_the_same_time_begin_at_different_tables(
    tmp_path: Path, sweep: Sweep, monkeypatch: pytest.MonkeyPatch
) -> None:
    def order(first: int) -> list[str]:
        monkeypatch.setattr("needleplan.sweep._make.random.randrange", lambda _: first)
        store = tmp_path / str(first)
        make_table_set(sweep, store, HERE)
        (file,) = (store / "records").iterdir()
        return [json.loads(line)["table"] for line in file.read_text().splitlines()]

    first, other = order(0), order(4)
    assert first == [point.address for point in TableSetStore.open(tmp_path / "0").points]
    assert other == first[4:] + first[:4]


@pytest.mark.slow
def test_a_run_that_was_stopped_at_once_is_no_other_folder(tmp_path: Path, sweep: Sweep) -> None:
    (tmp_path / "store" / "tables").mkdir(parents=True)
    assert counts(make_table_set(sweep, tmp_path / "store", HERE)) == (6, 0, 0)


def test_a_table_without_its_record_is_read_and_not_solved(sweep: Sweep, store: Path) -> None:
    records = npl.TableSet.open(store).to_pandas().drop(columns=["at", "worker_s", "solved"])
    for file in (store / "records").iterdir():
        file.unlink()
    assert npl.TableSet.open(store)[0].record is None
    assert counts(make_table_set(sweep, store, HERE)) == (0, 6, 0)
    again = npl.TableSet.open(store).to_pandas().drop(columns=["at", "worker_s", "solved"])
    assert again.equals(records)


def test_an_unfinished_record_is_ignored_and_made_again(sweep: Sweep, store: Path) -> None:
    (file,) = (store / "records").iterdir()
    file.write_bytes(file.read_bytes()[:-20])
    assert counts(make_table_set(sweep, store, HERE)) == (0, 1, 5)


def test_a_missing_or_damaged_table_is_solved_again(sweep: Sweep, store: Path) -> None:
    first, second = sorted((store / "tables").rglob("*.h5"))[:2]
    first.unlink()
    second.write_bytes(second.read_bytes()[:1000])
    for file in (store / "records").iterdir():
        file.unlink()
    assert counts(make_table_set(sweep, store, HERE)) == (2, 4, 0)
    assert all(entry.table().digest == entry.record["digest"] for entry in npl.TableSet.open(store))


def test_other_entries_need_other_records_but_no_new_tables(sweep: Sweep, store: Path) -> None:
    other = replace(sweep, entry=replace(sweep.entry, start=(0.0, 20.0, 10.0)))
    assert counts(make_table_set(other, store, HERE)) == (0, 6, 0)
    entry = npl.TableSet.open(store)[0]
    wanted = entry.table().lookup(entry.table().start((0.0, 20.0, np.radians(10.0))))
    assert (entry.record["start_success"], entry.record["start_cost"]) == (wanted.success, wanted.value)


def test_combinations_that_are_no_scenario_are_failures_and_the_rest_is_made(tmp_path: Path, sweep: Sweep) -> None:
    target = SweptParameter("target.center_mm.x", name="x", values=[50.0, -5.0, 90.0])
    report = make_table_set(replace(sweep, parameters=(target,)), tmp_path / "store", HERE)
    assert report.solved == 1
    assert report.points == 3
    assert sorted(report.failures) == ["x = -5", "x = 90"]
    assert "must lie in the workspace" in report.failures["x = 90"]
    assert not report.complete
    tables = npl.TableSet.open(tmp_path / "store")
    with pytest.raises(SweepError, match="must lie in the workspace"):
        tables.table(x=90.0)


def test_selections(store: Path) -> None:
    tables = npl.TableSet.open(store)
    assert len(tables.select(radius_mm=40)) == 2
    assert len(tables.select(radius_mm=(35.0, 60.0), rotation=8.0)) == 2
    assert len(tables.select(radius_mm=41.0)) == 0
    assert tables.select(radius_mm=44.0, rotation=100.0, nearest=True)[0].values == {"radius_mm": 40.0, "rotation": 8.0}
    with pytest.raises(SweepError, match='did you mean "radius_mm"'):
        tables.select(radius_m=40.0)
    with pytest.raises(SweepError, match="selects 2 tables, not 1"):
        tables.table(radius_mm=40.0)
    grid = tables.to_xarray()
    assert dict(grid.sizes) == {"radius_mm": 3, "rotation": 2}
    one = tables.select(radius_mm=50.0, rotation=8.0)[0]
    assert grid.success.sel(radius_mm=50.0, rotation=8.0).item() == one.record["success"]


def test_files_of_killed_writers_are_removed_after_an_hour(sweep: Sweep, store: Path) -> None:
    folder = next((store / "tables").iterdir())
    old, new = folder / ".a.h5.12.partial", folder / ".b.h5.34.partial"
    old.write_bytes(b"half")
    new.write_bytes(b"half")
    os.utime(old, (0, 0))
    assert counts(make_table_set(sweep, store, HERE)) == (0, 0, 6)
    assert (old.exists(), new.exists()) == (False, True)


def test_arc_points_lie_on_the_circle() -> None:
    turn = np.array([0.0, 0.3, 0.1, 0.1])
    poses = np.zeros((4, 4))
    poses[:, 2] = turn
    for number, change in enumerate(np.diff(turn)):
        chord = 5.0 * np.sinc(change / 2 / np.pi)
        along = turn[number] + change / 2
        poses[number + 1, :2] = poses[number, :2] + chord * np.array([np.cos(along), np.sin(along)])
    scenario = npl.Scenario.read("four_obstacles")
    points = PlannedPath(poses, np.zeros(3, np.uint8), npl.Outcome.TARGET, 15.0, 0.0, scenario).points_mm
    assert np.allclose(points[8::8], poses[1:, :2])
    center = np.array([0.0, 5.0 / 0.3])
    assert np.allclose(np.hypot(*(points[:9] - center).T), 5.0 / 0.3)
    assert np.allclose(np.diff(points[16:], axis=0), (poses[3, :2] - poses[2, :2]) / 8)


def test_the_folder_of_another_sweep_or_of_other_files_is_refused(tmp_path: Path, sweep: Sweep, store: Path) -> None:
    other = replace(sweep, parameters=(SweptParameter("objective.rotation", values=[1.0]),))
    with pytest.raises(SweepError, match="set of another sweep, over radius_mm, rotation; this one is over rotation"):
        make_table_set(other, store, HERE)
    with pytest.raises(SweepError, match=r"is no table set: tables\.jsonl cannot be read"):
        make_table_set(sweep, tmp_path, HERE)


@pytest.mark.parametrize("line", ["", "{", "[]", '{"schema": "needleplan.tables/9"}', '{"schema": 3}', "null"])
def test_a_damaged_list_is_refused(store: Path, line: str) -> None:
    rest = (store / "tables.jsonl").read_text().split("\n", 1)[1]
    (store / "tables.jsonl").write_text(line + "\n" + rest)
    with pytest.raises(SweepError):
        TableSetStore.open(store)


@pytest.mark.slow
def test_the_command(tmp_path: Path) -> None:
    file = write_sweep(tmp_path)
    done = needleplan("sweep", file, "-o", tmp_path / "store", "--array", "1/2", "--workers", "0", "--json")
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert (answer["solved"], answer["complete"]) == (3, True)
    done = needleplan("sweep", file, "-o", tmp_path / "store", "--workers", "0")
    assert "3 solved, 3 there before, of 6" in done.stdout


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--array", "3/2"), "--array = 3/2: must be K/N"),
        (("--array", "x"), "--array = x: must be K/N"),
        (("--workers", "-1"), "workers = -1: must be a whole number from 0"),
        (("--workers", "1", "--scheduler", "tcp://127.0.0.1:1"), "must be left out beside a scheduler"),
        (("--wait", "nan", "--workers", "0"), "wait_s = nan"),
        (("--scheduler", "nonsense://x", "--wait", "1"), "scheduler = nonsense://x"),
        (("--scheduler", "foo", "--wait", "1"), "is no scheduler address: missing port"),
        (("--scheduler", "", "--wait", "1"), "is no scheduler address: missing port"),
        (("--scheduler", "tcp://127.0.0.1:9", "--wait", "1"), "no scheduler answers within 1 s"),
    ],
)
def test_wrong_options(tmp_path: Path, options: tuple[str, ...], says: str) -> None:
    refused(needleplan("sweep", write_sweep(tmp_path), "-o", tmp_path / "store", *options), says)


def test_a_folder_that_cannot_be_written(tmp_path: Path, store: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    changed = Sweep.read(write_sweep(tmp_path, radii=[45.0]))
    file = tmp_path / "file"
    file.write_text("")
    refused(needleplan("sweep", tmp_path / "sweep.toml", "-o", file / "store", "--workers", "0"), "cannot be made")
    monkeypatch.setattr(os, "access", lambda _, mode: mode != os.W_OK)  # root may write where modes forbid it
    with pytest.raises(OutputError, match=r"store: cannot be written \(a read-only disk.* 2 of its tables are missing"):
        make_table_set(changed, store, HERE)


def test_a_sweep_without_a_scenario_leaves_a_store_as_it_is(tmp_path: Path, store: Path) -> None:
    before = (store / "tables.jsonl").read_bytes()
    impossible = Sweep.read(write_sweep(tmp_path, radii=[-1.0]))
    for folder in (store, tmp_path / "new"):
        with pytest.raises(SweepError, match="no combination of values is a scenario"):
            make_table_set(impossible, folder, HERE)
    assert (store / "tables.jsonl").read_bytes() == before
    assert not (tmp_path / "new").exists()


def flip(file: Path, at: int) -> None:
    data = bytearray(file.read_bytes())
    data[at] ^= 4
    file.write_bytes(data)


def test_damaged_tables_are_made_again(sweep: Sweep, store: Path) -> None:
    first, second, third = sorted((store / "tables").rglob("*.h5"))[:3]
    whole = [file.read_bytes() for file in (first, second)]
    first.write_bytes(whole[0][:-100])
    third.unlink()
    report = make_table_set(sweep, store, HERE)
    assert (report.solved, report.present) == (2, sweep.tables - 2)
    flip(second, len(whole[1]) // 2)
    assert make_table_set(sweep, store, HERE).present == sweep.tables
    told: list[str] = []
    report = make_table_set(sweep, store, HERE, check=True, tell=told.append)
    assert (report.solved, report.present, len(told)) == (1, sweep.tables - 1, 1)
    assert second.name in told[0]
    assert make_table_set(sweep, store, HERE, check=True).present == sweep.tables


def test_a_changed_record_is_made_again_and_a_changed_list_is_refused(sweep: Sweep, store: Path) -> None:
    (file,) = (store / "records").iterdir()
    text = file.read_text()
    success = json.loads(text.splitlines()[0])["success"]
    file.write_text(text.replace(f'"success":{success}', '"success":0.125', 1))
    assert sum(each.record is None for each in npl.TableSet.open(store)) == 1
    report = make_table_set(sweep, store, HERE)
    assert (report.read, report.present) == (1, sweep.tables - 1)
    assert success in [each.record["success"] for each in npl.TableSet.open(store)]
    listed = store / "tables.jsonl"
    lines = listed.read_text().splitlines()
    lines[1] = lines[1].replace("3", "4", 1)
    listed.write_text("\n".join(lines) + "\n")
    with pytest.raises(SweepError, match=r"tables\.jsonl is damaged .*: remove this file and make the sweep again"):
        make_table_set(sweep, store, HERE)
    listed.unlink()
    assert make_table_set(sweep, store, HERE).present == sweep.tables


def test_tables_of_another_sweep_are_told(tmp_path: Path, sweep: Sweep, store: Path) -> None:
    fewer = Sweep.read(write_sweep(tmp_path, radii=[next(iter(sweep.parameters[0].values))]))
    told: list[str] = []
    make_table_set(fewer, store, HERE, tell=told.append)
    assert "belong to another sweep or version; they stay" in told[0]


def test_lists_become_texts_in_xarray(tmp_path: Path) -> None:
    pytest.importorskip("xarray")
    grid = SweptParameter("grid.spacing_mm", values=[[4.0, 4.0], [5.0, 5.0]])
    make_table_set(Sweep("four_obstacles", [SweptParameter("objective.rotation", values=[4.0]), grid]), tmp_path, HERE)
    found = npl.TableSet.open(tmp_path).to_xarray()
    assert found.success.dims == ("rotation", "spacing_mm")
    assert found.spacing_mm.values.tolist() == ["[4.0, 4.0]", "[5.0, 5.0]"]


def test_numbers_in_xarray_have_units(store: Path) -> None:
    pytest.importorskip("xarray")
    data = npl.TableSet.open(store).to_xarray()
    wanted = {
        "length_mm": "mm",
        "entry_heading_rad": "rad",
        "seconds": "s",
        "radius_mm": "mm",
        "rotation": "cost units",
    }
    assert {name: data[name].attrs["units"] for name in wanted} == wanted
    assert ("units" in data["success"].attrs, data.attrs["title"]) == (False, "Radius and rotation")
    assert (record_unit("direction_s"), record_unit("entry_s_mm")) == ("", "mm")


def test_a_table_that_is_not_there_is_named_by_its_values(store: Path) -> None:
    tables = npl.TableSet.open(store)
    for file in (store / "tables").rglob("*.h5"):
        file.unlink()
    with pytest.raises(
        SweepError, match=r"the table for radius_mm = 30, rotation = 1 is not there: it is not made yet"
    ):
        tables[0].table()
