"""Text files of other laboratories: columns by name or number, units, signs, sums, preambles, resets, no velocity."""

from pathlib import Path

import numpy as np
import pytest

from needleplan.errors import DataError, InputError
from needleplan.recording import ColumnMap, parse_records, read_records
from needleplan.signals import MeasuredMotion, Record, Role, insertion_cycles, lspb

MOTION = lspb([-2, 30, 20, 60, -2], [4, 8, 6, 12], rate_hz=50)
FORCE = 0.01 * np.maximum(MOTION.depth_mm, 0) * MOTION.direction


def text(header: str, *columns: object, separator: str = ",") -> bytes:
    rows = zip(*(np.asarray(each, float) for each in columns), strict=True)
    body = "\n".join(separator.join(f"{cell:.9g}" for cell in row) for row in rows)
    return f"{header}\n{body}\n".encode() if header else f"{body}\n".encode()


def one(content: bytes, columns: str, **options: object) -> Record:
    (record,) = parse_records(content, "raw.txt", columns=ColumnMap.parse(columns, **options))  # type: ignore[arg-type]
    return record


def test_names_units_and_signs() -> None:
    content = text("t,Fz,z", 1e3 * MOTION.time_s, -1e3 * FORCE, MOTION.depth_mm / 10)
    record = one(content, "time=t[ms], force=-Fz[mN], depth=z[cm]")
    np.testing.assert_allclose(record["time_s"], MOTION.time_s, atol=1e-8)
    np.testing.assert_allclose(record["force_n"], FORCE, atol=1e-8)
    np.testing.assert_allclose(record["depth_mm"], MOTION.depth_mm, atol=1e-6)
    assert record.notes[0] == "read time_s = t [ms], force_n = -Fz [mN], depth_mm = z [cm]"


@pytest.mark.parametrize("separator", [",", ";", "\t", "  "])
def test_a_file_without_a_header(separator: str) -> None:
    content = text("", MOTION.depth_mm, MOTION.time_s, FORCE, separator=separator)
    record = one(content, "time=2[s],depth=1[mm],force=3[N]")
    np.testing.assert_allclose(record["force_n"], FORCE, atol=1e-8)


def test_a_preamble_units_in_the_header_and_decimal_commas() -> None:
    rows = "\n".join(f"{t:.3f};{d:.4f};{f:.6f}" for t, d, f in zip(MOTION.time_s, MOTION.depth_mm, FORCE, strict=True))
    content = f"Logger 3000\nDate; 1.2.2026\n% rig 2\nTime [s];Depth (mm);Fz\ns;mm;N\n{rows}\n".replace(".", ",")
    record = one(content.encode(), "time=Time, depth=depth, force=Fz[N]")
    np.testing.assert_allclose(record["depth_mm"], MOTION.depth_mm, atol=1e-4)
    assert any("the rows of numbers begin in line 6" in note for note in record.notes)


@pytest.mark.parametrize("encoding", ["utf-8", "cp1252", "utf-16"])
def test_units_in_other_encodings(encoding: str) -> None:
    header, _, rows = text("t,Kraft (µN)", MOTION.time_s, 1e6 * FORCE).partition(b"\n")
    content = (header + b"\n" + rows).decode().encode(encoding)
    record = one(content, "time=t[s],force=Kraft")
    np.testing.assert_allclose(record["force_n"], FORCE, atol=1e-8)


def test_a_file_that_is_no_text_is_refused() -> None:
    with pytest.raises(DataError, match="null characters"):
        one(bytes(range(256)), "time=1[s]")


def test_seconds_and_nanoseconds_of_a_clock_keep_their_digits() -> None:
    seconds, rest = np.divmod(np.arange(200) * 0.02 + 0.5, 1)
    rows = [
        f"{1666030238 + int(s)},{round(1e9 * r)},{0.1 * i}" for i, (s, r) in enumerate(zip(seconds, rest, strict=True))
    ]
    content = "\n".join(["Tip sec,Tip nanosec,Tip y", *rows]).encode()
    record = one(content, "time=Tip sec[s]+Tip nanosec[ns],depth=Tip y[mm]")
    np.testing.assert_allclose(record["time_s"], np.arange(200) * 0.02, atol=1e-9)


def test_the_depth_counts_from_the_surface() -> None:
    record = one(text("t,z", MOTION.time_s, MOTION.depth_mm - 110), "time=t[s],depth=z[mm]", surface_mm=-110.0)
    np.testing.assert_allclose(record["depth_mm"], MOTION.depth_mm, atol=1e-6)


