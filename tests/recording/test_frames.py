"""Every record says in which frame it is, and trials of different frames are not mixed."""

from pathlib import Path

import numpy as np
import pytest

from needleplan.cli import main
from needleplan.diagnosis import diagnose
from needleplan.errors import DataError
from needleplan.identification import curvature
from needleplan.models import ShaftAndTip, SpatialBicycle
from needleplan.recording import ColumnMap, read_records, write_records
from needleplan.reports.diagnosis import compare
from needleplan.signals import FrameName, Record, RecordFrame, Role, require_one_frame

SURFACE = RecordFrame(FrameName.SURFACE, "entry")
TRACKER = RecordFrame(FrameName.TRACKER, "tracker")
COLUMNS = "time=t[s], depth=d[mm], x=d[mm], y=y[mm], z=z[mm]"
ABOVE = ColumnMap.parse(COLUMNS, surface_mm=10.0)


def insertion(name: str, frame: RecordFrame, seed: int) -> Record:
    depth = np.linspace(0.0, 60.0, 200)
    noise = np.random.default_rng(seed).normal(0, 0.05, (2, depth.size))
    columns = {
        "time_s": depth / 5, "depth_mm": depth, "x_mm": depth, "y_mm": depth**2 / 2000 + noise[0], "z_mm": noise[1],
        "force_n": 0.01 * depth + noise[1],
    }  # fmt: skip
    return Record(columns, name, frame=frame)


def foreign(path: Path, depths: list[float], y_mm: float, name: str = "theirs") -> Path:
    """A file whose y and z stand at `y_mm` and -3 mm before the entry at 10 mm, and drift by a tenth of the depth."""
    lines = [
        f"{index},{depth},{y_mm + 0.1 * max(depth - 10, 0)},-3,{name}"
        for index, depth in enumerate(depths)
    ]  # fmt: skip
    path.write_text("\n".join(["t,d,y,z,run", *lines]) + "\n")
    return path


