"""The path as a member of the family."""

import math

import numpy as np
import pytest

from needleplan.models import FitStatus, TipPath, fit, simulate
from needleplan.models.deflection import march, tip_path_mm
from needleplan.signals import Motion, Record
from tests.models.deflection.thesis import COIL_MM, NEEDLE, SOFT

MODEL = TipPath.of(NEEDLE, SOFT.stiffness_n_mm2, 0.055)


def insertion(turned_at_mm: float | None = None, end_mm: float = 80.0) -> Motion:
    time = np.arange(0, end_mm / 10, 0.025)
    depth = 10 * time
    angle = np.where(depth >= turned_at_mm, math.pi, 0.0) if turned_at_mm else None
    return Motion.sampled(time, depth, np.full_like(time, 10.0), angle)


def recorded(model: TipPath, motion: Motion, noise: float = 0.0) -> Record:
    y = simulate(model, motion).output + noise * np.random.default_rng(3).standard_normal(len(motion))
    columns = {name: getattr(motion, name) for name in ("time_s", "depth_mm", "velocity_mm_s", "angle_rad")}
    return Record({**columns, "y_mm": y})


def test_it_is_the_path_law() -> None:
    motion = insertion()
    model = MODEL.with_values(slope=0.01, offset=0.3)
    fine = Motion.sampled(np.arange(8001.0), np.arange(8001) / 100)
    law = np.interp(motion.depth_mm, fine.depth_mm, tip_path_mm(NEEDLE, SOFT, fine.depth_mm, model.push_n(fine)))
    np.testing.assert_allclose(simulate(model, motion).output, law + 0.3 + 0.01 * motion.depth_mm, atol=1e-6)
    bent = np.diff(simulate(MODEL, motion).output[-20:], 2) / 0.25**2
    np.testing.assert_allclose(bent, MODEL.curvature_1_mm, rtol=1e-3)


@pytest.mark.parametrize("kept", [1.0, 0.9])
def test_its_own_integration_is_kutta_with_its_derivative(kept: float) -> None:
    motion, model = insertion(40.0), MODEL.with_values(anchoring=kept)
    start = np.array([30.0, 2.0])
    own = model.integrate(motion, start)
    stepped = [start]
    for k, step in enumerate(motion.interval_s):
        first, middle, last = motion[k], motion.between(0.5)[k], motion[k + 1]
        k1 = model.derivative(stepped[-1], first)
        k2 = model.derivative(stepped[-1] + step / 2 * k1, middle)
        k3 = model.derivative(stepped[-1] + step * (2 * k2 - k1), last)
        stepped.append(stepped[-1] + step / 6 * (k1 + 4 * k2 + k3))
    np.testing.assert_allclose(own, np.array(stepped).T, rtol=1e-11)


def test_the_coil_is_where_the_march_has_it() -> None:
    # A coil behind the tip of a long needle that has been deep in the tissue for a while.
    from dataclasses import replace

    depth = np.arange(301.0)
    reach = np.maximum(depth - 150, 0) / 5
    force = 0.05 * (1 - (1 + reach) * np.exp(-reach))
    inserted = march(replace(NEEDLE, length_mm=600.0), SOFT, force, 1.0, behind_tip_mm=COIL_MM)
    apart = inserted.tip_mm - inserted.tracked_mm
    motion = Motion.sampled(np.arange(151.0), np.arange(151.0))
    model = TipPath.of(NEEDLE, SOFT.stiffness_n_mm2, 0.05)
    own = simulate(model, motion).output - simulate(model.with_values(tracked=COIL_MM), motion).output
    np.testing.assert_allclose(own[100:], apart[250:], rtol=0.03)


def test_on_the_way_out_the_tip_goes_back_the_way_it_came() -> None:
    time = np.arange(0, 16.01, 0.05)
    depth = np.where(time <= 8, 10 * time, 160 - 10 * time)
    motion = Motion.sampled(time, depth, np.where(time < 8, 10.0, -10.0))
    y = simulate(MODEL, motion).output
    np.testing.assert_allclose(y[160:], y[:161][::-1], atol=0.02 * y.max())


def test_partial_memory_is_the_second_order_system_of_the_march() -> None:
    from dataclasses import replace

    depth = np.arange(301.0)
    reach = np.maximum(depth - 150, 0) / 5
    force = 0.05 * (1 - (1 + reach) * np.exp(-reach))
    inserted = march(replace(NEEDLE, length_mm=600.0), SOFT, force, 1.0, anchoring=0.8, terms="plain")  # type: ignore[arg-type]
    motion = Motion.sampled(np.arange(151.0), np.arange(151.0))
    y = simulate(TipPath.of(NEEDLE, SOFT.stiffness_n_mm2, 0.05).with_values(anchoring=0.8), motion).output
    np.testing.assert_allclose(y, inserted.tip_mm[150:], atol=5e-3)


def test_one_record_gives_curvature_slope_and_offset() -> None:
    truth = MODEL.with_values(slope=0.01, offset=-0.4)
    found = fit(MODEL.with_values(cutting_force=0.02), recorded(truth, insertion(), 0.05))
    assert found.status is FitStatus.CONVERGED
    assert found.free == ("cutting_force", "slope", "offset")
    for name, estimate in found.estimates.items():
        assert estimate.low < getattr(truth, name) < estimate.high
        assert estimate.identified
    assert found.model.values()["cutting_force"] == pytest.approx(0.055, rel=0.05)


def test_stiffness_of_needle_and_tissue_are_told_apart_only_by_a_flip() -> None:
    free = ["cutting_force", "slope", "offset", "stiffness"]
    # The entry, which no model describes, is left out.
    straight, flipped = (
        fit(MODEL, recorded(MODEL, insertion(turn), 0.05), free=free, mask=lambda each: each["depth_mm"] > 20)
        for turn in (None, 45.0)
    )
    wide, narrow = (each.estimates["stiffness"] for each in (straight, flipped))
    assert narrow.identified
    assert narrow.low < MODEL.stiffness < narrow.high
    assert wide.sd > 5 * narrow.sd
