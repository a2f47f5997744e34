import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy.signal import lfilter_zi

from needleplan.errors import DataError, ModelError
from needleplan.signals import Array, DiscreteFilter, MovingAverage, TrackerFilter, TrackerModel

rows = arrays.arrays(float, st.integers(1, 60), elements=st.floats(-5, 5))


@given(rows, st.integers(1, 9))
def test_the_moving_average_is_the_mean_of_the_last_samples(values: Array, samples: int) -> None:
    average = MovingAverage(samples)
    expected = [values[max(0, end - samples + 1) : end + 1].mean() for end in range(values.size)]
    np.testing.assert_allclose(average.apply(values), expected, rtol=0, atol=1e-12)
    stream = average.stream()
    np.testing.assert_allclose([stream.push(each) for each in values.tolist()], expected, rtol=0, atol=1e-12)


def test_the_moving_average_delays_by_ten_milliseconds() -> None:
    average = MovingAverage()
    time = np.arange(400) / 200
    assert average.delay_s(0.005) == pytest.approx(0.010)
    np.testing.assert_allclose(average.apply(3 * time)[4:], 3 * (time - 0.010)[4:], atol=1e-12)
    gain = average.response(np.array([0.0, 7.0]), 0.005)
    np.testing.assert_allclose(np.angle(gain), [0, -2 * np.pi * 7 * 0.010], atol=1e-12)
    filtered = average.apply(np.sin(2 * np.pi * 7 * time))[4:]
    np.testing.assert_allclose(filtered, (gain[1] * np.exp(14j * np.pi * time)).imag[4:], atol=1e-12)


def test_a_missing_force_spoils_only_the_averages_that_it_is_in() -> None:
    values = np.arange(20.0)
    values[7] = np.nan
    assert np.flatnonzero(np.isnan(MovingAverage(5).apply(values))).tolist() == [7, 8, 9, 10, 11]


def test_bad_filters_are_refused() -> None:
    with pytest.raises(ModelError, match="whole number"):
        MovingAverage(0)
    with pytest.raises(ModelError, match="not causal"):
        DiscreteFilter((1.0, 0.0), (0.0, 1.0), 0.1)
    with pytest.raises(ModelError, match="as long as"):
        DiscreteFilter((1.0,), (1.0, 1.0), 0.1)
    with pytest.raises(DataError, match="row"):
        DiscreteFilter((1.0,), (2.0,), 0.1).apply(np.zeros((2, 2)))
    assert DiscreteFilter((1.0,), (2.0,), 0.1).apply(np.ones(3)).tolist() == [0.5, 0.5, 0.5]


def tracked(seed: int = 0) -> tuple[Array, Array, Array]:
    """A coil in tissue at 40 Hz: time, true velocity, position as measured."""
    time = np.arange(1200) / 40
    omega = 2 * np.pi * 0.1
    noise = np.random.default_rng(seed).normal(0, 0.1, time.size)
    return time, 5 * omega * np.cos(omega * time), 5 * np.sin(omega * time) + noise


@pytest.mark.parametrize(("model", "density"), [
    (TrackerModel.CONSTANT_VELOCITY, 2.0), (TrackerModel.CONSTANT_ACCELERATION, 0.7),
])  # fmt: skip
def test_the_velocity_of_a_tracker(model: TrackerModel, density: float) -> None:
    time, velocity, position = tracked()
    filtered = TrackerFilter(0.1, density, model)
    causal, whole = filtered.apply(time, position), filtered.smooth(time, position)
    settled = slice(200, None)
    difference = float(np.std(np.gradient(position, time)[settled] - velocity[settled]))
    error = [float(np.sqrt(np.mean((each.velocity_mm_s - velocity)[settled] ** 2))) for each in (causal, whole)]
    assert error[0] < difference / 3
    assert error[1] < error[0]
    says = float(whole.velocity_sd_mm_s[settled].mean())
    assert error[1] < 1.5 * says


