"""Public files as they are, by a map of their columns: what the readers of single formats find, and the steps."""

import re
from pathlib import Path

import numpy as np
import pytest

from needleplan.errors import DataError
from needleplan.recording import ColumnMap, read_records
from needleplan.signals import Record
from tests.real.shared import require

TIP = "time=Tip sec[s]+Tip nanosec[ns], depth=-Tip y[mm], x=-Tip y[mm], y=Tip x[mm], z=Tip z[mm]"
INSERTIONS = sorted(require("real_insertions").glob("*.csv"))


def steps(record: Record) -> tuple[int, float]:
    """Return number and median length (mm) of the movements that the remark on the velocity counts."""
    (found,) = [match for note in record.notes if (match := re.search(r"(\d+) movements of ([\d.]+) mm", note))]
    return int(found[1]), float(found[2])


@pytest.mark.parametrize("path", INSERTIONS, ids=lambda each: each.stem)
def test_stepwise_insertions(path: Path) -> None:
    """The robot made 20 steps of 5 mm; the closed loop more, with corrections."""
    (record,) = read_records(path, columns=TIP)
    known = read_records(path)[0]
    assert len(record) == len(known)
    np.testing.assert_allclose(record["time_s"], known["time_s"], atol=1e-6)
    for name in ("y_mm", "z_mm"):  # the columns are in the frame of the study, the known ones count from the guide
        np.testing.assert_allclose(record[name] - record[name][0], known[name] - known[name][0], atol=1e-6)
    count, length = steps(record)
    assert 19 <= count <= 25
    assert length == pytest.approx(5.0, abs=0.4)


def test_a_curve_without_times() -> None:
    path = require("liver_force", "depth_force.csv")
    (record,) = read_records(path, columns="depth=1[m], force=2[N], speed=3[mm/s]")
    assert len(record) == 312
    np.testing.assert_allclose(np.diff(record["time_s"]), np.diff(record["depth_mm"]) / 3, atol=1e-9)
    with pytest.raises(DataError, match="questionably small, in metres"):
        read_records(path, columns="depth=1[mm], force=2[N], speed=3[mm/s]")


def test_strokes_of_a_rig_with_rests() -> None:
    path = require("friction_rig", "test_data_2.txt")
    columns = ColumnMap.parse("time=Time, depth=Position, force=-Friction", surface_mm=-210.0)
    (record,) = read_records(path, columns=columns, accept_units=True, rate_hz=50.0)
    count, length = steps(record)
    assert abs(count - 102) <= 2  # strokes of 1 s with rests of 1 s, in 213 s
    assert length == pytest.approx(0.227, abs=0.003)
    assert np.ptp(record["force_n"]) == pytest.approx(5.2, abs=0.6)
    way = np.abs(np.diff(record["depth_mm"])).sum()
    speed = np.abs(record["velocity_mm_s"])
    assert float(((speed[1:] + speed[:-1]) / 2).sum() / 50) == pytest.approx(way, rel=0.02)


@pytest.mark.slow
def test_positions_from_the_surface_begin_near_zero_or_are_refused() -> None:
    """At the reading 0 one of the files begins inside of the tissue: its y would be 26 mm off."""
    columns = ColumnMap.parse(TIP, surface_mm=0.0)
    refused = []
    for path in INSERTIONS:
        try:
            (record,) = read_records(path, columns=columns)
        except DataError as error:
            assert error.source == str(path)
            assert "has no origin" in str(error)
            refused.append(path.stem)
        else:
            assert record.frame.text == "surface: entry"
            assert np.abs([record["y_mm"][0], record["z_mm"][0]]).max() < 3
    assert refused == ["exvivo_openloop_03"]
    assert {each.frame.known for each in read_records(INSERTIONS, columns=TIP)} == {False}
