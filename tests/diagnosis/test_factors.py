"""Eliminated and swept rows of many matrices agree with the formulas, matrix by matrix."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from needleplan.diagnosis._factors import eliminated, inverse_root, root_of, swept
from needleplan.signals import Array


def positive_definite(seed: int, matrices: int, rows: int, largest: float = 1.0) -> Array:
    """Return matrices (matrices, rows, rows) whose rows have units between 1 and `largest`."""
    random = np.random.default_rng(seed)
    columns = random.normal(size=(matrices, rows + 3, rows)) * largest ** random.random(rows)
    return np.asarray(columns.swapaxes(1, 2) @ columns)


@given(st.integers(0, 10**6), st.integers(0, 5), st.integers(1, 3), st.sampled_from([1.0, 1e4, 1e8]))
def test_the_schur_complement_and_the_determinant_are_those_of_the_formulas(
    seed: int, count: int, left: int, largest: float
) -> None:
    matrices = positive_definite(seed, 4, count + left, largest)
    rest, logs = eliminated(matrices, count)
    for matrix, own, log in zip(matrices, rest, logs, strict=True):
        inner, cross, corner = matrix[:count, :count], matrix[:count, count:], matrix[count:, count:]
        expected = corner - cross.T @ np.linalg.inv(inner) @ cross
        scale = np.sqrt(np.diag(corner))
        assert own / scale[:, None] / scale == pytest.approx(expected / scale[:, None] / scale, abs=1e-6)
        assert log == pytest.approx(np.linalg.slogdet(inner)[1], abs=1e-6)


@given(st.integers(0, 10**6), st.integers(0, 5), st.integers(1, 3))
def test_swept_matrices_hold_inverse_solution_and_schur_complement(seed: int, count: int, left: int) -> None:
    matrices = positive_definite(seed, 6, count + left).reshape(2, 3, count + left, count + left)
    found, logs = swept(matrices.transpose(2, 3, 0, 1), count)
    for place in np.ndindex(2, 3):
        matrix, own = matrices[place], found[:, :, *place]
        inner, cross, corner = matrix[:count, :count], matrix[:count, count:], matrix[count:, count:]
        inverse = np.linalg.inv(inner)
        assert own[:count, :count] == pytest.approx(inverse, rel=1e-6, abs=1e-9)
        assert own[:count, count:] == pytest.approx(inverse @ cross, rel=1e-6, abs=1e-9)
        assert own[count:, :count] == pytest.approx(-(inverse @ cross).T, rel=1e-6, abs=1e-9)
        assert own[count:, count:] == pytest.approx(corner - cross.T @ inverse @ cross, rel=1e-6, abs=1e-9)
        assert logs[place] == pytest.approx(np.linalg.slogdet(inner)[1], abs=1e-9)


def test_a_sweep_leaves_its_argument_alone() -> None:
    matrix = positive_definite(0, 1, 3)[0]
    before = matrix.copy()
    swept(matrix, 2)
    assert (matrix == before).all()


def test_the_units_of_rows_do_not_matter_to_the_nearest_matrix() -> None:
    """Two columns are equal but for rounding, and in units far below those of the third."""
    close = np.array([[1.0, 1.0 + 1e-13, 0.5], [1.0 + 1e-13, 1.0, 0.5], [0.5, 0.5, 1.0]])
    units = np.array([1.0, 1.0, 1e9])
    root = root_of(close * units[:, None] * units) / units[:, None]
    assert root @ root.T == pytest.approx(close, abs=1e-8)
    assert (np.diag(root) > 0).all()


@pytest.mark.parametrize("rows", [0, 1, 7])
def test_the_inverse_of_a_root_is_its_inverse(rows: int) -> None:
    roots = root_of(positive_definite(3, 4, rows)) if rows else np.empty((4, 0, 0))
    found = inverse_root(roots)
    np.testing.assert_allclose(found @ roots, np.broadcast_to(np.eye(rows), roots.shape), atol=1e-12)
    np.testing.assert_array_equal(found, np.tril(found))