def test_a_path_counts_from_the_entry() -> None:
    bend = np.where(MOTION.depth_mm > 0, 1e-3 * MOTION.depth_mm**2, 0)
    content = text("t,x,y", MOTION.time_s, MOTION.depth_mm + 7, bend - 25)
    record = one(content, "time=t[s],depth=x[mm],x=x[mm],y=y[mm]", surface_mm=7.0)
    inside = np.flatnonzero(MOTION.depth_mm > 0)[0]
    np.testing.assert_allclose(record["x_mm"], MOTION.depth_mm[inside:], atol=1e-6)
    np.testing.assert_allclose(record["y_mm"], bend[inside:], atol=1e-6)
    assert any(f"in the {inside} rows before the entry" in note for note in record.notes)


def test_an_insertion_at_constant_speed_needs_no_times() -> None:
    content = text("", [0, 0.002, 0.001, 0.003, 0.003], [0, 2, 1, 3, 5])
    record = one(content, "depth=1[m],force=2[N],speed=2[mm/s]")
    np.testing.assert_allclose(record["time_s"], [0, 0.5, 1, 1.5])
    np.testing.assert_allclose(record["force_n"], [0, 1, 2, 4])
    assert "times follow from the depth at 2 mm/s" in record.notes
    assert {"1 points were sorted by depth", "1 points at equal depth were averaged"} <= set(record.notes)


def test_rows_without_a_new_measurement_are_left_out() -> None:
    time, depth = np.arange(50) / 10, np.linspace(0, 20, 50) ** 1.1
    shown = np.repeat(np.arange(50), 2)
    content = text("t,z", np.r_[0, 0, 5000 + time[shown]], np.r_[0, 0, 3 + depth[shown]])
    record = one(content, "time=t[s],depth=z[mm]")
    assert len(record) == 50
    assert "rows of zeros were left out: 2, the first in line 2" in record.notes
    assert "rows that repeat the row before were left out: 50, the first in line 5" in record.notes


def test_a_clock_that_begins_again_is_a_further_trial() -> None:
    time = np.r_[MOTION.time_s, MOTION.time_s + 0.01]
    content = text("t,z,F", time, np.tile(MOTION.depth_mm, 2), np.r_[FORCE, 2 * FORCE])
    first, second = parse_records(content, "run.csv", columns=ColumnMap.parse("time=t[s],depth=z[mm],force=F[N]"))
    assert (first.trial, second.trial) == ("run part 1", "run part 2")
    assert f"the clock begins again in line {len(MOTION) + 2}: 2 trials" in first.notes
    np.testing.assert_allclose(second["force_n"], 2 * FORCE, atol=1e-8)


RAW = text("t,z,Fz", MOTION.time_s, MOTION.depth_mm, FORCE)
LINES = RAW.decode().splitlines()


def altered(line: int, new: str) -> bytes:
    return "\n".join([*LINES[: line - 1], new, *LINES[line:]]).encode()


