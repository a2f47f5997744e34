import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from needleplan.devices import Health, PoseSample, Stamp
from needleplan.errors import DataError, ModelError
from needleplan.estimation import PoseUse, Registration, TipFilter, TipSettings, TipStatus
from needleplan.signals import Array
from tests.estimation.needle_walk import Walk, stage, unseen

RADIUS_MM, COIL_MM, FRAME_NS = 40.0, 9.3, 25_000_000
SETTINGS = TipSettings(
    position_sd_mm=0.2, angle_sd_rad=0.01, heading_sd_rad_sqrt_mm=0.003, slip_sd_mm_sqrt_mm=0.001,
    factor_sd_sqrt_mm=1e-4, change_sd_per_mm=0.0, roll_sd_rad=0.03, roll_sd_sqrt_rad=0.0, entry_sd_mm=0.3,
    entry_sd_rad=0.01,
)  # fmt: skip


def drawn(random: np.random.Generator, settings: TipSettings = SETTINGS) -> tuple[Walk, float]:
    """A needle whose entry, curvature and bevel are off by what the filter expects; and how far its bevel is off."""
    sd, turn = settings.entry_sd_mm, settings.entry_sd_rad
    factor = 1 + settings.factor_sd * random.normal()
    pose = (random.normal(0, sd), random.normal(0, sd), random.normal(0, turn))
    walk = Walk(random, factor / RADIUS_MM, settings.heading_sd_rad_sqrt_mm, pose)
    return walk, settings.roll_sd_rad * random.normal()


def inserted(
    walk: Walk, tip: TipFilter, off_rad: float, legs: tuple[tuple[float, float], ...], step_mm: float = 0.25
) -> list[tuple[Array, Array, float]]:
    """Insert by (length, roll); return error and covariance of (x, y, z, heading, elevation, factor), and NIS."""
    settings, now, found = tip.settings, 0, []
    depth = 0.0
    tip.predict(stage(now, depth, legs[0][1]))
    for length, roll in legs:
        for _ in range(round(length / step_mm)):
            now += FRAME_NS
            depth += step_mm
            walk.go(step_mm, roll + off_rad)
            tip.predict(stage(now, depth, roll))
            coil = depth - tip.registration.coil_offset_mm
            tip.update(walk.pose_of_coil(coil, now, now, settings.position_sd_mm, settings.angle_sd_rad))
            state, covariance = tip.tip_state()
            place, tangent = walk.at(depth)
            angles = (math.atan2(tangent[1], tangent[0]), math.asin(tangent[2]))
            true = np.array([*place, *angles, walk.curvature_per_mm * RADIUS_MM])
            found.append((state[:6] - true, covariance[:6, :6], tip.nis))
    return found


LEGS = ((20.0, 0.0), (15.0, math.pi), (15.0, 0.0))


@pytest.mark.study
def test_errors_are_as_large_as_the_filter_says() -> None:
    ends, nis = [], []
    for seed in range(20):
        random = np.random.default_rng(seed)
        walk, off = drawn(random)
        # Entry along x is known: the stage is at zero where the surface is.
        tip = TipFilter(Registration(coil_offset_mm=COIL_MM), (0.0, 0.0, 0.0), 1 / RADIUS_MM, SETTINGS)
        found = inserted(walk, tip, off, LEGS)
        for row in (79, 139, 199):
            error, covariance, _ = found[row]
            ends.append(float(error @ np.linalg.solve(covariance, error)))
        nis += [each[2] for each in found]
    # Mean of independent chi-squared: the ends of one insertion are nearly so.
    assert np.mean(ends) == pytest.approx(6, abs=4 * math.sqrt(12 / 20))
    assert np.mean(nis) == pytest.approx(5, abs=0.15)
    outliers = np.mean(np.array(nis) > stats.chi2.isf(0.01, 5))
    assert outliers == pytest.approx(0.01, abs=0.006)


