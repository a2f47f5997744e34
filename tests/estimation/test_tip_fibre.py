"""Curvature sensors in the tip filter: on a needle of small rotation matrices, and on the lab twin."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from needleplan.devices import FibreSample, Health, Stamp
from needleplan.errors import DataError
from needleplan.estimation import Registration, TipFilter, TipSettings
from needleplan.models.deflection import FibreSensors
from needleplan.signals import Array
from needleplan.simulation import Effects, Lab, Setup, SimulatedEntry
from tests.estimation.needle_walk import STEP_MM, Walk, stage

RADIUS_MM, SPEED_MM_S = 40.0, 5.0
SENSORS = FibreSensors((2.5, 10.0, 30.0))
SETTINGS = TipSettings(
    position_sd_mm=0.2, angle_sd_rad=0.01, entry_sd_mm=1e-3, entry_sd_rad=1e-4,  factor_sd=0.0,
    factor_sd_sqrt_mm=0.0, change_sd_per_mm=0.0, roll_sd_rad=0.0, roll_sd_sqrt_rad=0.0,
)  # fmt: skip
TICK_NS = round(STEP_MM / SPEED_MM_S * 1e9)


def readings(walk: Walk, length: float, roll: float, random: np.random.Generator, bias: Array) -> FibreSample:
    """What the sensors measure: the change of the tangent over the gauge, in the axes of the turned needle."""
    seen = []
    for number, behind in enumerate(SENSORS.from_tip_mm):
        place = length - behind
        # A grating at the tip ends where the needle ends.
        rows = [round((place + part * SENSORS.gauge_mm / 2) / STEP_MM) + 600 for part in (-1, 0, 1)]
        before, middle, after = (walk.frames[min(row, len(walk.frames) - 1)] for row in rows)
        turned = middle.inv().apply(after.apply([1, 0, 0]) - before.apply([1, 0, 0])) / SENSORS.gauge_mm
        y, z = (
            math.cos(roll) * turned[1] + math.sin(roll) * turned[2],
            math.cos(roll) * turned[2] - math.sin(roll) * turned[1],
        )
        noise = random.normal(0, SETTINGS.fibre_sd_per_mm, 2) + bias[number]
        seen.append((y + noise[0], z + noise[1]))
    return FibreSample(Stamp(round(length / STEP_MM) * TICK_NS, 0), tuple(seen))


def walked(seed: int, *, poses: bool, fibre: bool, coil_mm: float = 9.3) -> tuple[float, Array]:
    """NEES across the path, and error of place and direction, after 50 mm with a turn by 2 rad at 22 mm."""
    random = np.random.default_rng(seed)
    walk = Walk(random, 1 / RADIUS_MM, SETTINGS.heading_sd_rad_sqrt_mm)
    tip = TipFilter(
        Registration(coil_offset_mm=coil_mm), (0.0, 0.0, 0.0), 1 / RADIUS_MM, SETTINGS, SENSORS if fibre else None
    )
    bias = random.normal(0, SETTINGS.fibre_bias_sd_per_mm, (3, 2))
    tip.predict(stage(0, 0.0, 0.0))
    for step in range(1, round(50 / STEP_MM) + 1):
        length = step * STEP_MM
        roll = 0.0 if length <= 22 else 2.0
        walk.go(STEP_MM, roll)
        tip.predict(stage(step * TICK_NS, length, roll, SPEED_MM_S))
        if fibre:
            tip.update_fibre(readings(walk, length, roll, random, bias))
        if poses and step % 5 == 0:
            tip.update(walk.pose_of_coil(length - coil_mm, step * TICK_NS, step, 0.2, 0.01))
    state, covariance = tip.tip_state()
    place, tangent = walk.at(50.0)
    error = state[:5] - [*place, math.atan2(tangent[1], tangent[0]), math.asin(tangent[2])]
    # Along the path, slip that does not happen here is expected: only the two axes across it count.
    across = np.zeros((4, 5))
    across[:2, :3] = np.linalg.svd(tangent[None])[2][1:]
    across[2:, 3:] = np.eye(2)
    off = across @ error
    return float(off @ np.linalg.solve(across @ covariance[:5, :5] @ across.T, off)), error


@pytest.mark.study
@pytest.mark.parametrize("poses", [True, False])
def test_the_deviations_hold_for_a_needle_of_another_hand(poses: bool) -> None:
    runs = [walked(seed, poses=poses, fibre=True) for seed in range(24)]
    low, high = chi2.ppf([0.005, 0.995], 4 * len(runs)) / len(runs)
    assert low < np.mean([nees for nees, _ in runs]) < high
    without = [walked(seed, poses=poses, fibre=False)[1] for seed in range(24)]
    better = np.linalg.norm([error[:3] for _, error in runs], axis=1).mean()
    assert better < 0.8 * np.linalg.norm([error[:3] for error in without], axis=1).mean()


def lab(seed: int) -> Lab:
    effects = Effects(
        curvature_error=0.2, heading_noise_rad_sqrt_mm=0.002, tracker_noise_mm=0.2, tracker_angle_noise_rad=0.01,
        coil_offset_mm=30.0, fibre_noise_per_mm=2e-4, fibre_bias_per_mm=1e-4,
    )  # fmt: skip
    entry = SimulatedEntry(depth_mm=-2.0)
    return Lab(Setup(plan_curvature_per_mm=1 / RADIUS_MM, entry=entry, effects=effects, fibre=SENSORS), seed)


def at_half(seed: int) -> tuple[float, float]:
    """Errors of the tip (mm) after half of a path of 55 mm: by the tracker alone, and with the sensors."""
    settings = TipSettings(position_sd_mm=0.2, angle_sd_rad=0.01)
    with lab(seed) as twin:
        plain, sensed = (
            TipFilter(Registration(coil_offset_mm=30.0), (0.0, 0.0, 0.0), 1 / RADIUS_MM, settings, each)
            for each in (None, SENSORS)
        )
        for depth, roll in ((15.0, math.pi), (27.5, None)):
            for step in ("insert", "rotate"):
                if step == "insert":
                    twin.stage.insert(depth, SPEED_MM_S)
                elif roll is not None:
                    twin.stage.rotate(roll, 6.0)
                moving = True
                while moving:
                    sample = twin.stage.read(0.01)
                    assert sample
                    moving = sample.moving and not (step == "rotate" and roll is None)
                    fibres, poses = twin.fibre.waiting(), twin.tracker.waiting()
                    for each in (plain, sensed):
                        each.predict(sample)
                        for pose in poses:
                            each.update(pose)
                    for fibre in fibres:
                        sensed.update_fibre(fibre)
        true = twin.plant.tip().position_mm
        return math.dist(plain.tip.position_mm, true), math.dist(sensed.tip.position_mm, true)


@pytest.mark.slow
def test_with_a_coil_far_behind_the_tip_is_twice_as_good() -> None:
    errors = np.array([at_half(seed) for seed in range(2)]).mean(axis=0)
    assert errors[1] < errors[0] / 2


def filled(fibre: FibreSensors | None = SENSORS) -> TipFilter:
    tip = TipFilter(Registration(), (0.0, 0.0, 0.0), 1 / RADIUS_MM, SETTINGS, fibre)
    tip.predict(stage(0, 0.0, 0.0))
    return tip


def fed(values: tuple[float, float], health: Health = Health.GOOD) -> TipFilter:
    """A filter after 40 mm in which all sensors always showed the same."""
    tip = filled()
    for step in range(1, 401):
        tip.predict(stage(step * TICK_NS, step * 0.1, 0.0, SPEED_MM_S))
        tip.update_fibre(FibreSample(Stamp(step * TICK_NS, step), (values,) * 3, health))
    return tip


def test_a_plan_that_is_right_is_confirmed_and_another_curvature_is_followed() -> None:
    assert fed((1 / RADIUS_MM, 0.0)).tip.y_mm == pytest.approx(filled_to_40().tip.y_mm, abs=0.05)
    more = fed((1.04 / RADIUS_MM, 0.0)).tip
    assert more.heading_rad > filled_to_40().tip.heading_rad + 0.01


def filled_to_40() -> TipFilter:
    tip = filled()
    tip.predict(stage(400 * TICK_NS, 40.0, 0.0, SPEED_MM_S))
    return tip


@pytest.mark.parametrize(("values", "health"), [
    ((math.nan, math.nan), Health.GOOD),
    ((1 / RADIUS_MM, 0.0), Health.SUSPECT),
    ((0.09, 0.0), Health.GOOD),
], ids=["broken", "suspect", "contradicting"])  # fmt: skip
def test_readings_that_cannot_be_are_not_used(values: tuple[float, float], health: Health) -> None:
    found, plain = fed(values, health).tip, filled_to_40().tip
    assert found.position_mm == pytest.approx(plain.position_mm, abs=0.02)
    assert found.heading_sd_rad == pytest.approx(plain.heading_sd_rad, rel=0.02)


def test_readings_in_another_unit_are_refused_and_a_short_glitch_is_not() -> None:
    with pytest.raises(
        DataError, match=r"curvatures_per_mm = .* 1/mm: is questionably large, in 10 samples in a row; in 1/m"
    ):
        fed((1000 / RADIUS_MM, 0.0))
    tip = filled()
    for number in range(40):
        values = (1000 / RADIUS_MM if number % 10 else 0.0, 0.0)
        tip.update_fibre(FibreSample(Stamp(number, number), (values,) * 3))
    assert tip.tip.position_mm == pytest.approx(filled().tip.position_mm)


def test_samples_of_other_sensors_are_refused() -> None:
    sample = FibreSample(Stamp(0, 0), ((0.0, 0.0),) * 3)
    with pytest.raises(DataError, match="give TipFilter the sensors of the needle"):
        filled(None).update_fibre(sample)
    with pytest.raises(DataError, match="must be 3, the sensors in from_tip_mm"):
        filled().update_fibre(replace(sample, curvatures_per_mm=((0.0, 0.0),)))
    before_the_stage = TipFilter(Registration(), (0.0, 0.0, 0.0), 1 / RADIUS_MM, SETTINGS, SENSORS)
    before_the_stage.update_fibre(sample)
    with pytest.raises(DataError, match="has not had a stage sample"):
        _ = before_the_stage.tip
