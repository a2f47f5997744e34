from dataclasses import replace

import numpy as np
import pytest

from needleplan.errors import DataError
from needleplan.identification import force
from needleplan.identification._force_record import starting_force
from needleplan.models import FitStatus, simulate
from needleplan.models.force import ForceModel1, ForceModel2, with_gauge
from needleplan.signals import Record, Role
from needleplan_thesis.chapter2.forces import PUBLISHED_FORCES
from tests.estimation.insertions import AVERAGE, MODEL, recorded

TRUTH = with_gauge(ForceModel1(**MODEL.values()), 0.02)
RECORD = recorded(MODEL)


def inward(record: Record) -> Record:
    return record.select(record.motion().direction > 0)


@pytest.mark.slow
def test_a_model_is_found_and_judged() -> None:
    held = replace(recorded(MODEL, seed=5), role=Role.HOLDOUT, trial="other")
    rest = replace(RECORD, role=Role.NOISE).with_column("force_n", recorded(MODEL, seed=3)["force_n"] - AVERAGE.apply(
        simulate(MODEL, RECORD.motion()).output))  # fmt: skip
    found = force.identify([RECORD, held, rest], starts=1)
    assert found.ok
    scores = {name: value for name, value, _ in found.scores}
    assert scores["RMSE of the fit"] < 2.1e-3
    assert scores["MAE of the open loop, held out"] < 2e-3
    assert scores["joint filter: MAE of the open loop"] < 3e-3
    assert found.model is not None
    assert found.model.values() == pytest.approx(TRUTH.values(), rel=0.15)
    assert all(each.low <= getattr(TRUTH, name) <= each.high for name, each in found.estimates.items())
    says = {each.name: each.says for each in found.findings}
    assert says["residuals over the sensor's noise"] == "the residual is the noise of the sensor"
    assert any("beta = 0.02 is not measured" in each for each in found.remarks)


@pytest.mark.parametrize("number", [2, 3])
def test_every_published_set_is_fitted_from_a_start_of_its_own(number: int) -> None:
    chosen = PUBLISHED_FORCES[number]
    record = recorded(chosen.model, chosen.velocity_mm_s, seed=number)
    found = force.fit_force(starting_force([record]), [record], AVERAGE, starts=1)
    assert found.ok
    assert found.rmse < 2.1e-3


def test_model_2_keeps_what_is_fixed() -> None:
    found = force.identify([RECORD], start=MODEL.with_values(sigma2=0.01, f1=0.1), starts=1, filtered=False)
    assert found.model is not None
    assert found.model.values()["f2"] == MODEL.f2
    assert set(found.estimates) == {"sigma0", "sigma1", "sigma2", "f1", "beta"}


def test_an_insertion_alone_says_what_it_cannot_tell() -> None:
    found = force.identify([inward(RECORD)], starts=1, filtered=False)
    whole = force.identify([RECORD], starts=1, filtered=False)
    assert any("no retraction" in each for each in found.remarks)
    widths = [np.log(each.estimates["sigma2"].high / each.estimates["sigma2"].low) for each in (found, whole)]
    assert widths[0] > 3 * widths[1]
    assert {name: value for name, value, _ in found.scores}["RMSE of the fit"] < 2.1e-3


def test_what_differs_in_speed_is_questioned() -> None:
    quick, slow = recorded(MODEL, depth=30.0), recorded(MODEL, 6.0, depth=30.0, seed=1)
    found = force.identify([quick, slow], start=MODEL, starts=1, filtered=False)
    assert any("differ in speed" in each for each in found.remarks)


def test_records_that_say_nothing() -> None:
    with pytest.raises(DataError, match="no trial to identify"):
        force.identify([replace(RECORD, role=Role.HOLDOUT)])
    with pytest.raises(DataError, match="needs more than"):
        force.identify([RECORD.select(slice(0, 40))])
    with pytest.raises(DataError, match="force_n"):
        force.identify([Record({"time_s": RECORD["time_s"], "depth_mm": RECORD["depth_mm"]})])


def test_reversals_do_not_count() -> None:
    keep = force.settled(RECORD, 5)
    turned = int(np.flatnonzero(RECORD.motion().direction < 0)[0])
    assert np.flatnonzero(~keep).tolist() == list(range(turned - 1, turned + 5))


def test_the_figure_is_drawn() -> None:
    from matplotlib.figure import Figure

    figure = Figure()
    force.identify([RECORD], starts=1, filtered=False).draw(figure)
    assert [axes.get_ylabel() for axes in figure.axes] == ["force (N)", "residual (mN)"]


@pytest.mark.slow
def test_a_rise_without_a_peak_ends_at_the_edge_and_says_so() -> None:
    depth = np.linspace(0, 50, 1000)
    bent = Record({
        "time_s": depth / 3, "depth_mm": depth, "force_n": 4e-4 * depth**2.2 + 0.01 * np.sin(depth),
    })  # fmt: skip
    found = force.identify([bent], average=1, starts=1, filtered=False)
    assert isinstance(found.model, ForceModel1 | ForceModel2)
    assert found.model.proper
    assert {name: value for name, value, _ in found.scores}["MAE of the open loop"] < 0.1
    assert any("not identified" in each for each in found.remarks)


def test_a_puncture_is_named_and_the_peak_of_the_model_is_none() -> None:
    depth = RECORD["depth_mm"]
    membrane = np.where((RECORD.motion().direction > 0) & (depth > 30) & (depth < 34), 0.05 * (depth - 30), 0.0)
    torn = replace(RECORD, trial="torn").with_column("force_n", RECORD["force_n"] + membrane)
    found = force.identify([torn], starts=1, filtered=False)
    (said,) = [each for each in found.remarks if "drops at once" in each]
    assert said.startswith("torn: the force drops at once, by 0.2")
    assert "at 34.0 mm" in said
    for chosen in PUBLISHED_FORCES:
        smooth = recorded(chosen.model, chosen.velocity_mm_s)
        assert not force._punctures([smooth], AVERAGE.samples)


def test_a_fit_that_crawls_along_a_valley_is_a_model_that_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = force.fit_force(starting_force([RECORD]), [RECORD], AVERAGE, starts=1)
    monkeypatch.setattr(force, "fit_force", lambda *_: replace(whole, status=FitStatus.EVALUATION_LIMIT))
    found = force.identify([RECORD], starts=1, filtered=False)
    assert found.ok
    assert any("one set of many" in each for each in found.remarks)
    monkeypatch.setattr(force, "fit_force", lambda *_: replace(whole, status=FitStatus.DIVERGED))
    assert not force.identify([RECORD], starts=1, filtered=False).ok
