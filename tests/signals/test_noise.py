import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from needleplan.signals import Array, SensorNoise, combine_axes


def slow(noise: SensorNoise, values: Array, taps: Array) -> Array:
    """Sample by sample: what the taps make of the values, and what of that the past does not foresee."""

    def read(k: int) -> Array:
        return np.asarray(sum(tap * values[max(k - j, 0)] for j, tap in enumerate(taps)))

    return np.array([
        (read(k) - sum(weight * read(k - 1 - j) for j, weight in enumerate(noise.weights))) / noise.sd
        for k in range(noise.order, len(values))
    ])  # fmt: skip


@settings(max_examples=25, deadline=None)
@given(
    st.integers(0, 10_000), st.integers(0, 5), st.integers(1, 4), st.integers(12, 210),
    st.sampled_from([(), (0,), (3,)]),
)  # fmt: skip
def test_a_matrix_is_whitened_as_sample_by_sample(
    seed: int, order: int, taps: int, samples: int, more: tuple[int, ...]
) -> None:
    generator = np.random.default_rng(seed)
    noise = SensorNoise(generator.uniform(-0.4, 0.4, order), 0.3, 0.4)
    values, weights = generator.standard_normal((samples, *more)), generator.standard_normal(taps)
    wanted = slow(noise, values, weights).reshape(samples - order, *more)
    np.testing.assert_allclose(noise.whiten(values, weights), wanted, atol=1e-11)
    if taps == 1:
        np.testing.assert_allclose(noise.whiten(weights[0] * values), wanted, atol=1e-11)


def test_a_missing_value_spoils_only_its_own_innovations() -> None:
    noise = SensorNoise(np.array([0.5, -0.2]), 1.0, 1.2)
    values = np.random.default_rng(1).standard_normal(200)
    values[70] = np.nan
    assert np.flatnonzero(np.isnan(noise.whiten(values))).tolist() == [68, 69, 70]


def test_axes_are_whitened_each_by_itself() -> None:
    axes = [SensorNoise(np.array([0.5, -0.2]), 1.0, 1.2), SensorNoise(np.array([0.3]), 2.0, 2.2)]
    values = np.random.default_rng(2).standard_normal((2 * 90, 4))
    found = combine_axes(axes).whiten(values)
    first, second = axes[0].whiten(values[:90]), axes[1].whiten(values[90:])[1:]
    np.testing.assert_array_equal(found, np.concatenate([first, second]))
    assert found[0, 0] == pytest.approx((values[2, 0] - 0.5 * values[1, 0] + 0.2 * values[0, 0]) / 1.0)