WRONG = {
    "an unknown column": (RAW, "time=t[s],force=Fx[N]", 'column Fx: is not in the file; did you mean "Fz"?'),
    "no column": (
        RAW,
        "time=zeit[s],force=kraft[N]",
        "is not in the file, which begins with t, z, Fz. Without a header",
    ),
    "a unit in the header": (RAW.replace(b"Fz", b"Fz [V]"), "time=t[s],force=Fz", "= V: is no known unit of force_n"),
    "a word": (altered(4, "0.04,deep,0"), "time=t[s],depth=z[mm]", "line 4, column 2 = deep: must be a number"),
    "a short row": (altered(4, "0.04"), "time=t[s],depth=z[mm]", "line 4: has 1 cells, but column 2 is needed"),
    "a repeated time": (altered(4, "0.02,1,0"), "time=t[s],depth=z[mm]", "time_s (line 4) = 0.02: must be greater"),
    "a time that goes back": (altered(400, "2,1,0"), "time=t[s],depth=z[mm]", "1 decreasing in the trial"),
    "a wrong scale": (
        RAW,
        "time=t[s],depth=z[um]",
        "is questionably small, in metres? Give the right unit in the column",
    ),
    "rows in any order": (
        "\n".join([LINES[0], *LINES[:0:-1]]).encode(),
        "time=t[s],depth=z[mm]",
        "time_s (line 3) = -0.02: must be greater than the time before it, 0; "
        f"{len(LINES) - 2} decreasing in the trial. The rows are not in order of time: sort them",
    ),
    "a name that occurs twice": (
        RAW.replace(b"t,z,Fz", b"t,Fz,Fz"),
        "time=t[s],force=Fz[N]",
        "column Fz: is ambiguous: it may be one of the columns 2 (Fz), 3 (Fz); give its number",
    ),
    "a name in another case that occurs twice": (
        RAW.replace(b"t,z,Fz", b"t,FZ,Fz"),
        "time=t[s],force=fz[N]",
        "column fz: is ambiguous: it may be one of the columns 2 (FZ), 3 (Fz)",
    ),
    "a unit that contradicts the header": (
        RAW.replace(b"Fz", b"Fz [gf]"),
        "time=t[s],force=Fz[N]",
        "unit of column Fz = N: contradicts the header, which has gf",
    ),
    "a unit that contradicts the line below the names": (
        RAW.replace(b"Fz", b"Fz\ns,cm,N"),
        "time=t[s],depth=z[mm],force=Fz[N]",
        "unit of column z = mm: contradicts the header, which has cm",
    ),
    "a unit that contradicts the header of a column by number": (
        RAW.replace(b"Fz", b"Fz (mN)"),
        "time=1[s],force=3[N]",
        "unit of column 3 = N: contradicts the header, which has mN",
    ),
    "a unit at the end of a name": (
        RAW.replace(b",z,", b",z_cm,"),
        "time=t[s],depth=z_cm",
        "unit of column z_cm: seems to be in cm: give the unit in brackets, as in z_cm[cm]",
    ),
    "both decimal signs": (
        altered(9, "0.14;-2.0;1,250").replace(b",", b";").replace(b"1;250", b"1,250"),
        "time=t[s],force=Fz[mN]",
        "line 9, column 3 = 1,250: has a comma, but 0.02 (line 3, column 1) has a point: write all numbers with one",
    ),
    "separators of thousands": (
        altered(4, "0.04;-5,000.00;0").replace(b",", b";").replace(b"-5;000", b"-5,000"),
        "time=t[s],depth=z[um]",
        "line 4, column 2 = -5,000.00: must be a number, or empty; separators of thousands are not read",
    ),
    "decimal commas in quotes": (
        altered(4, '"0,04",1,0'),
        "time=t[s],depth=z[mm]",
        "line 4, column 1 = 0,04: must be a number, or empty; decimal commas between commas that separate",
    ),
    "a wrong scale of time": (RAW, "time=t[ms],depth=z[mm]", "the depth changes by"),
}


def test_the_name_in_the_same_case_is_read() -> None:
    content = text("t,f,F", MOTION.time_s, np.sin(MOTION.time_s), FORCE)
    for columns in ("time=t[s],force=F[N]", "time=T[s],force=F"):
        np.testing.assert_allclose(one(content, columns)["force_n"], FORCE, atol=1e-8)


def test_units_below_the_names_are_read() -> None:
    content = text("t,z,Fz\nms,cm,[mN]", 1e3 * MOTION.time_s, MOTION.depth_mm / 10, 1e3 * FORCE)
    for columns in ("time=t,depth=z,force=Fz", "time=1,depth=2,force=3", "time=t[ms],depth=z[cm],force=Fz[mN]"):
        record = one(content, columns)
        np.testing.assert_allclose(record["depth_mm"], MOTION.depth_mm, atol=1e-6)
        np.testing.assert_allclose(record["force_n"], FORCE, atol=1e-8)


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_is_said_with_its_place(case: str) -> None:
    content, columns, expected = WRONG[case]
    with pytest.raises(DataError) as raised:
        parse_records(content, "raw.csv", columns=ColumnMap.parse(columns))
    assert expected in str(raised.value)
    assert str(raised.value).startswith("raw.csv: ")


@pytest.mark.parametrize(("columns", "expected"), [
    ("time", "must be QUANTITY=COLUMN[UNIT]"),
    ("time=t[s],forse=Fz[N]", 'did you mean "force"?'),
    ("time=t[s],force=Fz[kg]", "must be one of N, mN"),
    ("time=t[s],time=u[s]", "gives time a second time"),
    ("force=Fz[N]", "must give time=..., or speed=..."),
    ("time=t[s],depth=z[mm],speed=3", "give either time or speed"),
    ("force=Fz,speed=3", "needs depth"),
    ("depth=z[mm],speed=fast", "must be a number above 0"),
    ("time=[s]", "must be a column with its unit"),
])  # fmt: skip
def test_a_wrong_map_is_refused(columns: str, expected: str) -> None:
    with pytest.raises(InputError) as raised:
        ColumnMap.parse(columns)
    assert expected in str(raised.value)


