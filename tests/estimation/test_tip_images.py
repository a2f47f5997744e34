"""Ultrasound in the tip filter: any subset of tracker, curvature sensors and images, on the lab twin and by hand."""

import math
from itertools import product

import numpy as np
import pytest
from scipy.stats import chi2

from needleplan.devices import Health, ImageSample, Stamp
from needleplan.errors import DataError, ModelError, SimulationError
from needleplan.estimation import PoseUse, Registration, TipFilter, TipSettings
from needleplan.models.deflection import FibreSensors
from needleplan.models.path import ImagePlane
from needleplan.simulation import Effects, Lab, Robot, Setup, SimulatedEntry
from tests.estimation.needle_walk import STEP_MM, Walk, stage

RADIUS_MM, SPEED_MM_S, COIL_MM = 120.0, 12.0, 9.3
SENSORS = FibreSensors((10.0, 30.0, 65.0))
PLANE = ImagePlane(thickness_mm=6.0)
SETTINGS = TipSettings(
    position_sd_mm=0.3, angle_sd_rad=0.01, heading_sd_rad_sqrt_mm=0.003, slip_sd_mm_sqrt_mm=0.0, factor_sd=0.1,
    factor_sd_sqrt_mm=0.0, change_sd_per_mm=0.0, roll_sd_rad=0.0, roll_sd_sqrt_rad=0.0, entry_sd_mm=0.4,
    entry_sd_rad=0.01, fibre_sd_per_mm=2e-4, fibre_bias_sd_per_mm=1e-4, image_sd_mm=1.0, image_latency_s=0.15,
)  # fmt: skip
EFFECTS = Effects(
    curvature_scatter=0.1, heading_noise_rad_sqrt_mm=0.003, tracker_noise_mm=0.3, tracker_angle_noise_rad=0.01,
    coil_offset_mm=COIL_MM, fibre_noise_per_mm=2e-4, fibre_bias_per_mm=1e-4, ultrasound_noise_mm=1.0,
    ultrasound_missed=0.3, ultrasound_outliers=0.05, ultrasound_outlier_mm=15.0, ultrasound_delay_s=0.15,
)  # fmt: skip
SUBSETS = [each for each in product((False, True), repeat=3) if any(each)]
"""Whether tracker, curvature sensors and images are used."""


def errors(seed: int) -> dict[tuple[bool, ...], tuple[float, float]]:
    """NEES (5 degrees of freedom) and distance (mm) of the estimated tip after 60 mm with a turn, by subset."""
    drawn = np.random.default_rng([seed, 99]).standard_normal(5)
    entry = tuple((drawn * [0.4, 0.4, 0.01, 0.4, 0.01]).tolist())
    filters = {
        subset: TipFilter(
            Registration(coil_offset_mm=COIL_MM if subset[0] else 0.0), entry, 1 / RADIUS_MM, SETTINGS,
            SENSORS if subset[1] else None, PLANE if subset[2] else None,
        )
        for subset in SUBSETS
    }  # fmt: skip
    setup = Setup(1 / RADIUS_MM, SimulatedEntry(depth_mm=-2.0), effects=EFFECTS, fibre=SENSORS, ultrasound=PLANE)
    with Lab(setup, seed) as twin:
        for depth, roll in ((25.0, 3.0), (60.0, None)):
            twin.stage.insert(depth, SPEED_MM_S)
            _heard(twin, filters)
            if roll is not None:
                twin.stage.rotate(roll, 6.0)
                _heard(twin, filters)
        true = twin.plant.tip()
    t = true.tangent
    truth = np.array([*true.position_mm, math.atan2(t[1], t[0]), math.asin(t[2])])
    found = {}
    for subset, tip in filters.items():
        state, covariance = tip.tip_state()
        off = state[:5] - truth
        found[subset] = float(off @ np.linalg.solve(covariance[:5, :5], off)), math.dist(state[:3], truth[:3])
    return found


