import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal
from scipy.integrate import solve_ivp

from needleplan.errors import DataError, ModelError
from needleplan.signals import Array, HighGainObserver, ObserverForm, Projection

GELATIN, AGAR = 9.0, 22.0
observers = st.builds(
    lambda a1, ratio, share, eps: (a1, ratio * a1**2 / 4, share, eps),
    st.floats(1.5, 60), st.floats(0.2, 5), st.floats(0.01, 0.5), st.floats(0.2, 3),
)  # fmt: skip


def positions(samples: int = 2000, seed: int = 0) -> Array:
    """A needle that swings, with the steps of an encoder."""
    time = np.arange(samples) / 200
    swing = 20 * np.sin(2 * np.pi * 0.1 * time) + 0.3 * np.sin(2 * np.pi * 3.3 * time)
    return np.round(swing + np.random.default_rng(seed).normal(0, 0.01, samples), 3)


def made(numbers: tuple[float, float, float, float], form: ObserverForm = ObserverForm.CORRECTED) -> HighGainObserver:
    """An observer at a share of its longest interval."""
    a1, a2, share, eps = numbers
    longest = HighGainObserver(a1, a2, 1e-9, eps, form).longest_interval_s
    return HighGainObserver(a1, a2, share * longest, eps, form)


@given(observers, st.sampled_from(ObserverForm))
def test_the_recursion_is_its_transfer_function(numbers: tuple[float, float, float, float], form: ObserverForm) -> None:
    observer = made(numbers, form)
    moved = positions(500) + 3.0
    velocity = observer.observe(moved)
    psi = observer.transfer
    expected = signal.lfilter(psi.numerator, psi.denominator, moved - moved[0])
    np.testing.assert_allclose(velocity, expected, atol=1e-9 * np.abs(expected).max())
    np.testing.assert_allclose(velocity, psi.apply(moved), atol=1e-9 * np.abs(expected).max())


@given(observers)
def test_the_estimate_converges_to_the_observer_in_continuous_time(numbers: tuple[float, float, float, float]) -> None:
    a1, a2, _, eps = numbers
    interval = 0.002 * eps / (a1 + np.sqrt(a2))
    time = np.arange(400) * interval
    observer = HighGainObserver(a1, a2, interval, eps)
    omega = 2 / time[-1]
    exact = solve_ivp(
        lambda t, x: [x[1] + a1 / eps * (np.sin(omega * t) - x[0]), a2 / eps**2 * (np.sin(omega * t) - x[0])],
        (0, time[-1]), [0, 0], "DOP853", time, rtol=1e-9, atol=1e-12,
    ).y[1]  # fmt: skip
    assert np.abs(observer.observe(np.sin(omega * time)) - exact).max() < 0.03 * np.abs(exact).max()


def printed_4_2(z: complex, a1: float, a2: float, t: float, eps: float) -> complex:
    return a2 * t * z * (z - 1) / ((eps + a1 * t) * z**2 + (a2 * t**2 - a1 * t - 2 * eps) * z + eps)


@given(observers)
def test_the_printed_equation_has_its_own_name(numbers: tuple[float, float, float, float]) -> None:
    printed = made(numbers, ObserverForm.PRINTED)
    a1, a2, t, eps = printed.alpha1, printed.alpha2, printed.interval_s, printed.epsilon
    frequency = 0.03 / t
    z = np.exp(2j * np.pi * 0.03)
    assert printed.transfer.response(frequency) == pytest.approx(printed_4_2(z, a1, a2, t, eps), rel=1e-9)
    same = HighGainObserver(a1, a2 * eps, t, eps)
    assert printed.transfer.response(frequency) == pytest.approx(complex(same.transfer.response(frequency)), rel=1e-9)
    if abs(eps - 1) > 0.1:
        assert abs(HighGainObserver(a1, a2, t * 1e-3, eps).correction - printed.correction) > 0.05 * printed.correction


@given(observers)
def test_it_is_stable_up_to_the_longest_interval(numbers: tuple[float, float, float, float]) -> None:
    observer = made(numbers)
    longest = observer.longest_interval_s
    assert HighGainObserver(observer.alpha1, observer.alpha2, 0.9999 * longest, observer.epsilon).transfer.stable
    with pytest.raises(ModelError, match="not stable"):
        HighGainObserver(observer.alpha1, observer.alpha2, longest * 1.0001, observer.epsilon)
    eps, a1, t = observer.epsilon, observer.alpha1, longest * 1.0001
    beyond = np.roots([eps + a1 * t, -(2 * eps + a1 * t - observer.alpha2 * t**2 / eps), eps])
    assert np.abs(beyond).max() > 1


def test_the_fast_observer_of_the_thesis_is_stable_to_0241_s() -> None:
    assert HighGainObserver.critically_damped(40, 0.005).longest_interval_s == pytest.approx(0.241, abs=5e-4)


