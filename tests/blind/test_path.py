"""The tip-path channel: base, tracker, effects, sizes, files, lists."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from needleplan.recording import read_records
from tests.blind import curve, path
from tests.blind.campaign import SEEDS, Purpose, Stratum, campaign
from tests.blind.path import PATH_EFFECTS, SIGMA_MM, Moves, PathSpec, generate
from tests.blind.path_campaign import SMALL_PATH, PathCounts, path_campaign
from tests.blind.path_effect import PathName
from tests.blind.recording import FileKind, Role
from tests.blind.steering import STRAIGHT_ON, STRAIGHT_ON_HELD_OUT, TWO_SPEED, SteeringKind, from_rates, steering


def shown(spec: PathSpec, *effects: path.PathEffect) -> np.ndarray:
    motions = [steering(each) for each in spec.training]
    return path._shown_mm(path._trials(spec, path._seeds(spec, len(motions)), motions), effects)


def bicycle(motion: path.Steering, curvature_1_mm: float) -> np.ndarray:
    """The base of the README, written once more: arcs in the plane, the sign by the side of the bevel."""
    x, y, heading = 0.0, 0.0, 0.0
    positions = [(x, y)]
    for length, angle in zip(np.diff(motion.depth_mm), motion.angle_rad[1:], strict=True):
        bent = curvature_1_mm * np.cos(angle) * length
        x, y = x + length * np.cos(heading + bent / 2), y + length * np.sin(heading + bent / 2)
        heading += bent
        positions.append((x, y))
    return np.array(positions)[::2]


@pytest.mark.parametrize("kinds", [TWO_SPEED, STRAIGHT_ON])
def test_without_effects_the_tip_follows_arcs(kinds: tuple[SteeringKind, ...]) -> None:
    spec = PathSpec(5, training=kinds)
    tissue = curve.medium([np.random.SeedSequence(5, spawn_key=(0, r, 0)) for r in range(3)], 0.0)
    made = shown(spec)
    for r, kind in enumerate(kinds):
        curvature = curve.CURVATURE_1_MM * tissue.along[r, 0]
        assert abs(curvature / curve.CURVATURE_1_MM - 1.0) <= 0.03
        assert np.abs(made[:, r, :2] - bicycle(steering(kind), curvature)).max() < 0.1 * SIGMA_MM
        assert np.abs(made[:, r, 2]).max() < 1e-9


def test_a_steady_circle_in_any_plane_closes() -> None:
    around = np.linspace(0.0, 2 * np.pi * 50.0, 4001)[:, None]
    for angle in (0.0, 1.0, 4.0):
        bend = np.broadcast_to(np.array([np.cos(angle), np.sin(angle)]) / 50.0, (4001, 1, 2))
        course = curve.integrated(around, bend, np.zeros(2))
        assert np.abs(course.position_mm[-1]).max() < 0.05
        across = course.position_mm[2000, 0]
        assert across == pytest.approx([0.0, 100 * np.cos(angle), 100 * np.sin(angle)], abs=0.05)
        assert np.einsum("trx,trx->tr", course.first, course.second) == pytest.approx(0.0, abs=1e-9)


def test_positive_angle_turns_from_y_toward_z() -> None:
    steps = 1600
    quarter = from_rates("quarter", np.full(steps, 4.0), np.zeros(steps), np.pi / 2)
    spec = PathSpec(1)
    tip = path.another(spec, quarter).columns
    assert tip["z_mm"][-1] == pytest.approx(80.0**2 / 2 / 250.0, rel=0.1)
    assert abs(tip["y_mm"][-1]) < 1.0
    with pytest.raises(ValueError, match="not drawn back"):
        from_rates("back", np.full(10, -1.0), np.zeros(10))


def test_tracker_noise_has_its_strength_and_colour() -> None:
    noise = path._noise(np.random.default_rng(5), 100_000)
    assert noise.std(axis=0) == pytest.approx([SIGMA_MM] * 3, rel=0.02)
    for axis in noise.T:
        lags = [np.mean(axis[k:] * axis[:-k]) / np.mean(axis**2) for k in (1, 5)]
        assert lags == pytest.approx([0.2 * 0.9**k for k in (1, 5)], abs=0.015)
    assert abs(np.corrcoef(noise.T)[0, 1]) < 0.02


@pytest.mark.parametrize("level", [0.03, 0.10])
def test_heterogeneity_bends_by_its_level(level: float) -> None:
    seeds = [np.random.SeedSequence(3, spawn_key=(i,)) for i in range(200)]
    even, rough = curve.medium(seeds, 0.0), curve.medium(seeds, level)
    assert (rough.along / even.along - 1.0).std() == pytest.approx(level, rel=0.06)
    assert rough.across.std() == pytest.approx(level / 2, rel=0.06)


@pytest.mark.parametrize("name", PathName)
def test_size_zero_is_the_base_to_the_last_bit(name: PathName) -> None:
    drawn = PATH_EFFECTS[name].drawn(np.random.default_rng(1), 80.0)
    assert drawn.size == 0.0
    spec = PathSpec(13, (), 0.03)
    assert np.array_equal(shown(spec, drawn), shown(spec))


@pytest.mark.parametrize("name", PathName)
def test_effects_move_the_tip_as_far_as_wanted(name: PathName) -> None:
    (hidden,) = generate(PathSpec(17, (Moves(name, 5.0),), 0.03))[1].effects
    assert hidden.largest == pytest.approx(5.0 * SIGMA_MM, rel=0.02)
    assert 0.0 < hidden.rms < hidden.largest * 1.0001
    assert 0 < abs(hidden.parameters["size"]) <= PATH_EFFECTS[name].LARGEST


def test_what_the_curvature_cannot_take_up_is_left() -> None:
    bias, layer = (generate(PathSpec(18, (Moves(name, 5.0),)))[1].effects[0] for name in (
        PathName.TRACKER_BIAS, PathName.CURVATURE_LAYER))  # fmt: skip
    assert 0.0 <= bias.absorbed < 0.5
    assert 0.1 < layer.absorbed < 0.99
    assert bias.noncentrality > layer.noncentrality > 100.0


def test_one_speed_without_a_turn_cannot_show_a_lag() -> None:
    spec = PathSpec(19, (Moves(PathName.TORSIONAL_LAG, 5.0),), 0.0, STRAIGHT_ON, STRAIGHT_ON_HELD_OUT)
    assert generate(spec)[1].effects[0].largest == 0.0


def test_the_tip_lags_by_the_twist_of_its_depth() -> None:
    lag = PATH_EFFECTS[PathName.TORSIONAL_LAG].drawn(np.random.default_rng(1), 80.0).with_size(0.3)
    depth = np.full((400, 1), 80.0)
    base = np.concatenate([np.linspace(0, np.pi, 200), np.linspace(np.pi, np.pi - 0.5, 200)])[:, None]
    tip = lag.tip_rad(base, depth)
    assert tip[199] == pytest.approx(np.pi - 0.3)
    assert tip[300] == tip[199]  # within the dead zone of twice the lag
    assert lag.tip_rad(base, 0.0 * depth) == pytest.approx(base)


def test_same_seed_same_data_and_the_motion_held_out_is_another() -> None:
    spec = PathSpec(23, (Moves(PathName.GRAVITY, 8.0),), 0.03)
    first, again, other = (generate(each)[0] for each in (spec, spec, PathSpec(24, spec.effects, 0.03)))
    assert np.array_equal(first.trials[0].columns["y_mm"], again.trials[0].columns["y_mm"])
    assert not np.array_equal(first.trials[0].columns["y_mm"], other.trials[0].columns["y_mm"])
    (train, *_), (held, *_) = first.of(Role.TRAIN), first.of(Role.HOLDOUT)
    assert np.abs(train.columns["depth_mm"] - held.columns["depth_mm"]).max() > 5.0


@pytest.mark.parametrize("kind", TWO_SPEED)
def test_training_motions_have_two_speeds_and_one_turn(kind: SteeringKind) -> None:
    motion = steering(kind)
    assert len(motion.time_s) == 1920
    speeds = {speed for speed in (4.0, 10.0) if (np.abs(motion.velocity_mm_s - speed) < 0.02).sum() > 100}
    assert speeds == {4.0, 10.0}
    assert np.abs(np.diff(motion.angle_rad[[0, -1]])) == pytest.approx([np.pi])
    turning = motion.phase == "rotation"
    assert turning.any()
    assert np.abs(np.diff(motion.depth_mm))[turning[1:]].max() < 1e-3
    assert motion.depth_mm[-1] == pytest.approx(80.0, abs=0.01)


@pytest.mark.parametrize("kind", FileKind)
def test_files_are_read_as_they_were_meant(kind: FileKind, tmp_path: Path) -> None:
    data, truth = generate(PathSpec(29, (Moves(PathName.COIL_OFFSET, 5.0),)))
    for file, trial in zip(data.write(tmp_path / "data", kind), data.trials, strict=True):
        (record,) = read_records(file)
        assert (record.trial, record.role) == (trial.name, trial.role)
        for name in ("time_s", "depth_mm", "velocity_mm_s", "angle_rad", "x_mm", "y_mm", "z_mm"):
            assert np.allclose(record.columns[name], trial.columns[name], atol=6e-5)
    with pytest.raises(ValueError, match="with the data"):
        truth.write(tmp_path / "data", tmp_path / "data")


def test_the_lists_are_disjoint_and_keep_what_is_never_tuned_with() -> None:
    full = {purpose: list(path_campaign(purpose)) for purpose in Purpose}
    seeds = {purpose: {case.spec.seed for case in cases} for purpose, cases in full.items()}
    for purpose, cases in full.items():
        assert len(seeds[purpose]) == len(cases)
        assert all(seed in SEEDS[purpose] for seed in seeds[purpose])
        assert not seeds[purpose] & {case.spec.seed for case in campaign(purpose)}
    assert not any(case.never_tuned for case in full[Purpose.TUNING])
    assert len({each.name for case in full[Purpose.REPORTING] if case.never_tuned for each in case.spec.effects}) >= 3
    known = {case.spec.seed: case for case in full[Purpose.REPORTING]}
    small = list(path_campaign(Purpose.REPORTING, SMALL_PATH))
    assert all(known[case.spec.seed] == case for case in small)
    pair = next(case for case in small if case.stratum is Stratum.PAIR)
    assert [each.name for each in generate(pair.spec)[1].effects] == [each.name for each in pair.spec.effects]
    with pytest.raises(ValueError, match="a row of cases"):
        list(path_campaign(Purpose.TUNING, PathCounts(nulls=1001)))
