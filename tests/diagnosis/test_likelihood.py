from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from needleplan.diagnosis.likelihood import JointLikelihood, WhitenedTrial
from needleplan.signals import Array

HETEROGENEITY_SDS = np.array([0.0, 0.3, 1.0])


def blocks(seed: int, shared: int) -> tuple[list[WhitenedTrial], list[Array]]:
    generator = np.random.default_rng(seed)
    made, columns = [], []
    for samples in (40, 55):
        modes = np.linalg.qr(generator.standard_normal((samples, 3)))[0]
        made.append(
            WhitenedTrial(
                generator.standard_normal(samples), generator.standard_normal((samples, 2)),
                generator.standard_normal((samples, shared)), modes, generator.uniform(0.5, 20, 3),
            )
        )  # fmt: skip
        columns.append(generator.standard_normal((samples, 4)))
    return made, columns


def direct_evidence(made: list[WhitenedTrial], heterogeneity_sd: float, extra: list[Array]) -> float:
    """Restricted in what each trial has for itself, profiled in what is shared: with whole covariances."""
    size = sum(each.samples for each in made)
    covariance, own, begin = np.zeros((size, size)), np.zeros((size, 2 * len(made))), 0
    for index, each in enumerate(made):
        part = slice(begin, begin + each.samples)
        covariance[part, part] = (
            np.eye(each.samples) + heterogeneity_sd**2 * (each.modes * each.variances) @ each.modes.T
        )
        own[part, 2 * index : 2 * index + 2] = each.base_sensitivities
        begin += each.samples
    inverse = np.linalg.inv(covariance)
    fixed = np.column_stack([own, np.vstack([each.shared for each in made]), np.vstack(extra)])
    residual = np.concatenate([each.residual for each in made])
    normal = fixed.T @ inverse @ fixed
    solved = np.linalg.solve(normal, fixed.T @ inverse @ residual)
    left = residual - fixed @ solved
    determinants = np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(own.T @ inverse @ own)[1]
    return float(-0.5 * (determinants + left @ inverse @ left))


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 10_000), st.integers(0, 2))
def test_gains_are_those_of_the_whole_likelihood(seed: int, shared: int) -> None:
    made, columns = blocks(seed, shared)
    likelihood = JointLikelihood(made, HETEROGENEITY_SDS)
    nothing = [np.zeros((each.samples, 0)) for each in made]
    plain = [direct_evidence(made, heterogeneity_sd, nothing) for heterogeneity_sd in HETEROGENEITY_SDS]
    np.testing.assert_allclose(likelihood.evidence, plain, rtol=1e-6)
    gains, _ = likelihood.scores(columns).gains()
    for column in range(4):
        whole = max(
            direct_evidence(made, heterogeneity_sd, [each[:, [column]] for each in columns])
            for heterogeneity_sd in HETEROGENEITY_SDS
        )
        assert gains[column] == pytest.approx(2 * (whole - max(plain)), abs=1e-4)
    whole = max(direct_evidence(made, heterogeneity_sd, columns) for heterogeneity_sd in HETEROGENEITY_SDS)
    assert likelihood.basis_gains(columns) == pytest.approx(2 * (whole - max(plain)), abs=1e-3)


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 3))
def test_shared_effects_held_equal_a_likelihood_without_them(seed: int, shared: int) -> None:
    made, _ = blocks(seed, shared)
    likelihood = JointLikelihood(made, HETEROGENEITY_SDS)
    alone = JointLikelihood([replace(each, shared=np.zeros((each.samples, 0))) for each in made], HETEROGENEITY_SDS)
    np.testing.assert_allclose(likelihood.evidence_alone, alone.evidence, rtol=1e-9)
    for heterogeneity_sd in range(len(HETEROGENEITY_SDS)):
        for found, slow in zip(
            likelihood.shared_normal(heterogeneity_sd),
            alone.normal([each.shared for each in made], heterogeneity_sd),
            strict=True,
        ):
            np.testing.assert_allclose(found, slow, rtol=1e-7, atol=1e-8)


def test_cached_scores_belong_to_their_sensitivities() -> None:
    made, columns = blocks(5, 1)
    likelihood, others = JointLikelihood(made, HETEROGENEITY_SDS), [2 * each for each in columns]
    first = likelihood.scores(columns)
    assert likelihood.scores(columns) is first
    np.testing.assert_allclose(likelihood.scores(others).slope, 2 * first.slope)
    np.testing.assert_allclose(likelihood.scores(columns).slope, first.slope)


def test_simulated_gains_of_one_candidate_are_chi_squared() -> None:
    made, columns = blocks(3, 0)
    likelihood = JointLikelihood(made, np.array([0.5]))
    drawn = likelihood.null_maxima([each[:, :1] for each in columns], np.zeros(1), np.zeros(1), 4000, 1)
    assert np.mean(drawn) == pytest.approx(1.0, abs=0.1)
    assert np.mean(drawn > 3.841) == pytest.approx(0.05, abs=0.015)


@pytest.mark.parametrize("scale", [1.0, 1e5])
def test_an_absorbed_sensitivity_has_no_gain(scale: float) -> None:
    """What rounding leaves of it would otherwise be divided by what rounding leaves of its square."""
    made, _ = blocks(5, 1)
    likelihood = JointLikelihood(made, HETEROGENEITY_SDS)
    taken = [scale * each.base_sensitivities @ [[1.0, 0.3], [-2.0, 1.0]] for each in made]
    gains, _ = likelihood.scores(taken).gains()
    np.testing.assert_allclose(gains, 0.0, atol=1e-9)
    assert likelihood.null_maxima(taken, np.zeros(2), np.zeros(2), 50, 2).max() == 0