def _heard(twin: Lab, filters: dict[tuple[bool, ...], TipFilter]) -> None:
    moving = True
    while moving:
        twin.advance(0.005)
        *_, sample = twin.stage.waiting()
        moving = sample.moving
        poses, fibres, images = twin.tracker.waiting(), twin.fibre.waiting(), twin.ultrasound.waiting()
        for (tracked, sensed, seen), tip in filters.items():
            tip.predict(sample)
            for pose in poses * tracked:
                tip.update(pose)
            for fibre in fibres * sensed:
                tip.update_fibre(fibre)
            for image in images * seen:
                tip.update_image(image)


def test_a_prediction_that_goes_on_from_the_one_before_equals_a_new_one() -> None:
    tip = TipFilter(Registration(coil_offset_mm=25.0), (0.0, 0.0, 0.0), 1 / RADIUS_MM, SETTINGS, SENSORS, PLANE)
    setup = Setup(
        1 / RADIUS_MM, SimulatedEntry(depth_mm=-2.0), robot=Robot(servo_hz=200), effects=EFFECTS, fibre=SENSORS,
        ultrasound=PLANE,
    )  # fmt: skip
    with Lab(setup, 4) as twin:
        for depth, roll in ((18.0, 3.0), (40.0, 3.2), (30.0, 6.0), (42.0, None)):
            twin.stage.insert(depth, SPEED_MM_S)
            if roll is not None:
                twin.stage.rotate(roll, 1.0)  # while the needle advances
            for _ in range(12):
                twin.advance(0.15)
                *_, sample = twin.stage.waiting()
                tip.predict(sample)
                for measured, use in ((twin.tracker, tip.update), (twin.fibre, tip.update_fibre)):
                    for each in measured.waiting():
                        use(each)
                for image in twin.ultrasound.waiting():
                    tip.update_image(image)
                went_on = tip.tip_state()
                tip._predictor.forget()
                for one, other in zip(went_on, tip.tip_state(), strict=True):
                    assert np.array_equal(one, other)


def _consistent(runs: int, level: float) -> None:
    found = [errors(seed) for seed in range(runs)]
    low, high = chi2.ppf([(1 - level) / 2, (1 + level) / 2], 5 * runs) / runs
    for subset in SUBSETS:
        nees = np.mean([each[subset][0] for each in found])
        assert low < nees < high, f"{subset}: {nees:.2f} is not within {low:.2f} and {high:.2f}"


@pytest.mark.slow
def test_the_filter_is_consistent_in_a_few_runs() -> None:
    _consistent(2, 0.999)


@pytest.mark.study
def test_the_filter_is_consistent_with_any_subset_of_measurements() -> None:
    _consistent(200, 0.95)


def walked(*, coil_mm: float, poses_until_mm: float, images: bool, seed: int = 5) -> tuple[TipFilter, float]:
    """Return a filter after 40 mm of a walk that bends more than planned, and its error (mm)."""
    random = np.random.default_rng(seed)
    walk = Walk(random, 1.2 / RADIUS_MM, 0.0)
    settings = TipSettings(image_sd_mm=0.5)
    tip = TipFilter(Registration(coil_offset_mm=coil_mm), (0.0, 0.0, 0.0), 1 / RADIUS_MM, settings, plane=PLANE)
    tip.predict(stage(0, 0.0, 0.0))
    for step in range(1, round(40 / STEP_MM) + 1):
        length, now = step * STEP_MM, step * 5_000_000
        walk.go(STEP_MM, 0.0)
        tip.predict(stage(now, length, 0.0, 10.0))
        if step % 5 == 0 and length <= poses_until_mm:
            tip.update(walk.pose_of_coil(length - coil_mm, now, step, 0.2, 0.01))
        if images and step % 10 == 0:
            u, v = (walk.at(length)[0][:2] + random.normal(0, 0.5, 2)).tolist()
            tip.update_image(ImageSample(Stamp(now, step), u, v))
    return tip, math.dist(tip.tip.position_mm, walk.at(40.0)[0].tolist())


