"""The end of an insertion, predicted from its beginning and from earlier insertions."""

import json
from pathlib import Path

import numpy as np
import pytest

from needleplan.errors import DataError
from needleplan.identification import predict_end
from needleplan.models import arc_step
from needleplan.models.deflection import FibreSensors
from needleplan.models.path import ImagePlane
from needleplan.recording import write_records
from needleplan.signals import FrameName, Record, RecordFrame
from tests.cli.commands import needleplan, refused

NOISE_MM = 0.1


def insertion(name: str, curvature: float, heading: float, *, length_mm: float = 100.0, seed: int) -> Record:
    """An arc in the plane xy, straight in the plane xz, by a tracker with white noise."""
    random = np.random.default_rng(seed)
    along = np.arange(0.0, length_mm, 0.5)
    x, y, _ = arc_step(0.0, 0.3, heading, curvature, along)
    columns = {"time_s": along / 5, "x_mm": x, "y_mm": y, "z_mm": 0.02 * along}
    noisy = {
        name: values + random.normal(0, NOISE_MM, along.size) for name, values in columns.items() if name != "time_s"
    }
    return Record({"time_s": columns["time_s"], **noisy}, name)


EARLIER = [insertion(f"earlier {k}", 0.0010 + 0.0001 * k, 0.02 + 0.01 * k, seed=k) for k in range(3)]
END_MM = 95.0


@pytest.mark.slow
def test_the_beginning_tells_more_than_the_earlier_insertions() -> None:
    errors, alone, inside = [], [], []
    for seed in range(10, 14):
        random = np.random.default_rng(seed)
        curvature, heading = 0.0011 + random.normal(0, 1e-4), 0.03 + random.normal(0, 0.01)
        whole = insertion("now", curvature, heading, seed=seed)
        end = predict_end(whole, EARLIER, depth_mm=END_MM, until_mm=50.0, layers=1)
        x, y, _ = arc_step(0.0, 0.3, heading, curvature, np.linspace(90, 100, 1001))
        true = np.interp(END_MM, x, y)
        assert end.z_mm is not None
        errors.append(abs(end.y_mm - true))
        alone.append(abs(end.before.y_mm - true))
        inside.append(end.inside)
        assert abs(end.z_mm - 0.02 * END_MM) < 0.5
        assert end.measured_mm is not None
        assert end.measured_mm[0] == pytest.approx(true, abs=3 * NOISE_MM)
        assert end.error_mm == pytest.approx(
            np.hypot(end.y_mm - end.measured_mm[0], end.z_mm - (end.measured_mm[1] or 0.0))
        )
    assert np.mean(errors) < 0.5 * np.mean(alone)
    assert all(inside)


def test_earlier_insertions_that_scatter_widen_the_region() -> None:
    calm = [insertion(f"calm {k}", 0.0011, 0.03, seed=30 + k) for k in range(3)]
    wild = [wandering(each, 40 + k) for k, each in enumerate(calm)]
    now = insertion("now", 0.0011, 0.03, length_mm=50, seed=50)
    one, other = (predict_end(now, earlier, depth_mm=END_MM, layers=1) for earlier in (calm, wild))
    narrow, wide = (end.y_region_mm[1] - end.y_region_mm[0] for end in (one, other))
    assert wide > 2 * narrow
    assert other.y_region_mm[0] < one.y_mm < other.y_region_mm[1]


def wandering(record: Record, seed: int) -> Record:
    """The record with a heading that goes off in the second half, by 0.1 rad."""
    sign = 1 - 2 * (seed % 2)
    beyond = np.maximum(record["x_mm"] - 50, 0)
    return Record(record.columns | {"y_mm": record["y_mm"] + sign * 0.1 * beyond}, f"wild {seed}")


