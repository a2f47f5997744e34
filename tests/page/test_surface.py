"""Surfaces of bodies on a grid: closed, with the normals outside, of the right volume."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from needleplan.page._space_maps import surface


def volume_mm3(vertices: np.ndarray, triangles: np.ndarray) -> float:
    """Return the volume within a closed surface, by the divergence theorem; positive if the normals point outside."""
    a, b, c = (vertices[triangles[:, number]].astype(float) for number in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


def test_a_ball() -> None:
    grid = np.stack(np.meshgrid(*[np.arange(25)] * 3, indexing="ij"), -1)
    body = np.linalg.norm(grid - 12.0, axis=-1) <= 9.0
    vertices, triangles = surface(body, 2.0)
    away = np.linalg.norm(vertices - 24.0, axis=1)
    assert np.all(abs(away - 18.0) < 2.0)
    assert volume_mm3(vertices, triangles) == pytest.approx(4 / 3 * np.pi * 18.0**3, rel=0.05)
    edges = 3 * len(triangles) // 2
    assert len(vertices) - edges + len(triangles) == 2  # Euler characteristic of a sphere


@given(arrays(np.bool_, (4, 3, 5), elements=st.booleans()))
def test_every_surface_is_closed(body: np.ndarray) -> None:
    vertices, triangles = surface(body, 1.0)
    sides = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    there, counts = np.unique(sides, axis=0, return_counts=True)
    back, backwards = np.unique(sides[:, ::-1], axis=0, return_counts=True)
    assert np.array_equal(there, back)
    assert np.array_equal(counts, backwards)
    assert (len(vertices) > 0) == body.any()
    if body.any():
        assert volume_mm3(vertices, triangles) > 0
        assert vertices.min() >= -1.0
        assert np.all(vertices <= np.array(body.shape))
