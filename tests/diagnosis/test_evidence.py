"""The evidence against a dense multivariate normal that is computed independently."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import block_diag
from scipy.special import logsumexp
from scipy.stats import gamma, multivariate_normal

from needleplan.diagnosis._blocks import Block
from needleplan.diagnosis._evidence import Columns, LinearModel, NoiseScale
from needleplan.diagnosis._factors import root_of
from needleplan.signals import Array

LEVEL = 5
# A heterogeneity of rough tissue, and one of smooth tissue.
LEVELS = (LEVEL, 16)


def block(random: np.random.Generator, n: int, q: int, k: int) -> Block:
    """A trial with priors of standard deviation 0.5 to 2 of its base coefficients in the last rows."""
    base = np.vstack([random.normal(size=(n, q)), np.diag(1 / random.uniform(0.5, 2.0, q))])
    kinds = [np.linalg.qr(random.normal(size=(n, count)))[0] for count in (k, k - 1)]
    modes = np.vstack([np.hstack(kinds), np.zeros((q, 2 * k - 1))])
    residual = np.concatenate([2.0 * random.normal(size=n), 0.3 * random.normal(size=q)])
    variances = block_diag(random.uniform(20.0, 400.0, k), random.uniform(20.0, 400.0, k - 1))
    return Block(residual, base / np.linalg.norm(base, axis=0), modes, variances)


def dense(
    blocks: list[Block], columns: list[Array], precision: Array, level: int, errors: list[Array] | None = None
) -> float:
    """Log density of the samples alone, each coefficient a normal variable of the covariance, at one heterogeneity.

    A base coefficient is normal with the mean that the rows of priors state, in units of its standard deviation.
    `errors` are further columns of each trial, of prior variance 1.
    """
    means, parts, shared = [], [], []
    for each, column in zip(blocks, columns, strict=True):
        q = each.base.shape[1]
        base = (each.base / np.diag(each.base[-q:]))[:-q]
        modes = (each.modes * np.sqrt(each.varied[level]))[:-q]
        parts.append(np.eye(len(base)) + modes @ modes.T + base @ base.T)
        means.append(each.residual[:-q] - base @ each.residual[-q:])
        shared.append(column[:-q] / np.sqrt(precision))
    f = np.vstack(shared)
    if errors is not None:
        parts = [part + own @ own.T for part, own in zip(parts, errors, strict=True)]
    covariance = block_diag(*parts) + f @ f.T
    return float(multivariate_normal(np.zeros(len(f)), covariance).logpdf(np.concatenate(means)))


def evidence(model: LinearModel, count: int = 0) -> Array:
    """Log evidence at each heterogeneity if the first `count` coefficients are zero."""
    rest, spread = model.marginal(count)
    return model.logs - spread / 2 - rest[:, -1, -1] / 2


@pytest.fixture(scope="module")
def parts() -> tuple[list[Block], list[Array], Array]:
    random = np.random.default_rng(3)
    blocks = [block(random, 40, 3, 4), block(random, 50, 3, 4)]
    columns = [np.vstack([random.normal(size=(len(each.residual) - 3, 6)), np.zeros((3, 6))]) for each in blocks]
    return blocks, columns, random.uniform(0.1, 5.0, 6)


@pytest.mark.parametrize("level", LEVELS)
def test_the_evidence_is_that_of_a_dense_normal_distribution(parts, level):
    blocks, columns, precision = parts
    both = [
        (evidence(LinearModel(blocks, [c[:, :m] for c in columns], precision[:m]))[level],
         dense(blocks, [c[:, :m] for c in columns], precision[:m], level))
        for m in (1, 3, 6)
    ]  # fmt: skip
    fast, slow = np.array(both).T
    samples = sum(len(each.residual) - each.base.shape[1] for each in blocks)
    np.testing.assert_allclose(fast - 0.5 * samples * np.log(2 * np.pi), slow, atol=1e-6)


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("share", [0.05, 0.4])
def test_errors_of_a_trial_are_part_of_the_covariance_of_the_dense_distribution(parts, level, share):
    blocks, columns, precision = parts
    random = np.random.default_rng(8)
    errors = [np.vstack([9.0 * random.normal(size=(len(each.residual) - 3, 2)), np.zeros((3, 2))]) for each in blocks]
    model = LinearModel(
        [replace(each, errors=own) for each, own in zip(blocks, errors, strict=True)], columns, precision, 1.0
    )
    fast = evidence(model.with_share(share))[level]
    samples = sum(len(each.residual) - each.base.shape[1] for each in blocks)
    slow = dense(blocks, columns, precision, level, [share * own[:-3] for own in errors])
    assert fast - 0.5 * samples * np.log(2 * np.pi) == pytest.approx(slow, abs=1e-6)


def test_the_evidence_without_the_first_coefficients_is_that_of_the_smaller_model(parts):
    blocks, columns, precision = parts
    whole = LinearModel(blocks, columns, precision)
    less = LinearModel(blocks, [each[:, 2:] for each in columns], precision[2:])
    np.testing.assert_allclose(evidence(whole, 2), evidence(less), atol=1e-8)


def with_errors(blocks: list[Block], count: int) -> list[Block]:
    """Blocks with errors: with more columns than the modes of a kind, they are eliminated first, or else last."""
    if not count:
        return blocks
    random = np.random.default_rng(8)
    sizes = [len(each.residual) - each.base.shape[1] for each in blocks]
    errors = [np.vstack([9.0 * random.normal(size=(n, count)), np.zeros((3, count))]) for n in sizes]
    return [replace(each, errors=own) for each, own in zip(blocks, errors, strict=True)]


@pytest.mark.parametrize("errors", [0, 2, 5])
def test_a_projected_column_gains_what_a_larger_model_gains(parts, errors):
    blocks, columns, precision = parts
    blocks = with_errors(blocks, errors)
    small = LinearModel(blocks, [each[:, :4] for each in columns], precision[:4])
    levels = np.array([0, *LEVELS])
    fixed = Columns(blocks, [each[:, 4:] for each in columns])
    found = small.project(fixed, levels)
    for column in (0, 1):
        chosen = [0, 1, 2, 3, 4 + column]
        large = LinearModel(blocks, [each[:, chosen] for each in columns], precision[chosen])
        prior = precision[4 + column]
        spread = np.log(1 + found.curvature[:, column] / prior)
        gain = 0.5 * found.slope[:, column] ** 2 / (found.curvature[:, column] + prior) - 0.5 * spread
        np.testing.assert_allclose(gain, (evidence(large) - evidence(small))[levels], atol=1e-7)
    both = small.normals(fixed, found, np.array([[0, 1]]))
    np.testing.assert_allclose(both[:, 0, [0, 1], [0, 1]], found.curvature, rtol=1e-9)


def test_the_best_base_coefficients_leave_no_slope(parts):
    blocks, columns, precision = parts
    model = LinearModel(blocks, columns, precision)
    f = model.mean[LEVEL]
    for each, column, d in zip(blocks, columns, model.base_steps(LEVEL, f), strict=True):
        left = each.residual - column @ f - each.base @ d
        weighed = left - each.modes @ (each.varied[LEVEL] / (1 + each.varied[LEVEL]) * (each.modes.T @ left))
        np.testing.assert_allclose(each.base.T @ weighed, 0.0, atol=1e-6)


@pytest.mark.parametrize("level", [0, *LEVELS])
@pytest.mark.parametrize("errors", [0, 2, 5])
def test_what_is_left_is_that_of_all_coefficients_at_once(parts, errors, level):
    blocks, columns, precision = parts
    blocks, share = with_errors(blocks, errors), 0.3
    model = LinearModel(blocks, columns, precision, share)
    f = model.mean[level]
    steps, left = model.base_steps(level, f), model.residuals(level, f)
    for block, column, step, own in zip(blocks, columns, steps, left, strict=True):
        parts = [] if block.errors is None else [share * block.errors]
        every = np.hstack([*parts, block.modes * np.sqrt(block.varied[level]), block.base])
        random = every.shape[1] - len(step)  # coefficients of variance 1; those of the base have none
        target = block.residual - column @ f
        prior = np.diag(np.repeat([1.0, 0.0], [random, len(step)]))
        coefficients = np.linalg.solve(every.T @ every + prior, every.T @ target)
        np.testing.assert_allclose(own, target - every @ coefficients, atol=1e-7)
        np.testing.assert_allclose(step, coefficients[random:], atol=1e-7)


def test_an_uncertain_noise_variance_is_integrated_out():
    # Its precision has a gamma density of `freedom` degrees of freedom and mean 1; the integral is done on a grid.
    scale, energies = NoiseScale(7.0, 40), np.array([0.0, 25.0, 40.0, 90.0])
    precision = np.linspace(1e-4, 20.0, 200_001)
    prior = gamma.logpdf(precision, 3.5, scale=2 / 7.0)
    whole = [logsumexp(prior + 20 * np.log(precision) - precision * each / 2) for each in energies]
    np.testing.assert_allclose(scale.log_likelihood(energies), np.array(whole) - whole[0], atol=1e-6)
    for energy, variance in zip(energies, scale.variance(energies), strict=True):
        best = precision[(prior + 21 * np.log(precision) - precision * energy / 2).argmax()]
        assert variance == pytest.approx(1 / best, rel=0.01)


def test_a_known_noise_variance_is_the_limit_of_many_samples():
    energies = np.array([10.0, 30.0, 80.0])
    nearly = NoiseScale(1e7, 40)
    np.testing.assert_allclose(nearly.log_likelihood(energies), -energies / 2, rtol=1e-4)
    np.testing.assert_allclose(nearly.variance(energies), 1.0, rtol=1e-4)


def test_another_prior_precision_gives_the_evidence_of_a_model_that_is_built_with_it(parts):
    blocks, columns, precision = parts
    other = precision * np.array([0.01, 1.0, 100.0, 1.0, 9.0, 1.0])
    model, built = LinearModel(blocks, columns, precision), LinearModel(blocks, columns, other)
    assert evidence(model)[LEVEL] != pytest.approx(evidence(built)[LEVEL])  # the caches hold the first precision
    changed = model.with_precision(other)
    np.testing.assert_allclose(evidence(changed), evidence(built), rtol=1e-9)
    np.testing.assert_allclose(changed.mean, built.mean, rtol=1e-6, atol=1e-9)
    assert model.evidence_with(other, LEVEL, NoiseScale(1e12, 90)) == pytest.approx(evidence(built)[LEVEL])


def test_gains_by_trial_are_those_of_each_trial_alone_at_the_shared_coefficients(parts):
    blocks, columns, precision = parts
    random = np.random.default_rng(4)
    values = [np.vstack([random.normal(size=(len(each.residual) - 3, 2)), np.zeros((3, 2))]) for each in blocks]
    model = LinearModel(blocks, columns, precision)
    slope, curvature = model.by_trial(Columns(blocks, values), slice(0, 2), LEVEL)
    for number, (each, own) in enumerate(zip(blocks, columns, strict=True)):
        left = Block(each.residual - own @ model.mean[LEVEL], each.base, each.modes, each.variances)
        alone = LinearModel([left], [np.zeros((len(left.residual), 0))], np.zeros(0))
        projected = alone.project(Columns([left], [values[number]]), np.array([LEVEL]))
        np.testing.assert_allclose(slope[number], projected.slope[0], rtol=1e-6)
        np.testing.assert_allclose(curvature[number], projected.curvature[0], rtol=1e-6)


def test_a_model_without_tissue_modes_has_the_same_evidence_at_each_heterogeneity():
    random = np.random.default_rng(4)
    plain = [replace(each, modes=each.modes[:, :0], variances=each.variances[:, :0]) for each in
             (block(random, 40, 3, 4), block(random, 50, 3, 4))]  # fmt: skip
    columns = [random.normal(size=(len(each.residual), 5)) for each in plain]
    model = LinearModel(plain, [each[:, :3] for each in columns], np.ones(3))
    found = model.project(Columns(plain, [each[:, 3:] for each in columns]), np.array([0, *LEVELS]))
    np.testing.assert_allclose(evidence(model), evidence(model)[0])
    np.testing.assert_allclose(found.curvature, found.curvature[[0, 0, 0]])
    assert (found.curvature > 0).all()


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**31), st.floats(1, 1e9), st.floats(1e-10, 1.0))
def test_errors_that_are_equal_but_for_rounding_have_an_evidence(seed: int, size: float, apart: float) -> None:
    random = np.random.default_rng(seed)
    plain = block(random, 40, 3, 4)
    alike = size * random.normal(size=(40, 1)) + apart * random.normal(size=(40, 3))
    errors = np.vstack([alike, np.zeros((3, 3))])
    model = LinearModel([replace(plain, errors=errors)], [10.0 * errors], np.ones(3), 0.4)
    assert np.isfinite(model.evidence_with(np.full(3, 1e-4), LEVEL, NoiseScale(1e12, 40)))
    assert np.isfinite(evidence(model)).all()


def test_the_root_of_a_matrix_that_rounding_made_indefinite_is_that_of_the_nearest_one() -> None:
    random = np.random.default_rng(1)
    columns = random.normal(size=(5, 2))
    matrices = np.stack([columns @ columns.T - 1e-13 * np.eye(5), np.eye(5)])
    roots = root_of(matrices)
    np.testing.assert_allclose(roots @ roots.swapaxes(1, 2), matrices, atol=1e-8)
    np.testing.assert_array_equal(roots, np.tril(roots))
    assert (np.einsum("tcc->tc", roots) > 0).all()


def test_a_residual_below_zero_by_rounding_counts_as_zero() -> None:
    noise = NoiseScale(1.0, 1000)
    rounded, zero = np.array([-1e3, -1e-9]), np.zeros(2)
    np.testing.assert_array_equal(noise.log_likelihood(rounded), noise.log_likelihood(zero))
    np.testing.assert_array_equal(noise.variance(rounded), noise.variance(zero))
