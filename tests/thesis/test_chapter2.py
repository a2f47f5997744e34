import math
from pathlib import Path

import numpy as np
import pytest

from needleplan.estimation import JointForce
from needleplan.identification import identify_by_passes
from needleplan.models import simulate
from needleplan.models.force import ForceModel1
from needleplan.reports.comparison import Agreement
from needleplan_thesis.chapter2.bank_table import phases_of, tables_2_1_and_2_2
from needleplan_thesis.chapter2.figures import draw_figures
from needleplan_thesis.chapter2.forces import PUBLISHED_FORCES, SENSOR, corners, insertion_record
from needleplan_thesis.chapter2.parameters import IdentifiedForce, forward, table_2_3_and_open_loops

pytestmark = pytest.mark.study

FAST = PUBLISHED_FORCES[0]


def test_statements_about_the_model_hold() -> None:
    rows = forward()
    assert len({each.id for each in rows}) == len(rows)
    assert {each.verdict for each in rows} == {Agreement.OURS, Agreement.REPRODUCED}


def test_the_table_of_the_bank() -> None:
    rows = {each.id: each for each in tables_2_1_and_2_2(1)}
    entire = [each for name, each in rows.items() if name.endswith("pooled from its phases")]
    assert [each.verdict for each in entire] == [Agreement.REPRODUCED, *[Agreement.IMPOSSIBLE] * 3]
    assert rows["ch2/section 2.5.2/Model II outperforms Model I/least squares"].verdict is Agreement.NOT_REPRODUCED
    assert sum(name.startswith("ch2/table 2.2/") for name in rows) == 16


def test_a_simulated_record_has_model_bumps_and_noise() -> None:
    record, clean = insertion_record(FAST, 3), insertion_record(FAST, 3, bubbles=False)
    force = SENSOR.apply(simulate(FAST.model, record.motion()).output)
    assert np.std(clean["force_n"] - force) == pytest.approx(1.9e-3, rel=0.1)
    bumps = record["force_n"] - clean["force_n"]
    inward, outward = record.motion().direction > 0, record.motion().direction < 0
    depth = np.linspace(5, 75, 50)
    there = np.interp(depth, record["depth_mm"][inward], bumps[inward])
    back = np.interp(depth, record["depth_mm"][outward][::-1], bumps[outward][::-1])
    np.testing.assert_allclose(there, -back, atol=2e-3)  # same places, other direction
    assert 2e-3 < np.std(bumps) < 20e-3


def test_starts_are_wrong_by_the_factor() -> None:
    for start in corners(ForceModel1(**FAST.model.values()), 3.0, 4):
        for name in ("sigma0", "sigma1", "sigma2", "alpha"):
            assert abs(math.log(getattr(start, name) / getattr(FAST.model, name))) == pytest.approx(math.log(3))
        assert start.f2 == pytest.approx(FAST.model.f2)
        assert start.proper


def test_errors_by_phase() -> None:
    from needleplan_thesis.chapter2.bank import run_bank

    record = insertion_record(FAST, 0)
    phases = phases_of(run_bank(FAST.model, record), record, 5)
    assert math.hypot(phases.insertion_n, phases.retraction_n) / 2**0.5 == pytest.approx(phases.entire_n, rel=1e-3)


def test_loops_and_figures(tmp_path: Path) -> None:
    record = insertion_record(FAST, 0).select(slice(0, None, 4))
    run = identify_by_passes(JointForce(FAST.model), FAST.model, [record])
    made = [IdentifiedForce(each, record, run) for each in PUBLISHED_FORCES]
    rows = table_2_3_and_open_loops(made)
    assert len(rows) == 5 * 6
    assert rows[0].published == FAST.model.sigma0
    assert all(each.verdict is Agreement.SAME_ORDER for each in rows[:5])
    draw_figures(made, tmp_path)
    assert sorted(each.name for each in tmp_path.iterdir()) == [f"fig_2_{n}.png" for n in range(2, 10)]
