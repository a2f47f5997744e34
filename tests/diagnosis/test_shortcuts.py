"""Every shortcut of a diagnosis against the slow computation that it replaces."""

from dataclasses import replace

import numpy as np
import pytest

from needleplan.diagnosis import Library, Settings, _search, calibration
from needleplan.diagnosis._diagnose import _best_sampling
from needleplan.diagnosis._hypothesis import Hypothesis, nuisances
from needleplan.diagnosis._problem import Problem
from needleplan.diagnosis._screening import Screening
from needleplan.diagnosis.catalogue import FittedEffect
from needleplan.models.effects import effect_columns, effect_named
from tests.diagnosis.trials import BASE, recordings

VISCOUS = FittedEffect(effect_named("viscous"), {"size": 3e-4})


@pytest.fixture(scope="module")
def empty() -> Hypothesis:
    return _best_sampling(BASE, recordings({"viscous": {"size": 3e-4}}), Settings())[1]


@pytest.mark.parametrize("levels", [(0, 2, 13), (4,)])
def test_a_set_at_other_heterogeneities_needs_no_new_products(empty: Hypothesis, levels: tuple[int, ...]) -> None:
    whole = Hypothesis.at(empty.problem, (VISCOUS,), empty.trials, scales=empty.scales)
    few = empty.problem.with_levels(np.array(levels))
    slow = Hypothesis.at(few, (VISCOUS,), empty.trials, scales=empty.scales)
    np.testing.assert_allclose(whole.with_levels(few).by_heterogeneity, slow.by_heterogeneity, rtol=1e-12)
    np.testing.assert_allclose(slow.with_levels(empty.problem).by_heterogeneity, whole.by_heterogeneity, rtol=1e-12)


def test_a_smaller_limit_of_the_heterogeneity_keeps_errors_and_modes(empty: Hypothesis) -> None:
    problem = empty.problem
    few, slow = problem.up_to(0.06), replace(problem, largest_sd=0.06)
    for (modes, variances), (slow_modes, slow_variances) in zip(few.modes, slow.modes, strict=True):
        np.testing.assert_array_equal(modes, slow_modes)
        np.testing.assert_array_equal(variances, slow_variances)


def test_modes_that_are_left_out_hardly_change_the_evidence(empty: Hypothesis, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(calibration, "HIDDEN_MODES", 0.0)
    trials = tuple(replace(trial) for trial in empty.problem.trials)  # nothing of them is kept
    problem = Problem(empty.problem.calibration, trials, empty.problem.settings, empty.problem.noise_freedom)
    problem = problem.up_to(empty.problem.largest_sd)
    assert all(
        len(few.T) < len(every.T)
        for trial, own in zip(empty.problem.trials, trials, strict=True)
        for few, every in zip(trial.tissue, own.tissue, strict=True)
    )
    whole = Hypothesis.at(problem, (), empty.trials, None, empty.formula_error, empty.scales)
    np.testing.assert_allclose(empty.by_heterogeneity, whole.by_heterogeneity, atol=0.2)


def test_breaths_with_and_without_a_phase_of_their_own_share_columns(empty: Hypothesis) -> None:
    names = ("respiration", "bias", "respiration_by_trial", "viscous")
    library = Library([effect_named(name) for name in names], BASE)
    motion = empty.trials[0].motion
    entries = library.entries([motion])
    found = library.sensitivities(BASE, motion, entries)
    assert [entry.effect.name for entry in entries] == list(names)
    assert found.shape[1] == len(entries[0].grid) + 2
    for entry in entries:
        own = effect_columns(entry.effect, BASE, motion, entry.grid)
        np.testing.assert_array_equal(found[:, entry.first : entry.last], own)


def test_added_effects_leave_the_shared_columns_at_the_given_base_as_they_are(empty: Hypothesis) -> None:
    screening = Screening.of(empty.problem, Library([VISCOUS.effect, effect_named("bias")], BASE))
    parent = Hypothesis.at(empty.problem, (VISCOUS,), empty.trials)
    for number, trial in enumerate(screening.at_given(parent)):
        assert trial.shared is not None
        np.testing.assert_allclose(trial.shared, nuisances(empty.problem, trial, number, (VISCOUS,)), atol=1e-9)


def test_a_fit_that_always_promises_more_is_repeated_a_few_times_only(
    empty: Hypothesis, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The promise of a further step grows with every fit, so that no score rises: the search ends nevertheless."""
    fits: list[float] = []

    class Promising:
        """A fitted set that gains two nats and promises ten more."""

        names, effects, trials = ("viscous",), (), ()
        promise = 10.0

        def __init__(self) -> None:
            self.log_evidence = 2.0 * len(fits)

    def fit(*_: object, **__: object) -> Promising:
        fits.append(0.0)
        return Promising()

    monkeypatch.setattr(_search, "fit_hypothesis", fit)
    library = Library([effect_named("viscous")], BASE)
    state = _search._Search(empty.problem, Screening.of(empty.problem, library))
    state.add(Promising())  # type: ignore[arg-type]
    state._converge(("viscous",))
    assert len(fits) == 3