@pytest.mark.parametrize("ending", ["csv", "h5", "mat"])
def test_a_file_keeps_the_frame_and_is_its_provenance(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"two.{ending}"
    write_records([insertion("first", SURFACE, 0), insertion("second", SURFACE, 1)], path)
    for record in read_records(path):
        assert record.frame == RecordFrame(FrameName.SURFACE, "entry", str(path))


@pytest.mark.parametrize("ending", ["csv", "h5", "mat"])
def test_a_file_that_does_not_say_it_has_an_unknown_origin(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"one.{ending}"
    write_records([insertion("first", RecordFrame(), 0)], path)
    (record,) = read_records(path)
    assert str(record.frame) == f"unknown, origin unknown ({path} does not say)"
    (told,) = read_records(path, frame=TRACKER)
    assert told.frame == TRACKER


def test_a_frame_of_another_name_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "one.csv"
    path.write_text("time_s,depth_mm,coordinate_frame\n0,0,table\n1,5,table\n")
    with pytest.raises(DataError, match=r"coordinate_frame = table: must be one of guide, surface, tracker, plan"):
        read_records(path)
    path.write_text("time_s,depth_mm,coordinate_frame\n0,0,surface\n1,5,plan\n")
    with pytest.raises(DataError, match="must be the same in a whole trial"):
        read_records(path)


@pytest.mark.parametrize("other", [TRACKER, RecordFrame(FrameName.SURFACE, "skin marker"), RecordFrame()])
def test_trials_of_different_frames_are_not_mixed(other: RecordFrame) -> None:
    mixed = [insertion("first.csv", SURFACE, 0), insertion("second.csv", other, 1)]
    named = f"frame of second.csv = {other.text}: must be that of first.csv: surface, origin entry"
    force = ShaftAndTip(friction=0.01, cutting=0.1, onset_mm=3.0, presliding_mm=0.3)
    for consumer in (
        lambda: curvature.identify(mixed),
        lambda: diagnose(SpatialBicycle(curvature_per_mm=1e-3), mixed),
        lambda: compare(force, mixed),
    ):
        with pytest.raises(DataError) as caught:
            consumer()
        assert named in str(caught.value)


def test_noise_at_rest_needs_no_frame() -> None:
    rest = Record({"time_s": np.arange(5.0)}, "rest", Role.NOISE, frame=TRACKER)
    assert require_one_frame([rest, insertion("first", SURFACE, 0)]) == SURFACE
    assert require_one_frame([rest]) == RecordFrame()


def test_the_command_refuses_a_mixture_unless_it_is_told_the_frame(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    known, silent = tmp_path / "known.csv", tmp_path / "silent.csv"
    write_records([insertion("first", SURFACE, 0)], known)
    write_records([insertion("second", RecordFrame(), 1)], silent)
    files = ["identify", "curvature", str(known), str(silent)]
    assert main(files) == 2
    said = capsys.readouterr().err
    assert f"{silent} does not say" in said
    assert "--frame" in said
    assert main([*files, "--frame", "surface:entry"]) == 0
    assert "frame: surface, origin entry" in capsys.readouterr().err


def test_depth_counts_from_the_surface_and_y_and_z_from_the_entry(tmp_path: Path) -> None:
    path = foreign(tmp_path / "theirs.csv", [4.0, 6.0, 8.0, 12.0, 20.0, 40.0], -108.0)
    (record,) = read_records(path, columns=ABOVE)
    np.testing.assert_allclose(record["y_mm"], [0.2, 1.0, 3.0], atol=1e-12)
    np.testing.assert_allclose(record["z_mm"], 0.0, atol=1e-12)
    assert record.frame.text == "surface: entry"
    assert any("in the 3 rows before the entry" in note for note in record.notes)


@pytest.mark.parametrize(
    ("depths", "rule"),
    [
        ([12.0, 20.0, 30.0, 40.0], "no row with a number is before the entry, at the reading 10 mm"),
        ([2.0, 5.0, 8.0, 9.0], "the depth never goes beyond the surface at the reading 10 mm"),
    ],
)
def test_y_and_z_without_an_origin_are_an_error_that_names_every_file(
    tmp_path: Path, depths: list[float], rule: str
) -> None:
    good = foreign(tmp_path / "good.csv", [4.0, 6.0, 12.0, 40.0], 1.0)
    bad = [foreign(tmp_path / f"bad_{number}.csv", depths, -108.0 + number) for number in range(2)]
    with pytest.raises(DataError) as one:
        read_records([good, bad[0]], columns=ABOVE)
    assert one.value.source == str(bad[0])
    assert {each.key for each in one.value.mistakes} == {"y_mm", "z_mm"}
    with pytest.raises(DataError) as both:
        read_records([bad[0], good, bad[1]], columns=ABOVE)
    assert [each.key for each in both.value.mistakes] == [
        f"{file}: {name}" for file in bad for name in ("y_mm", "z_mm")
    ]
    assert all(rule in each.rule for each in both.value.mistakes)
    # Without y and z there is no origin to miss, and a noise file is at rest.
    plain = ColumnMap.parse("time=t[s], depth=d[mm]", surface_mm=10.0)
    (record,) = read_records(bad[0], columns=plain)
    assert record["depth_mm"][0] == depths[0] - 10.0
    (rest,) = read_records(bad[0], columns=ABOVE, roles={str(bad[0]): Role.NOISE})
    assert len(rest) == len(depths)


def test_rows_without_a_tip_before_the_entry_are_no_origin(tmp_path: Path) -> None:
    path = tmp_path / "lost.csv"
    path.write_text("t,d,y,z\n0,4,,\n1,6,,\n2,12,5,1\n3,20,6,1\n")
    with pytest.raises(DataError, match="y_mm: has no origin"):
        read_records(path, columns=ABOVE)


def test_a_file_of_several_trials_names_the_one_without_an_origin(tmp_path: Path) -> None:
    whole = foreign(tmp_path / "both.csv", [4.0, 6.0, 12.0, 40.0], 1.0, "first").read_text()
    late = foreign(tmp_path / "late.csv", [12.0, 20.0, 40.0], 1.0, "second").read_text()
    (tmp_path / "both.csv").write_text(whole + late.split("\n", 1)[1])
    columns = ColumnMap.parse(COLUMNS + ", trial=run", surface_mm=10.0)
    with pytest.raises(DataError) as caught:
        read_records(tmp_path / "both.csv", columns=columns)
    assert [each.key for each in caught.value.mistakes] == ["y_mm of second", "z_mm of second"]