def test_what_comes_after_the_beginning_does_not_count() -> None:
    whole = insertion("now", 0.0012, 0.03, seed=20)
    begun = Record({name: values[:100] for name, values in whole.columns.items()}, "now")
    one = predict_end(whole, EARLIER, depth_mm=END_MM, until_mm=float(begun["x_mm"].max()), layers=1)
    other = predict_end(begun, EARLIER, depth_mm=END_MM, layers=1)
    assert (one.y_mm, one.y_region_mm, one.z_mm) == (other.y_mm, other.y_region_mm, other.z_mm)
    assert other.measured_mm is None
    assert other.inside is None


def test_an_insertion_in_the_plane_has_no_z() -> None:
    flat = [Record({name: each[name] for name in ("time_s", "x_mm", "y_mm")}, each.trial) for each in EARLIER]
    end = predict_end(insertion("now", 0.0012, 0.03, length_mm=50, seed=21), flat, layers=1)
    assert end.z_mm is None
    assert end.z_region_mm is None
    assert len(end.lines()) == 2


def test_what_cannot_be_predicted_is_refused() -> None:
    whole = insertion("now", 0.0012, 0.03, seed=22)
    with pytest.raises(DataError, match=r"has passed the end at 80 mm"):
        predict_end(whole, EARLIER, depth_mm=80, layers=1)
    with pytest.raises(DataError, match="has no sample"):
        predict_end(whole, EARLIER, until_mm=1e-6, layers=1)
    with pytest.raises(DataError, match="until_mm = -5: must be a finite number of mm above 0"):
        predict_end(whole, EARLIER, until_mm=-5, layers=1)
    with pytest.raises(DataError, match="depth_mm = nan: must be a finite number of mm above 0"):
        predict_end(whole, EARLIER, depth_mm=np.nan, layers=1)
    elsewhere = Record(whole.columns, "now", frame=RecordFrame(FrameName.TRACKER, "coil"))
    earlier = [Record(each.columns, each.trial, frame=RecordFrame(FrameName.GUIDE, "guide")) for each in EARLIER]
    with pytest.raises(DataError, match="frame"):
        predict_end(elsewhere, earlier, layers=1)


def test_files_and_tables_are_taken_as_records_are(tmp_path: Path) -> None:
    now = insertion("now", 0.0012, 0.03, seed=23)
    write_records(EARLIER, tmp_path / "earlier.csv")
    write_records([now], tmp_path / "now.csv")
    expected = predict_end(now, EARLIER, until_mm=50, layers=1)
    for beginning, earlier in (
        (tmp_path / "now.csv", str(tmp_path / "earlier.csv")),
        (dict(now.columns), [dict(each.columns) for each in EARLIER]),
    ):
        end = predict_end(beginning, earlier, until_mm=50, layers=1)
        assert end.y_mm == pytest.approx(expected.y_mm)
    with pytest.raises(DataError, match="must hold one insertion, not 3"):
        predict_end(EARLIER, now, layers=1)
    with pytest.raises(DataError, match="must hold one insertion, not 0"):
        predict_end([], now, layers=1)


