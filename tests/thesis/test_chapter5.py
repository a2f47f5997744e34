"""Chapter 5: algebra, signs, and the consistency of the printed numbers."""

from pathlib import Path

import numpy as np
import pytest

from needleplan.reports.chapters import Effort, Request
from needleplan.reports.comparison import Agreement, Comparison
from needleplan.scenario import Scenario
from needleplan_thesis.chapter5 import chapter
from needleplan_thesis.chapter5.chapter import residual_n, singular_force_n
from needleplan_thesis.chapter5.insertions import CASES, CHANGES, MEMORY, PRINTED, SENSITIVITY, required_force_n
from needleplan_thesis.chapter5.table52 import arcs_apart_mm

pytestmark = pytest.mark.study


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Comparison], Path]:
    folder = tmp_path_factory.mktemp("figures")
    return {each.id: each for each in chapter.run(Request(folder, Effort.QUICK, lambda _: None))}, folder


def test_percentages_of_the_radii_are_the_printed_ones() -> None:
    np.testing.assert_allclose([case.error_percent for case in CASES], [14.15, 13.58, 8.70, 18.72], atol=0.01)
    assert CASES[1].error_percent - SENSITIVITY[0][1] == pytest.approx(4.98, abs=0.01)
    assert CASES[1].error_percent - SENSITIVITY[3][1] == pytest.approx(4.73, abs=0.01)


def test_sixteen_heading_steps_of_the_phantom() -> None:
    headings = Scenario.read("phantom").motion.headings
    assert -16 * 360 / headings == pytest.approx(-3.2, rel=1e-12)


def test_table_5_1_holds_up_to_its_singularity() -> None:
    assert max(residual_n(force) for force in np.linspace(0.01, 0.2685, 30)) < 1e-12
    assert singular_force_n() == pytest.approx(0.268901, rel=3e-4)  # I is rounded in print


def test_arcs_of_the_printed_radii_do_not_have_the_printed_errors() -> None:
    tangent, shifted = zip(*(arcs_apart_mm(case) for case in CASES), strict=True)
    np.testing.assert_allclose(tangent, [0.390, 0.337, 0.245, 0.513], atol=1e-3)
    assert [case.name for case, apart in zip(CASES, shifted, strict=True) if apart > case.max_error_mm] == [
        "B, 15 mm/s"
    ]


@pytest.mark.parametrize(("reading", "behind", "last_digit", "rows_n"), [
    (PRINTED, 9.3, 1e-3, ([0.014, 0.071, 0.158, 0.278], [0.026, 0.122, 0.271, 0.485])),
    (MEMORY, 0.0, 1e-4, ([0.0069, 0.0254, 0.0394, 0.0492], [0.0118, 0.0342, 0.0497, 0.0611])),
], ids=["printed", "memory"])  # fmt: skip
def test_forces_that_the_radii_need(
    reading: object, behind: float, last_digit: float, rows_n: tuple[list[float], list[float]]
) -> None:
    for case, expected in zip((CASES[0], CASES[3]), rows_n, strict=True):
        depth, force = required_force_n(
            reading,
            case.tissue,
            case.velocity_mm_s,
            case.estimated_mm,
            2.0,
            behind_mm=behind,  # type: ignore[arg-type]
        )
        np.testing.assert_allclose(np.interp([20, 40, 60, 80], depth, force), expected, rtol=5e-3, atol=last_digit / 2)


def test_all_cells_are_there_and_say_why(rows: tuple[dict[str, Comparison], Path]) -> None:
    found, folder = rows
    cells = [each for name, each in found.items() if name.startswith("ch5/Table 5.3/") and "mm/s/" in name]
    assert len(cells) == len(CASES) * len(CHANGES)
    radii = [each for name, each in found.items() if name.endswith(("/estimated radius", "/measured radius"))]
    assert len(radii) == 2 * len(CASES)
    assert {each.verdict for each in [*cells, *radii]} == {Agreement.IMPOSSIBLE}
    assert all(each.reason for each in found.values() if each.verdict is not Agreement.REPRODUCED)
    assert {file.name for file in folder.iterdir()} == {"fig_5_1.png", "fig_5_2.png"}


@pytest.mark.parametrize("reading", [MEMORY, PRINTED], ids=["memory", "printed"])
@pytest.mark.parametrize("what", ["kf -20 %", "vf +20 %", "15 for 10 mm/s"])
def test_signs_hold_in_every_case(rows: tuple[dict[str, Comparison], Path], reading: object, what: str) -> None:
    name = reading.name  # type: ignore[attr-defined]
    (row,) = [each for key, each in rows[0].items() if key.startswith(f"ch5/signs/{what}") and key.endswith(name)]
    changes = [float(each) for each in str(row.ours).split(", ")]
    assert len(changes) == (2 if what.startswith("15") else 4)
    assert max(changes) < 0
    assert row.verdict is Agreement.REPRODUCED
