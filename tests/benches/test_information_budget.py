"""The information on an effect that each uncertainty of the diagnosis leaves."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from needleplan.diagnosis import Library, diagnose
from needleplan.models.effects import effect_named
from tests.diagnosis.trials import BASE, recordings

BENCHES = Path(__file__).parents[2] / "benches" / "python"


@pytest.fixture(autouse=True)
def on_path(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHES))


@pytest.fixture(scope="module")
def found():
    library = Library([effect_named(name) for name in ("viscous", "bias")], BASE)
    return diagnose(BASE, recordings({"viscous": {"size": 5e-4}}), library=library)


@pytest.mark.slow
def test_noise_alone_leaves_the_squared_output_and_each_uncertainty_takes_a_part(found):
    from information_budget import STAGES, budget_of

    budget = budget_of(found, "viscous")
    fitted = found.posterior.hypotheses["viscous",]
    whitened = [trial.whiten(np.asarray(own[0])) for trial, own in zip(fitted.trials, fitted.outputs, strict=True)]
    assert len(budget) == len(STAGES)
    assert budget[0] == pytest.approx(sum(float(each @ each) for each in whitened), rel=1e-4)
    assert all(after <= before * (1 + 1e-6) for before, after in pairwise(budget))
    assert 0 < budget[-1] < budget[0]


def test_an_effect_that_was_not_fitted_has_no_budget(found):
    from information_budget import budget_of

    assert budget_of(found, "latency") == []