@pytest.mark.slow
def test_the_arc_is_better_than_the_straight_line_from_the_coil() -> None:
    arc, line = [], []
    for seed in range(5):
        random = np.random.default_rng(100 + seed)
        walk, off = drawn(random)
        tip = TipFilter(Registration(coil_offset_mm=COIL_MM), (0.0, 0.0, 0.0), 1 / RADIUS_MM, SETTINGS)
        found = inserted(walk, tip, off, LEGS)
        place, _ = walk.at(walk.length_mm)
        coil, direction = walk.at(walk.length_mm - COIL_MM)
        arc.append(np.linalg.norm(found[-1][0][:3]))
        line.append(np.linalg.norm(coil + COIL_MM * direction - place))
    assert np.mean(arc) < 0.15 * np.mean(line)


def test_a_curvature_off_the_plan_is_found() -> None:
    for seed, factor in ((0, 1.2), (1, 0.8), (2, 1.2)):
        random = np.random.default_rng(seed)
        walk = Walk(random, factor / RADIUS_MM, SETTINGS.heading_sd_rad_sqrt_mm)
        tip = TipFilter(Registration(coil_offset_mm=COIL_MM), (0.0, 0.0, 0.0), 1 / RADIUS_MM, SETTINGS)
        inserted(walk, tip, 0.0, ((30.0, 0.0),))
        found = tip.tip
        assert found.curvature_factor == pytest.approx(factor, abs=3 * found.curvature_factor_sd)
        assert abs(found.curvature_factor - 1) > 3 * found.curvature_factor_sd
        assert found.curvature_per_mm == pytest.approx(found.curvature_factor / RADIUS_MM)
        assert found.status is TipStatus.TRACKING


def test_a_curvature_that_fades_is_found_with_its_change_and_extrapolated() -> None:
    random = np.random.default_rng(4)
    settings = replace(SETTINGS, change_sd_per_mm=0.01, change_mm=200.0, heading_sd_rad_sqrt_mm=5e-4)
    walk = Walk(random, 1.2 / RADIUS_MM, 0.0)
    tip = TipFilter(Registration(coil_offset_mm=COIL_MM), (0.0, 0.0, 0.0), 1 / RADIUS_MM, settings)
    now = 0
    tip.predict(stage(now, 0.0, 0.0))
    for number in range(240):
        now += FRAME_NS
        depth = 0.25 * (number + 1)
        walk.curvature_per_mm = (1.2 - 0.008 * depth) / RADIUS_MM
        walk.go(0.25, 0.0)
        tip.predict(stage(now, depth, 0.0))
        tip.update(walk.pose_of_coil(depth - COIL_MM, now, now, 0.1, 0.005))
    found = tip.tip
    assert found.curvature_factor == pytest.approx(1.2 - 0.008 * 60, abs=3 * found.curvature_factor_sd)
    change, sd = found.curvature_factor_change_per_mm, found.curvature_factor_change_sd_per_mm
    assert change == pytest.approx(-0.008, abs=3 * sd)
    assert change < -sd
    mean, mean_sd = tip.mean_curvature(20.0)
    assert mean * RADIUS_MM == pytest.approx(1.2 - 0.008 * 70, abs=3 * mean_sd * RADIUS_MM)
    assert mean < found.curvature_per_mm
    assert tip.mean_curvature(0.0)[0] == pytest.approx(found.curvature_per_mm)
    for _ in range(80):
        walk.curvature_per_mm -= 0.008 * 0.25 / RADIUS_MM
        walk.go(0.25, 0.0)
    ahead, covariance = tip.ahead(20.0)
    off = ahead[:3] - walk.at(80.0)[0]
    assert np.all(np.abs(off) < 4 * np.sqrt(np.diag(covariance)[:3]))
    assert np.linalg.norm(off) < 0.5


def test_an_entry_out_of_the_plane_is_a_start_of_the_path() -> None:
    tip = TipFilter(Registration(), (0.0, 1.0, 0.1, 2.0, 0.05), 1 / RADIUS_MM)
    tip.predict(stage(0, 0.0, 0.0))
    found = tip.tip
    assert (found.y_mm, found.z_mm, found.heading_rad, found.elevation_rad) == (1.0, 2.0, 0.1, 0.05)
    with pytest.raises(DataError, match="must be finite numbers"):
        TipFilter(Registration(), (0.0, 1.0, 0.1, 2.0), 1 / RADIUS_MM)