@pytest.mark.slow
def test_the_command(tmp_path: Path) -> None:
    write_records(EARLIER, tmp_path / "earlier.csv")
    write_records([insertion("now", 0.0012, 0.03, seed=23)], tmp_path / "now.csv")
    words = ("predict", "now.csv", "--earlier", "earlier.csv", "--depth", "95", "--until", "50")
    done = needleplan(*words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "in the region" in done.stdout
    assert done.stdout.count("by the earlier insertions alone") == 3
    answer = json.loads(needleplan(*words, "--json", cwd=tmp_path).stdout)
    assert answer["inside"] is True
    assert answer["y_region_mm"][0] < answer["y_mm"] < answer["y_region_mm"][1]
    refused(
        needleplan("predict", "earlier.csv", "--earlier", "now.csv", cwd=tmp_path), "must hold one insertion, not 3"
    )
    refused(needleplan("predict", "now.csv", "--earlier", "now.csv", cwd=tmp_path), "is given twice")


def test_curvature_sensors_continue_a_path_whose_tracker_is_lost() -> None:
    sensors = FibreSensors.at((5.0, 20.0, 40.0))

    def trial(curvature: float, seed: int, until_mm: float = 100.0, lost_mm: float = 100.0) -> Record:
        random, depth = np.random.default_rng(seed), np.arange(0.0, until_mm, 0.5)
        # The second tissue, from 60 mm on, bends the needle twice as much.
        y = curvature * (depth**2 / 2 + np.maximum(depth - 60, 0) ** 2 / 2) + random.normal(0, 0.1, depth.size)
        columns = {"time_s": depth / 5, "x_mm": depth, "depth_mm": depth, "y_mm": np.where(depth < lost_mm, y, np.nan)}
        for name, behind in zip(sensors.columns[::2], sensors.from_tip_mm, strict=True):
            place = depth - behind
            true = curvature * ((place > 0) + 1.0 * (place > 60))
            columns[name] = true + random.normal(0, 1e-4, depth.size)
            columns[name.replace("_y_", "_z_")] = random.normal(0, 1e-4, depth.size)
        return Record(columns, f"of {curvature}")

    earlier = [trial(each, seed) for seed, each in enumerate((0.0010, 0.0012, 0.0009, 0.0011))]
    begun, true = trial(0.0016, 9, 80.0, 20.0), 0.0016 * (95**2 + 35**2) / 2
    alone, together = (predict_end(begun, earlier, depth_mm=95, fibre=each) for each in (None, sensors))
    assert abs(together.y_mm - true) < 0.5 < abs(alone.y_mm - true)
    assert (alone.until_mm, together.until_mm) == pytest.approx((20, 80), abs=0.5)
    with pytest.raises(DataError, match="fbg1_y_per_mm: is missing or empty"):
        predict_end(insertion("a", 0.001, 0.0, seed=1), earlier, fibre=sensors)


def test_images_continue_a_path_whose_tracker_is_lost(tmp_path: Path) -> None:
    plane = ImagePlane(origin_mm=(20.0, -5.0, 0.0))

    def trial(curvature: float, seed: int, until_mm: float = 100.0, lost_mm: float = 100.0) -> Record:
        random, depth = np.random.default_rng(seed), np.arange(0.0, until_mm, 1.0)
        y = curvature * depth**2 / 2
        measured = np.where(depth < lost_mm, y + random.normal(0, 0.1, depth.size), np.nan)
        there = np.arange(depth.size) % 2 == 0
        u, v = (np.where(there, true + random.normal(0, 0.5, depth.size), np.nan) for true in (depth - 20, y + 5))
        columns = {"time_s": depth / 5, "x_mm": depth, "depth_mm": depth, "y_mm": measured}
        return Record(columns | {"image_u_mm": u, "image_v_mm": v}, f"of {curvature}")

    earlier = [trial(each, seed) for seed, each in enumerate((0.0010, 0.0012, 0.0009))]
    begun, true = trial(0.0016, 9, 80.0, 20.0), 0.0016 * 95**2 / 2
    alone, together = (predict_end(begun, earlier, depth_mm=95, plane=each) for each in (None, plane))
    assert abs(together.y_mm - true) < 0.5 * abs(alone.y_mm - true)
    assert together.until_mm == pytest.approx(78, abs=1)
    write_records(earlier, tmp_path / "earlier.csv")
    write_records([begun], tmp_path / "now.csv")
    words = ("predict", "now.csv", "--earlier", "earlier.csv", "--depth", "95")
    place = "20,-5,0,1,0,0,0,1,0"
    answer = json.loads(needleplan(*words, "--image-plane", place, "--json", cwd=tmp_path).stdout)
    assert answer["y_mm"] == pytest.approx(together.y_mm, abs=1e-3)
    refused(needleplan(*words, "--image-plane", "20,-5,0", cwd=tmp_path), "--image-plane")
    refused(needleplan(*words, "--image-plane", place[:-5] + "1,0,0", cwd=tmp_path), "right angle")
    refused(needleplan(*words, "--image-delay", "0.1", cwd=tmp_path), "--image-delay", "with --image-plane")
