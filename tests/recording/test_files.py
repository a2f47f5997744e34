"""Files of records: what is read is what was written, and every mistake gives one clear message."""

import io
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from needleplan.artifacts import digest
from needleplan.errors import DataError, OutputError
from needleplan.recording import parse_records, read_records, write_records
from needleplan.signals import Record, Role

GOOD = "time_s,depth_mm,force_n\n" + "".join(f"{i / 100},{i / 10},{0.1 + i / 1000}\n" for i in range(20))


def trial(name: str, samples: int, role: Role = Role.TRAIN) -> Record:
    time = np.arange(samples) / 200
    force = np.sin(7 * time) / 3
    force[samples // 2] = np.nan
    columns = {"time_s": time, "depth_mm": 10 * time, "velocity_mm_s": np.full(samples, 10.0), "force_n": force}
    return Record(columns, name, role, tuple("in" if i < samples // 2 else "out" for i in range(samples)))


@pytest.mark.parametrize("name", ["data.csv", "data.h5", "data.hdf5"])
def test_what_was_written_is_read(tmp_path: Path, name: str) -> None:
    written = [trial("first, of many", 100), trial("zweite é", 130, Role.HOLDOUT)]
    its_digest = write_records(written, tmp_path / name)
    found = read_records(tmp_path / name)
    assert [each.trial for each in found] == ["first, of many", "zweite é"]
    for before, after in zip(written, found, strict=True):
        assert after.role is before.role
        assert after.phase == before.phase
        assert after.digest == its_digest == digest((tmp_path / name).read_bytes())
        assert after.columns.keys() == before.columns.keys()
        for column in before.columns:
            np.testing.assert_array_equal(after[column], before[column])
        assert any(f"force_n is missing in 1 of {len(before)} rows" in note for note in after.notes)


def test_a_column_that_only_one_trial_has_survives(tmp_path: Path) -> None:
    written = [trial("a", 50), trial("b", 50).with_column("torque_n_mm", np.arange(50.0))]
    write_records(written, tmp_path / "two.csv")
    first, second = read_records(tmp_path / "two.csv")
    assert "torque_n_mm" not in first.columns
    assert "torque_n_mm has no number in this trial, and was left out" in first.notes
    np.testing.assert_array_equal(second["torque_n_mm"], np.arange(50.0))


@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize("ending", ["\n", "\r\n", "\r"])
def test_usual_kinds_of_csv(separator: str, ending: str) -> None:
    text = "\ufeff# made by a logger\n" + GOOD.replace(",", separator)
    (record,) = parse_records(text.replace("\n", ending).encode(), "run 7.csv")
    assert record.trial == "run 7"
    assert len(record) == 20
    assert record["force_n"][-1] == 0.1 + 19 / 1000


def test_datasets_in_the_root_are_columns() -> None:
    image = io.BytesIO()
    with h5py.File(image, "w") as file:
        file["time_s"] = np.tile(np.arange(5) / 10, 2)
        file["depth_mm"] = np.arange(10)
        file["trial"] = [b"one"] * 5 + [b"two"] * 5
        file["comment"] = "nothing"
    records = parse_records(image.getvalue(), "x.h5")
    assert [(each.trial, len(each)) for each in records] == [("one", 5), ("two", 5)]
    assert "left out: comment" in records[0].notes[0]


def test_files_with_the_same_names_stay_apart(tmp_path: Path) -> None:
    for folder, samples in (("a", 30), ("b", 31)):
        (tmp_path / folder).mkdir()
        write_records([trial("one", samples)], tmp_path / folder / "data.csv")
    found = read_records([tmp_path / "a" / "data.csv", tmp_path / "b" / "data.csv"])
    assert found[0].trial == f"{tmp_path / 'a' / 'data.csv'}: one"
    assert len({each.trial for each in found}) == 2


def changed(line: int, text: str) -> str:
    lines = GOOD.splitlines()
    lines[line] = text
    return "\n".join(lines)


MISTAKES = {
    "empty": ("", "is empty: it must begin with a header"),
    "header only": ("time_s,force_n\n", "has a header but no rows"),
    "one row": ("time_s,force_n\n0,1\n", "too short: a trial has at least 2 samples"),
    "no time": ("depth_mm,force_n\n0,1\n", "time_s: is missing"),
    "twice": ("time_s,force_n,force_n\n0,1,1\n", "force_n: occurs twice"),
    "depth in metres by name": ("time_s,depth_m\n0,1\n", "depth_m: must be depth_mm: multiply by 1000"),
    "angle in degrees by name": ("time_s,angle_deg\n0,1\n", "must be angle_rad: multiply by 0.01745329252"),
    "time in ms by name": ("time_ms,force_n\n0,1\n", "must be time_s: multiply by 0.001"),
    "no unit": ("time_s,force\n0,1\n", 'force: must carry its unit, N: convert where necessary and rename it "force'),
    "capitals": ("time_s,Force_N\n0,1\n", 'must be written "force_n"'),
    "spelling": ("time_s,velocty_mm_s\n0,1\n", 'did you mean "velocity_mm_s"?'),
    "too few cells": (changed(3, "0.02,0.2"), "line 4: must have 3 cells like the header, not 2"),
    "decimal commas": (changed(3, "0,02,0,2,0,1"), "decimal commas are not read"),
    "a separator at the end": (
        changed(3, "0.02,0.2,0.1,"),
        "line 4: must have 3 cells like the header, not 4; the line ends with a separator that the header",
    ),
    "rows in any order": (
        "time_s,force_n\n" + "".join(f"{(7 * i) % 20},0.1\n" for i in range(20)),
        "6 decreasing in the trial. The rows are not in order of time: sort them",
    ),
    "a word": (changed(3, "0.02,deep,0.1"), "depth_mm (line 4) = deep: must be a number in mm"),
    "infinite": (changed(3, "0.02,inf,0.1"), "depth_mm (line 4) = inf"),
    "stray quote": (changed(3, '0.02,"0.2,0.1'), "line 4"),
    "missing time": (changed(3, ",0.2,0.1"), "time_s (line 4) = nan: must be a number"),
    "repeated time": (changed(3, "0.01,0.2,0.1"), "time_s (line 4) = 0.01: must be greater than the time before it"),
    "decreasing time": (changed(3, "0.005,0.2,0.1"), "1 decreasing in the trial"),
    "no motion": (changed(3, "0.02,,0.1").replace("0.05,0.5", "0.05,"), "depth_mm: is missing in 2 of 20 rows"),
    "role": ("time_s,force_n,role\n0,1,test\n1,1,test\n", "role = test: must be one of train, holdout, reference, "),
    "roles": ("time_s,force_n,role\n0,1,train\n1,1,noise\n", "must be the same in a whole trial"),
    "depth in metres": ("time_s,depth_mm\n0,0.01\n1,0.09\n", "depth_mm = 0.08 mm: is questionably small, in metres?"),
    "speed in m/s": ("time_s,velocity_mm_s\n0,0.01\n1,0.009\n", "in metres per second?"),
    "force in mN": ("time_s,force_n\n0,10\n1,900\n", "force_n = 900 N: is questionably large, in millinewtons"),
    "degrees": ("time_s,angle_rad\n0,0\n1,90\n", "in degrees?"),
    "positions in metres": ("time_s,x_mm,y_mm\n0,0,0\n1,0.01,0.001\n", "x_mm = 0.01 mm: is questionably small"),
    "time in ms": ("time_s,force_n\n0,0.1\n5,0.2\n10,0.2\n", "in milliseconds?"),
    "velocity does not fit": (
        "time_s,depth_mm,velocity_mm_s\n" + "".join(f"{i},{i},0.1\n" for i in range(9)),
        "velocity_mm_s: must be the change of depth_mm per time, which is 10 times as much",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", MISTAKES)
def test_every_mistake_gives_a_clear_message(name: str) -> None:
    text, message = MISTAKES[name]
    with pytest.raises(DataError) as raised:
        parse_records(text.encode(), "data.csv")
    assert message in str(raised.value)
    assert str(raised.value).startswith("data.csv: ")
    assert "\n" not in str(raised.value)


def test_questioned_units_can_be_meant() -> None:
    text, _ = MISTAKES["depth in metres"]
    (record,) = parse_records(text.encode(), accept_units=True)
    assert record["depth_mm"][-1] == 0.09
    quiet = "time_s,depth_mm,role\n0,0.001,noise\n1,0.002,noise\n"
    assert parse_records(quiet.encode())[0].role is Role.NOISE


def test_what_is_strange_but_usable_is_noted() -> None:
    rows = [f"{t},{d},0.5\n" for t, d in ((0, 0), (0.01, 1), (0.02, 2), (0.5, 3), (0.51, 4))]
    (record,) = parse_records(("time_s,depth_mm,force_n\n" + "".join(rows)).encode())
    gap, short, constant = record.notes
    assert gap.startswith("1 gap in time_s; the longest, after 0.02 s (line 4), is 0.48 s")
    assert short == "only 5 samples: too few to identify a model reliably"
    assert constant.startswith("force_n is constant, 0.5")


def test_rows_without_a_depth_are_left_out_and_counted() -> None:
    (record,) = parse_records(changed(3, "0.02,nan,0.1").encode())
    assert len(record) == 19
    assert "1 of 20 rows without depth_mm were left out" in record.notes


def test_files_that_cannot_be_read_or_written(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="No such file"):
        read_records(tmp_path / "nothing.csv")
    with pytest.raises(DataError, match="no data file"):
        read_records([])
    with pytest.raises(DataError, match="UTF-16"):
        parse_records(GOOD.encode("utf-16"))
    with pytest.raises(DataError, match="line 3: is not UTF-8"):
        parse_records(b"time_s,phase\n0,in\n1,\xff\n")
    with pytest.raises(DataError, match="damaged"):
        parse_records(b"\x89HDF\r\n\x1a\n" + bytes(100))
    with pytest.raises(OutputError, match="must end in"):
        write_records([trial("a", 9)], tmp_path / "a.xlsx")
    with pytest.raises(DataError, match='two trials have the name "a"'):
        write_records([trial("a", 9), trial("a", 9)], tmp_path / "a.csv")


def survives(content: bytes) -> None:
    """Reading ends with records or with DataError: anything else fails the test."""
    try:
        records = parse_records(content)
    except DataError as error:
        assert error.mistakes
    else:
        assert all(len(record) >= 2 for record in records)


CELLS = st.one_of(
    st.text(max_size=20), st.floats().map(repr), st.integers().map(str), st.just("9" * 200_000),
    st.sampled_from(["", "nan", "1e400", "1_0", '"', "#", "\0", "\x1c", "٣", "time_s", "role", "trial"]),
)  # fmt: skip


@settings(max_examples=150, deadline=None)
@given(st.binary(max_size=300))
def test_random_bytes(content: bytes) -> None:
    survives(content)
    survives(b"time_s,force_n\n" + content)
    survives(b"\x89HDF\r\n\x1a\n" + content)


@settings(max_examples=150, deadline=None)
@given(st.lists(st.lists(CELLS, max_size=5), max_size=5), st.sampled_from(["utf-8", "utf-16", "latin-1", "utf-7"]))
def test_random_cells(rows: list[list[str]], encoding: str) -> None:
    text = "time_s,depth_mm,trial\n" + "\n".join(",".join(row) for row in rows)
    survives(text.encode(encoding, "replace"))


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_truncated_and_altered_files(data: st.DataObject) -> None:
    """As CSV; HDF5 files, which take a process each, are in test_hdf5_damage.py."""
    content = GOOD.encode()
    survives(content[: data.draw(st.integers(0, len(content)))])
    place = data.draw(st.integers(0, len(content) - 1))
    survives(content[:place] + data.draw(st.binary(min_size=1, max_size=4)) + content[place + 1 :])


def test_one_measurement_given_twice_is_refused(tmp_path: Path) -> None:
    """It would count as a repetition, and narrow every interval; another encoding of the same numbers is the same."""
    (tmp_path / "a.csv").write_text(GOOD)
    (tmp_path / "b.csv").write_text("\ufeff" + GOOD)
    for files in (["a.csv", "a.csv"], ["a.csv", "b.csv"]):
        with pytest.raises(DataError, match=r"holds the same numbers as .*a\.csv, trial a: one measurement must not"):
            read_records([tmp_path / file for file in files])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (GOOD.split("\n", 1)[1], r"line 1 = 0\.0,0\.0,0\.1: holds numbers: the first line must be a header"),
        (GOOD.replace(",", " "), "line 1 = time_s depth_mm force_n: is one cell: columns must be separated by commas"),
        (GOOD.replace(",", ";").replace(".", ","), "write decimal points"),
    ],
)
def test_a_file_that_only_a_person_can_read_says_what_to_change(text: str, message: str) -> None:
    with pytest.raises(DataError, match=message):
        parse_records(text.encode())


def test_another_axis_of_a_sensor_is_left_out_and_a_slip_is_refused() -> None:
    head, *rows = GOOD.strip().split("\n")
    both = "\n".join([f"{head},force_x", *(f"{row},{number}" for number, row in enumerate(rows))])
    (record,) = parse_records(both.encode())
    assert record.notes == ("unknown columns were left out: force_x",)
    with pytest.raises(DataError, match='did you mean "force_n"'):
        parse_records(GOOD.replace("force_n", "force_x").encode())
