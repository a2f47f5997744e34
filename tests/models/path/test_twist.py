"""The twisted shaft against closed forms, and against a discretised shaft that is solved by bounded least squares."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import lsq_linear

from needleplan.models import Torsion
from needleplan.models.path import TwistedShaft
from needleplan.signals import Array
from tests.models.path.test_bicycle import tips_of

GJ, TAU, LENGTH = 1.5e4, 0.05, 200.0
TORSION = Torsion(GJ, TAU)


class Discretised:
    """Nodes every `h` mm on the shaft; each step minimises elastic energy plus dissipation (rate-independent).

    The dual problem bounds the friction q of each node by its capacity. The angles move by C (q + load), with the
    compliance C, so that q minimises the quadratic form of C.
    """

    def __init__(self, count: int) -> None:
        self.h = LENGTH / count
        self.angles = np.zeros(count)
        stiffness = GJ / self.h
        self.matrix = stiffness * (2 * np.eye(count) - np.eye(count, k=1) - np.eye(count, k=-1))
        self.matrix[-1, -1] = stiffness
        self.stiffness = stiffness
        self.compliance = np.linalg.inv(self.matrix)
        self.factor = np.linalg.cholesky(self.compliance).T

    def step(self, base: float, inserted: float) -> tuple[float, float]:
        from_tip = LENGTH - self.h * np.arange(1, self.angles.size + 1)
        upper = np.minimum(from_tip + self.h / 2, LENGTH)
        covered = np.clip(np.minimum(upper, inserted) - np.maximum(from_tip - self.h / 2, 0), 0, None)
        load = -self.matrix @ self.angles
        load[0] += self.stiffness * base
        held = covered > 0
        if held.any():
            capacity = TAU * covered[held]
            found = lsq_linear(
                self.factor[:, held], -self.factor @ load, bounds=(-capacity, capacity), method="bvls", tol=1e-14,
                max_iter=10_000,
            )  # fmt: skip
            load[held] += found.x
        self.angles = self.angles + self.compliance @ load
        return float(self.angles[-1]), float(self.stiffness * (base - self.angles[0]))


PROGRAM = [
    (0.0, 60.0), (0.02, 60.0), (0.05, 60.0), (0.03, 60.0), (0.04, 60.0), (0.035, 60.0), (0.2, 60.0), (0.17, 60.0),
    (0.17, 90.0), (0.20, 90.0), (0.30, 90.0), (0.29, 90.0), (0.29, 40.0), (0.25, 40.0), (0.1, 40.0), (0.13, 70.0),
]  # fmt: skip


def test_rotations_and_insertions_against_a_discretised_shaft() -> None:
    exact, fine = TwistedShaft(TORSION, LENGTH), Discretised(100)
    moved = set()
    for base, inserted in PROGRAM:
        tip, torque = fine.step(base, inserted)
        before = exact.tip_rad
        assert exact.step(base, inserted) == pytest.approx(tip, abs=2e-4)
        assert exact.torque_n_mm == pytest.approx(torque, abs=0.02)
        moved.add(exact.tip_rad != before)
    assert moved == {True, False}  # the tip sticks in some steps and slips in others


@pytest.mark.parametrize("slipping", [5.0, 30.0, 59.0])
def test_a_part_slips_and_the_rest_is_stuck(slipping: float) -> None:
    inserted = 60.0
    twist = TAU * slipping * (LENGTH - inserted + slipping / 2) / GJ
    shaft = TwistedShaft(TORSION, LENGTH)
    shaft.step(0.0, inserted)
    assert shaft.step(twist, inserted) == 0.0
    assert shaft.torque_n_mm == pytest.approx(TAU * slipping)
    assert shaft.stuck_mm == pytest.approx(inserted - slipping)


def test_the_tip_moves_as_play_does_at_a_fixed_depth() -> None:
    base = np.cumsum(np.random.default_rng(3).normal(0, 0.02, 400))
    shaft = TwistedShaft(TORSION, LENGTH, base[0])
    shaft.step(float(base[0]), 80.0)
    tips = [shaft.step(float(each), 80.0) for each in base]
    np.testing.assert_allclose(tips, tips_of(TORSION, base), atol=1e-12)
    assert np.ptp(tips) > 0.02


def test_overshoot_and_return_end_without_torque_in_the_mean() -> None:
    shaft = TwistedShaft(TORSION, LENGTH)
    shaft.step(0.0, 80.0)
    for base in TORSION.compensated_rad(0.0, math.pi, 120.0, 80.0):
        tip = shaft.step(float(base), 80.0)
    assert tip == pytest.approx(math.pi, abs=1e-12)


def released(inserted: float, radius: float, along: Array) -> Array:
    """Return the lag of the tip while the needle is inserted, with isotropic Coulomb friction, by `solve_ivp`."""
    count = 60
    h = inserted / count
    at = h * (np.arange(count) + 0.5)

    def rate(_: float, angle: Array) -> Array:
        inner = np.concatenate([[angle[0]], angle, [angle[-1]]])
        torque = np.diff(inner)
        torque[-1] = -h * angle[-1] / (LENGTH - inserted + h / 2)
        share = np.clip(np.diff(torque) * GJ / (h * h * TAU), -0.999, 0.999)
        return share / np.sqrt(1 - share**2) / radius

    lag = TORSION.lag_rad(LENGTH - inserted, inserted)
    start = -0.5 * (lag - TAU / GJ * at**2 / 2)
    done = solve_ivp(rate, (0, along[-1]), start, method="BDF", t_eval=along, rtol=1e-8, atol=1e-12)
    return np.asarray(-done.y[0])


@pytest.mark.parametrize("inserted", [60.0, 150.0])
def test_insertion_releases_the_twist_over_the_stated_length(inserted: float) -> None:
    length = TORSION.release_mm(0.6, LENGTH - inserted, inserted)
    lags = released(inserted, 0.6, np.array([0.0, 2.0, 3.0]) * length)
    assert lags[2] / lags[1] == pytest.approx(math.exp(-1), rel=0.02)
    assert length == pytest.approx(0.6 * TORSION.lag_rad(LENGTH - inserted, inserted), rel=0.2)
    shaft = TwistedShaft(TORSION, LENGTH, release_mm=length)
    shaft.step(0.0, inserted)
    shaft.step(1.0, inserted)
    lag = 1.0 - shaft.tip_rad
    shaft.step(1.0, inserted + length)
    assert (1.0 - shaft.tip_rad) / lag == pytest.approx(math.exp(-1), rel=0.01)
    assert shaft.torque_n_mm == pytest.approx(TAU * inserted * math.exp(-1), rel=0.01)


def test_out_of_the_tissue_the_tip_follows_the_base() -> None:
    shaft = TwistedShaft(TORSION, LENGTH)
    shaft.step(1.0, 60.0)
    assert shaft.step(1.0, 0.0) == 1.0
    assert shaft.torque_n_mm == 0.0
    assert TwistedShaft(Torsion(GJ, 0.0), LENGTH).step(2.0, 50.0) == 2.0