def test_late_poses_correct_the_path_where_the_coil_was() -> None:
    latency_ns = 75_000_000
    settings = replace(SETTINGS, latency_s=0.075)
    walk = Walk(np.random.default_rng(3), 1 / RADIUS_MM, 0.0)
    late = TipFilter(Registration(coil_offset_mm=COIL_MM), (0.0, 0.0, 0.0), 1 / RADIUS_MM, settings)
    wrong = TipFilter(Registration(coil_offset_mm=COIL_MM), (0.0, 0.0, 0.0), 1 / RADIUS_MM, SETTINGS)
    depth = 0.0
    for frame in range(160):
        now = frame * FRAME_NS
        for each in (late, wrong):
            each.predict(stage(now, depth, 0.0, 10.0))
        if frame >= 3:
            pose = walk.pose_of_coil(depth - 0.75 - COIL_MM, now - latency_ns, frame, 0.01, 0.001)
            for each in (late, wrong):
                each.update(replace(pose, stamp=Stamp(now, frame)))
        walk.go(0.25, 0.0)
        depth += 0.25
    place, _ = walk.at(depth - 0.25)
    assert math.dist((late.tip.x_mm, late.tip.y_mm), place[:2]) < 0.05
    assert math.dist((wrong.tip.x_mm, wrong.tip.y_mm), place[:2]) > 0.15


def test_poses_that_are_no_use_are_counted_and_deviations_grow() -> None:
    random = np.random.default_rng(4)
    walk, off = drawn(random)
    tip = TipFilter(Registration(coil_offset_mm=COIL_MM), (0.0, 0.0, 0.0), 1 / RADIUS_MM, SETTINGS)
    with pytest.raises(DataError, match="has not had a stage sample"):
        _ = tip.tip
    pose = walk.pose_of_coil(-5.0, 1, 1, 0.1, 0.01)
    assert tip.update(pose) is PoseUse.EARLY
    tip.predict(stage(2, 0.0, 0.0))
    assert tip.tip.status is TipStatus.WAITING
    inserted(walk, tip, off, ((20.0, 0.0),))
    before, depth = tip.tip, 20.0
    now = before.time_ns
    for health, use in ((Health.MISSING, PoseUse.MISSING), (Health.SUSPECT, PoseUse.SUSPECT)) * 60:
        now += FRAME_NS
        depth += 0.1
        tip.predict(stage(now, depth, 0.0))
        assert tip.update(unseen(replace(pose, stamp=Stamp(now, now)), health)) is use
    after = tip.tip
    assert after.status is TipStatus.COASTING
    assert after.pose_age_s == pytest.approx(3.0)
    assert after.y_sd_mm > 2 * before.y_sd_mm
    assert tip.update(replace(pose, stamp=Stamp(1, 1))) is PoseUse.STALE
    broken = PoseSample(Stamp(now + 1, 1), (math.nan,) * 3, (1.0, 0.0, 0.0, 0.0), 0.1)
    assert tip.update(broken) is PoseUse.MISSING
    assert tip.counts[PoseUse.MISSING] == 61


def test_a_lost_track_says_so_and_comes_back() -> None:
    random = np.random.default_rng(5)
    walk = Walk(random, 1 / RADIUS_MM, 0.0)
    tip = TipFilter(Registration(coil_offset_mm=COIL_MM), (0.0, 0.0, 0.0), 1 / RADIUS_MM, SETTINGS)
    inserted(walk, tip, 0.0, ((20.0, 0.0),))
    now, before = tip.tip.time_ns, tip.tip
    statuses = []
    for frame in range(60):
        now += FRAME_NS
        tip.predict(stage(now, 20.0, 0.0))
        pose = walk.pose_of_coil(20.0 - COIL_MM, now, frame, 0.2, 0.01)
        x, y, z = pose.position_mm
        tip.update(replace(pose, position_mm=(x, y + 5.0, z)) if frame < 20 else pose)
        statuses.append(tip.tip.status)
    assert statuses[:9] == [TipStatus.TRACKING] * 9
    assert TipStatus.LOST in statuses[11:13]
    assert statuses[20] is TipStatus.LOST
    assert statuses[-1] is TipStatus.TRACKING
    assert math.dist((tip.tip.x_mm, tip.tip.y_mm), (before.x_mm, before.y_mm)) < 0.2


