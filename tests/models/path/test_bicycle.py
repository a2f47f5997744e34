from itertools import accumulate

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicHermiteSpline

from needleplan.errors import ModelError
from needleplan.models import Bicycle, Torsion, arc_step, fit, simulate
from needleplan.models._simulate import _kutta
from needleplan.models.path._twist import dragged
from needleplan.signals import Array, Motion, Record


def test_an_arc_is_the_solution_of_its_equations() -> None:
    for bend in (0.03, -0.001, 0.0):
        solved = solve_ivp(
            lambda _, p, k=bend: [np.cos(p[2]), np.sin(p[2]), k], (0, 70), [1, 2, 0.3], rtol=1e-11, atol=1e-12
        )
        np.testing.assert_allclose(arc_step(1.0, 2.0, 0.3, bend, 70.0), solved.y[:, -1], atol=1e-8)


def insertion() -> Motion:
    """In, half a turn at rest, further in, and out again."""
    time = np.linspace(0, 12, 2401)
    smooth = CubicHermiteSpline([0, 4, 5, 9, 12], [0, 40, 40, 80, 60], np.zeros(5))
    return Motion.sampled(time, smooth(time), smooth(time, 1), np.interp(time, [4.2, 4.8], [0, np.pi]))


def test_the_closed_form_is_what_kutta_finds() -> None:
    model, motion = Bicycle(1 / 60, 0.02, 1.5), insertion()
    stepped = _kutta(model, motion, model.initial_state(motion), 1)
    np.testing.assert_allclose(simulate(model, motion).states, stepped, atol=1e-4)


def test_after_half_a_turn_it_bends_to_the_other_side() -> None:
    model = Bicycle(1 / 100)
    heading = simulate(model, insertion()).states[1]
    assert heading.max() == pytest.approx(0.4, abs=1e-9)
    np.testing.assert_allclose(heading[[1800, -1]], [0, 0.2], atol=1e-9)


def test_a_fit_finds_the_curvature() -> None:
    truth, motion = Bicycle(-1 / 400, 0.01, 3.0), insertion()
    noise = 0.1 * np.random.default_rng(0).standard_normal(len(motion))
    columns = {"time_s": motion.time_s, "depth_mm": motion.depth_mm, "angle_rad": motion.angle_rad}
    found = fit(Bicycle(1e-3), Record({**columns, "y_mm": simulate(truth, motion).output + noise}))
    for name, estimate in found.estimates.items():
        assert abs(estimate.value - getattr(truth, name)) < 3 * estimate.sd
    assert found.estimates["curvature_per_mm"].value == pytest.approx(-1 / 400, rel=0.03)


def chain(base_rad: Array, torsion: Torsion, outside_mm: float, inserted_mm: float, elements: int) -> Array:
    """Tip angle of a chain of springs, every link held by Coulomb friction, moved until all is in equilibrium."""
    part = inserted_mm / elements
    hold = torsion.torque_per_length_n * part
    stiff = torsion.stiffness_n_mm2 / np.array([outside_mm + part / 2, *[part] * (elements - 1)])
    angles = np.zeros(elements)
    tips = []
    for base in base_rad:
        for _ in range(20_000):
            before = angles.copy()
            for i in range(elements):
                above = base if i == 0 else angles[i - 1]
                pull = stiff[i] * above + (stiff[i + 1] * angles[i + 1] if i + 1 < elements else 0)
                total = stiff[i] + (stiff[i + 1] if i + 1 < elements else 0)
                angles[i] = np.clip(angles[i], (pull - hold) / total, (pull + hold) / total)
            if np.abs(angles - before).max() < 1e-12:
                break
        tips.append(angles[-1])
    return np.array(tips)


def tips_of(torsion: Torsion, base: np.ndarray) -> np.ndarray:
    """Return the angles of the tip for a history of the base, 80 mm inside of the tissue and 120 mm outside."""
    lag = torsion.lag_rad(120.0, 80.0)
    tips = accumulate(base.tolist(), lambda tip, angle: dragged(tip, angle, lag), initial=float(base[0]))
    return np.array(list(tips)[1:])


@pytest.mark.slow
def test_torsion_is_what_a_chain_of_springs_does() -> None:
    torsion = Torsion(1789.0, 0.005)
    lag = torsion.lag_rad(120.0, 80.0)
    assert lag == pytest.approx(0.005 * 80 * 160 / 1789)
    base = np.concatenate([np.linspace(0, 3, 7), np.linspace(3, 0.5, 6), np.linspace(0.5, 2, 5)]) * lag
    expected = chain(base, torsion, 120.0, 80.0, 12)
    np.testing.assert_allclose(tips_of(torsion, base), expected, atol=1e-6)


def test_the_dead_zone_is_twice_the_lag_and_can_be_compensated() -> None:
    torsion = Torsion(1789.0, 0.005)
    lag, lengths = torsion.lag_rad(120.0, 80.0), (120.0, 80.0)
    returned = tips_of(torsion, np.array([0, 1, 1 - 1.9 * lag, 1 - 2.1 * lag]))
    np.testing.assert_allclose(returned, [0, 1 - lag, 1 - lag, 1 - 1.1 * lag], atol=1e-12)
    for target in (np.pi, -1.0, 0.0):
        turning = torsion.compensated_rad(0.0, target, *lengths)
        assert turning[-1] == target
        assert tips_of(torsion, turning)[-1] == pytest.approx(target)
    with pytest.raises(ModelError, match="must be lengths"):
        torsion.lag_rad(-1.0, 80.0)
    with pytest.raises(ModelError) as raised:
        Torsion(0.0, -1.0)
    assert len(raised.value.mistakes) == 2
