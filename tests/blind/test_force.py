"""The force channel: base, noise, effects, sizes, files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from needleplan.recording import read_records
from tests.blind import base, force
from tests.blind.effect import ForceName
from tests.blind.force import FORCE_EFFECTS, NOISE_N, ForceSpec, Wanted, generate
from tests.blind.identifiable import left
from tests.blind.motions import AIR_MM, POOR, POOR_HELD_OUT, RICH, RICH_HELD_OUT, MotionKind, from_depths, trajectory
from tests.blind.recording import FileKind, Role


def columns(spec: ForceSpec, role: Role = Role.TRAIN) -> list[np.ndarray]:
    return [each.columns["force_n"] for each in generate(spec)[0].of(role)]


@pytest.mark.slow
def test_same_seed_same_data_and_another_seed_other_data() -> None:
    spec = ForceSpec(3, (Wanted(ForceName.PUNCTURE, 1.0),), 0.03)
    assert all(np.array_equal(a, b) for a, b in zip(columns(spec), columns(spec), strict=True))
    assert not np.array_equal(columns(spec)[0], columns(ForceSpec(4, spec.effects, 0.03))[0])


def test_forces_of_a_steady_insertion_balance() -> None:
    spec = ForceSpec(7, (), 0.0, POOR, POOR_HELD_OUT)
    trials = force._training(spec)
    shown = force._force_n(trials, ())
    motion = trajectory(MotionKind.CONSTANT)
    depth, speed = motion.depth_mm[::2], motion.velocity_mm_s[::2]
    friction = trials.tissue.friction_n_mm[:, 0]
    cutting = trials.tissue.cutting_n[:, 0]
    lag = speed * 0.0053  # of the filter
    inwards = (speed > 4.999) & (depth > 30)
    fresh = base.PRESLIDING_MM * friction  # what is not loaded yet behind the tip
    wanted = friction * (depth - lag)[inwards, None] - fresh + cutting
    assert np.abs(shown[inwards] - wanted).max() < 2e-3
    outwards = (speed < -4.999) & (depth > 5) & (depth < 60)
    assert np.abs(shown[outwards] + friction * (depth - lag)[outwards, None]).max() < 2e-3
    air = depth < -0.1
    assert np.abs(shown[air]).max() < 1e-3


def test_the_filter_lags_by_its_time_constant() -> None:
    ramp = np.arange(400.0)[:, None] * 0.01
    lag = ramp - force._filtered(ramp)
    assert lag[0] == 0.0
    assert lag[-1] == pytest.approx(1 / (2 * np.pi * 30), rel=1e-9)


@pytest.mark.parametrize("kinds", [RICH, POOR, (MotionKind.DITHER,)])
def test_the_lumped_base_of_the_readme_is_what_the_elements_make(kinds: tuple[MotionKind, ...]) -> None:
    trials = force._training(ForceSpec(5, training=kinds))
    shown = force._force_n(trials, ())
    for r, motion in enumerate(trials.trajectories):
        length = trials.tissue.compliance.bristle_mm[r, 0] + base.NODE_MM
        lumped, state = np.zeros((len(motion.depth_mm), 1)), 0.0
        for k, (depth, step) in enumerate(zip(motion.depth_mm[1:], np.diff(motion.depth_mm), strict=True), start=1):
            state = np.sign(step) + (state - np.sign(step)) * np.exp(-abs(step) / length)
            friction = trials.tissue.friction_n_mm[r, 0] * max(depth, 0.0) * state
            onset = 1.0 - np.exp(-max(depth, 0.0) / base.ONSET_MM)
            lumped[k] = friction + trials.tissue.cutting_n[r, 0] * onset * (1.0 + state) / 2.0
        error = force._filtered(lumped)[::2, 0] - shown[:, r]
        assert error.std() < 0.05 * NOISE_N


def test_scatter_between_trials_is_within_what_is_said() -> None:
    seeds = [np.random.SeedSequence(9, spawn_key=(i,)) for i in range(200)]
    tissue = base.specimen(seeds, 0.0)
    for values, nominal, part in (
        (tissue.friction_n_mm[:, 0], base.FRICTION_N_MM, 0.15), (tissue.cutting_n[:, 0], base.CUTTING_N, 0.15),
        (tissue.compliance.bristle_mm[:, 0], base.PRESLIDING_MM, 0.10),
    ):  # fmt: skip
        error = values / nominal - 1.0
        assert np.abs(error).max() <= part
        assert error.std() == pytest.approx(part / np.sqrt(3), rel=0.15)


@pytest.mark.parametrize("level", [0.03, 0.10])
def test_heterogeneity_has_its_level_and_its_correlation(level: float) -> None:
    seeds = [np.random.SeedSequence(11, spawn_key=(i,)) for i in range(300)]
    flat, rough = base.specimen(seeds, 0.0), base.specimen(seeds, level)
    for even, uneven in ((flat.friction_n_mm, rough.friction_n_mm), (flat.cutting_n, rough.cutting_n)):
        error = uneven / even - 1.0
        assert error.std() == pytest.approx(level, rel=0.05)
        four = np.mean(error[:, 4:] * error[:, :-4]) / np.mean(error**2)  # 5 mm apart
        assert four == pytest.approx(np.exp(-1.0), abs=0.05)


def test_noise_has_its_strength_and_colour() -> None:
    noise = force._noise(np.random.default_rng(5), 200_000)
    assert noise.std() == pytest.approx(NOISE_N, rel=0.02)
    lags = [np.mean(noise[k:] * noise[:-k]) / np.mean(noise**2) for k in (1, 2, 5)]
    assert lags == pytest.approx([0.6 * 0.8**k for k in (1, 2, 5)], abs=0.015)
    recorded = force.noise_record(5)
    assert len(recorded) == 3000
    assert recorded.columns["force_n"].std() == pytest.approx(NOISE_N, rel=0.1)


def test_recorded_values_have_the_quanta_of_their_sensors() -> None:
    trial = generate(ForceSpec(2))[0].trials[0]
    for name, quantum in (("force_n", 0.002), ("depth_mm", 0.005)):
        steps = trial.columns[name] / quantum
        assert np.abs(steps - np.round(steps)).max() < 1e-6
    assert np.diff(trial.columns["time_s"]) == pytest.approx(0.02)


@pytest.mark.parametrize("name", ForceName)
def test_size_zero_is_the_base_to_the_last_bit(name: ForceName) -> None:
    trials = force._training(ForceSpec(13, (), 0.03))
    drawn = FORCE_EFFECTS[name].drawn(np.random.default_rng(1), 66.0)
    assert drawn.size == 0.0
    assert np.array_equal(force._force_n(trials, (drawn,)), force._force_n(trials, ()))


@pytest.mark.slow
@pytest.mark.parametrize("name", ForceName)
def test_sizes_are_reached(name: ForceName) -> None:
    spec = ForceSpec(17, (Wanted(name, 0.5),), 0.0)
    _, truth = generate(spec)
    (hidden,) = truth.effects
    assert hidden.noise_multiple == pytest.approx(0.5, rel=0.02)
    assert hidden.rms == pytest.approx(0.5 * NOISE_N, rel=0.02)
    assert 0 < abs(hidden.parameters["size"]) <= FORCE_EFFECTS[name].LARGEST


@pytest.mark.slow
@pytest.mark.parametrize("multiple", [0.05, 6.0])
def test_sizes_are_reached_far_below_and_above_the_noise(multiple: float) -> None:
    for name in (ForceName.TISSUE_MOTION, ForceName.CUTTING_LAYER):
        (hidden,) = generate(ForceSpec(18, (Wanted(name, multiple),)))[1].effects
        assert hidden.noise_multiple == pytest.approx(multiple, rel=0.02)


def test_a_size_that_nobody_would_believe_is_not_taken() -> None:
    spec = ForceSpec(19, (Wanted(ForceName.FRESH_CUTTING, 1.0),), 0.0, POOR, POOR_HELD_OUT)
    (hidden,) = generate(spec)[1].effects
    assert hidden.parameters["size"] == 1.0
    assert hidden.noise_multiple < 0.2


def test_two_effects_have_both_their_sizes() -> None:
    wanted = (Wanted(ForceName.VISCOUS, 1.0), Wanted(ForceName.PUNCTURE, 0.5))
    hidden = generate(ForceSpec(23, wanted))[1].effects
    assert [each.name for each in hidden] == ["viscous", "puncture"]
    assert [each.noise_multiple for each in hidden] == pytest.approx([1.0, 0.5], rel=0.02)


@pytest.mark.slow
def test_what_calibration_absorbs_and_what_is_left() -> None:
    names = (ForceName.GAIN, ForceName.BIAS, ForceName.MOTOR_RIPPLE)
    absorbed, rest = zip(*(
        (hidden.absorbed, hidden.noncentrality)
        for name in names for hidden in generate(ForceSpec(27, (Wanted(name, 1.0),)))[1].effects
    ), strict=True)  # fmt: skip
    assert absorbed[0] > 0.999
    assert rest[0] < 10.0
    assert 0.0 < absorbed[1] < 0.9
    assert absorbed[2] < 0.05
    assert rest[2] > 1000.0


def test_noncentrality_is_what_the_likelihood_would_see() -> None:
    rng = np.random.default_rng(3)
    added = np.sin(np.arange(400) / 9.0)[:, None, None] * 0.01
    base_column = np.arange(400.0)[:, None, None, None]
    lags = np.arange(400)
    covariance = NOISE_N**2 * (0.4 * np.eye(400) + 0.6 * 0.8 ** np.abs(lags[:, None] - lags))
    inverse = np.linalg.inv(covariance)
    signal, column = added[:, 0, 0], base_column[:, 0, 0, 0]
    taken = (column @ inverse @ signal) ** 2 / (column @ inverse @ column)
    whole = signal @ inverse @ signal
    absorbed, rest = left(added, base_column, force.COLOUR)
    assert rest == pytest.approx(whole - taken, rel=0.03)
    assert absorbed == pytest.approx(taken / whole, abs=0.02)
    white = force.COLOUR.whitened(force._noise(rng, 50_000))
    assert white.std() == pytest.approx(1.0, rel=0.02)
    assert abs(np.mean(white[1:] * white[:-1])) < 0.02


def test_the_difference_to_the_base_is_the_effect() -> None:
    bias = ForceSpec(29, (Wanted(ForceName.BIAS, 3.0),))
    moved = np.concatenate(columns(bias)) - np.concatenate(columns(ForceSpec(29)))
    assert np.abs(np.abs(moved) - 0.09).max() < 0.0021


def test_one_more_trial_of_somebody_elses_motion() -> None:
    spec = ForceSpec(31, (Wanted(ForceName.BIAS, 5.0),))
    motion = from_depths("mine", np.array([0.0, 6.0, 8.0, 14.0]), np.array([-2.0, 28.0, 28.0, -2.0]))
    first, again, second = (force.another(spec, motion, number) for number in (0, 0, 1))
    assert np.array_equal(first.columns["force_n"], again.columns["force_n"])
    assert not np.array_equal(first.columns["force_n"], second.columns["force_n"])
    assert first.columns["depth_mm"].max() == pytest.approx(28.0, abs=0.02)
    assert first.role is Role.TRAIN
    with pytest.raises(ValueError, match="in the air"):
        from_depths("bad", np.array([0.0, 1.0]), np.array([2.0, 3.0]))


@pytest.mark.parametrize("kind", MotionKind)
def test_motions_are_what_they_say(kind: MotionKind) -> None:
    motion = trajectory(kind)
    assert len(motion.time_s) == 3100
    assert motion.depth_mm[[0, -1]] == pytest.approx([AIR_MM, AIR_MM], abs=0.02)
    assert motion.depth_mm.max() <= 70.1
    assert np.gradient(motion.depth_mm, motion.time_s) == pytest.approx(motion.velocity_mm_s, abs=0.6)
    speeds = {MotionKind.CONSTANT_SLOW: 2.5, MotionKind.CONSTANT: 5.0, MotionKind.CONSTANT_FAST: 8.0}
    if kind in speeds:
        assert np.abs(motion.velocity_mm_s).max() == pytest.approx(speeds[kind], rel=0.002)
    holds = {MotionKind.HOLDS, MotionKind.RICH_A, MotionKind.RICH_B, MotionKind.RICH_C}
    resting = (motion.phase == "hold").sum() * 0.01
    assert (resting > 2.5) == (kind in holds)


def test_no_training_motion_is_held_out() -> None:
    assert not {*POOR} & {*POOR_HELD_OUT}
    assert not {*RICH} & {*RICH_HELD_OUT}


@pytest.mark.parametrize("kind", FileKind)
def test_files_are_read_as_they_were_meant(kind: FileKind, tmp_path: Path) -> None:
    data, _ = generate(ForceSpec(37))
    for path, trial in zip(data.write(tmp_path, kind), data.trials, strict=True):
        (record,) = read_records(path)
        assert (record.trial, record.role) == (trial.name, trial.role)
        for name in ("time_s", "depth_mm", "velocity_mm_s", "force_n"):
            assert np.allclose(record.columns[name], trial.columns[name], atol=6e-5)
    assert [each.role for each in data.trials] == ["train"] * 3 + ["holdout"] * 2 + ["noise"]


def test_the_truth_is_never_with_the_data(tmp_path: Path) -> None:
    data, truth = generate(ForceSpec(41, (Wanted(ForceName.DRIFT, 1.0),)))
    files = data.write(tmp_path / "data")
    with pytest.raises(ValueError, match="with the data"):
        truth.write(tmp_path / "data" / "below", tmp_path / "data")
    path = truth.write(tmp_path / "truth", tmp_path / "data")
    assert json.loads(path.read_text())["effects"][0]["name"] == "drift"
    assert sorted((tmp_path / "data").iterdir()) == sorted(files)
    for file in files:
        assert "drift" not in file.read_text()