def test_a_needle_drawn_back_is_where_it_was_and_may_leave_its_channel() -> None:
    walk = Walk(np.random.default_rng(6), 1 / RADIUS_MM, 0.0)
    tip = TipFilter(Registration(coil_offset_mm=COIL_MM), (0.0, 0.0, 0.0), 1 / RADIUS_MM, SETTINGS)
    inserted(walk, tip, 0.0, ((30.0, 0.0),))
    now = tip.tip.time_ns
    for back in np.arange(30.0, 14.9, -0.25):
        now += FRAME_NS
        tip.predict(stage(now, float(back), math.pi))
        use = tip.update(walk.pose_of_coil(float(back) - COIL_MM, now, now, 0.2, 0.01))
    assert use is PoseUse.WITHDRAWN
    place, tangent = walk.at(15.0)
    assert math.dist((tip.tip.x_mm, tip.tip.y_mm, tip.tip.z_mm), place) < 0.15
    assert tip.tip.bevel == -1
    branch = Walk(np.random.default_rng(7), 1 / RADIUS_MM, 0.0)
    branch.go(15.0, 0.0)
    branch.go(20.0, math.pi)
    for depth in np.arange(15.25, 35.1, 0.25):
        now += FRAME_NS
        tip.predict(stage(now, float(depth), math.pi))
        tip.update(branch.pose_of_coil(float(depth) - COIL_MM, now, now, 0.2, 0.01))
    place, tangent = branch.at(35.0)
    assert math.dist((tip.tip.x_mm, tip.tip.y_mm, tip.tip.z_mm), place) < 0.4
    assert tip.tip.heading_rad == pytest.approx(math.atan2(tangent[1], tangent[0]), abs=0.04)
    assert tip.counts[PoseUse.OUTLIER] <= 2


def test_a_needle_drawn_back_is_as_certain_as_it_was() -> None:
    random = np.random.default_rng(8)
    walk, off = drawn(random)
    tip = TipFilter(Registration(coil_offset_mm=COIL_MM), (0.0, 0.0, 0.0), 1 / RADIUS_MM, SETTINGS)
    inserted(walk, tip, off, ((30.0, 0.0),), step_mm=0.1)
    now = tip.tip.time_ns
    for back in np.arange(30.0, 14.9, -0.25):
        now += FRAME_NS
        tip.predict(stage(now, float(back), 0.0))
        tip.update(walk.pose_of_coil(float(back) - COIL_MM, now, now, 0.2, 0.01))
    state, covariance = tip.tip_state()
    error = state[:3] - walk.at(15.0)[0]
    # The coil has been there: what the tip's place is uncertain by is what the coil's was.
    assert np.sqrt(np.diag(covariance)[:3]).max() < 0.12
    assert float(error @ np.linalg.solve(covariance[:3, :3], error)) < stats.chi2.isf(1e-3, 3)


def test_settings_and_entry_that_cannot_be_are_refused() -> None:
    with pytest.raises(ModelError) as caught:
        TipSettings(position_sd_mm=0.0, latency_s=-1.0)
    assert [each.key for each in caught.value.mistakes] == ["position_sd_mm", "latency_s"]
    with pytest.raises(DataError, match="entry"):
        TipFilter(Registration(), (0.0, math.nan, 0.0), 0.025)
    with pytest.raises(DataError, match="planned_per_mm"):
        TipFilter(Registration(), (0.0, 0.0, 0.0), -0.025)
