"""Descriptions of unexplained gaps whose truth is known."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from needleplan.diagnosis import Diagnosis, GapAxis, GapDescription, Library, Verdict, diagnose
from needleplan.diagnosis.gap import curves_along
from needleplan.errors import ModelError
from needleplan.models import simulate
from needleplan.models.effects import SIZE, Effect, effect_named, known_effects, register_file
from needleplan.reports.diagnosis import effect_file_text
from needleplan.signals import Array, Motion, Record, Role
from tests.diagnosis.trials import BASE, RATE_HZ, coloured, motion
from tests.models.effects import test_contract

LENGTH_MM = 3.7


def wave(path: Motion) -> Array:
    return np.asarray(0.04 * np.sin(2 * np.pi * np.maximum(path.depth_mm, 0) / LENGTH_MM))


def step(path: Motion) -> Array:
    return np.where(path.time_s > 12.3, -0.06, 0.0)


def diagnosed(gap: Callable[[Motion], Array]) -> Diagnosis:
    generator = np.random.default_rng(5)
    found = []
    for number, role in enumerate((Role.TRAIN, Role.TRAIN, Role.HOLDOUT)):
        path = motion(number)
        force = simulate(BASE, path).output + gap(path) + coloured(generator, len(path))
        columns = {"time_s": path.time_s, "depth_mm": path.depth_mm, "velocity_mm_s": path.velocity_mm_s}
        found.append(Record({**columns, "force_n": force}, f"trial {number}", role))
    time = np.arange(1500) / RATE_HZ
    still = {"time_s": time, "depth_mm": np.full(1500, -5.0), "force_n": coloured(generator, 1500)}
    library = Library([effect_named(name) for name in ("viscous", "inertia")], BASE)
    return diagnose(BASE, [*found, Record(still, "noise", Role.NOISE)], library=library)


@pytest.fixture(scope="module")
def periodic() -> tuple[Diagnosis, GapDescription]:
    found = diagnosed(wave)
    assert found.verdict is Verdict.UNKNOWN
    described = found.described
    assert described is not None
    return found, described


@pytest.fixture(scope="module")
def slipped() -> tuple[Diagnosis, GapDescription]:
    found = diagnosed(step)
    assert found.verdict is Verdict.UNKNOWN
    described = found.described
    assert described is not None
    return found, described


def test_a_wave_of_the_position_is_found_as_one(periodic: tuple[Diagnosis, GapDescription]) -> None:
    _, described = periodic
    assert described.axis is GapAxis.PERIOD
    formula = described.sparse
    assert formula is not None
    assert formula.transfer is not None
    assert formula.transfer > 0.8
    path = motion(2)
    np.testing.assert_allclose(formula.values(path, simulate(BASE, path).output), wave(path), atol=0.012)


def test_a_step_in_time_has_its_moment_and_height(slipped: tuple[Diagnosis, GapDescription]) -> None:
    found, described = slipped
    assert described.axis is GapAxis.TIME
    (change,) = (each for each in found.localisation.changes if each.axis is GapAxis.TIME)
    assert change.place == pytest.approx(12.3, abs=0.3)
    assert described.sparse is not None
    assert described.sparse.products[0].text.startswith("(time_s > 12")
    assert described.sparse.factors[0] == pytest.approx(-0.06, abs=0.01)


def test_a_curve_follows_what_was_missing_and_knows_where_it_does_not(
    slipped: tuple[Diagnosis, GapDescription],
) -> None:
    _, described = slipped
    (curve,) = described.curves.curves
    early, late = curve.places < 11, curve.places > 14
    jump = curve.mean[late & curve.inside].mean() - curve.mean[early & curve.inside].mean()
    assert jump == pytest.approx(-0.06, abs=0.015)
    prior = described.curves.prior_sd
    assert (curve.sd <= prior * 1.001).all()
    assert curve.sd[~curve.inside].max() > 0.9 * prior
    assert np.median(curve.sd[curve.inside]) < 0.5 * prior


def test_the_posterior_is_that_of_the_samples(slipped: tuple[Diagnosis, GapDescription]) -> None:
    """Slow twin: the curve as a normal variable among all samples, with what the base takes up given a wide prior."""
    found, _ = slipped
    base, trials = found.selection.base, found.calibration.training
    curves = curves_along(GapAxis.TIME, trials, lambda basis: base.normal(
        [trial.whiten(each) for trial, each in zip(trials, basis, strict=True)], base.best
    ))  # fmt: skip
    (curve,) = curves.curves
    places = curve.places
    span = max(float(trial.motion.time_s[-1]) for trial in trials)
    rows, residual, nuisance = [], [], []
    for index, trial in enumerate(trials):
        hats = np.column_stack([np.interp(trial.motion.time_s, places, one) for one in np.eye(len(places))])
        rows.append(trial.whiten(hats))
        residual.append(trial.whitened.residual)
        blocks = [np.zeros((trial.whitened.samples, each.whitened.base_sensitivities.shape[1])) for each in trials]
        blocks[index] = trial.whitened.base_sensitivities
        heterogeneity_sd = base.heterogeneity_sd * np.sqrt(trial.whitened.variances)
        modes = [np.zeros((trial.whitened.samples, each.whitened.modes.shape[1])) for each in trials]
        modes[index] = trial.whitened.modes * heterogeneity_sd
        nuisance.append(np.hstack([1e3 * np.hstack(blocks), np.hstack(modes)]))
    design, data, free = np.vstack(rows), np.concatenate(residual), np.vstack(nuisance)
    means = []
    for length in (0.08, 0.15, 0.3, 0.6):
        shape = np.exp(-0.5 * ((places[:, None] - places) / (span * length)) ** 2) + 1e-6 * np.eye(len(places))
        root = np.linalg.cholesky(curves.prior_sd**2 * shape)
        whole = np.hstack([design @ root, free])
        normal = whole.T @ whole + np.eye(whole.shape[1])
        means.append(root @ np.linalg.solve(normal, whole.T @ data)[: len(places)])
    assert min(np.abs(mean - curve.mean).max() for mean in means) < 0.05 * np.abs(curve.mean).max()


@pytest.fixture(params=["formula", "table"])
def draft(
    request: pytest.FixtureRequest, slipped: tuple[Diagnosis, GapDescription], tmp_path: Path
) -> Iterator[tuple[Effect, GapDescription]]:
    _, described = slipped
    if request.param == "table":
        described = GapDescription(described.axis, described.curves, None, described.rms)
    file = tmp_path / "effect_to_name.py"
    file.write_text(effect_file_text(described, "slip"))
    effect = register_file(str(file))
    yield effect, described
    del known_effects()[effect.name]


def test_the_draft_keeps_the_contract_of_effects(draft: tuple[Effect, GapDescription]) -> None:
    effect, _ = draft
    test_contract.test_it_says_what_it_is(effect)
    test_contract.test_size_zero_is_the_base_to_the_last_bit(effect)
    test_contract.test_columns_are_what_the_simulation_gains(effect)
    test_contract.test_memories_are_their_rates_integrated(effect)
    test_contract.test_a_run_goes_on_where_it_was(effect)
    test_contract.test_a_model_file_keeps_it(effect)
    test_contract.test_what_is_of_the_sensor_is_not_in_the_plant(effect)


def test_the_draft_adds_what_was_described(draft: tuple[Effect, GapDescription]) -> None:
    effect, described = draft
    path, plain = motion(1), simulate(BASE, motion(1)).output
    size = effect.parameters[SIZE].typical
    added = simulate(effect.apply(BASE, {SIZE: size}), path).output - plain
    if described.sparse is None:
        (curve,) = described.curves.curves
        wanted = np.interp(path.time_s, curve.places[curve.inside], curve.mean[curve.inside])
    else:
        wanted = described.sparse.values(path, plain)
    np.testing.assert_allclose(added, wanted, atol=0.01 * np.abs(wanted).max())


def test_with_its_draft_a_gap_has_a_name(draft: tuple[Effect, GapDescription]) -> None:
    effect, _ = draft
    generator = np.random.default_rng(6)
    path = motion(0)
    force = simulate(BASE, path).output + step(path) + coloured(generator, len(path))
    column = effect.columns(BASE, path, [{}])[:, 0]
    left = force - simulate(BASE, path).output
    fitted = float(column @ left / (column @ column))
    assert np.std(left - fitted * column) < 0.75 * np.std(left)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("import nothing_like_it", "cannot be created: ModuleNotFoundError"),
        ("EFFECT = 3", "must be defined as an Effect"),
        ("from needleplan.models.effects import FORCE_EFFECTS\nfrom dataclasses import replace\n"
         "EFFECT = replace(FORCE_EFFECTS[0])", "is the name of another effect"),
        ("raise SystemExit(3)", "cannot be created: SystemExit"),
    ],
)  # fmt: skip
def test_a_file_that_holds_no_effect_is_refused(text: str, says: str, tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    file.write_text(text)
    with pytest.raises(ModelError, match=says):
        register_file(str(file))
    with pytest.raises(ModelError, match="cannot be read"):
        register_file(str(tmp_path / "missing.py"))
