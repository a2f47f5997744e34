import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from needleplan.errors import DataError
from needleplan.signals import dominant_frequency_hz, lag_rad, sine_at


@given(st.floats(0.05, 2.0), st.floats(-3, 3), st.floats(0.1, 50), st.floats(20, 60))
def test_a_sine_is_found(frequency: float, phase: float, amplitude: float, seconds: float) -> None:
    time = np.arange(0, seconds, 0.02)
    values = 7 + amplitude * np.cos(2 * np.pi * frequency * time + phase)
    found = dominant_frequency_hz(time, values)
    assert found == pytest.approx(frequency, abs=0.01 / seconds)
    sine = sine_at(frequency, time, values)
    assert (sine.amplitude, sine.offset) == (pytest.approx(amplitude, rel=1e-6), pytest.approx(7, rel=1e-6))
    assert np.exp(1j * sine.phase_rad) == pytest.approx(np.exp(1j * phase), abs=1e-6)


@given(st.floats(-3, 3))
def test_a_lag_is_positive_where_a_signal_is_late(lag: float) -> None:
    time = np.arange(0, 20, 0.01)
    late = lag_rad(0.3, time, np.sin(0.6 * np.pi * time - lag), 2 * np.sin(0.6 * np.pi * time))
    assert late == pytest.approx(lag, abs=1e-9)


def test_a_constant_has_no_frequency() -> None:
    with pytest.raises(DataError, match="must be at least eight samples that are not all equal"):
        dominant_frequency_hz(np.arange(20.0), np.ones(20))
