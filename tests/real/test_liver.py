"""Axial force in bovine liver and heart, 3 mm/s, digitised from a figure (Okamura, Simone, O'Leary 2004)."""

import numpy as np
import pytest

from needleplan.identification import force_drops
from needleplan.identification._relaxing_force import can_relax, fit_members
from needleplan.models import FitStatus, ForceModel1, fit, residual_findings
from needleplan.recording import read_records
from needleplan.signals import Record
from tests.real.shared import require

FILE = require("liver_force", "depth_force.csv")
BEFORE_MM = 18.5
START = ForceModel1(sigma0=1e-3, sigma1=1e-2, sigma2=1e-3, f1=1e-2, f2=-5e-3, alpha=0.05, beta=1.0)


@pytest.fixture(scope="module")
def record() -> Record:
    return read_records(FILE, columns="depth=1[m], force=2[N], speed=3[mm/s]")[0]


def test_what_was_put_in_order_is_counted(record: Record) -> None:
    assert len(record) == 312
    assert [int(note.split()[0]) for note in record.notes if "points" in note] == [20, 59]
    assert record["depth_mm"][-1] == pytest.approx(48, abs=0.1)


def test_capsules_are_found(record: Record) -> None:
    drops = force_drops(record, least_n=0.5)
    places = [drop.peak_mm for drop in drops]
    for place in (19.1, 29.9, 32.7, 36.8):
        assert np.abs(np.array(places) - place).min() < 0.3
    assert max(drop.drop_n for drop in drops) > 1.0


def test_the_force_model_roughly_holds_up_to_the_first_puncture(record: Record) -> None:
    """It follows the loading to a tenth, at the edge of its ranges; insertion alone identifies hardly a parameter."""
    before = record.select(record["depth_mm"] < BEFORE_MM)
    found = fit(START, before, starts=8, spread=2.0)
    assert found.status is FitStatus.AT_BOUND
    assert before["force_n"].max() > 10 * found.rmse
    assert sum(not each.identified for each in found.estimates.values()) >= 3


def test_what_is_left_over_the_whole_depth_are_the_punctures(record: Record) -> None:
    found = fit(START, record, starts=8, spread=2.0)
    assert found.rmse > 0.2
    whiteness = residual_findings(found, [record])[0]
    assert whiteness.p_value is not None
    assert whiteness.p_value < 1e-50
    (left,) = found.residuals
    falls = force_drops(record.with_column("force_n", left), least_n=0.5)
    assert any(abs(drop.peak_mm - 36.8) < 0.3 for drop in falls)


@pytest.mark.slow
def test_a_spring_that_stiffens_follows_the_loading(record: Record) -> None:
    """At one speed, a Maxwell branch adds nothing to it: the two differ in the transient only."""
    before = record.select(record["depth_mm"] < BEFORE_MM)
    members = {
        each.label: each for each in fit_members([before], mask=lambda each: np.ones(len(each), bool), capsules=0)
    }
    assert members["spring"].fit.rmse < 0.031
    assert members["spring, two branches"].fit.rmse > 0.028
    assert not can_relax([before])


@pytest.mark.slow
def test_capsules_halve_what_is_left_over_the_whole_depth(record: Record) -> None:
    everywhere = lambda each: np.ones(len(each), bool)  # noqa: E731
    members = {each.label: each for each in fit_members([record], mask=everywhere, most_branches=0)}
    assert members["4 capsules"].fit.rmse < 0.13
    assert members["spring"].fit.rmse > 0.25
    places = [depth for depth, _, _ in members["4 capsules"].model.boundaries]
    assert places == pytest.approx([19.1, 29.9, 32.7, 36.8], abs=0.4)
