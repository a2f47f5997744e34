"""Fits come near the optimum where a missing effect or other laws distort the base."""

from __future__ import annotations

import pytest

from needleplan.diagnosis import Library, Settings, _fit, diagnose
from needleplan.diagnosis._diagnose import _best_sampling
from needleplan.models.effects import effect_named
from tests.diagnosis.trials import BASE, recordings


@pytest.mark.slow
def test_the_fit_goes_further_with_the_laws_of_the_base_in_its_sensitivities(monkeypatch: pytest.MonkeyPatch) -> None:
    strange = recordings({"viscous": {"size": 3e-3}})
    _, further = _best_sampling(BASE, strange, Settings())
    assert further.trials[0].laws is not None
    monkeypatch.setattr(_fit, "_visible_laws", lambda *_: None)  # sensitivities of the model alone
    _, stuck = _best_sampling(BASE, strange, Settings())
    assert further.height > stuck.height + 500


@pytest.mark.slow
def test_a_long_delay_does_not_leave_a_longer_presliding() -> None:
    library = Library([effect_named(name) for name in ("viscous", "bias", "latency")], BASE)
    found = diagnose(BASE, recordings({"latency": {"size": 0.09}}, seed=2), library=library)
    assert found.names == ("latency",)
    for trial in found.named.trials:
        assert trial.model.presliding_mm == pytest.approx(BASE.presliding_mm, rel=0.1)
        assert found.effects[0].values["size"] + trial.lag_s == pytest.approx(0.09, abs=0.004)