def test_a_name_with_a_comma_and_a_bracket() -> None:
    columns = ColumnMap.parse(["time=t, laser[ms]", "force=F-z [raw] [mN], depth=2"])
    assert [str(each) for terms in columns.numbers.values() for each in terms] == [
        "t, laser [ms]",
        "F-z [raw] [mN]",
        "2",
    ]


def test_roles_of_files_and_a_noise_record_without_a_motion(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_bytes(RAW)
    (tmp_path / "b.csv").write_bytes(text("t,Fz", np.arange(20) / 50, np.sin(np.arange(20))))
    columns = "time=t[s],depth=z[mm],force=Fz[N]"
    files = [tmp_path / "a.csv", tmp_path / "b.csv"]
    trial, air = read_records(files, columns=columns, roles={files[1]: Role.NOISE})
    assert (trial.role, air.role) == (Role.TRAIN, Role.NOISE)
    assert "depth_mm" not in air.columns


def test_interpolation_to_one_rate(tmp_path: Path) -> None:
    time = np.cumsum(np.random.default_rng(0).uniform(0.01, 0.09, 400))
    (tmp_path / "a.csv").write_bytes(text("time_s,depth_mm", time, 3 * time))
    (record,) = read_records(tmp_path / "a.csv", rate_hz=40.0)
    np.testing.assert_allclose(np.diff(record["time_s"]), 0.025)
    np.testing.assert_allclose(record["depth_mm"], 3 * record["time_s"], atol=1e-6)
    for rate in (0.0, np.nan, np.inf, 1e9):
        with pytest.raises(DataError, match="samples for the"):
            read_records(tmp_path / "a.csv", rate_hz=rate)


def steps(noise_mm: float, rate_hz: float, dwell_s: float = 3.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Twelve steps of 5 mm within 0.5 s each: times, measured depths and true velocities."""
    time = np.arange(0, 12 * (dwell_s + 0.5) + dwell_s, 1 / rate_hz)
    phase = time % (dwell_s + 0.5)
    moving = (phase >= dwell_s) & (time < 12 * (dwell_s + 0.5))
    depth = 5 * (np.floor(time / (dwell_s + 0.5)) + np.clip((phase - dwell_s) / 0.5, 0, 1))
    depth = np.minimum(depth, 60.0)
    random = np.random.default_rng(3)
    return time, depth + random.normal(0, noise_mm, time.size), np.where(moving, 10.0, 0.0)


@pytest.mark.parametrize(("noise_mm", "rate_hz"), [(0.0, 50), (0.02, 50), (0.1, 2), (0.1, 200)])
def test_a_stepwise_insertion_stands_between_its_steps(noise_mm: float, rate_hz: float) -> None:
    time, depth, velocity = steps(noise_mm, rate_hz)
    motion = MeasuredMotion.of(time, depth)
    assert motion.steps_mm.size == 12
    np.testing.assert_allclose(motion.steps_mm, 5.0, atol=0.01 + 3 * noise_mm)
    assert abs(np.mean(motion.standing) - np.mean(velocity == 0)) < 0.15
    still = motion.standing & np.roll(motion.standing, 1) & np.roll(motion.standing, -1)
    assert not motion.velocity_mm_s[still].any()
    way = np.cumsum((motion.velocity_mm_s[1:] + motion.velocity_mm_s[:-1]) / 2 * np.diff(time))
    np.testing.assert_allclose(way[-1], 60, atol=0.01 + 6 * noise_mm)
    if rate_hz > 2:
        assert np.median(motion.velocity_mm_s[~motion.standing]) == pytest.approx(10, rel=0.25)


def test_a_smooth_motion_has_its_velocity() -> None:
    motion = insertion_cycles(40.0, 10.0, rate_hz=50.0)
    found = MeasuredMotion.of(motion.time_s, motion.depth_mm)
    assert np.sqrt(np.mean((found.velocity_mm_s - motion.velocity_mm_s) ** 2)) < 0.3
    noisy = MeasuredMotion.of(motion.time_s, motion.depth_mm + np.random.default_rng(0).normal(0, 0.05, len(motion)))
    assert np.sqrt(np.mean((noisy.velocity_mm_s - motion.velocity_mm_s) ** 2)) < 1.5


def test_a_coarse_encoder_at_rest_stands() -> None:
    time = np.arange(1000) / 200
    depth = 0.01 * np.round(100 * np.where(time < 3, 4.0 + 0.004 * np.sin(9 * time), 4.0 + 5 * (time - 3)))
    motion = MeasuredMotion.of(time, depth)
    assert motion.standing[:580].all()
    assert not motion.standing[640:].any()
