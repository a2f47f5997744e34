"""Series with a damaged or foreign fourth insertion: one clear error, or a remark that names it."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from needleplan.cli import main
from needleplan.signals import Array
from tests.blind.series import Drift, Insertion, drawn

INSERTIONS = drawn(np.random.default_rng(1), Drift.STEADY, 4).insertions
Columns = dict[str, Array]
NUMBERS = np.arange(INSERTIONS[0].depth_mm.size)


def columns(insertion: Insertion) -> Columns:
    depth = insertion.depth_mm
    return {"time_s": depth / 2, "depth_mm": depth, "x_mm": depth, "y_mm": insertion.y_mm, "z_mm": insertion.z_mm}


def text(table: Columns) -> str:
    rows = zip(*table.values(), strict=True)
    return "\n".join([",".join(table), *(",".join(f"{cell:.6g}" for cell in row) for row in rows)]) + "\n"


def stepwise(insertion: Insertion, begun_s: int, *, guide_m: float | None = -0.025) -> str:
    """A file of the published study: tip in mm, depth along -y, guide in m."""
    guide = "" if guide_m is None else ",Robot x,Robot z,Robot sec"
    lines = ["Timestamp sec,Timestamp nanosec,Tip x,Tip y,Tip z,Tip sec,Tip nanosec" + guide]
    for number, (depth, y, z) in enumerate(zip(insertion.depth_mm, insertion.y_mm, insertion.z_mm, strict=True)):
        time = f"{begun_s + number},0"
        place = "" if guide_m is None else f",{guide_m},0.02,{begun_s}"
        lines.append(f"{time},{y - 25:.4f},{-depth:.4f},{z + 20:.4f},{time}{place}")
    return "\n".join(lines) + "\n"


def changed(**change: Callable[[Array], Array]) -> str:
    table = columns(INSERTIONS[3])
    return text(table | {name: done(table[name]) for name, done in change.items()})


def rows(part: slice) -> str:
    return text({name: values[part] for name, values in columns(INSERTIONS[3]).items()})


GOOD = text(columns(INSERTIONS[3]))
Y, Z = INSERTIONS[3].y_mm, INSERTIONS[3].z_mm
REFUSED = {
    "another frame": ("\n".join(
        f"{line},{'tracker:coil' if number else 'coordinate_frame'}" for number, line in enumerate(GOOD.splitlines())
    ), "frame of last = tracker: coil"),
    "metres": (changed(**dict.fromkeys(("depth_mm", "x_mm", "y_mm", "z_mm"), lambda values: values / 1000)), "metres?"),
    "rows in reverse order": (changed(**dict.fromkeys(("depth_mm", "x_mm", "y_mm"), np.flip)), "rows in reverse order"),
    "depth with the wrong sign": (changed(depth_mm=np.negative, x_mm=np.negative), "a depth with the wrong sign"),
    "another one under a new name": (text(columns(INSERTIONS[1])), "holds the same numbers as"),
    "every second sample of another one": (
        text({name: values[::2] for name, values in columns(INSERTIONS[1]).items()}), "is the same insertion as two"
    ),
    "no y": (changed(y_mm=lambda values: np.full_like(values, np.nan)), "last: y_mm: is missing"),
    "no column y": (text({name: each for name, each in columns(INSERTIONS[3]).items() if name != "y_mm"}), "y_mm: is"),
    "constant y": (changed(y_mm=np.ones_like), "is constant to the last bit"),
    "words": (GOOD.replace("\n", "\nabc,", 1), "must"),
    "cut off": (GOOD[:-20], "must have 5 cells"),
    "empty": ("", "is empty"),
    "header alone": (GOOD.partition("\n")[0] + "\n", "no rows"),
    "a clock that was reset": (
        changed(time_s=lambda values: np.where(NUMBERS > 60, values - 20, values)), "must be greater than the time"
    ),
    "guide in mm": (stepwise(INSERTIONS[3], 9000, guide_m=-25.0), "are they in mm?"),
    "published and cut off": (stepwise(INSERTIONS[3], 9000)[:-30], "line 121 = "),
    "published with a word": (stepwise(INSERTIONS[3], 9000).replace(",0.02,", ",left,", 1), "Robot z (line 2) = left"),
    "published with decimal commas": (
        stepwise(INSERTIONS[3], 9000).replace(",", ";").replace(".", ","), "must be a number with a decimal point"
    ),
    "no guide": (stepwise(INSERTIONS[3], 9000, guide_m=None), "frame of last = unknown"),
}  # fmt: skip
SAID = {
    "y and z in metres": (changed(y_mm=lambda values: values / 1000, z_mm=lambda values: values / 1000), "in metres?"),
    "no entry": (rows(slice(40, None)), "last starts 32 mm away"),
    "y and z exchanged": (text(columns(INSERTIONS[3]) | {"y_mm": Z, "z_mm": Y}), "last ends 12 mm beside the others"),
    "y flipped": (changed(y_mm=np.negative), "last bends to the other side"),
    "another origin": (changed(y_mm=lambda values: values + 60), "last starts 60 mm away"),
    "shallow": (rows(slice(0, 20)), "last ends at 19.3 mm, the others at 100 mm"),
    "spikes": (changed(y_mm=lambda values: values + 50 * (abs(NUMBERS - 52) < 2)), "last: 3 samples lie up to 4"),
    "rows without y": (changed(y_mm=lambda values: np.where(abs(NUMBERS - 50) < 10, np.nan, values)), "in 19 of 120"),
    "no z": (text({name: each for name, each in columns(INSERTIONS[3]).items() if name != "z_mm"}), "plane: last"),
}  # fmt: skip


def identified(folder: Path, last: str) -> int:
    """Identify three good insertions and the last one, in the format of the last one."""
    files = []
    for number, name in enumerate(("one", "two", "three")):
        published = last.removeprefix("\ufeff").startswith("Timestamp")
        good = stepwise(INSERTIONS[number], 8000 + 200 * number) if published else text(columns(INSERTIONS[number]))
        files.append(folder / f"{name}.csv")
        files[-1].write_text(good)
    (folder / "last.csv").write_text(last, encoding="utf-8")
    words = ("--layers", "1", "--segments", "1", "--verbose")
    return main(["identify", "curvature", *map(str, files), str(folder / "last.csv"), *words])


@pytest.mark.parametrize("case", REFUSED)
def test_it_is_refused(case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content, expected = REFUSED[case]
    assert identified(tmp_path, content) == 2
    captured = capsys.readouterr()
    assert expected in captured.err
    assert "Traceback" not in captured.err
    assert not captured.out


@pytest.mark.parametrize("case", SAID)
def test_it_is_said(case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content, expected = SAID[case]
    assert identified(tmp_path, content) == 0
    assert expected in capsys.readouterr().out


@pytest.mark.parametrize("mark", ["", "\ufeff"], ids=["plain", "with a byte order mark"])
def test_a_good_one_is_not_accused(mark: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert identified(tmp_path, mark + stepwise(INSERTIONS[3], 8600)) == 0
    said = capsys.readouterr().out
    assert not any(word in said for word in ("beside", "one frame", "in metres", "it limits", "hours after"))


def test_one_series_in_two_folders_is_one_series(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = []
    for place, number in (("b", 2), ("b", 3), ("a", 0), ("a", 1)):
        (tmp_path / place).mkdir(exist_ok=True)
        files.append(tmp_path / place / f"insertion_{number % 2}.csv")
        files[-1].write_text(stepwise(INSERTIONS[number], 8000 + 200 * number))
    assert main(["identify", "curvature", *map(str, files), "--layers", "1", "--verbose"]) == 0
    said = capsys.readouterr().out
    (line,) = [each for each in said.splitlines() if "order of their times" in each]
    assert line.index("a/insertion_0") < line.index("a/insertion_1") < line.index("b/insertion_0")
