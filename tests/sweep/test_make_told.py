"""What making a table set in this process tells."""

import json
from pathlib import Path

import pytest

import needleplan as npl
from needleplan.cli.sweep import _Progress
from needleplan.errors import SweepError
from needleplan.sweep import Engine, Sweep, make_table_set
from tests.cli.commands import needleplan, refused
from tests.sweep.sweeps import write_sweep

HERE = Engine(workers=0)


@pytest.mark.slow
def test_tables_that_are_not_converged_are_told(tmp_path: Path) -> None:
    file = write_sweep(tmp_path)
    file.write_text(
        file.read_text().replace("objective.rotation", "solver.tolerance").replace("1.0, 8.0", "0.01, 1e-9")
    )
    for present in (0, 6):
        report = make_table_set(Sweep.read(file), tmp_path / "store", HERE)
        assert (report.present, report.unconverged, report.complete) == (present, {"precision_limit": 3}, True)
    done = needleplan("sweep", file, "-o", tmp_path / "store", "--workers", "0")
    assert "unconverged  3 tables: precision limit" in done.stdout
    assert json.loads(needleplan("info", tmp_path / "store", "--json").stdout)["unconverged"] == {"precision_limit": 3}


def test_a_check_says_how_many_tables_were_read(sweep: Sweep, store: Path, tmp_path: Path) -> None:
    assert make_table_set(sweep, store, Engine(workers=0), check=True).checked == 6
    done = needleplan("sweep", write_sweep(tmp_path), "-o", store, "--workers", "0", "--check")
    assert "checked      6 tables were read" in done.stdout


@pytest.mark.parametrize("value", [(40.0, 30.0), "30", None, [30.0], True])
def test_values_that_no_point_can_have_are_refused(store: Path, value: object) -> None:
    with pytest.raises(SweepError, match="radius_mm = "):
        npl.TableSet.open(store).select(radius_mm=value)
    assert len(repr(npl.TableSet.open(store)[0])) < 2500


def test_info_shows_a_table_set_and_finds_damaged_tables(store: Path) -> None:
    done = needleplan("info", store)
    assert "tables       6 of 6, " in done.stdout
    assert "radius_mm    30, 40, 50 (needle.curvature_radius_mm)" in done.stdout
    tables = npl.TableSet.open(store)
    one, other = (store / "tables" / each.record["table"][:2] / f"{each.record['table']}.h5" for each in tables[:2])
    one.write_bytes(other.read_bytes())  # whole, but another table
    data = bytearray(other.read_bytes())
    data[len(data) // 2] ^= 1
    other.write_bytes(data)
    done = needleplan("info", store, "--json")
    found = json.loads(done.stdout)["damaged"]
    assert done.returncode == 1
    assert list(found) == ["radius_mm = 30, rotation = 1", "radius_mm = 30, rotation = 8"]
    assert "is not the one that was recorded" in found["radius_mm = 30, rotation = 1"]
    refused(needleplan("info", store, "--print-scenario"), "is an option for a table, not for a table set")
    refused(needleplan("info", store / "tables"), "is no table set")


def test_a_run_without_a_terminal_prints_a_line_each_minute(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = iter([0.0, 1.0, 30.0, 61.0, 90.0, 125.0])
    monkeypatch.setattr("needleplan.cli.sweep.time.monotonic", lambda: next(now))
    told: list[str] = []
    progress = _Progress(lambda text, _: told.append(text))
    for done in (10, 20, 30, 40, 50):
        progress(done, 70)
    assert capsys.readouterr().err == "30 of 70 tables, 2 min left\n50 of 70 tables, 62 s left\n"
    assert told[0] == "10 of 70 tables"
