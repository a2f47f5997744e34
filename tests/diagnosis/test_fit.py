"""Fits come near the optimum where a missing effect or other laws distort the base."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from needleplan.diagnosis import Library, Settings, _fit, diagnose
from needleplan.diagnosis._diagnose import _best_sampling
from needleplan.diagnosis._hypothesis import nuisances
from needleplan.diagnosis._screening import Screening
from needleplan.diagnosis._tangents import Coordinate
from needleplan.diagnosis.catalogue import FittedEffect
from needleplan.models import ShaftAndTip
from needleplan.models.effects import effect_named
from needleplan.signals import Array, Motion, Role
from tests.diagnosis.trials import BASE, recordings


@dataclass(frozen=True, kw_only=True)
class SlowTip(ShaftAndTip):
    """A base whose cutting force reverses over ten times the travel of its friction."""

    def output(self, state: Array, motion: Motion) -> Array:
        slow = ShaftAndTip(**{**self.values(), "presliding_mm": 0.5})
        return self.shaft_n(state, motion) + self.tip_n(slow.integrate(motion, np.zeros(1)), motion)


@pytest.mark.slow
def test_the_fit_goes_further_with_the_laws_of_the_base_in_its_sensitivities(monkeypatch: pytest.MonkeyPatch) -> None:
    strange = recordings({"viscous": {"size": 3e-3}})
    _, further = _best_sampling(BASE, strange, Settings())
    assert further.trials[0].laws is not None
    monkeypatch.setattr(_fit, "_laws", lambda *_: None)  # sensitivities of the model alone
    _, stuck = _best_sampling(BASE, strange, Settings())
    assert further.height > stuck.height + 500


@pytest.mark.slow
def test_the_fit_ends_at_an_optimum_beside_another_law_of_reversal_of_the_tip() -> None:
    strange = recordings(base=SlowTip(**BASE.values()))
    _, further = _best_sampling(BASE, strange, Settings())
    assert further.promise < 0.5


def test_the_output_of_the_laws_at_the_point_of_their_columns_is_that_of_the_columns() -> None:
    _, found = _best_sampling(BASE, recordings({"viscous": {"size": 1e-4}}), Settings())
    laws = np.random.default_rng(0).standard_normal(len(found.beside_model))
    for number, trial in enumerate(found.trials):
        output = found.problem.whiten(trial, number, _fit._law_output(found.problem, trial, laws)(trial.model))
        columns = nuisances(found.problem, trial, number, ())[:, found.beside_model]
        np.testing.assert_allclose(output, columns @ laws, atol=1e-10)


@pytest.mark.parametrize("bound_s", [0.0, 0.05])
def test_a_step_does_not_promise_what_a_bound_forbids(bound_s: float) -> None:
    _, empty = _best_sampling(BASE, recordings(), Settings())
    delay = FittedEffect(effect_named("latency"), {"size": 0.05}, {"size": (bound_s, 1.0)})
    here = _fit.fit_hypothesis(empty.problem, [delay], empty.trials, most_steps=0)
    move, energy = _fit._step(here, here.best_here)
    assert here.promise > 100
    if bound_s:
        assert move[0] == 0
        assert here.rise_to(energy) < here.promise - 10
    else:
        assert move[0] < 0
        assert here.rise_to(energy) == pytest.approx(here.promise, rel=1e-3)


@pytest.mark.study
@pytest.mark.parametrize(("delay_s", "seed"), [(0.09, 2), (0.12, 0)])
def test_a_long_delay_does_not_leave_a_longer_presliding(delay_s: float, seed: int) -> None:
    library = Library([effect_named(name) for name in ("viscous", "bias", "latency")], BASE)
    found = diagnose(BASE, recordings({"latency": {"size": delay_s}}, seed=seed), library=library)
    assert found.names == ("latency",)
    for trial in found.named.trials:
        assert trial.model.presliding_mm == pytest.approx(BASE.presliding_mm, rel=0.2)
        assert found.effects[0].values["size"] + trial.lag_s == pytest.approx(delay_s, abs=0.005)


def test_the_variance_of_an_amplitude_by_its_law_is_that_of_draws_of_the_law() -> None:
    _, empty = _best_sampling(BASE, recordings({"drift": {"size": 0.01}}), Settings())
    drift = FittedEffect(effect_named("drift"), {"size": 0.01}, {"size": (-1.0, 1.0)})
    here = _fit.fit_hypothesis(empty.problem, [drift], empty.trials)
    h, which = here.best, here.cosines[0]
    covariance = here.linear.inverse[h] * here.problem.noise_scale.variance(here.linear.energy)[h]
    draws = np.random.default_rng(3).multivariate_normal(here.linear.mean[h], covariance, 1000)[:, which]
    deviations = np.concatenate([own[:, which] @ draws.T for own in here.linear.basis])
    per_unit = np.concatenate([own[:, here.coordinates.index(Coordinate(0, "size"))] for own in here.linear.basis])
    wanted = np.mean(np.sum(deviations**2, axis=0)) / (per_unit @ per_unit)
    assert here.law_variance(0, h) == pytest.approx(wanted, rel=0.15)
    assert here.law_variance(0, h) < (0.2 * 0.01 / effect_named("drift").parameters["size"].typical) ** 2


@pytest.mark.parametrize("name", ["bristle", "tissue_motion"])
def test_below_the_presliding_length_an_effect_is_another_presliding_length_unless_references_show_it(
    name: str,
) -> None:
    _, empty = _best_sampling(BASE, recordings(), Settings())
    screening = Screening.of(empty.problem, Library([effect_named(name)], BASE))
    *shown, last = empty.problem.trials
    reference = replace(last, record=replace(last.record, role=Role.REFERENCE))
    beside = replace(screening, problem=replace(empty.problem, trials=(*shown, reference)))
    assert [each._start(each.entries[0], 0, 0.01).bounds.get("size") for each in (screening, beside)] == [
        (BASE.presliding_mm, effect_named(name).parameters["size"].upper), None
    ]  # fmt: skip