def test_a_steady_velocity_is_found_without_error() -> None:
    time = np.arange(2000) / 200
    for alpha1 in (GELATIN, AGAR, 40):
        velocity = HighGainObserver.critically_damped(alpha1, 0.005).observe(5 + 3 * time)
        assert velocity[-1] == pytest.approx(3, abs=1e-9)
    assert complex(HighGainObserver.critically_damped(9, 0.005).normalised.response(0.0)) == pytest.approx(1)


@pytest.mark.parametrize(("interval", "gelatin", "agar"), [
    (0.001, (1.809, 12.300), (0.225, 2.940)),
    (0.005, (1.784, 12.305), (0.219, 2.940)),
    (0.025, (1.660, 12.330), (0.187, 2.943)),
])  # fmt: skip
def test_the_projection_at_a_tenth_of_a_hertz(
    interval: float, gelatin: tuple[float, float], agar: tuple[float, float]
) -> None:
    for alpha1, expected in ((GELATIN, gelatin), (AGAR, agar)):
        projection = Projection.critically_damped(alpha1, interval)
        assert 100 * projection.attenuation(0.1) == pytest.approx(expected[0], abs=6e-4)
        assert np.degrees(projection.lag_rad(0.1)) == pytest.approx(expected[1], abs=6e-4)


def test_the_published_response_within_what_the_print_allows() -> None:
    gelatin, agar = (Projection.critically_damped(alpha1, 0.005) for alpha1 in (GELATIN, AGAR))
    assert 100 * gelatin.attenuation(0.1) == pytest.approx(1.67, abs=0.15)
    assert np.degrees(gelatin.lag_rad(0.1)) == pytest.approx(12.36, abs=0.1)
    assert 100 * agar.attenuation(0.1) == pytest.approx(0.19, abs=0.04)
    assert np.degrees(agar.lag_rad(0.1)) == pytest.approx(2.99, abs=0.06)


@given(st.floats(1.5, 39.9), st.sampled_from([0.001, 0.005, 0.025]), st.integers(0, 5))
def test_forth_and_back(alpha1: float, interval: float, seed: int) -> None:
    projection = Projection.critically_damped(alpha1, interval)
    assert projection.transfer.minimum_phase
    velocity = np.random.default_rng(seed).normal(0, 10, 500)
    back = projection.inverse.apply(projection.transfer.apply(velocity))
    np.testing.assert_allclose(back, velocity, rtol=0, atol=1e-9 * np.abs(velocity).max())
    both = projection.transfer.response(7.0) * projection.inverse.response(7.0)
    assert complex(both) == pytest.approx(1, abs=1e-12)


def test_the_projection_is_the_slow_observer_after_the_fast_one() -> None:
    projection = Projection.critically_damped(GELATIN, 0.005)
    moved = positions()
    slow = projection.slow.observe(moved)
    np.testing.assert_allclose(projection.transfer.apply(projection.fast.observe(moved)), slow, atol=1e-9)


def test_the_inverse_amplifies_at_nyquist() -> None:
    for alpha1, gain in ((GELATIN, 18.4), (AGAR, 3.2)):
        inverse = Projection.critically_damped(alpha1, 0.005).inverse
        assert abs(complex(inverse.response(100.0))) == pytest.approx(gain, abs=0.05)
    assert np.abs(inverse.poles).max() == pytest.approx(0.9129, abs=5e-5)


def test_one_sample_at_a_time_is_the_record() -> None:
    observer = HighGainObserver.critically_damped(GELATIN, 0.005)
    moved = positions()
    stream = observer.stream()
    assert [stream.push(each) for each in moved.tolist()] == observer.observe(moved).tolist()
    projection = Projection.critically_damped(GELATIN, 0.005)
    for what in (projection.transfer, projection.inverse, observer.transfer):
        flow = what.stream()
        np.testing.assert_allclose([flow.push(each) for each in moved.tolist()], what.apply(moved), rtol=0, atol=1e-12)


@pytest.mark.parametrize("numbers", [(0.0, 1.0, 0.005), (1.0, -1.0, 0.005), (1.0, float("nan"), 0.005), (1, 1, 0.0)])
def test_numbers_that_are_no_observer_are_refused(numbers: tuple[float, float, float]) -> None:
    with pytest.raises(ModelError, match="greater than 0"):
        HighGainObserver(*numbers)


def test_positions_that_are_none_are_refused() -> None:
    observer = HighGainObserver.critically_damped(GELATIN, 0.005)
    with pytest.raises(DataError, match="finite"):
        observer.observe(np.array([0.0, np.nan]))
    with pytest.raises(ModelError, match=r"fast observer, 0\.005 s"):
        Projection(observer, HighGainObserver.critically_damped(GELATIN, 0.001))
    with pytest.raises(ModelError, match="not causal and stable"):
        observer.transfer.inverse()