def test_the_tracker_filter_is_the_textbook_recursion() -> None:
    time, _, position = tracked()
    q, r = 2.0, 0.1**2
    x, p = np.array([position[0], 0.0]), np.diag([r, 100.0**2])
    estimate = TrackerFilter(0.1, q, TrackerModel.CONSTANT_VELOCITY).apply(time, position)
    for index in range(1, 80):
        t = time[index] - time[index - 1]
        a = np.array([[1, t], [0, 1]])
        x, p = a @ x, a @ p @ a.T + q * np.array([[t**3 / 3, t**2 / 2], [t**2 / 2, t]])
        gain = p[:, 0] / (p[0, 0] + r)
        x, p = x + gain * (position[index] - x[0]), p - np.outer(gain, p[0])
        assert estimate.velocity_mm_s[index] == pytest.approx(x[1], rel=1e-9)
        assert estimate.velocity_sd_mm_s[index] == pytest.approx(np.sqrt(p[1, 1]), rel=1e-9)


def test_samples_that_the_tracker_missed_are_bridged_and_counted() -> None:
    time, velocity, position = tracked()
    position[[0, 1]] = np.nan
    position[600:620] = np.nan
    filtered = TrackerFilter(0.1, 0.7)
    estimate = filtered.apply(time, position)
    assert estimate.missed == 22
    assert np.isnan(estimate.velocity_mm_s[:2]).all()
    assert np.isfinite(estimate.velocity_mm_s[2:]).all()
    assert estimate.velocity_sd_mm_s[619] > 2 * estimate.velocity_sd_mm_s[599]
    stream = filtered.stream()
    rows = [stream.push(*each) for each in zip(time.tolist(), position.tolist(), strict=True)]
    assert [each[1] for each in rows[2:]] == estimate.velocity_mm_s[2:].tolist()
    smooth = filtered.smooth(time, position)
    assert np.abs(smooth.velocity_mm_s - velocity)[600:620].max() < 1.0


def test_bad_tracks_are_refused() -> None:
    filtered = TrackerFilter(0.1, 1.0)
    with pytest.raises(DataError, match="the tracker measured nothing"):
        filtered.apply(np.arange(3.0), np.full(3, np.nan))
    with pytest.raises(DataError, match="increase"):
        filtered.apply(np.array([0.0, 1.0, 1.0]), np.zeros(3))
    with pytest.raises(DataError, match="as long as"):
        filtered.apply(np.arange(3.0), np.zeros(2))
    with pytest.raises(ModelError, match="greater than 0"):
        TrackerFilter(0.0, 1.0)
    stream = filtered.stream()
    stream.push(1.0, 0.0)
    with pytest.raises(DataError, match="greater than the time before"):
        stream.push(1.0, 0.0)


def test_the_centred_average_is_the_mean_about_each_sample() -> None:
    values = np.random.default_rng(0).normal(size=20)
    means = [values[max(place - 2, 0) : place + 3].mean() for place in range(20)]
    assert MovingAverage(5).centred(values) == pytest.approx(np.array(means))
    assert MovingAverage(5).centred(values[:3]) == pytest.approx(np.full(3, values[:3].mean()))
    with pytest.raises(ModelError, match="must be odd"):
        MovingAverage(4).centred(values)


@given(st.lists(st.tuples(st.floats(-3, 3), st.floats(-0.2, 0.2)), max_size=4), st.floats(0.5, 2), st.floats(-9, 9))
def test_a_filter_begins_settled(pairs: list[tuple[float, float]], first: float, value: float) -> None:
    numerator, denominator = (1.0, *(b for b, _ in pairs)), (first, *(first * a for _, a in pairs))
    filtering = DiscreteFilter(numerator, denominator, 0.005)
    if pairs:
        assert filtering._settled(value) == pytest.approx(value * lfilter_zi(numerator, denominator), abs=1e-9)
    gain = sum(numerator) / sum(denominator)
    assert filtering.apply(np.full(5, value)) == pytest.approx(np.full(5, gain * value), abs=1e-9)
    stream = filtering.stream()
    assert [stream.push(value) for _ in range(5)] == pytest.approx([gain * value] * 5, abs=1e-9)
