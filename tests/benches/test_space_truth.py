"""The bench of success in the voxels of the file: its judge, and its figures."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from tests.blind.volume_files import FiledAnatomy
from tests.blind.voxel_tracer import Ball, Volume

BENCHES = Path(__file__).parents[2] / "benches" / "python"


@pytest.fixture(scope="module", autouse=True)
def on_path():
    sys.path.insert(0, str(BENCHES))
    yield
    sys.path.remove(str(BENCHES))


def filed(diameter_mm: float = 0.0, target: Ball | int = 4) -> FiledAnatomy:
    """Voxels of 1 mm: a wall at x = 10 mm, from y = 5 mm upwards; a target before it and one behind it."""
    labels = np.zeros((21, 11, 11), np.uint8)
    labels[10, 5:] = 7
    labels[7, 5:8, 5] = labels[13, 2:8, 5] = 4
    return FiledAnatomy(Volume(labels, np.eye(4), (7,)), target, diameter_mm)


def along(y: float, *xs: float) -> np.ndarray:
    return np.array([[x, y, 5.0] for x in xs])


def test_a_path_succeeds_if_the_target_comes_before_the_obstacle() -> None:
    from space_truth import judged

    behind = Ball((13.0, 6.0, 5.0), 1.0)
    paths = [along(6.0, 0.0, 7.0), along(6.0, 0.0, 14.0), along(3.0, 0.0, 9.0, 13.0), along(6.0, 0.0, 5.0)]
    verdicts = judged(filed(), paths)
    assert verdicts.success.tolist() == [True, True, True, False]
    assert verdicts.touches.tolist() == [False, True, False, False]
    assert verdicts.ends_in_target.tolist() == [True, False, True, False]
    assert judged(filed(target=behind), paths).success.tolist() == [False, False, False, False]


def test_a_needle_with_a_diameter_touches_beside_its_axis() -> None:
    from space_truth import judged

    # The lowest face of the wall is at y = 4.5 mm.
    paths = [along(4.2, 0.0, 14.0), along(4.2, 0.0, 8.0), along(5.0, 0.0, 9.2)]
    thin, thick = judged(filed(0.5), paths), judged(filed(0.7), paths)
    assert thin.success.tolist() == [True, False, True]
    assert not thin.touches.any()
    margin = judged(FiledAnatomy(filed().volume, 4, 0.3, 0.2), paths)
    assert margin.success.tolist() == thick.success.tolist()
    # The first one meets the wall before the target behind it; the last one meets the target first.
    assert thick.success.tolist() == [False, False, True]
    assert thick.touches.tolist() == [True, False, True]


def test_a_polyline_ends_at_a_length() -> None:
    from space_truth import until

    corner = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [3.0, 4.0, 0.0]])
    np.testing.assert_allclose(until(corner, 5.0), [[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [3.0, 2.0, 0.0]])
    np.testing.assert_allclose(until(corner, 9.0), [*corner, corner[-1]])


def entry(told: float, realised: float, listed: bool) -> dict[str, object]:
    return {
        "listed": listed, "told": told, "interval": (told - 0.0196, told + 0.0196), "table": told, "realised": realised,
        "reached": realised, "reached_and_touch": 0, "reached_and_end_beside": 2, "missed": 3, "path_touches": listed,
        "entry_mm": (1.0, 2.0, 3.0), "direction": (1.0, 0.0, 0.0),
    }  # fmt: skip


def test_the_report_gives_differences_chance_and_what_must_not_be() -> None:
    from space_truth_report import chance, line, text

    anatomy = {
        "name": "foreign lung", "seed": 2, "diameter_mm": 0.9081, "voxels": 2_000_000, "spacing_mm": 1.5, "runs": 100,
        "states": 40_000_000, "seconds": 3.0, "processor_s": 5.0, "memory_mb": 400.0,
        "entries": [entry(0.9, 0.88, True), entry(0.5, 0.56, False)],
    }  # fmt: skip
    pairs = [(anatomy, each) for each in anatomy["entries"]]
    cells = line("all", pairs)
    assert cells[1:5] == [2, "70.0 %", "72.0 %", "4.00"]
    assert cells[6:] == ["-2.00", "-6.0", "+2.0", "3.00"]
    # Standard deviations of 5 points by the executions and 1 point by the estimate.
    assert chance(entry(0.5, 0.5, True), 100) == pytest.approx(np.sqrt(2 / np.pi * 26.0))
    about = {"processor": "P", "threads": 2, "load_before": 1.0, "commit": "abc", "date": "today"}
    report = text(about, [anatomy])
    assert "1 of 2 entries above 5" in report
    assert "end beside the target, of 200 | 4 |" in report
    assert "path without noise touches an obstacle or its margin, of 1 | 1 |" in report
    # The largest difference stands first.
    assert report.index("| random | 1.00, 2.00, 3.00") < report.index("| listed | 1.00, 2.00, 3.00")


@pytest.mark.study
def test_an_anatomy_is_judged(tmp_path: Path) -> None:
    from space_truth import judged_anatomy, written

    found = judged_anatomy(written("foreign brain", 5, tmp_path), "foreign brain", 5, 1, 1, 50)
    assert [each.listed for each in found.entries] == [True, False]
    for each in found.entries:
        assert each.reached_and_touch == each.reached_and_end_beside == 0
        assert abs(each.told - each.realised) < 4 * np.sqrt(0.25 / 50)