@pytest.mark.parametrize(("coil_mm", "until_mm"), [(0.0, 0.0), (10.0, 15.0)])
def test_images_replace_a_tracker_that_is_absent_or_lost(coil_mm: float, until_mm: float) -> None:
    tip, error = walked(coil_mm=coil_mm, poses_until_mm=until_mm, images=True)
    _, without = walked(coil_mm=coil_mm, poses_until_mm=until_mm, images=False)
    assert error < min(0.4, 0.8 * without)
    assert tip.tip.usable


def fed(u: float, v: float, health: Health = Health.GOOD, at_mm: float = 20.0, time_s: float = 2.0) -> PoseUse:
    tip = TipFilter(Registration(), (0.0, 0.0, 0.0), 1e-4, TipSettings(image_latency_s=0.5), plane=PLANE)
    for step in range(201):
        tip.predict(stage(step * 10_000_000, step * at_mm / 200, 0.0, at_mm / 2))
    return tip.update_image(ImageSample(Stamp(round(time_s * 1e9), 1), u, v, health))


def test_a_detection_is_used_missing_suspect_or_an_outlier_at_the_time_of_its_image() -> None:
    assert fed(15.0, 0.0) is PoseUse.USED  # half a second ago the tip was at 15 mm
    assert fed(20.0, 0.0) is PoseUse.OUTLIER
    assert fed(15.0, 9.0) is PoseUse.OUTLIER
    assert fed(math.nan, 0.0) is PoseUse.MISSING
    assert fed(math.nan, math.nan, Health.MISSING) is PoseUse.MISSING
    assert fed(15.0, 0.0, Health.SUSPECT) is PoseUse.SUSPECT


def test_wrong_use_and_wrong_planes_have_one_clear_error() -> None:
    tip = TipFilter(Registration(), (0.0, 0.0, 0.0), 0.01)
    with pytest.raises(DataError, match="plane: is missing: give TipFilter the image plane"):
        tip.update_image(ImageSample(Stamp(0, 0), 0.0, 0.0))
    with pytest.raises(ModelError, match=r"v_axis.*must be at a right angle to u_axis"):
        ImagePlane(v_axis=(0.6, 0.8, 0.0))
    with pytest.raises(ModelError, match=r"u_axis.*must be of length 1"):
        ImagePlane(u_axis=(1.0, 1.0, 0.0))
    assert ImagePlane((0.0, 0.0, 9.0)).apart_mm(np.array([[0.0, 5.0, 1.0], [0.0, 0.0, 2.0]])) == 5.0
    assert ImagePlane().apart_mm(np.array([[0.0, 5.0, 1.9]])) == 0.0
    far = ImagePlane((0.0, 0.0, 400.0))
    with pytest.raises(SimulationError, match=r"ultrasound.origin_mm.*must be crossed by the tip: the slice is 398 mm"):
        Setup(0.01, ultrasound=far)


def test_the_twin_shows_the_tip_late_with_its_noise_within_the_slice_only() -> None:
    effects = Effects(ultrasound_noise_mm=0.2, ultrasound_missed=0.5, ultrasound_delay_s=0.2)
    across = ImagePlane((20.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    seen: list[ImageSample] = []
    with Lab(Setup(0.01, effects=effects, ultrasound=across), 3) as twin:
        twin.stage.insert(40.0, 10.0)
        for _ in range(30):
            twin.advance(0.2)
            seen += twin.ultrasound.waiting()
    detected = [each for each in seen if each.health is Health.GOOD]
    # The slice is 4 mm thick: 0.4 s at 20 Hz, half of which are missed.
    assert 1 <= len(detected) <= 8
    assert {each.health for each in seen} == {Health.GOOD, Health.MISSING}
    assert all(abs(each.u_mm - 2.0) < 1.2 and abs(each.v_mm) < 0.8 for each in detected)
    assert seen[0].stamp.received_ns == pytest.approx(0.25e9)
