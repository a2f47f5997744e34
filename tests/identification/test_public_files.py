"""Public files as they are: repeated times, resets, units, scales, missing columns, mixed frames, no hold-out."""

from pathlib import Path

import numpy as np
import pytest

from needleplan.cli import main
from needleplan.identification import curvature
from needleplan.identification.friction import identify
from needleplan.recording import read_records, write_records
from needleplan.signals import Array, Record, insertion_cycles

MOTION = insertion_cycles(40.0, 10.0, rate_hz=20.0)
FORCE = 0.005 * MOTION.depth_mm + 0.1 * MOTION.direction
COLUMNS: dict[str, Array] = {"time_s": MOTION.time_s, "depth_mm": MOTION.depth_mm, "force_n": FORCE}


def changed(name: str, place: int, value: float) -> Array:
    values = COLUMNS[name].copy()
    values[place:] += value - values[place]
    return values


def written(folder: Path, columns: dict[str, Array]) -> str:
    """Write columns under any names, which `write_records` would refuse."""
    rows = zip(*columns.values(), strict=True)
    text = "\n".join([",".join(columns), *(",".join(f"{cell:.9g}" for cell in row) for row in rows)])
    (folder / "public.csv").write_text(text + "\n")
    return str(folder / "public.csv")


WITHOUT_FORCE = {name: COLUMNS[name] for name in ("time_s", "depth_mm")}
FAST_S = np.linspace(0, 1.8, len(MOTION))
LONG_MM = np.linspace(0, 300, len(MOTION))
CASES: dict[str, tuple[dict[str, Array], str]] = {
    "a repeated time": (COLUMNS | {"time_s": np.repeat(MOTION.time_s[::2], 2)[: len(MOTION)]}, "clock is coarser"),
    "a clock that was reset": (COLUMNS | {"time_s": changed("time_s", 50, 0.0)}, "If the clock was reset, name"),
    "metres": (COLUMNS | {"depth_mm": MOTION.depth_mm / 1000}, "questionably small, in metres?"),
    "metres by name": (
        {"time_s": MOTION.time_s, "depth_m": MOTION.depth_mm / 1000, "force_n": FORCE}, "multiply by 1000"
    ),
    "milliseconds": (COLUMNS | {"time_s": 1000 * MOTION.time_s}, "questionably large, in milliseconds?"),
    "kilonewtons": (COLUMNS | {"force_n": FORCE / 1000}, "questionably small, in kilonewtons"),
    "a scale against the velocity": (
        {"time_s": FAST_S, "depth_mm": LONG_MM, "velocity_mm_s": np.full_like(LONG_MM, 3.0), "force_n": FORCE},
        "55.6 times as much",
    ),
    "a scale without a velocity": (
        {"time_s": FAST_S, "depth_mm": LONG_MM, "force_n": FORCE}, "300 mm in 1.8 s: the depth changes by 167 mm/s"
    ),
    "no force": (WITHOUT_FORCE, "force_n: is missing"),
    "no time": ({"depth_mm": MOTION.depth_mm, "force_n": FORCE}, "time_s: is missing"),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_the_command_refuses_with_the_likely_fix(case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    columns, expected = CASES[case]
    assert main(["identify", "force", written(tmp_path, columns)]) == 2
    captured = capsys.readouterr()
    assert expected in captured.err
    assert "Traceback" not in captured.err
    assert not captured.out


def test_one_cycle_is_not_called_held_out() -> None:
    motion = insertion_cycles(20.0, 10.0, rate_hz=40.0)
    noise = np.random.default_rng(0).normal(0, 0.01, len(motion))
    columns = {"time_s": motion.time_s, "depth_mm": 80 + motion.depth_mm, "force_n": 0.3 * motion.direction + noise}
    found = identify([Record(columns)], models=["Karnopp"])
    assert any("only one cycle" in each for each in found.remarks)
    assert not any("held out" in name for name, _, _ in found.scores)
    assert "nothing is held out" in found.findings[0].says


def arcs(last: str) -> list[Record]:
    """Four arcs with a radius of 300 mm; the last one in another frame."""
    random, along = np.random.default_rng(1), np.linspace(0, 80, 100)
    records = []
    for number in range(4):
        x, y = 300 * np.sin(along / 300), 300 * (1 - np.cos(along / 300))
        x, y = x + random.normal(0, 0.1, 100), y + random.normal(0, 0.1, 100)
        frames = {"same": (x, y), "exchanged": (y, x), "flipped": (x, -y), "backwards": (-x, y), "moved": (x + 200, y)}
        x, y = frames[last] if number == 3 else (x, y)
        columns = {"time_s": np.linspace(0, 8, 100), "depth_mm": along, "x_mm": x, "y_mm": y}
        records.append(Record(columns, f"t{number}"))
    return records


@pytest.mark.parametrize(("last", "expected"), [
    ("exchanged", "t3 runs at"), ("flipped", "t3 bends to the other side"), ("backwards", "t3 runs at"),
    ("moved", "t3 starts 200 mm away"),
])  # fmt: skip
def test_a_trial_in_another_frame_is_named(last: str, expected: str) -> None:
    said = [each for each in curvature.identify(arcs(last), layers=1).remarks if "one frame" in each]
    assert len(said) == 1
    assert said[0].startswith(expected)


def test_trials_in_one_frame_are_not_accused() -> None:
    assert not any("one frame" in each for each in curvature.identify(arcs("same"), layers=1).remarks)


def test_a_repair_is_accepted(tmp_path: Path) -> None:
    """Parts named in a column trial, after a reset of the clock."""
    parts = [Record({name: values[rows] for name, values in COLUMNS.items()}, name) for name, rows in
             (("one", slice(0, 80)), ("two", slice(80, None)))]  # fmt: skip
    write_records(parts, tmp_path / "repaired.csv")
    assert [len(each) for each in read_records(tmp_path / "repaired.csv")] == [80, len(MOTION) - 80]
