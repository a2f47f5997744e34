"""Columns of the nonparametric components beside another formula of the same functions."""

from types import SimpleNamespace

import numpy as np
from scipy.integrate import solve_ivp

from needleplan.diagnosis._components import _ringing
from needleplan.diagnosis._constants import RINGING_S
from tests.diagnosis.trials import motion


def test_ringing_is_a_damped_oscillator_that_the_acceleration_drives() -> None:
    path, hertz = motion(1), 4.0
    drive = np.gradient(path.velocity_mm_s, path.time_s)
    swing = 2 * np.pi * hertz

    def rates(time_s: float, state: np.ndarray) -> list[float]:
        sine, cosine = state
        force = float(np.interp(time_s, path.time_s, drive))
        return [-sine / RINGING_S + swing * cosine, -cosine / RINGING_S - swing * sine + force]

    ends = (path.time_s[0], path.time_s[-1])
    wanted = solve_ivp(rates, ends, [0.0, 0.0], t_eval=path.time_s, max_step=0.005, rtol=1e-8).y.T
    found = _ringing(SimpleNamespace(motion=path), np.array([1.0, hertz]))[:, 1]
    assert np.abs(wanted).max() > 1
    np.testing.assert_allclose(found, wanted, atol=1e-4)
