from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from needleplan.diagnosis.space import Block, Space
from needleplan.signals import Array

LEVELS = np.array([0.0, 0.3, 1.0])


def blocks(seed: int, shared: int) -> tuple[list[Block], list[Array]]:
    generator = np.random.default_rng(seed)
    made, columns = [], []
    for samples in (40, 55):
        modes = np.linalg.qr(generator.standard_normal((samples, 3)))[0]
        made.append(
            Block(
                generator.standard_normal(samples), generator.standard_normal((samples, 2)),
                generator.standard_normal((samples, shared)), modes, generator.uniform(0.5, 20, 3),
            )
        )  # fmt: skip
        columns.append(generator.standard_normal((samples, 4)))
    return made, columns


def likelihood(made: list[Block], level: float, extra: list[Array]) -> float:
    """Restricted in what each trial has for itself, profiled in what is shared: with whole covariances."""
    size = sum(each.samples for each in made)
    covariance, own, begin = np.zeros((size, size)), np.zeros((size, 2 * len(made))), 0
    for index, each in enumerate(made):
        part = slice(begin, begin + each.samples)
        covariance[part, part] = np.eye(each.samples) + level**2 * (each.modes * each.variances) @ each.modes.T
        own[part, 2 * index : 2 * index + 2] = each.sensitivities
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
    space = Space(made, LEVELS)
    nothing = [np.zeros((each.samples, 0)) for each in made]
    plain = [likelihood(made, level, nothing) for level in LEVELS]
    np.testing.assert_allclose(space.evidence, plain, rtol=1e-6)
    gains, _ = space.scores(columns).gains()
    for column in range(4):
        whole = max(likelihood(made, level, [each[:, [column]] for each in columns]) for level in LEVELS)
        assert gains[column] == pytest.approx(2 * (whole - max(plain)), abs=1e-4)
    whole = max(likelihood(made, level, columns) for level in LEVELS)
    assert space.basis_gains(columns) == pytest.approx(2 * (whole - max(plain)), abs=1e-3)


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 3))
def test_what_is_shared_is_known_as_in_a_space_without_it(seed: int, shared: int) -> None:
    made, _ = blocks(seed, shared)
    space = Space(made, LEVELS)
    alone = Space([replace(each, shared=np.zeros((each.samples, 0))) for each in made], LEVELS)
    np.testing.assert_allclose(space.evidence_alone, alone.evidence, rtol=1e-9)
    for level in range(len(LEVELS)):
        for found, slow in zip(
            space.shared_normal(level), alone.normal([each.shared for each in made], level), strict=True
        ):
            np.testing.assert_allclose(found, slow, rtol=1e-7, atol=1e-8)


def test_scores_are_those_of_the_columns_that_are_asked_for() -> None:
    made, columns = blocks(5, 1)
    space, others = Space(made, LEVELS), [2 * each for each in columns]
    first = space.scores(columns)
    assert space.scores(columns) is first
    np.testing.assert_allclose(space.scores(others).slope, 2 * first.slope)
    np.testing.assert_allclose(space.scores(columns).slope, first.slope)


def test_simulated_gains_of_one_column_are_chi_squared() -> None:
    made, columns = blocks(3, 0)
    space = Space(made, np.array([0.5]))
    drawn = space.null_maxima([each[:, :1] for each in columns], np.zeros(1), np.zeros(1), 4000, 1)
    assert np.mean(drawn) == pytest.approx(1.0, abs=0.1)
    assert np.mean(drawn > 3.841) == pytest.approx(0.05, abs=0.015)


@pytest.mark.parametrize("scale", [1.0, 1e5])
def test_a_column_that_the_base_takes_up_explains_nothing_however_long_it_is(scale: float) -> None:
    """What rounding leaves of it would otherwise be divided by what rounding leaves of its square."""
    made, _ = blocks(5, 1)
    space = Space(made, LEVELS)
    taken = [scale * each.sensitivities @ [[1.0, 0.3], [-2.0, 1.0]] for each in made]
    gains, _ = space.scores(taken).gains()
    np.testing.assert_allclose(gains, 0.0, atol=1e-9)
    assert space.null_maxima(taken, np.zeros(2), np.zeros(2), 50, 2).max() == 0
