import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from needleplan.models import recurrence
from needleplan.signals import Array


def one_by_one(factor: Array, offset: Array, start: Array | float) -> Array:
    rows = [np.asarray(start, float)]
    for each, more in zip(factor, offset, strict=True):
        rows.append(each * rows[-1] + more)
    return np.array(rows)


@given(st.integers(0, 60), st.sampled_from([(), (1,), (3,)]), st.integers(0, 2**32 - 1))
def test_it_is_the_loop(n: int, rest: tuple[int, ...], seed: int) -> None:
    generator = np.random.default_rng(seed)
    factor, offset = generator.uniform(-1.2, 1.2, n), generator.normal(size=(n, *rest))
    start = generator.normal(size=rest)
    found, slow = recurrence(factor, offset, start), one_by_one(factor, offset, start)
    assert found.shape == slow.shape == (n + 1, *rest)
    assert found == pytest.approx(slow, rel=1e-12, abs=1e-12)


def test_what_grows_without_bound_is_infinite() -> None:
    found = recurrence(np.full(400, 1e3), np.ones(400), 1.0)
    assert np.isfinite(found[:100]).all()
    assert np.isposinf(found[-1])
